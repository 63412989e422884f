"""A diagnosis: which effect makes a rig's runs differ from the model, where, and by how much."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from diagnose.checks import outlier_runs as odd_runs
from diagnose.checks.caveats import caveats
from diagnose.dataset import RigDataset
from diagnose.gap.cross_validation import HeldOutPrediction, at_mean_sinkage, predict_held_out
from diagnose.gap.discretization_error import discretization_errors
from diagnose.gap.gap import gaps
from diagnose.gap.noise_floor import noise_floors
from diagnose.gap.repeatability import repeat_variance
from diagnose.gap.selected_effects import SelectedEffects, best_selection, effects_of
from diagnose.gap.stepwise import stepwise_gap
from diagnose.gap.zeta_matching import REFERENCE_NAME, WITH_EFFECTS_NAME, residuals_of, unmatched
from diagnose.hypotheses.hypothesis import Hypothesis, block_mean_squares, prior_widths, top_ranked
from diagnose.hypotheses.screening import Report, ScreeningResult, screen_effects
from diagnose.linear.linear_fit import FLOOR
from diagnose.linear.regressors import Regressors
from diagnose.localization.localization import localize
from diagnose.next_runs.discrimination import next_run
from diagnose.result import Diagnosis, ParameterEstimate
from diagnose.selection.model_weights import NONE, UNKNOWN, ScoredHypothesis, weights
from diagnose.selection.verdict import (
    competing_hypotheses,
    decide,
    hypothesis_behind,
    reassign_unknown,
    weight_by_name,
)
from diagnose.unknown.correction_fit import fit_unknown_effect
from diagnose.unknown.disturbances import by_stage, estimate_disturbances
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import field_metadata, reported_name, reported_names

if TYPE_CHECKING:
    pass

# Hypotheses whose prediction of left-out runs is simulated: the leading ones of each kind.
JUDGED_SINGLES, JUDGED_PAIRS = 4, 4


def diagnose(
    case: RigDataset,
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
    found = screen_effects(case, effects, report)
    report("predicting the runs left out")
    leading = [*top_ranked(found.singles, JUDGED_SINGLES), *top_ranked(found.pairs, JUDGED_PAIRS)]
    of_each = case.map_items(lambda each: predict_held_out(found.regressors, each), leading)
    # With numbers at which a run left out cannot be simulated an effect explains nothing.
    unseen = {each.hypothesis.names: each for each in of_each if case.all_finite(each.residual)}
    leading = [each for each in leading if each.names in unseen]
    share = _weights(found, leading, unseen)
    verdict, groups = decide(share)
    chosen = hypothesis_behind(found, leading, share, verdict)
    alone = at_mean_sinkage(found.regressors, predict_held_out(found.regressors, found.none))
    met = at_mean_sinkage(found.regressors, unseen[chosen.names]) if chosen.names else alone
    before, after = residuals_of(alone), residuals_of(met)
    own = discretization_errors(case, found.none.log_zeta)
    floors, how = noise_floors(case, before, after, own, found.none.by_zeta)
    known = SelectedEffects(
        effects_of(chosen), chosen.log_zeta, met, gaps(case, before, after, floors)
    )
    rivals = competing_hypotheses(found, leading, share, verdict)
    report("where the gap lies")
    places = list(localize(case, before, dict(floors)))
    notes = [
        how,
        *caveats(case),
        *odd_runs.outliers_among_repeats(case, [before, after], own, found.none.by_zeta),
        *odd_runs.outliers_by_zeta(found.regressors, chosen),
    ]
    signal, added, lies = None, known, []
    if verdict != (NONE,):
        lies = estimate_disturbances(case, found.none.log_zeta)
        places += by_stage(lies)
    if verdict == (UNKNOWN,):
        if lies:
            report("what an effect that explains it would look like")
            signal = fit_unknown_effect(case, lies, found.none, before, floors, places)
        curve = None if signal is None or signal.tried is None else signal.tried.added
        reference = SelectedEffects(
            (), found.none.log_zeta, alone, gaps(case, before, before, floors)
        )
        added = best_selection([known] if curve is None else [known, curve], reference)
        notes += [] if signal is None else signal.sentences(added is curve)
        notes += odd_runs.gap_carried_by_one_run(case, places, before, floors)
        meant = signal.tried.means if added is curve and signal and signal.tried else None
        if meant in {reported_name(each.about.name) for each in effects}:
            share = reassign_unknown(share, meant)
            verdict, groups = (meant,), [[meant]]
    notes += unmatched(case, alone, REFERENCE_NAME)
    notes += unmatched(case, added.matches, WITH_EFFECTS_NAME) if added.effects else []
    report("what to run next")
    advice = next_run(case, chosen, rivals, floors) if rivals else {}
    return Diagnosis(
        verdict=reported_names(verdict),
        weights=weight_by_name(share),
        groups=[reported_names(group) for group in groups],
        selected=added,
        parameters=_parameters(found.regressors, chosen) if chosen.names and added is known else {},
        notes=notes,
        next_run=advice,
        screening=found,
        chosen=chosen,
        residual_before=before,
        floors=floors,
        localization=places,
        unknown_effect=signal,
        stepwise=(
            stepwise_gap(found, chosen, unseen, before, floors, known.gap)
            if verdict == chosen.names and added is known
            else []
        ),
    )


def _weights(
    found: ScreeningResult,
    leading: Sequence[Hypothesis],
    unseen: Mapping[tuple[str, ...], HeldOutPrediction],
) -> dict[tuple[str, ...], float]:
    products = found.regressors.gram_matrices
    none = found.none.fit
    judged = [ScoredHypothesis((), none.mean_square, none.mean_square, none.zeta_variance, 0)]
    for each in leading:
        left, _ = block_mean_squares(found.regressors, unseen[each.names].residual)
        line = each.fit
        judged.append(
            ScoredHypothesis(
                each.names, left, line.mean_square, line.zeta_variance, len(each.coordinates)
            )
        )
    total = products.sample_count.sum(axis=0)
    runs = len(products.log_zeta)
    noise = found.regressors.noise_power
    residuals = [each.residual for each in (found.none, *leading)]
    differ = repeat_variance(found.regressors.dataset, residuals, found.none.by_zeta)
    return weights(judged, products.blocks, total, noise, runs, chance=differ)


def _parameters(bench: Regressors, chosen: Hypothesis) -> dict[str, dict[str, ParameterEstimate]]:
    """The chosen effects' numbers with standard errors, by their own columns.

    What is believed of a number before any run bounds the error of one that the runs do not tell.
    """
    products = bench.gram_matrices_of(chosen.columns, chosen.residual, chosen.log_zeta)
    worth = np.array([1.0 if kind == "slow" else 0.1 for _, kind in products.blocks])
    floor = np.array([FLOOR[block] for block in products.blocks]) ** 2
    weight = worth / (chosen.fit.mean_square + floor)
    gram = np.einsum("b,rbij->rij", weight, products.gram[:, :, :-1, :-1])
    width, _ = prior_widths(chosen.model)
    information = np.diag(1 / width**2)
    for run in gram:
        own = max(run[0, 0], 1e-300)
        information += run[1:, 1:] - np.outer(run[1:, 0], run[0, 1:]) / own
    error = np.sqrt(np.diag(np.linalg.inv(information)))
    found: dict[str, dict[str, ParameterEstimate]] = {}
    for free, at, spread in zip(chosen.model.free, chosen.coordinates, error, strict=True):
        effect = chosen.model.effects[free.index]
        value = float(free.value(at))
        scale = free.scale if free.scale is not None else value
        fields = found.setdefault(reported_name(effect.about.name), {})
        unit = field_metadata(effect)[free.field]["unit"]
        fields[free.field] = ParameterEstimate(value, float(scale * spread), unit)
    return found
