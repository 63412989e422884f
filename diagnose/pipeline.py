"""A diagnosis: which effect makes a rig's runs differ from the model, where, and by how much."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from diagnose.checks import outlier_runs as odd_runs
from diagnose.checks.caveats import caveats
from diagnose.dataset import Case
from diagnose.gap.cross_validation import Unseen, at_mean_sinkage, predicted_unseen
from diagnose.gap.discretization_error import own_errors
from diagnose.gap.gap import gaps
from diagnose.gap.noise_floor import noise_floors
from diagnose.gap.repeatability import chance
from diagnose.gap.selected_effects import Added, effects_of, most_helpful
from diagnose.gap.stepwise import one_by_one
from diagnose.gap.zeta_matching import REFERENCE, WITH, not_met, residuals_of
from diagnose.hypotheses.hypothesis import Hypothesis, beliefs, foremost, left_of
from diagnose.hypotheses.screening import Found, Report, search
from diagnose.linear.linear_fit import FLOOR
from diagnose.linear.regressors import Bench
from diagnose.localization.localization import where
from diagnose.next_runs.discrimination import next_run
from diagnose.result import Diagnosis, Number
from diagnose.selection.model_weights import NONE, UNKNOWN, Judged, weights
from diagnose.selection.verdict import by_name, in_another_form, rivals_of, stands_for, verdict_of
from diagnose.unknown.correction_fit import unwritten
from diagnose.unknown.disturbances import by_stage, stages
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import numbers, spoken, spoken_of

if TYPE_CHECKING:
    pass

# Hypotheses whose prediction of left-out runs is simulated: the leading ones of each kind.
JUDGED_SINGLES, JUDGED_PAIRS = 4, 4


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
