"""How good answers to blind sets are, once their labels are open."""

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from diagnose.blind.answers.answer_file import Answer, read_answers
from diagnose.blind.generation.sealed_labels import open_labels
from diagnose.blind.scoring.proportion import Proportion
from diagnose.gap.gap import is_reducible, share_removed
from drftjax.common.errors import InputError

NONE, UNKNOWN = "none", "unknown"


# What shows by fewer floors than this is faint; of a pair, the weaker one counts.
FAINT_FLOORS = 3.0


CONFIDENT = 0.8


BINS = 10


# A promise is kept where the realised shrinkage lies within ten points of it.
PROMISE = 0.10


SINGLE, PAIR = "single", "pair"


PLAIN, FAINT = "plain", "faint"


@dataclass(frozen=True)
class ScoredSet:
    """A set's label beside its answer.

    Attributes:
        name: The set.
        true: Effects that it has; "unknown" for one outside the catalogue.
        floors: How much they show, where labels say it; of several, the weakest.
        answer: What was answered.
    """

    name: str
    true: tuple[str, ...]
    floors: float | None
    answer: Answer

    @property
    def kind(self) -> str:
        """Single, pair, unknown or none, and how plainly it shows where that is stated."""
        if not self.true:
            return NONE
        kind = UNKNOWN if UNKNOWN in self.true else SINGLE if len(self.true) == 1 else PAIR
        if self.floors is None:
            return kind
        return f"{kind}, {PLAIN if self.floors >= FAINT_FLOORS else FAINT}"

    @property
    def tellable(self) -> bool:
        """Whether a gap, or that there is none, can be told from these runs."""
        return not self.kind.endswith(FAINT)

    @property
    def right_names(self) -> frozenset[str]:
        """Every name that is right here."""
        return frozenset(self.true or (NONE,))

    @property
    def first(self) -> str:
        """The answer at first place."""
        return next(iter(self.answer.named()), NONE)

    def holds(self, explanation: str) -> bool:
        """Whether an explanation, one name or several joined by +, is right as far as it goes."""
        return all(each.strip() in self.right_names for each in explanation.split("+"))

    @property
    def is_first(self) -> bool:
        """Whether what leads is there; of one effect, and it alone is named."""
        alone = len(self.true) != 1 or len(self.answer.verdict) == 1
        return alone and self.first in self.right_names

    @property
    def all_named(self) -> bool:
        """Whether each effect is named, and nothing else."""
        return frozenset(self.answer.named() or (NONE,)) == self.right_names

    @property
    def in_group(self) -> bool:
        """Whether each effect is named, or in the group of one that is."""
        return self.right_names <= self._offered

    @property
    def group_size(self) -> int:
        """How many effects are offered for one: those named, and all in their groups.

        Of a pair, those offered for the first.
        """
        if len(self.true) == 1:
            return len(self._offered)
        groups = (each for each in self.answer.groups if self.first in each)
        return max(1, len(set(next(groups, ()))))

    @property
    def _offered(self) -> frozenset[str]:
        return frozenset({self.first, *self.answer.named()}.union(*self.answer.groups))

    @property
    def confidently_wrong(self) -> bool:
        """Whether an effect that the rig does not have is all but certain."""
        return any(
            weight > CONFIDENT and name not in (NONE, UNKNOWN) and not self.holds(name)
            for name, weight in self.answer.weights.items()
        )


def scored_sets(labels: Mapping[str, dict], answers: Mapping[str, Answer]) -> list[ScoredSet]:
    """Labels beside their answers, for every set that has both."""
    return [
        ScoredSet(name, tuple(label["effects"]), _floors(label), answers[name])
        for name, label in sorted(labels.items())
        if name in answers
    ]


def _floors(label: dict) -> float | None:
    apart = [each["floors"] for each in label.get("mechanisms", ())]
    return min(apart) if apart else label.get("floors")


def _share(over: Iterable[ScoredSet], of: Callable[[ScoredSet], bool]) -> dict:
    held = [of(case) for case in over]
    return Proportion(sum(held), len(held)).document()


def _held(promises: Iterable[bool | None]) -> dict:
    """The share of intervals that held; without those that were not given."""
    given = [each for each in promises if each is not None]
    return Proportion(sum(given), len(given)).document()


def _order(kind: str) -> tuple[int, bool]:
    return (SINGLE, PAIR, UNKNOWN, NONE).index(kind.split(",")[0]), kind.endswith(FAINT)


def by_kind(given: list[ScoredSet]) -> dict[str, dict]:
    """Counts and shares for each kind of set that there is."""
    table = {}
    for kind in sorted({case.kind for case in given}, key=_order):
        these = [case for case in given if case.kind == kind]
        row: dict = {
            "sets": len(these),
            "first": _share(these, lambda case: case.is_first),
            "in_group": _share(these, lambda case: case.in_group),
            "mean_group_size": sum(case.group_size for case in these) / len(these),
            "confidently_wrong": _share(these, lambda case: case.confidently_wrong),
        }
        if kind == NONE:
            row["false_alarms"] = _share(these, lambda case: bool(case.answer.named()))
        elif kind.startswith(UNKNOWN):
            row["recognised"] = _share(these, lambda case: case.first == UNKNOWN)
        else:
            row["missed"] = _share(these, lambda case: not case.answer.named())
            row["called_unknown"] = _share(these, lambda case: case.first == UNKNOWN)
        if kind.startswith(PAIR):
            row["both"] = _share(these, lambda case: case.all_named)
            row["at_least_one"] = _share(
                these, lambda case: bool(case.right_names & set(case.answer.named()))
            )
        table[kind] = row
    return table


def confusion(given: list[ScoredSet]) -> dict[str, dict[str, int]]:
    """How often each truth was answered by what; names of a pair are joined by +."""
    matrix: dict[str, Counter] = defaultdict(Counter)
    for case in given:
        truth = " + ".join(sorted(case.true)) or NONE
        matrix[truth][" + ".join(sorted(case.answer.named())) or NONE] += 1
    return {truth: dict(sorted(row.items())) for truth, row in sorted(matrix.items())}


def calibration(given: list[ScoredSet]) -> list[dict]:
    """For weights in ten equal bins: how many, their mean, and the share that was right."""
    bins: list[list[tuple[float, bool]]] = [[] for _ in range(BINS)]
    for case in given:
        for name, weight in case.answer.weights.items():
            # 0.3 times ten is 3 only nearly.
            index = int(BINS * weight + 1e-9)
            bins[min(max(index, 0), BINS - 1)].append((weight, case.holds(name)))
    return [
        {
            "from": index / BINS,
            "to": (index + 1) / BINS,
            "mean_weight": sum(w for w, _ in held) / len(held) if held else None,
            "right": Proportion(sum(right for _, right in held), len(held)).document(),
        }
        for index, held in enumerate(bins)
    ]


def shrinkage(given: list[ScoredSet]) -> dict[str, dict]:
    """Promised against realised shrinkage of the misfit on fresh runs, by channel.

    Both are shares of what lies above the promise's noise floor. A promise is untried where the
    fresh runs show too little above it.
    """
    found: dict[str, list[dict]] = defaultdict(list)
    untried: Counter[str] = Counter()
    for case in given:
        for channel, fresh in case.answer.fresh.items():
            promise = case.answer.gap.get(channel)
            if promise is None or not is_reducible(promise.before_mm, promise.floor_mm):
                continue
            tried = found[channel]
            if not is_reducible(fresh.before_mm, promise.floor_mm):
                untried[channel] += 1
                continue
            interval, after = promise.shrinkage_interval, fresh.after_mm
            realised = (
                math.nan
                if after is None
                else share_removed(fresh.before_mm, after, promise.floor_mm)
            )
            tried.append(
                {
                    "set": case.name,
                    "promised": promise.shrinkage,
                    "realised": realised,
                    "kept": abs(realised - promise.shrinkage) <= PROMISE + 1e-12,
                    "in_interval": interval and interval[0] <= realised <= interval[1],
                }
            )
    return {
        channel: {
            "kept": Proportion(sum(each["kept"] for each in rows), len(rows)).document(),
            "in_interval": _held(each["in_interval"] for each in rows),
            "untried": untried[channel],
            "sets": rows,
        }
        for channel, rows in sorted(found.items())
    }


def score(labels: Mapping[str, dict], answers: Mapping[str, Answer]) -> dict:
    """Everything there is to say of answers, as plain values."""
    given = scored_sets(labels, answers)
    return {
        "schema": "drft-blind-score",
        "schema_version": 1,
        "sets": len(given),
        "unanswered": sorted(set(labels) - set(answers)),
        "kinds": by_kind(given),
        "confusion": confusion(given),
        "calibration": calibration(given),
        "calibration_without_faint": calibration([case for case in given if case.tellable]),
        "shrinkage": shrinkage(given),
        "wrong": [
            {"set": case.name, "true": list(case.true), "answered": case.answer.named()}
            for case in given
            if not case.all_named
        ],
    }


def open_and_score(
    folders: Sequence[Path], files: Sequence[Path]
) -> tuple[dict[str, dict], dict[str, Answer]]:
    """Labels and answers by the name of the set; of several folders, by folder and set.

    Args:
        folders: Folders of sets with their labels.
        files: The answers to each, in the same order.

    Raises:
        InputError: where a folder has no answers of its own, or one answers what it does not hold.
    """
    if len(folders) != len(files):
        raise InputError(
            f"{len(folders)} folders of sets and {len(files)} files of answers are given; each "
            "folder needs one --answers, in the same order"
        )
    if len({folder.resolve() for folder in folders}) < len(folders):
        raise InputError("a folder of sets is given twice")
    labels: dict[str, dict] = {}
    answers: dict[str, Answer] = {}
    for folder, file in zip(folders, files, strict=True):
        before = f"{folder}/" if len(folders) > 1 else ""
        given, known = read_answers(file), open_labels(folder)
        strangers = sorted(set(given) - set(known))
        if strangers:
            raise InputError(f"{file}: answers {strangers[0]!r}, which {folder} has no label of")
        labels |= {before + name: label for name, label in known.items()}
        answers |= {before + name: answer for name, answer in given.items()}
    return labels, answers
