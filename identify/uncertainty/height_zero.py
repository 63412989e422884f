"""Zero of the vertical scale: how well a fit's runs tell it, and what zeta owes to it.

A wheel that runs steadily is as deep in soft sand from the true zero as in firmer sand from a lower
one. Only where its depth changes, over a standstill or another slip, do the two differ.
"""

from collections.abc import Sequence
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
        errors: if it is also so many of the reported errors.
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
    ordered = problem.shared + problem.own
    zetas = [place for place, each in enumerate(ordered) if each.quantity.is_zeta]
    fitted = [each.quantity.name for each in ordered]
    if "z" not in problem.batch.channels or not zetas or "sinkage_offset.offset" in fitted:
        return []
    error, shift = zero_of_height(estimate, zetas)
    told = np.sqrt(np.diag(estimate.covariance))
    runs = np.arange(len(estimate.runs))
    shares = []
    for place, slopes in zip(zetas, np.abs(shift).T, strict=True):
        at = place + estimate.own * runs if place >= estimate.shared else np.full(len(runs), place)
        moved = slopes * np.minimum(error, settings.believed)
        # A zeta is positive: a change of its coordinate is a share of it.
        off = moved > np.maximum(settings.noticeable, settings.errors * told[at])
        shares += slopes[off].tolist()
    if not shares:
        return []
    unit, scale = SHOWN["z"]
    low, high = (f"{100 * each / scale:.2g}" for each in (min(shares), max(shares)))
    number = len(zetas) * len(runs)
    of = f" of {len(shares)} of {number} runs" if len(shares) < number else ""
    return [
        f"zeta{of} cannot be told apart from the zero of the height: 1 {unit} of it is "
        f"{low if low == high else f'{low} to {high}'} % of zeta, which the errors do not hold. "
        "Record the wheel standing before it drives, and the zero can be fitted, too: --own zeta "
        "--own sinkage_offset.offset"
    ]


def zero_of_height(
    estimate: Estimate, zetas: Sequence[int]
) -> tuple[Float[np.ndarray, " runs"], Float[np.ndarray, "runs zetas"]]:
    """Standard error of each run's zero, and the change of its zeta with it.

    Every run by itself, as if a shared zeta were its own; other shared numbers are held, which
    costs little: what hardly moves a run hardly moves its zero.

    Args:
        estimate: Of the fit.
        zetas: Places of the zeta among a run's parameters: shared ones, then its own.

    Returns:
        Errors [m]; and changes of the coordinates of zeta for one metre of the zero [1/m], the
        run's other coordinates following.
    """
    own = range(estimate.shared, estimate.shared + estimate.own)
    kept = [*(place for place in zetas if place < estimate.shared), *own]
    column = _derivative(estimate)[..., None]
    blocks = np.concatenate([estimate.solution.blocks[..., kept], column], axis=-1)
    errors, shifts = [], []
    for run in range(len(estimate.runs)):
        whitening = estimate.whitening.of_run(run)
        spread = covariance(blocks[run][None], whitening, len(kept) + 1)
        errors.append(np.sqrt(spread[-1, -1]))
        shifts.append(spread[[kept.index(place) for place in zetas], -1] / spread[-1, -1])
    return np.array(errors), np.array(shifts)


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
