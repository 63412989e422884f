"""What an effect that nobody has written looks like, and a correction that stands for it.

Where no effect of the list explains the runs, the simplest unknown signal is held against every
state variable. Where it follows one, the curve is fitted as a correction: all its runs simulated
freely, then those left out by condition, as any effect's.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from diagnose.dataset import RigDataset
from diagnose.gap.cross_validation import at_mean_sinkage, predict_held_out
from diagnose.gap.gap import gaps
from diagnose.gap.selected_effects import SelectedEffects, effects_of
from diagnose.gap.zeta_matching import residuals_of
from diagnose.hypotheses.hypothesis import STRENGTH_BELIEF, Hypothesis, linear_start, refine
from diagnose.linear.linear_fit import WORTH
from diagnose.linear.regressors import Regressors, ShapeVariant
from diagnose.localization.shares import MOST, GapShare
from diagnose.localization.spectrum import HERTZ, HERTZ_LABELS
from diagnose.model.augmented_model import AugmentedModel, predict
from diagnose.model.shared_programs import in_modes
from diagnose.selection.model_weights import SCALE
from diagnose.unknown.dependence import FittedCurve, choose_disturbance, fit_curve
from diagnose.unknown.disturbances import KNOT, Disturbance
from drftjax.effects.correction import STAGES, Curve, correction_variables, entry_of, with_values
from drftjax.recorded.repeats import group_by_condition

# A signal follows a variable that explains this share of it; curves over so many of these are
# simulated, as straight lines tell little of how a curve goes on in runs left out.
FOLLOWS = 0.5


LIKELY = 3


# A signal whose knots lie `KNOT` apart has nothing over this [Hz].
FASTEST = 1 / (2 * KNOT)


# Simulations that its curve is fitted by.
TURNS = 6


# What an effect of the list means, whatever its form: sand that depends on the place, and a surface
# that is not flat.
MEANT = {("zeta", "travel"): "terrain_variation", ("height", "travel"): "surface_profile"}


# A curve of that meaning explains the runs where no more of the gap is left over all channels than
# `unknown` is taken to leave, or so many noise floors in each channel.
AT_FLOOR = 1.2


# It goes up and down along the bed, the lesser by this share of the larger, or leaps: between three
# knots, past this share of the bed, by such a share of all its ups and downs. What slowly falls or
# rises, or does so at first, may as well be a matter of wear, of turning or of time.
BOTH_WAYS, PAST, LEAP = 0.2, 0.25, 0.5


# It stands before a curve over the wheel's turning that leaves hardly less, as way and turning are
# nearly one where slip is; one over any other variable must leave that much more. And time must
# leave twice as much unexplained of the signal: runs of one profile do not tell place from moment.
HARDLY, OF_TIME = 1.25, 2.0


# Ways for a curve to bend are left out where they are believed to be this much smaller than the
# largest.
SMALLEST_MODE = 0.003


@dataclass(frozen=True, eq=False)
class Correction:
    """A curve that stands for an effect that nobody has written.

    Attributes:
        effect: With its values.
        explained: Share of the signal that such a curve explains on runs left out [-].
        added: What it leaves of the gap.
        means: The effect of the list that it is a form of; None where it is none, or need not be.
    """

    effect: Curve
    explained: float
    added: SelectedEffects
    means: str | None = None

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
            "gap": {channel: gap.document() for channel, gap in self.added.gap.items()},
        }


@dataclass(frozen=True, eq=False)
class UnknownEffect:
    """The simplest unknown signal.

    Attributes:
        stage: Where it would act.
        follows: Variables with the share of it that a curve over each explains: first that of
            `tried`, then the others, best first.
        tried: Of the corrections that were simulated, the one that leaves least; None where the
            signal follows nothing that its stage can know.
        too_fast: Share of the gap at frequencies that a signal with such knots cannot have [-].
    """

    stage: Disturbance
    follows: Sequence[tuple[str, float]]
    tried: Correction | None
    too_fast: float = 0.0

    def sentences(self, offered: bool) -> list[str]:
        """What it looks like, and why no correction is offered where none is."""
        said = f"The simplest unknown signal is one of {self.stage.name} ({self.stage.meaning})"
        if not self.follows or self.follows[0][1] < FOLLOWS:
            found = [f"{said}; it follows none of the variables known."]
            if self.too_fast > MOST:
                found.append(
                    f"{self.too_fast:.0%} of the gap is faster than such a signal can be (over "
                    f"{FASTEST:g} Hz): its shares by frequency and by order of rotation tell more."
                )
            return found
        name, share = self.follows[0]
        found = [f"{said}; it follows {name}, which explains {share:.0%} of it on runs left out."]
        if self.tried is None:
            found.append(f"Nothing that {self.stage.name} can know stands for it: no correction.")
        elif offered and self.tried.means is not None:
            found.append(
                f"That is what {self.tried.means} means, in another form than the list's: "
                "model.toml holds the curve, which has no numbers to name."
            )
        elif not offered:
            added = self.tried.added
            found.append(
                f"A correction by a curve of it over {self.tried.effect.variable} was tried and is "
                f"not offered: {added.left:.1f} of {added.before:.1f} noise floors are left."
            )
        return found


def fit_unknown_effect(
    case: RigDataset,
    found: Sequence[Disturbance],
    none: Hypothesis,
    before: Sequence[np.ndarray],
    floors: Mapping[str, float],
    places: Sequence[GapShare],
) -> UnknownEffect:
    """The simplest unknown signal of a case, and a correction where it follows something.

    Args:
        case: The runs.
        found: By `stages`, best first; not empty.
        none: The reference model, settled.
        before: What it leaves of each run, shape (channels, samples) [m, N, N m].
        floors: Noise floor of each channel.
        places: Shares of the gap, by frequency among others.
    """
    fast = HERTZ_LABELS[1 + HERTZ.index(FASTEST) :]
    too_fast = sum(e.share for e in places if e.axis == "frequency" and e.label in fast)
    stage, variables = choose_disturbance(case, found)
    known = [each for each in variables if each[0] in correction_variables(stage.name)]
    likely = [(name, share) for name, share in known if share >= FOLLOWS][:LIKELY]
    curves = [(curve, share) for name, share in likely for curve in fit_curve(case, stage, name)]
    if not curves:
        return UnknownEffect(stage, variables, None, too_fast)
    kinds = [in_modes(each.kind, _modes(each), 1 / STRENGTH_BELIEF) for each, _ in curves]
    case.precompile(predict, [AugmentedModel((kind,)) for kind in kinds])
    bench = Regressors.of(case, none.log_zeta, kinds)

    def of(one: tuple[tuple[FittedCurve, float], ShapeVariant]) -> Correction | None:
        (curve, share), variant = one
        found = refine(bench, linear_start(bench, [variant]), TURNS)
        return (
            _corrected(bench, curve, share, found, before, floors) if found.is_simulated else None
        )

    each_of = case.map_items(of, zip(curves, bench.variants, strict=True))
    tried = [each for each in each_of if each is not None]
    if not tried:
        return UnknownEffect(stage, variables, None, too_fast)
    best = min(tried, key=lambda each: (not each.added.helps, each.added.left))
    # With one condition nothing was left out, and sixteen knots follow anything.
    if len(group_by_condition(case.runs)) > 1:
        best = match_listed_effect(tried, dict(variables)) or best
    variables.sort(key=lambda each: each[0] != best.effect.variable)
    return UnknownEffect(stage, variables, best, too_fast)


def equivalent_effect(one: Correction) -> str | None:
    """The effect of the list that a curve would be a form of, where it explains the runs."""
    least = max(
        SCALE.unknown_residual_share * one.added.before, AT_FLOOR * math.sqrt(len(one.added.gap))
    )
    explains = one.added.helps and one.added.left <= least
    if not explains or not _of_places(np.asarray(one.effect.values())):
        return None
    return MEANT.get((one.effect.stage, one.effect.variable))


def _of_places(values: np.ndarray) -> bool:
    """Whether a curve over the way goes up and down, or leaps on the way."""
    steps = np.diff(values)
    rises, falls = steps.clip(0).sum(), (-steps).clip(0).sum()
    if min(rises, falls) >= BOTH_WAYS * max(rises, falls):
        return True
    between_three = np.abs(steps[:-1] + steps[1:])
    later = between_three[math.ceil(PAST * len(steps)) :]
    return bool(later.max(initial=0.0) > LEAP * (rises + falls))


def match_listed_effect(
    tried: Sequence[Correction], follows: Mapping[str, float]
) -> Correction | None:
    """The curve that is an effect of the list, where the runs tell it from curves of other things.

    Args:
        tried: Curves of one stage, simulated.
        follows: Share of the signal that each variable explains on runs left out [-].
    """
    meant = [each for each in tried if equivalent_effect(each) is not None]
    if not meant:
        return None
    best = min(meant, key=lambda each: each.added.left)
    place = best.effect.variable
    rivals = [each for each in tried if each.effect.variable != place and each.added.helps]
    told = all(
        best.added.left <= HARDLY * each.added.left
        if each.effect.variable == "turning"
        else HARDLY * best.added.left <= each.added.left
        for each in rivals
    )
    of_place = 1 - follows.get("time", 0.0) >= OF_TIME * (1 - follows[place])
    return replace(best, means=equivalent_effect(best)) if told and of_place else None


def _corrected(
    bench: Regressors,
    curve: FittedCurve,
    explained: float,
    found: Hypothesis,
    before: Sequence[np.ndarray],
    floors: Mapping[str, float],
) -> Correction | None:
    """What a curve, fitted by simulation, leaves of the gap on runs left out; None if one fails."""
    met = at_mean_sinkage(bench, predict_held_out(bench, found))
    after = residuals_of(met)
    if not bench.dataset.all_finite(after):
        return None
    (effect,) = effects_of(found)
    assert isinstance(effect, Curve)
    plain = with_values(curve.kind, np.asarray(effect.values()).tolist())
    added = SelectedEffects(
        (plain,), found.log_zeta, met, gaps(bench.dataset, before, after, floors)
    )
    return Correction(plain, explained, added)


def _modes(curve: FittedCurve) -> np.ndarray:
    """Curves whose amplitudes are believed to be one each, and independent, before any run."""
    # A fit by simulation takes a half second for less than the straight lines here do.
    precision = WORTH["slow"] * curve.precision
    size, way = np.linalg.eigh(precision)
    spread = 1 / np.sqrt(size)
    kept = spread > SMALLEST_MODE * spread.max()
    return way[:, kept] * spread[kept]
