"""One set's label beside its answer: what it gets right."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import hypot

from diagnose.blind.answers.answer_file import Answer
from diagnose.gap.gap import is_reducible
from drftjax.effects.catalogue import reported_name

NONE, UNKNOWN = "none", "unknown"
SINGLE, PAIR = "single", "pair"
SEVERAL, CHANGE, SWEEP = "several", "change", "sweep"
PLAIN, FAINT = "plain", "faint"


@dataclass(frozen=True)
class ScoreSettings:
    """Thresholds of the scores.

    Attributes:
        faint_floors: Size below which a set is faint [noise floors]; of a pair, the weaker effect
            counts.
        confident_weight: Weight above which an answer is confident [-].
        calibration_bins: Number of equal bins of weights from zero to one.
        shrinkage_tolerance: Greatest difference of a realised shrinkage from the promised one that
            is kept [-].
        budget_tolerance: Greatest difference of a share in the budget from the true one [-].
        size_tolerance: Greatest difference of a change's size from the true one, over that [-].
        likely_weight: Weight over which something outside the list is told beside names [-].
    """

    faint_floors: float = 3.0
    confident_weight: float = 0.8
    calibration_bins: int = 10
    shrinkage_tolerance: float = 0.10
    budget_tolerance: float = 0.10
    size_tolerance: float = 0.20
    likely_weight: float = 0.5


DEFAULT_SCORING = ScoreSettings()


@dataclass(frozen=True)
class ScoredSet:
    """Label of a set beside its answer.

    Attributes:
        name: Name of the set.
        true: Effects that it has; "unknown" for a mechanism outside the catalogue.
        floors: Size of the weakest effect [noise floors]; None if the label does not say.
        answer: Answer to the set.
        settings: Thresholds of the scores.
        label: The whole label.
    """

    name: str
    true: tuple[str, ...]
    floors: float | None
    answer: Answer
    settings: ScoreSettings = DEFAULT_SCORING
    label: Mapping = field(default_factory=dict)

    @property
    def kind(self) -> str:
        """Kind of the set: what is wrong with a single rig, or the kind that the label states.

        Plain or faint where the size is known, but for sets of several effects, which are plain.
        """
        made = self.label.get("kind", SINGLE)
        if made == SEVERAL:
            return SEVERAL
        if not self.true:
            return NONE if made == SINGLE else f"{made}, {NONE}"
        kind = UNKNOWN if UNKNOWN in self.true else SINGLE if len(self.true) == 1 else PAIR
        kind = kind if made == SINGLE else made
        if self.floors is None:
            return kind
        return f"{kind}, {PLAIN if self.floors >= self.settings.faint_floors else FAINT}"

    @property
    def is_faint(self) -> bool:
        """True if the runs hardly show the effects."""
        return self.kind.endswith(FAINT)

    @property
    def right_names(self) -> frozenset[str]:
        """Names that are right for this set."""
        return frozenset(self.true or (NONE,))

    @property
    def first(self) -> str:
        """First name of the answer."""
        return next(iter(self.answer.named()), NONE)

    def is_right(self, hypothesis: str) -> bool:
        """True if every name of a hypothesis, joined by +, is right for this set."""
        return all(each.strip() in self.right_names for each in hypothesis.split("+"))

    @property
    def first_is_right(self) -> bool:
        """True if the first name is right; with one effect, it must be the only name."""
        alone = len(self.true) != 1 or len(self.answer.verdict) == 1
        return alone and self.first in self.right_names

    @property
    def all_named(self) -> bool:
        """True if the answer names every effect of the set and nothing else."""
        return frozenset(self.answer.named() or (NONE,)) == self.right_names

    @property
    def in_group(self) -> bool:
        """True if every effect of the set is named, or in the group of one that is."""
        return self.right_names <= self._offered

    @property
    def group_size(self) -> int:
        """Number of effects offered: those named and all in their groups.

        For a pair, those offered for the first.
        """
        if len(self.true) == 1:
            return len(self._offered)
        groups = (each for each in self.answer.groups if self.first in each)
        return max(1, len(set(next(groups, ()))))

    @property
    def _offered(self) -> frozenset[str]:
        return frozenset({self.first, *self.answer.named()}.union(*self.answer.groups))

    @property
    def confident_names(self) -> list[bool]:
        """For every effect with a confident weight, True if the rig does not have it."""
        return [
            not self.is_right(name)
            for name, weight in self.answer.weights.items()
            if weight > self.settings.confident_weight and name not in (NONE, UNKNOWN)
        ]

    @property
    def confidently_wrong(self) -> bool:
        """True if an effect that the rig does not have has a confident weight."""
        return any(self.confident_names)

    @property
    def unknown_is_told(self) -> bool:
        """True if the answer says that something outside the list acts, alone or beside names."""
        beside = self.answer.weights.get(UNKNOWN, 0.0)
        return self.first == UNKNOWN or beside > self.settings.likely_weight

    @property
    def effects_offered(self) -> list[bool]:
        """For every effect of the set, True if it is named or in the group of one that is."""
        return [name in self._offered for name in self.true]

    @property
    def worse_channels(self) -> list[bool]:
        """For every channel of the answer, True if its gap is larger with the effects named."""
        return [gap.after_mm > gap.before_mm for gap in self.answer.gap.values()]

    @property
    def budget_shares(self) -> list[bool]:
        """True for each share that the budget states within the tolerance.

        Shares of effects that are there, and of those that the answer names besides, whose true
        share is zero, in every channel with a gap to share out. A group has one joint share, that
        of the effect which is named. Empty without a budget.
        """
        if self.answer.budget is None:
            return []
        stated = self.answer.budget.channels
        within = []
        for channel, truth in self.label.get("budget", {}).get("channels", {}).items():
            given = stated.get(channel)
            if given is not None and not is_reducible(truth["before"], given.floor):
                continue
            shares = {} if given is None else {n: e.share for n, e in given.effects.items()}
            true: dict[str, float] = {}
            for name, each in truth["effects"].items():
                stated_as = self._stated_as(name)
                true[stated_as] = true.get(stated_as, 0.0) + each["share"]
            within += [
                abs(shares.get(name, 0.0) - true.get(name, 0.0)) <= self.settings.budget_tolerance
                for name in sorted({*true, *shares})
            ]
        return within

    def _stated_as(self, name: str) -> str:
        """The effect that the answer names for one of the set: itself, or the first of its group.

        Where that one is in the set too, it speaks for itself alone.
        """
        firsts = (
            each[0] for each in self.answer.groups if name in each and each[0] not in self.true
        )
        return name if name in self.answer.named() else next(firsts, name)

    @property
    def size_is_right(self) -> bool | None:
        """True if the size of a change that is named is within the tolerance.

        None where the change is not named, or has no number that means the same in both.
        """
        size = self.label.get("size")
        if size is None or not self.first_is_right:
            return None
        fields = next(
            (n for name, n in self.answer.parameters.items() if reported_name(name) == self.first),
            {},
        )
        values = [fields[name].value for name in size["numbers"] if name in fields]
        if len(values) < len(size["numbers"]):
            return False
        # A vector has a length without a sign.
        stated = values[0] if len(values) == 1 else hypot(*values)
        return abs(stated - size["value"]) <= self.settings.size_tolerance * abs(size["value"])


def scored_sets(
    labels: Mapping[str, dict],
    answers: Mapping[str, Answer],
    settings: ScoreSettings = DEFAULT_SCORING,
) -> list[ScoredSet]:
    """Labels beside their answers, for every set that has both."""
    return [
        ScoredSet(name, tuple(label["effects"]), _floors(label), answers[name], settings, label)
        for name, label in sorted(labels.items())
        if name in answers
    ]


def _floors(label: dict) -> float | None:
    single = [each["floors"] for each in label.get("mechanisms", ())]
    return min(single) if single else label.get("floors")
