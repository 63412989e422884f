"""Zero of the vertical scale: how well a fit's runs tell it, and what zeta owes to it.

A wheel that runs steadily is as deep in soft sand from the true zero as in firmer sand from a lower
one. Only where its depth changes, over a standstill or another slip, do the two differ.
"""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from drftjax.recorded.observation import SHOWN
from identify.solver.problem import predict
from identify.uncertainty.covariance import covariance
from identify.uncertainty.estimate import Estimate

# Move of the start's height for a central difference [m]: far over the simulation's rounding, and
# small beside any sinkage.
DIFFERENCE = 1e-5


@dataclass(frozen=True)
class HeightZeroSettings:
    """Numbers that say from when on zeta hangs on the zero of the height.

    Attributes:
        believed: Error of a zero that a person sets by touching the surface [m].
        noticeable: Change of zeta by so much of the zero that is worth a sentence [-],
        errors: if it is also so many of the errors told.
    """

    believed: float = 1e-3
    noticeable: float = 0.02
    errors: float = 2.0


HEIGHT_ZERO_SETTINGS = HeightZeroSettings()


def height_zero_sentences(
    estimate: Estimate, settings: HeightZeroSettings = HEIGHT_ZERO_SETTINGS
) -> list[str]:
    """Sentences on a zeta that cannot be told apart from the zero of the height.

    Args:
        estimate: Of the fit.
        settings: Decision numbers.
    """
    problem = estimate.problem
    if "z" not in problem.batch.channels or any(
        each.quantity.name == "sinkage_offset.offset" for each in problem.parameters
    ):
        return []
    error, shift = zero_of_height(estimate)
    unseen = np.minimum(error, settings.believed)
    told = np.sqrt(np.diag(estimate.covariance))
    shares, number = [], 0
    for place, (each, run) in enumerate(estimate.coordinate_parameters):
        if not each.quantity.is_zeta:
            continue
        number += 1
        runs = [run] if run is not None else [*range(len(estimate.runs))]
        slopes = np.abs(shift[place, runs])
        # A zeta is positive: a change of its coordinate is a share of it.
        if slopes @ unseen[runs] > max(settings.noticeable, settings.errors * told[place]):
            shares.append(float(slopes.sum()))
    if not shares:
        return []
    unit, scale = SHOWN["z"]
    low, high = (f"{100 * each / scale:.2g}" for each in (min(shares), max(shares)))
    of = f" of {len(shares)} of {number} runs" if len(shares) < number else ""
    return [
        f"zeta{of} cannot be told apart from the zero of the height: 1 {unit} of it is "
        f"{low if low == high else f'{low} to {high}'} % of zeta, which the errors do not hold. "
        "Record the wheel standing before it drives, and the zero can be fitted, too: --own zeta "
        "--own sinkage_offset.offset"
    ]


def zero_of_height(
    estimate: Estimate,
) -> tuple[Float[np.ndarray, " runs"], Float[np.ndarray, "coordinates runs"]]:
    """Standard error of each run's zero, and the change of the coordinates with it.

    Args:
        estimate: Of the fit.

    Returns:
        Errors [m]; and changes of all coordinates for one metre of each run's zero [1/m], all other
        coordinates following.
    """
    column = _derivative(estimate)[..., None]
    blocks = np.concatenate([estimate.solution.blocks, column], axis=-1)
    spread = covariance(blocks, estimate.whitening, estimate.shared, estimate.run_variance)
    runs, own = len(estimate.runs), estimate.own + 1
    zeros = estimate.shared + own * np.arange(runs) + estimate.own
    padded = estimate.shared + own * np.arange(len(blocks)) + estimate.own
    others = np.delete(np.arange(len(spread)), padded)[: len(estimate.coordinate_parameters)]
    variance = np.diag(spread)[zeros]
    return np.sqrt(variance), spread[np.ix_(others, zeros)] / variance


def _derivative(estimate: Estimate) -> Float[np.ndarray, "runs channels samples"]:
    """Weighted, whitened derivative of the readings by their zero: the start was read from it."""
    problem, coordinates = estimate.problem, estimate.solution.coordinates

    def moved(height: float) -> np.ndarray:
        start = problem.batch.trials.start.position.at[:, 1].add(height)
        there = eqx.tree_at(lambda p: p.batch.trials.start.position, problem, start)
        return predict(there, coordinates)

    slope = (moved(-DIFFERENCE) - moved(DIFFERENCE)) / (2 * DIFFERENCE)
    slope[:, problem.batch.channels.index("z")] += 1
    observed = problem.batch.observed
    weighted = observed.weight * jnp.asarray(np.nan_to_num(slope))
    return np.asarray(jax.vmap(problem.whiten)(weighted, observed))
