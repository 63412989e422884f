"""A hypothesis: some effects with all their numbers, judged by free-running simulation.

Its columns come from the bench's straight lines; every simulation then corrects them along the way
it went (Broyden's update), so that a few simulations settle a hypothesis even far from the null.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from diagnose.linear.linear_fit import (
    LINES_ERR,
    GramMatrices,
    LinearFit,
    fit_linear,
    floor_inflation,
    log_score,
)
from diagnose.linear.regressors import Regressors, ShapeVariant
from diagnose.model.augmented_model import AugmentedModel, predict_with_jacobian
from drftjax.common.arrays import as_real
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import field_metadata, reported_names, strengths

# Width of the belief about a strength, in typical sizes, and about a shape's logarithm.
STRENGTH_BELIEF = 5.0


SHAPE_BELIEF = 1.0


# One unit of each coordinate, for the shares that Broyden's update gives them: a strength's is its
# typical size, these are of the logarithms of zeta and of a shape.
ZETA_UNIT, SHAPE_UNIT = 0.02, 0.3


# A fit moves a logarithm (of zeta, of a shape) by no more than this at once.
LONGEST_MOVE = 0.5


# Share of a move's response that corrected columns may be wrong by.
CORRECTED_ERR = 0.05


# The first turns take every floor for this share of the worst block's distance from its own.
SHARES = (0.3, 0.1, 0.03)


# A step is not shortened under this share of itself.
SHORTEST = 0.1


# Turns end where the score gains less.
SMALL_GAIN = 0.2


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Effects with their numbers.

    Attributes:
        model: The effects.
        log_zeta: Each run's log zeta over its set-up's, shape (runs,).
        coordinates: The effects' free numbers.
        line: What a fit in the neighbourhood says: score, what is left by block, scatter of zeta.
        columns: By run, derivatives by (own log zeta, coordinates).
        residual: By run, simulated less recorded.
        simulated: Whether `line` is by simulation, or still by straight lines.
        ahead: Change of log zeta and of the coordinates that straight lines propose.
    """

    model: AugmentedModel
    log_zeta: np.ndarray
    coordinates: np.ndarray
    fit: LinearFit
    columns: list[np.ndarray]
    residual: list[np.ndarray]
    is_simulated: bool
    proposed_step: tuple[np.ndarray, np.ndarray] | None = None

    def by_zeta(self, run: int) -> np.ndarray:
        """Derivative of a run's channels by its log zeta, shape (channels, samples)."""
        return self.columns[run][:, :, 0]

    @property
    def score(self) -> float:
        return self.fit.score

    @property
    def names(self) -> tuple[str, ...]:
        return self.model.names


def linear_fit_of(
    bench: Regressors,
    variants: Sequence[ShapeVariant],
    coarse: float = 1.0,
    trust: float = LINES_ERR,
) -> LinearFit:
    """What some effects would explain, were all responses straight lines.

    Args:
        bench: The case.
        variants: The effects.
        coarse, trust: See `fit_line`.
    """
    columns = [column for variant in variants for column in variant.columns]
    belief = np.full(len(columns), STRENGTH_BELIEF)
    least = np.array([bound for variant in variants for bound in lower_bounds(variant.effect)])
    return fit_linear(
        bench.gram_matrices, columns, prior=belief, least=least, trust=trust, coarse=coarse
    )


def lower_bounds(effect: type[AbstractEffect]) -> list[float]:
    """Least value of each strength [typical sizes]: zero where only one sign makes sense."""
    return [_bound(effect, name, "least") for name in strengths(effect)]


def linear_start(
    bench: Regressors, variants: Sequence[ShapeVariant], line: LinearFit | None = None
) -> Hypothesis:
    """A hypothesis as straight lines give it: at the null, with the way ahead of it.

    Args:
        bench: The case.
        variants: The effects.
        line: What straight lines say of them; found here where it is not given.
    """
    line = linear_fit_of(bench, variants) if line is None else line
    model = AugmentedModel(tuple(variant.effect for variant in variants))
    coordinates: list[float] = []
    weights: list[list[tuple[int, float]]] = []
    used = 0
    for variant in variants:
        count = len(variant.columns)
        strength = line.coefficients[used : used + count]
        used += count
        coordinates += list(strength)
        weights += [[(column, 1.0)] for column in variant.columns]
        for axis, value in enumerate(variant.shapes):
            coordinates.append(float(np.log(value)))
            weights.append(_by_shape(bench, variant, axis, strength))
    columns = [
        np.concatenate([own[:, :, :1], *(_mixed(own, mix)[:, :, None] for mix in weights)], axis=2)
        for own in bench.columns
    ]
    null = np.array(
        [0.0 if f.scale is not None else c for f, c in zip(model.free, coordinates, strict=True)]
    )
    return Hypothesis(
        model,
        bench.log_zeta,
        null,
        line,
        columns,
        bench.residual,
        is_simulated=False,
        proposed_step=(line.log_zeta_change, np.array(coordinates) - null),
    )


def _by_shape(
    bench: Regressors, variant: ShapeVariant, axis: int, strength: np.ndarray
) -> list[tuple[int, float]]:
    """A shape's column as a mix of the neighbouring variants', at these strengths."""
    before, after = (bench.variants[number] for number in variant.neighbours[axis])
    apart = np.log(after.shapes[axis] / before.shapes[axis])
    if apart == 0:
        return []
    mix = [(c, s / apart) for c, s in zip(after.columns, strength, strict=True)]
    return mix + [(c, -s / apart) for c, s in zip(before.columns, strength, strict=True)]


def _mixed(columns: np.ndarray, mix: list[tuple[int, float]]) -> np.ndarray:
    found = np.zeros(columns.shape[:2])
    for column, weight in mix:
        found += weight * columns[:, :, 1 + column]
    return found


def prior_widths(model: AugmentedModel) -> tuple[np.ndarray, np.ndarray]:
    """Width of the belief about each coordinate, and where it is centred."""
    width, centre = [], []
    for free in model.free:
        if free.scale is not None:
            width.append(STRENGTH_BELIEF)
            centre.append(0.0)
            continue
        starts = np.log(field_metadata(model.effects[free.index])[free.field]["starts"])
        width.append(max(SHAPE_BELIEF, float(np.ptp(starts)) / 2))
        centre.append(float(starts.mean()))
    return np.array(width), np.array(centre)


def refine(bench: Regressors, start: Hypothesis, turns: int) -> Hypothesis:
    """The hypothesis after some simulations, each followed by a fit; the best of them.

    A hypothesis whose first simulations fail stays as it was proposed.
    """
    here, best = start, start if start.is_simulated else None
    if start.proposed_step is None:
        zeta, coordinates = _step(bench, start, 0.0)
    else:
        zeta, coordinates = (
            start.log_zeta + start.proposed_step[0],
            start.coordinates + start.proposed_step[1],
        )
    reach = 1.0
    for turn in range(turns):
        moved = _simulated(bench, here, zeta, np.minimum(coordinates, _bounds(here, "most")))
        leading = not start.is_simulated and turn < len(SHARES)
        share = SHARES[turn] if leading else 0.0
        before = -np.inf if best is None else best.score
        if moved is not None and moved.score > before:
            best = moved
        if moved is None:
            reach /= 4
        elif leading or moved.score > before:
            here, reach = moved, 1.0
            if not leading and moved.score - before < SMALL_GAIN:
                break
        else:
            # Not so far; but the way there has corrected the columns.
            here = replace(best or here, columns=moved.columns)
            reach /= 2
            if reach < SHORTEST:
                break
        far_zeta, far = _step(bench, here, share)
        zeta = here.log_zeta + reach * (far_zeta - here.log_zeta)
        coordinates = here.coordinates + reach * (far - here.coordinates)
    return start if best is None else best


def relinearize(bench: Regressors, here: Hypothesis) -> Hypothesis:
    """The hypothesis with its columns by the simulator's own derivative where it stands."""
    case = bench.dataset

    def of(run: int) -> np.ndarray:
        _, slope = predict_with_jacobian(
            here.model,
            case.channels,
            case.trials[run],
            case.observations[run],
            as_real(here.log_zeta[run]),
            here.coordinates,
        )
        counts = case.counts(run)
        return slope[:, : len(counts)][:, counts]

    return replace(here, columns=case.map_runs(of))


def top_ranked(ranked: Sequence[Hypothesis], count: int) -> list[Hypothesis]:
    """The first ones, best first, until so many explanations are among them.

    Two forms of one effect are one explanation, and take no other's place.
    """
    found: list[Hypothesis] = []
    for each in ranked:
        if len({frozenset(reported_names(known.names)) for known in found}) >= count:
            break
        found.append(each)
    return found


def least_changes(here: Hypothesis) -> np.ndarray:
    """Least change of each coordinate that leaves the effects' numbers where they make sense."""
    return _bounds(here, "least") - here.coordinates


def _bounds(here: Hypothesis, side: Literal["least", "most"]) -> np.ndarray:
    """Bound of each coordinate; a shape's, which is a logarithm, has none."""
    free = {"least": -np.inf, "most": np.inf}[side]
    return np.array(
        [
            free if f.scale is None else _bound(here.model.effects[f.index], f.field, side)
            for f in here.model.free
        ]
    )


def _bound(effect: type[AbstractEffect], strength: str, side: str) -> float:
    """Bound of a strength, in typical sizes."""
    about = field_metadata(effect)[strength]
    return about[side] / about["typical"]


def gauss_newton_step(
    here: Hypothesis, products: GramMatrices, coarse: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Change of the runs' log zeta and of the coordinates that straight lines from here propose.

    Args:
        here: Where the lines start.
        products: Of its columns and residuals, over the runs that count.
        coarse: See `fit_line`.
    """
    line = _from_here(here, products, coarse)
    logarithmic = np.array([f.scale is None for f in here.model.free], bool)
    # The whole step is shortened, or the numbers that belong together would part.
    longest = np.abs(np.r_[line.log_zeta_change, line.coefficients[logarithmic]]).max(initial=0.0)
    part = min(1.0, LONGEST_MOVE / max(longest, 1e-12))
    return part * line.log_zeta_change, part * line.coefficients


def predicted_score(bench: Regressors, here: Hypothesis) -> float:
    """The score that straight lines from here promise, or that it has where they promise less."""
    products = bench.gram_matrices_of(here.columns, here.residual, here.log_zeta)
    return max(here.score, _from_here(here, products, 1.0).score)


def _from_here(here: Hypothesis, products: GramMatrices, coarse: float) -> LinearFit:
    width, centre = prior_widths(here.model)
    return fit_linear(
        products,
        range(len(here.coordinates)),
        prior=width,
        at=here.coordinates - centre,
        least=least_changes(here),
        trust=CORRECTED_ERR if here.is_simulated else LINES_ERR,
        coarse=coarse,
    )


def _step(bench: Regressors, here: Hypothesis, share: float) -> tuple[np.ndarray, np.ndarray]:
    products = bench.gram_matrices_of(here.columns, here.residual, here.log_zeta)
    coarse = floor_inflation(bench.gram_matrices.blocks, here.fit.mean_square, share)
    zeta, change = gauss_newton_step(here, products, coarse)
    return here.log_zeta + zeta, here.coordinates + change


def _simulated(
    bench: Regressors, before: Hypothesis, log_zeta: np.ndarray, coordinates: np.ndarray
) -> Hypothesis | None:
    """The hypothesis simulated elsewhere, with columns corrected by how it came out."""
    case = bench.dataset
    units = np.array([1.0 if f.scale is not None else SHAPE_UNIT for f in before.model.free])
    change = (coordinates - before.coordinates) / units

    def of(run: int) -> tuple[np.ndarray, np.ndarray]:
        predicted = case.prediction(before.model, run, log_zeta[run], coordinates)
        residual = predicted - case.recording(run)
        own = (log_zeta[run] - before.log_zeta[run]) / ZETA_UNIT
        step = np.concatenate([[own], change])
        scaled = before.columns[run] * np.concatenate([[ZETA_UNIT], units])
        size = step @ step
        if size > 0:
            surprise = residual - before.residual[run] - scaled @ step
            scaled = scaled + surprise[:, :, None] * step / size
        return scaled / np.concatenate([[ZETA_UNIT], units]), residual

    both = case.map_runs(of)
    columns, residual = [c for c, _ in both], [r for _, r in both]
    if not case.all_finite(residual):
        return None
    moved = log_zeta + bench.log_reference_zeta
    left, number = block_mean_squares(bench, residual)
    scatter = float(np.var(moved, ddof=1)) if len(moved) > 1 else 0.0
    score = log_score(bench.gram_matrices.blocks, number, left, scatter, len(moved))
    line = LinearFit(score, coordinates, log_zeta - before.log_zeta, left, scatter)
    return Hypothesis(
        before.model, log_zeta, coordinates, line, columns, residual, is_simulated=True
    )


def block_mean_squares(
    bench: Regressors, residual: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Mean square of residuals in each block, and how many values each has."""
    nothing = [np.zeros((*each.shape, 0)) for each in residual]
    products = bench.gram_matrices_of(nothing, residual, np.zeros(len(residual)))
    number = products.sample_count.sum(axis=0)
    return products.gram[:, :, -1, -1].sum(axis=0) / np.maximum(number, 1), number
