"""A diagnosis: which effect makes a rig's runs differ from the model, where, and by how much."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import jax
import numpy as np

from diagnose import odd_runs
from diagnose.added import Added, effects_of, most_helpful
from diagnose.bench import Bench
from diagnose.case import Case
from diagnose.caveats import caveats
from diagnose.chance import chance
from diagnose.cut import Share
from diagnose.evidence import FLOOR
from diagnose.floor import noise_floors
from diagnose.hypothesis import Hypothesis, beliefs, foremost, left_of
from diagnose.left_out import Unseen, at_mean_sinkage, predicted_unseen
from diagnose.mean_sinkage import REFERENCE, WITH, not_met, residuals_of
from diagnose.next_run import next_run
from diagnose.plates import own_errors
from diagnose.search import Found, Report, search
from diagnose.shrinkage import Gap, gaps
from diagnose.stages import stages
from diagnose.steps import Step, one_by_one
from diagnose.unwritten import Correction, Unwritten, unwritten
from diagnose.verdict import by_name, in_another_form, rivals_of, stands_for, verdict_of
from diagnose.weights import NONE, UNKNOWN, Judged, weights
from diagnose.where import by_stage, where
from drftjax.effects.catalogue import effect_class, numbers, spoken, spoken_of
from drftjax.effects.stage import AbstractEffect
from identify.summary import summary_html, summary_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCHEMA = "drft-diagnosis"
# Hypotheses whose prediction of left-out runs is simulated: the leading ones of each kind.
JUDGED_SINGLES, JUDGED_PAIRS = 4, 4


@dataclass(frozen=True)
class Number:
    """A fitted number of an effect.

    Attributes:
        value, error: The number and its standard error, in `unit`.
        unit: "-" for none.
    """

    value: float
    error: float
    unit: str


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis:
    """What was found.

    Attributes:
        verdict: Effects that explain the runs, or ("none",), or ("unknown",).
        weights: Weight of each effect, of none and of unknown.
        groups: Names that these runs cannot tell apart, the likeliest first.
        added: What shrinks the gap, as model.toml holds it: the verdict's effects, or a curve that
            is one of another form than the list's. Where the verdict is unknown, the likeliest
            effect known or a correction, if either helps.
        steps: The same as two effects are added one by one; empty where there are not two.
        parameters: Numbers of the effects added, by effect and field; none of a correction.
        notes: What else must be known, in sentences.
        next_run: What would tell the group apart; empty where nothing need be.
        found: The search behind it.
        chosen: The hypothesis that the verdict stands for: the reference model for none, the
            likeliest effect known for unknown.
        before: By run, simulated less recorded by the reference model with the zeta that meets the
            run's mean sinkage, shape (channels, samples).
        floors: Noise floor of each channel [m, N, N m].
        where: Shares of the gap by axis.
        unwritten: What an effect that explains the runs looks like, where no form of the list does.
    """

    verdict: tuple[str, ...]
    weights: Mapping[str, float]
    groups: Sequence[Sequence[str]]
    added: Added
    parameters: Mapping[str, Mapping[str, Number]]
    notes: Sequence[str]
    next_run: Mapping[str, object]
    found: Found
    chosen: Hypothesis
    before: list[np.ndarray]
    floors: Mapping[str, float]
    where: Sequence[Share] = field(default_factory=list)
    unwritten: Unwritten | None = None
    steps: Sequence[Step] = field(default_factory=list)

    @property
    def case(self) -> Case:
        return self.found.bench.case

    @property
    def origin(self) -> float | None:
        """Recorded x that the effects' x = 0 stands for [m]; None where x is as recorded."""
        return self.case.candidates[0].setup.start.origin

    @property
    def gap(self) -> Mapping[str, Gap]:
        """Before, and after with what is added, on runs left out, by channel."""
        return self.added.gap

    @property
    def correction(self) -> Correction | None:
        """The curve that is added in the place of an effect that nobody has written."""
        tried = None if self.unwritten is None else self.unwritten.tried
        return tried if tried is not None and tried.added is self.added else None

    def meaning(self, name: str) -> str:
        """What an effect of the verdict does; it may be of the user's own and in no catalogue."""
        given = {each.effect.about.name: each.effect for each in self.found.bench.variants}
        return (given.get(name) or effect_class(name)).about.meaning

    def summary(self, width: int = 110) -> str:
        """Verdict, gaps and all else in words, as text so many columns wide."""
        from diagnose.report import in_words

        return summary_text(in_words(self), width)

    def __repr__(self) -> str:
        return f"<Diagnosis of {len(self.case.candidates)} runs: {', '.join(self.verdict)}>"

    def _repr_html_(self) -> str:
        from diagnose.report import in_words

        return summary_html(in_words(self))

    def plot(self) -> "Figure":
        """The gap before and after against the noise floor, and where it lies."""
        from diagnose.report_figures import at_a_glance

        return at_a_glance(self)

    def write(self, folder: str | Path) -> list[Path]:
        """Write diagnosis.json, model.toml and report.html, as `drft diagnose -o` does.

        Raises:
            InputError: where one cannot be written.
        """
        from diagnose.report import write

        with jax.enable_x64(True):
            return write(self, Path(folder))

    def document(self) -> dict:
        """The diagnosis as plain values, in the layout of diagnosis.json."""
        return {
            "schema": SCHEMA,
            "schema_version": 1,
            "verdict": list(self.verdict),
            "weights": dict(self.weights),
            "groups": [list(group) for group in self.groups],
            "gap": {channel: gap.document() for channel, gap in self.gap.items()},
            "steps": [each.document() for each in self.steps],
            "where": [
                {
                    "axis": each.axis,
                    "label": each.label,
                    "share": each.share,
                    "interval": list(each.interval),
                }
                for each in self.where
            ],
            "parameters": {
                name: {
                    number: {"value": n.value, "error": n.error, "unit": n.unit}
                    for number, n in fields.items()
                }
                for name, fields in self.parameters.items()
            },
            "correction": None if self.correction is None else self.correction.document(),
            "next_run": dict(self.next_run),
            "notes": list(self.notes),
        }


def diagnose(
    case: Case,
    effects: Sequence[type[AbstractEffect]],
    report: Report = lambda stage: None,
) -> Diagnosis:
    """Find which effects explain the runs of a case.

    Args:
        case: Runs of one rig.
        effects: Effects to choose from.
        report: Called with what is done next.

    Raises:
        InputError: where the runs cannot be simulated.
    """
    found = search(case, effects, report)
    report("predicting the runs left out")
    leading = [*foremost(found.singles, JUDGED_SINGLES), *foremost(found.pairs, JUDGED_PAIRS)]
    of_each = case.side_by_side(lambda each: predicted_unseen(found.bench, each), leading)
    # With numbers at which a run left out cannot be simulated an effect explains nothing.
    unseen = {each.hypothesis.names: each for each in of_each if case.sound(each.residual)}
    leading = [each for each in leading if each.names in unseen]
    share = _weights(found, leading, unseen)
    verdict, groups = verdict_of(share)
    chosen = stands_for(found, leading, share, verdict)
    alone = at_mean_sinkage(found.bench, predicted_unseen(found.bench, found.none))
    met = at_mean_sinkage(found.bench, unseen[chosen.names]) if chosen.names else alone
    before, after = residuals_of(alone), residuals_of(met)
    own = own_errors(case, found.none.log_zeta)
    floors, how = noise_floors(case, before, after, own, found.none.by_zeta)
    known = Added(effects_of(chosen), chosen.log_zeta, met, gaps(case, before, after, floors))
    rivals = rivals_of(found, leading, share, verdict)
    report("where the gap lies")
    places = list(where(case, before, dict(floors)))
    notes = [
        how,
        *caveats(case),
        *odd_runs.of_repeats(case, [before, after], own, found.none.by_zeta),
        *odd_runs.by_zeta(found.bench, chosen),
    ]
    signal, added, lies = None, known, []
    if verdict != (NONE,):
        lies = stages(case, found.none.log_zeta)
        places += by_stage(lies)
    if verdict == (UNKNOWN,):
        if lies:
            report("what an effect that explains it would look like")
            signal = unwritten(case, lies, found.none, before, floors, places)
        curve = None if signal is None or signal.tried is None else signal.tried.added
        reference = Added((), found.none.log_zeta, alone, gaps(case, before, before, floors))
        added = most_helpful([known] if curve is None else [known, curve], reference)
        notes += [] if signal is None else signal.sentences(added is curve)
        notes += odd_runs.alone_in_the_gap(case, places, before, floors)
        meant = signal.tried.means if added is curve and signal and signal.tried else None
        if meant in {spoken_of(each.about.name) for each in effects}:
            share = in_another_form(share, meant)
            verdict, groups = (meant,), [[meant]]
    notes += not_met(case, alone, REFERENCE)
    notes += not_met(case, added.met, WITH) if added.effects else []
    report("what to run next")
    advice = next_run(case, chosen, rivals, floors) if rivals else {}
    return Diagnosis(
        verdict=spoken(verdict),
        weights=by_name(share),
        groups=[spoken(group) for group in groups],
        added=added,
        parameters=_parameters(found.bench, chosen) if chosen.names and added is known else {},
        notes=notes,
        next_run=advice,
        found=found,
        chosen=chosen,
        before=before,
        floors=floors,
        where=places,
        unwritten=signal,
        steps=(
            one_by_one(found, chosen, unseen, before, floors, known.gap)
            if verdict == chosen.names and added is known
            else []
        ),
    )


def _weights(
    found: Found,
    leading: Sequence[Hypothesis],
    unseen: Mapping[tuple[str, ...], Unseen],
) -> dict[tuple[str, ...], float]:
    products = found.bench.products
    none = found.none.line
    judged = [Judged((), none.left, none.left, none.scatter, 0)]
    for each in leading:
        left, _ = left_of(found.bench, unseen[each.names].residual)
        line = each.line
        judged.append(Judged(each.names, left, line.left, line.scatter, len(each.coordinates)))
    total = products.number.sum(axis=0)
    runs = len(products.log_zeta)
    noise = found.bench.noise
    residuals = [each.residual for each in (found.none, *leading)]
    differ = chance(found.bench.case, residuals, found.none.by_zeta)
    return weights(judged, products.blocks, total, noise, runs, chance=differ)


def _parameters(bench: Bench, chosen: Hypothesis) -> dict[str, dict[str, Number]]:
    """The chosen effects' numbers with standard errors, by their own columns.

    What is believed of a number before any run bounds the error of one that the runs do not tell.
    """
    products = bench.products_of(chosen.columns, chosen.residual, chosen.log_zeta)
    worth = np.array([1.0 if kind == "slow" else 0.1 for _, kind in products.blocks])
    floor = np.array([FLOOR[block] for block in products.blocks]) ** 2
    weight = worth / (chosen.line.left + floor)
    gram = np.einsum("b,rbij->rij", weight, products.gram[:, :, :-1, :-1])
    width, _ = beliefs(chosen.model)
    information = np.diag(1 / width**2)
    for run in gram:
        own = max(run[0, 0], 1e-300)
        information += run[1:, 1:] - np.outer(run[1:, 0], run[0, 1:]) / own
    error = np.sqrt(np.diag(np.linalg.inv(information)))
    found: dict[str, dict[str, Number]] = {}
    for free, at, spread in zip(chosen.model.free, chosen.coordinates, error, strict=True):
        effect = chosen.model.effects[free.index]
        value = float(free.value(at))
        scale = free.scale if free.scale is not None else value
        fields = found.setdefault(spoken_of(effect.about.name), {})
        unit = numbers(effect)[free.field]["unit"]
        fields[free.field] = Number(value, float(scale * spread), unit)
    return found
