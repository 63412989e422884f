"""Unknown effect: the likeliest disturbance, and a correction curve in place of a mechanism.

Where no listed effect explains the runs, the simplest disturbance is compared with every state
variable. Where it depends on one, the curve is fitted as a correction: all runs simulated without
any disturbance, then held-out conditions, as with any effect.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from diagnose.dataset import RigDataset
from diagnose.gap.cross_validation import at_mean_sinkage, predict_held_out
from diagnose.gap.gap import DEFAULT_GAP, GapSettings, gaps
from diagnose.gap.selected_effects import (
    DEFAULT_EFFECT_SELECTION,
    EffectSelectionSettings,
    SelectedEffects,
    effects_of,
)
from diagnose.gap.zeta_matching import residuals_of
from diagnose.hypotheses.hypothesis import Hypothesis, linear_start
from diagnose.hypotheses.refinement import DEFAULT_REFINEMENT, RefinementSettings, refine
from diagnose.linear.linear_fit import DEFAULT_LINEAR_FIT, LinearFitSettings
from diagnose.linear.linearized_runs import LinearizedRuns
from diagnose.linear.regressors import Regressors, ShapeVariant
from diagnose.localization.settings import DEFAULT_LOCALIZATION, LocalizationSettings
from diagnose.localization.shares import GapShare
from diagnose.model.shared_programs import in_modes
from diagnose.run_pool import RunPool
from diagnose.selection.model_weights import DEFAULT_WEIGHTS, WeightSettings
from diagnose.unknown.dependence import FittedCurve, choose_disturbance, fit_curve
from diagnose.unknown.disturbances import Disturbance
from diagnose.unknown.settings import DEFAULT_UNKNOWN_EFFECT, UnknownEffectSettings
from drftjax.effects.correction import STAGES, Curve, correction_variables, entry_of, with_values
from drftjax.recorded.repeats import group_by_condition

EQUIVALENT_EFFECTS = {
    ("zeta", "travel"): "terrain_variation",
    ("height", "travel"): "surface_profile",
}
"""Listed effect that a curve of a stage over a variable is a form of: sand that depends on the
place, and a surface that is not flat."""


@dataclass(frozen=True, eq=False)
class Correction:
    """Curve in place of an effect that is not listed.

    Attributes:
        effect: With its values.
        explained: Share of the disturbance that such a curve explains in held-out runs [-].
        selection: The effect and the gap that remains with it.
        listed_effect: Name of the listed effect that it is a form of; None where it is none, or
            that was not asked.
    """

    effect: Curve
    explained: float
    selection: SelectedEffects
    listed_effect: str | None = None

    @property
    def unit(self) -> str:
        """Of its values; "-" for none."""
        return STAGES[self.effect.stage][1]

    def document(self) -> dict[str, Any]:
        """Plain values, in the layout of diagnosis.json."""
        entry = entry_of(self.effect)
        return {
            "stage": entry["stage"],
            "variable": entry["variable"],
            "unit": self.unit,
            "knots": entry["knots"],
            "values": entry["values"],
            "explained": self.explained,
            "gap": {channel: gap.document() for channel, gap in self.selection.gap.items()},
        }


@dataclass(frozen=True, eq=False)
class UnknownEffect:
    """The simplest disturbance, and its dependence on state variables.

    Attributes:
        disturbance: With its stage.
        dependence: Variables with the share of it that a curve over each explains [-]: first that
            of `best_correction`, then the others, best first.
        best_correction: Of the corrections that were simulated, the one with the smallest remaining
            gap; None where the disturbance depends on nothing that its stage can know.
        fast_share: Share of the gap at frequencies that a disturbance with such knots cannot have
            [-].
        settings: Thresholds that it was found by.
    """

    disturbance: Disturbance
    dependence: Sequence[tuple[str, float]]
    best_correction: Correction | None
    fast_share: float = 0.0
    settings: UnknownEffectSettings = DEFAULT_UNKNOWN_EFFECT

    def sentences(self, offered: bool) -> list[str]:
        """The disturbance in words, and why no correction is offered where none is.

        Args:
            offered: True where the best correction is part of the model that is written.
        """
        stage = self.disturbance.name
        said = f"The simplest unknown signal is one of {stage} ({self.disturbance.meaning})"
        if not self.dependence or self.dependence[0][1] < self.settings.min_explained:
            found = [f"{said}; it follows none of the variables known."]
            if self.fast_share > DEFAULT_LOCALIZATION.most_share:
                found.append(
                    f"{self.fast_share:.0%} of the gap is faster than such a signal can be (over "
                    f"{self.settings.max_frequency:g} Hz): its shares by frequency and by order of "
                    "rotation tell more."
                )
            return found
        name, share = self.dependence[0]
        found = [f"{said}; it follows {name}, which explains {share:.0%} of it on held-out runs."]
        correction = self.best_correction
        if correction is None:
            found.append(f"No correction of {stage} can depend on that variable: none is offered.")
        elif offered and correction.listed_effect is not None:
            found.append(
                f"That is what {correction.listed_effect} means, in another form than the list's: "
                "model.toml holds the curve, which has no numbers to name."
            )
        elif not offered:
            selection = correction.selection
            found.append(
                f"A correction by a curve of it over {correction.effect.variable} was tried and is "
                f"not offered: {selection.remaining:.1f} of {selection.before:.1f} noise floors "
                "are left."
            )
        return found


@dataclass(frozen=True)
class CorrectionStepSettings:
    """Settings of the other steps of a diagnosis that a correction goes through.

    Attributes:
        localization: Bands that the shares of the gap by frequency are of.
        linear_fit: Weights of linear fits.
        refinement: Numbers of the refinement by simulation.
        weights: For the share of a gap that `unknown` is taken to leave.
        gap: Numbers of a gap.
        selection: Rule by which effects are worth adding.
    """

    localization: LocalizationSettings = DEFAULT_LOCALIZATION
    linear_fit: LinearFitSettings = DEFAULT_LINEAR_FIT
    refinement: RefinementSettings = DEFAULT_REFINEMENT
    weights: WeightSettings = DEFAULT_WEIGHTS
    gap: GapSettings = DEFAULT_GAP
    selection: EffectSelectionSettings = DEFAULT_EFFECT_SELECTION


DEFAULT_CORRECTION_STEPS = CorrectionStepSettings()


def fit_unknown_effect(
    dataset: RigDataset,
    linearized: LinearizedRuns,
    found: Sequence[Disturbance],
    before: Sequence[np.ndarray],
    floors: Mapping[str, float],
    shares: Sequence[GapShare],
    pool: RunPool,
    settings: UnknownEffectSettings = DEFAULT_UNKNOWN_EFFECT,
    steps: CorrectionStepSettings = DEFAULT_CORRECTION_STEPS,
) -> UnknownEffect:
    """The simplest disturbance of a dataset, and a correction where it depends on something.

    Args:
        dataset: The runs.
        linearized: The same, linearised along the reference model.
        found: By `estimate_disturbances`, best first; not empty.
        before: Residual of each run by the reference model [m, N, N m], shape (channels, samples).
        floors: Noise floor of each channel [m, N, N m].
        shares: Shares of the gap, by frequency among others.
        pool: Threads.
        settings: Curves and thresholds.
        steps: Settings of the other steps.
    """
    disturbance, variables = choose_disturbance(dataset, found, settings)
    unknown = UnknownEffect(
        disturbance, variables, None, _fast_share(shares, settings, steps.localization), settings
    )
    curves = _candidate_curves(dataset, disturbance, variables, settings)
    if not curves:
        return unknown
    tried = _simulate_curves(dataset, linearized, curves, before, floors, pool, settings, steps)
    if not tried:
        return unknown
    best = min(
        tried,
        key=lambda each: (
            not each.selection.improves_gap(steps.selection),
            each.selection.remaining,
        ),
    )
    # With one condition nothing was held out, and sixteen knots follow anything.
    if len(group_by_condition(dataset.runs)) > 1:
        best = match_listed_effect(tried, dict(variables), settings, steps) or best
    variables = sorted(variables, key=lambda each: each[0] != best.effect.variable)
    return replace(unknown, dependence=variables, best_correction=best)


def _fast_share(
    shares: Sequence[GapShare], settings: UnknownEffectSettings, localization: LocalizationSettings
) -> float:
    """Share of the gap in the bands above the disturbance's highest frequency [-]."""
    edges, labels = localization.frequency_edges, localization.frequency_labels
    fast = [
        label
        for edge, label in zip(edges, labels[1:], strict=True)
        if edge >= settings.max_frequency
    ]
    return sum(each.share for each in shares if each.axis == "frequency" and each.label in fast)


def _candidate_curves(
    dataset: RigDataset,
    disturbance: Disturbance,
    variables: Sequence[tuple[str, float]],
    settings: UnknownEffectSettings,
) -> list[tuple[FittedCurve, float]]:
    """Curves over the best variables that the stage can know, each with its explained share."""
    known = correction_variables(disturbance.name)
    likely = [each for each in variables if each[0] in known and each[1] >= settings.min_explained]
    return [
        (curve, share)
        for name, share in likely[: settings.max_variables]
        for curve in fit_curve(dataset, disturbance, name, settings)
    ]


def _simulate_curves(
    dataset: RigDataset,
    linearized: LinearizedRuns,
    curves: Sequence[tuple[FittedCurve, float]],
    before: Sequence[np.ndarray],
    floors: Mapping[str, float],
    pool: RunPool,
    settings: UnknownEffectSettings,
    steps: CorrectionStepSettings,
) -> list[Correction]:
    """Corrections fitted by simulation; without those by which a run cannot be simulated."""
    weights = steps.linear_fit
    types = [
        in_modes(
            each.effect_type,
            _modes(each, weights.slow_worth, settings.min_mode),
            1 / weights.strength_prior,
        )
        for each, _ in curves
    ]
    regressors = Regressors.of(dataset, linearized, types, pool, weights)

    def fitted(one: tuple[tuple[FittedCurve, float], ShapeVariant]) -> Correction | None:
        (curve, share), variant = one
        start = linear_start(regressors, [variant])
        found = refine(regressors, start, settings.refinement_steps, pool, steps.refinement)
        if not found.is_simulated:
            return None
        return _correction(regressors, curve, share, found, before, floors, pool, steps.gap)

    each_of = pool.map_outer(fitted, zip(curves, regressors.variants, strict=True))
    return [each for each in each_of if each is not None]


def equivalent_effect(
    correction: Correction,
    settings: UnknownEffectSettings = DEFAULT_UNKNOWN_EFFECT,
    steps: CorrectionStepSettings = DEFAULT_CORRECTION_STEPS,
) -> str | None:
    """Listed effect that a curve is a form of, where it explains the runs; None otherwise."""
    selection = correction.selection
    reached = steps.weights.unknown_residual_share * selection.before
    enough = max(reached, settings.max_floors * math.sqrt(len(selection.gap)))
    explains = selection.improves_gap(steps.selection) and selection.remaining <= enough
    if not explains or not _is_of_places(np.asarray(correction.effect.values()), settings):
        return None
    return EQUIVALENT_EFFECTS.get((correction.effect.stage, correction.effect.variable))


def _is_of_places(values: np.ndarray, settings: UnknownEffectSettings) -> bool:
    """True where a curve over the travel goes up and down, or leaps on the way."""
    steps = np.diff(values)
    rises, falls = steps.clip(0).sum(), (-steps).clip(0).sum()
    if min(rises, falls) >= settings.min_return * max(rises, falls):
        return True
    two_steps = np.abs(steps[:-1] + steps[1:])
    later = two_steps[math.ceil(settings.leap_from * len(steps)) :]
    return bool(later.max(initial=0.0) > settings.min_leap * (rises + falls))


def match_listed_effect(
    tried: Sequence[Correction],
    dependence: Mapping[str, float],
    settings: UnknownEffectSettings = DEFAULT_UNKNOWN_EFFECT,
    steps: CorrectionStepSettings = DEFAULT_CORRECTION_STEPS,
) -> Correction | None:
    """The curve that is a form of a listed effect, where the runs rule out other variables.

    Args:
        tried: Curves of one stage, simulated.
        dependence: Share of the disturbance that each variable explains in held-out runs [-].
        settings: Thresholds.
        steps: Settings of the other steps.
    """
    equivalent = [each for each in tried if equivalent_effect(each, settings, steps) is not None]
    if not equivalent:
        return None
    best = min(equivalent, key=lambda each: each.selection.remaining)
    place, remaining = best.effect.variable, best.selection.remaining
    rivals = [
        each
        for each in tried
        if each.effect.variable != place and each.selection.improves_gap(steps.selection)
    ]
    ratio = settings.rival_ratio
    better = all(
        remaining <= ratio * each.selection.remaining
        if each.effect.variable == "turning"
        else ratio * remaining <= each.selection.remaining
        for each in rivals
    )
    unexplained_by_time = 1 - dependence.get("time", 0.0)
    not_of_time = unexplained_by_time >= settings.time_ratio * (1 - dependence[place])
    if not (better and not_of_time):
        return None
    return replace(best, listed_effect=equivalent_effect(best, settings, steps))


def _correction(
    regressors: Regressors,
    curve: FittedCurve,
    explained: float,
    found: Hypothesis,
    before: Sequence[np.ndarray],
    floors: Mapping[str, float],
    pool: RunPool,
    settings: GapSettings,
) -> Correction | None:
    """A fitted curve with the gap of held-out runs; None where one cannot be simulated."""
    dataset = regressors.dataset
    matches = at_mean_sinkage(predict_held_out(regressors, found, pool), pool)
    after = residuals_of(matches)
    if not dataset.all_finite(after):
        return None
    (effect,) = effects_of(found)
    assert isinstance(effect, Curve)
    plain = with_values(curve.effect_type, np.asarray(effect.values()).tolist())
    gap = gaps(dataset, before, after, floors, settings)
    return Correction(plain, explained, SelectedEffects((plain,), found.log_zeta, matches, gap))


def _modes(curve: FittedCurve, slow_worth: float, min_mode: float) -> np.ndarray:
    r"""Modes of a curve whose amplitudes have independent standard normal priors.

    Eigenvectors of the precision $P = V \Lambda V^T$ over the roots of its eigenvalues, shape
    (knots, modes).
    """
    # A fit by simulation gives a half second less weight than the linear fit here does.
    eigenvalues, vectors = np.linalg.eigh(slow_worth * curve.precision)
    spread = 1 / np.sqrt(eigenvalues)
    kept = spread > min_mode * spread.max()
    return vectors[:, kept] * spread[kept]
