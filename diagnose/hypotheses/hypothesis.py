"""A hypothesis: some effects with all their numbers, and the responses of all runs about them.

Its responses come from the regressors, by linear fits about the reference model
(`linear_start`), until simulations correct them (`diagnose.hypotheses.refinement`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from diagnose.linear.linear_fit import LinearFit, LinearFitSettings, fit_linear
from diagnose.linear.regressors import Regressors, ShapeVariant
from diagnose.model.augmented_model import AugmentedModel
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import field_metadata, reported_names, strengths

# Columns of the regressors, by number, and the weight of each in a sum.
ColumnMix = list[tuple[int, float]]


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Effects with their numbers.

    Attributes:
        model: The effects.
        log_zeta: Log zeta of each run over its set-up's [-], shape (runs,).
        coordinates: The effects' free numbers, shape (free,).
        fit: Log score, mean square left by block, and variance of zeta, by simulation or by a
            linear fit.
        columns: By run, derivatives by (own log zeta, coordinates) [m, N, N m], shape (channels,
            samples, 1 + free).
        residual: By run, simulated minus recorded [m, N, N m], shape (channels, samples).
        is_simulated: `fit` is by simulation.
        proposed_step: Change of (log zeta, coordinates) that the linear fit proposes, if it has not
            been made yet.
        start_score: Log score by simulation at these numbers, before the proposed step; minus
            infinity where they were not simulated.
    """

    model: AugmentedModel
    log_zeta: np.ndarray
    coordinates: np.ndarray
    fit: LinearFit
    columns: list[np.ndarray]
    residual: list[np.ndarray]
    is_simulated: bool
    proposed_step: tuple[np.ndarray, np.ndarray] | None = None
    start_score: float = -np.inf

    def by_zeta(self, run: int) -> np.ndarray:
        """Derivative of a run's channels by its log zeta [m, N, N m], shape (channels, samples)."""
        return self.columns[run][:, :, 0]

    @property
    def score(self) -> float:
        """Log score; see `diagnose.linear.linear_fit`."""
        return self.fit.score

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return self.model.names


def linear_fit_of(
    regressors: Regressors,
    variants: Sequence[ShapeVariant],
    inflation: float = 1.0,
    linear_error: float | None = None,
) -> LinearFit:
    """Linear fit of some effects' strengths about the reference model.

    Args:
        regressors: The runs.
        variants: The effects.
        inflation, linear_error: See `fit_linear`.
    """
    columns = [column for variant in variants for column in variant.columns]
    lower = np.array([bound for variant in variants for bound in lower_bounds(variant.effect)])
    return fit_linear(
        regressors.gram_matrices,
        columns,
        prior=np.full(len(columns), regressors.settings.strength_prior),
        lower=lower,
        linear_error=linear_error,
        inflation=inflation,
        settings=regressors.settings,
    )


def lower_bounds(effect: type[AbstractEffect]) -> list[float]:
    """Least value of each strength [typical sizes]: zero where only one sign makes sense."""
    return [_bound(effect, name, "least") for name in strengths(effect)]


def linear_start(
    regressors: Regressors, variants: Sequence[ShapeVariant], fit: LinearFit | None = None
) -> Hypothesis:
    """Hypothesis at the null of its effects, with the step that a linear fit proposes.

    Args:
        regressors: The runs.
        variants: The effects.
        fit: Linear fit of them; made here where it is not given.
    """
    fit = linear_fit_of(regressors, variants) if fit is None else fit
    model = AugmentedModel(tuple(variant.effect for variant in variants))
    coordinates: list[float] = []
    mixes: list[ColumnMix] = []
    used = 0
    for variant in variants:
        count = len(variant.columns)
        strength = fit.coefficients[used : used + count]
        used += count
        coordinates += list(strength)
        coordinates += [float(np.log(value)) for value in variant.shapes]
        mixes += column_mixes(regressors, variant, strength)
    null = np.array(
        [0.0 if f.scale is not None else c for f, c in zip(model.free, coordinates, strict=True)]
    )
    return Hypothesis(
        model,
        regressors.log_zeta,
        null,
        fit,
        [mix_columns(own, mixes) for own in regressors.columns],
        regressors.residual,
        is_simulated=False,
        proposed_step=(fit.log_zeta_change, np.array(coordinates) - null),
    )


def column_mixes(
    regressors: Regressors, variant: ShapeVariant, strength: np.ndarray
) -> list[ColumnMix]:
    """Columns of an effect's strengths and shapes, as sums of those of the regressors.

    Args:
        regressors: The runs.
        variant: The effect.
        strength: Its strengths [typical sizes], shape (strengths,).
    """
    shapes = [
        _shape_mix(regressors, variant, axis, strength) for axis in range(len(variant.shapes))
    ]
    return [*([(column, 1.0)] for column in variant.columns), *shapes]


def _shape_mix(
    regressors: Regressors, variant: ShapeVariant, axis: int, strength: np.ndarray
) -> ColumnMix:
    """A shape's column at these strengths: difference of its neighbours over that of their log.

    Zero where it has none; a simulation comes before it is needed.
    """
    if not variant.neighbours:
        return []
    before, after = (regressors.variants[number] for number in variant.neighbours[axis])
    apart = np.log(after.shapes[axis] / before.shapes[axis])
    if apart == 0:
        return []
    mix = [(c, s / apart) for c, s in zip(after.columns, strength, strict=True)]
    return mix + [(c, -s / apart) for c, s in zip(before.columns, strength, strict=True)]


def mix_columns(columns: np.ndarray, mixes: Sequence[ColumnMix]) -> np.ndarray:
    """Own log zeta, and weighted sums of a run's columns, shape (channels, samples, 1 + mixes).

    Args:
        columns: Of the regressors, own log zeta first, shape (channels, samples, 1 + columns).
        mixes: For each sum, columns and their weights.
    """
    found = np.zeros((*columns.shape[:2], 1 + len(mixes)))
    found[:, :, 0] = columns[:, :, 0]
    for number, mix in enumerate(mixes, start=1):
        for column, weight in mix:
            found[:, :, number] += weight * columns[:, :, 1 + column]
    return found


def gaussian_prior(
    model: AugmentedModel, settings: LinearFitSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Width and centre of the prior on each coordinate, each of shape (free,)."""
    width, centre = [], []
    for free in model.free:
        if free.scale is not None:
            width.append(settings.strength_prior)
            centre.append(0.0)
            continue
        starts = np.log(field_metadata(model.effects[free.index])[free.field]["starts"])
        width.append(max(settings.shape_prior, float(np.ptp(starts)) / 2))
        centre.append(float(starts.mean()))
    return np.array(width), np.array(centre)


def top_ranked(ranked: Sequence[Hypothesis], count: int) -> list[Hypothesis]:
    """The first hypotheses, best first, until `count` explanations are among them.

    Two forms of one effect are one explanation, and take no other's place.
    """
    found: list[Hypothesis] = []
    for each in ranked:
        if len({frozenset(reported_names(known.names)) for known in found}) >= count:
            break
        found.append(each)
    return found


def best_first(hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Hypotheses in the order of their scores; those that no simulation could follow come last.

    What a linear fit promises of these is no score that others could be held against.
    """
    return sorted(hypotheses, key=lambda each: (not each.is_simulated, -each.score))


def best_of_each(hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """The best of those with the same effects, best first: one set is weighed once."""
    found: dict[frozenset[str], Hypothesis] = {}
    for each in best_first(hypotheses):
        found.setdefault(frozenset(each.names), each)
    return list(found.values())


def least_changes(here: Hypothesis) -> np.ndarray:
    """Least change of each coordinate that keeps the effects' numbers in their bounds."""
    return coordinate_bounds(here, "least") - here.coordinates


def coordinate_bounds(here: Hypothesis, side: Literal["least", "most"]) -> np.ndarray:
    """Bound of each coordinate, shape (free,); a shape's, which is a logarithm, has none."""
    free = {"least": -np.inf, "most": np.inf}[side]
    return np.array(
        [
            free if f.scale is None else _bound(here.model.effects[f.index], f.field, side)
            for f in here.model.free
        ]
    )


def _bound(effect: type[AbstractEffect], strength: str, side: str) -> float:
    """Bound of a strength [typical sizes]."""
    about = field_metadata(effect)[strength]
    return about[side] / about["typical"]
