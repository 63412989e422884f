r"""Bootstrap: how values and simulated channels scatter over recordings that might have been.

Parametric: noise like the residuals' own (first-order autoregressive, of each run's and channel's
size, and a constant in every phase of the command that the simulation may be off by; what a zeta
that runs share scatters by from run to run) is put on the fitted simulation, and the fit made
again. Over runs: as many runs are drawn with replacement, which needs no model of the noise but
several runs, and speaks of shared values only.

Each refit is one Gauss-Newton step from the optimum with the derivative stored there,
$-(J^T J)^{-1} J^T r$: exact where the simulation is a straight line over the errors. `refit=True`
goes all the way instead, every draw side by side.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from drftjax.common.errors import InputError
from drftjax.common.memory import piece_bytes
from identify.solver.batched_levenberg_marquardt import BatchedLevenbergMarquardt
from identify.solver.problem import linearize, normal_equations
from identify.solver.whitening import FINEST_RUN, lag_one_correlation
from identify.uncertainty.covariance import inverse
from identify.uncertainty.estimate import Estimate

LEVEL = 0.90


MOST_DRAWS = 100_000


# Noise and bands of so many bytes at most are held at once.
CHUNK_BYTES = 1e8


# Draws of the noise that are made together, so that they are the same in pieces of any size.
DRAWN_TOGETHER = 20


# Fewer runs than this say nothing of the scatter from run to run.
FEWEST_RUNS = 3


@dataclass(frozen=True, eq=False)
class Bootstrap:
    """Values drawn again and again.

    Attributes:
        over: "noise" or "runs".
        refit: Whether every draw was fitted all the way, or by one Gauss-Newton step.
        labels: Which values.
        draws: Values, shape (draws, values).
        low, high: Ends of each value's interval.
        error: Standard deviation of each.
        level: Level of intervals and bands.
        bands: Lowest and highest reading expected at the recorded times, by run and channel
            [m, N, N m]; NaN where nothing was compared.
    """

    over: str
    refit: bool
    labels: tuple[str, ...]
    draws: np.ndarray
    low: np.ndarray
    high: np.ndarray
    error: np.ndarray
    level: float = LEVEL
    bands: dict[str, dict[str, tuple[np.ndarray, np.ndarray]]] = field(default_factory=dict)

    @classmethod
    def of(cls, over: str, refit: bool, labels: tuple[str, ...], draws: np.ndarray, bands=None):
        """Intervals and errors of these draws."""
        tail = (1 - LEVEL) / 2
        low, high = np.nanquantile(draws, (tail, 1 - tail), axis=0)
        error = np.nanstd(draws, axis=0, ddof=1)
        return cls(over, refit, labels, draws, low, high, error, LEVEL, bands or {})

    def sentences(self) -> list[str]:
        """An interval for each value, and how it was found."""
        how = "refitted" if self.refit else "linearised"
        told = [f"bootstrap over {self.over}, {len(self.draws)} draws, {how}:"]
        told += [
            f"  {name} {low:.5g} to {high:.5g} ({100 * self.level:.0f} %)"
            for name, low, high in zip(self.labels, self.low, self.high, strict=True)
        ]
        return told


def require_draws(count: int) -> None:
    """Refuse a number of draws that makes no interval."""
    if not 20 <= count <= MOST_DRAWS:
        raise InputError(
            f"the number of draws is {count}, must lie between 20 and {MOST_DRAWS} (--bootstrap)"
        )


def bootstrap(
    optimum: Estimate, count: int, *, seed: int = 0, refit: bool = False
) -> list[Bootstrap]:
    """Draw values over the noise, and over the runs where there are enough of them.

    Args:
        optimum: Where the fit ended.
        count: Draws.
        seed: Of the draws.
        refit: Fit every draw of the noise all the way.

    Raises:
        InputError: for too few or too many draws, or full refits of a fit with priors.
    """
    require_draws(count)
    if refit and optimum.share is not None:
        raise InputError(
            "full refits of draws weigh every sample alike and would outweigh the priors; "
            "leave refit out"
        )
    believing = np.random.default_rng([seed, 3])
    points = np.concatenate(
        [
            refit_draws(optimum, noise) if refit else one_step_draws(optimum, noise, believing)
            for noise in noise_chunks(optimum, count, np.random.default_rng(seed))
        ]
    )
    draws = optimum.values(points)
    bands = predictive_bands(optimum, points - optimum.flat, np.random.default_rng([seed, 1]))
    found = [Bootstrap.of("noise", refit, optimum.labels, draws, bands)]
    active = np.flatnonzero(optimum.solution.active[: len(optimum.candidates)])
    # Between runs drawn again and a prior nothing says how the one outweighs the other.
    if optimum.shared and len(active) >= FEWEST_RUNS and optimum.share is None:
        moves = resample_runs(optimum, count, np.random.default_rng([seed, 2]))
        flat = np.tile(optimum.flat, (count, 1))
        flat[:, : optimum.shared] += moves
        values = optimum.values(flat)[:, : optimum.shared]
        labels = optimum.labels[: optimum.shared]
        found.append(Bootstrap.of("runs", False, labels, values))
    return found


# Draws ------------------------------------------------------------------------------------------


def noise_chunks(
    optimum: Estimate, count: int, random: np.random.Generator
) -> Iterator[np.ndarray]:
    """Noise like the residuals', a bounded number of draws at a time.

    Yields:
        Weighted residuals of noise alone, shape (draws, runs, channels, samples).
    """
    size = 8 * DRAWN_TOGETHER * max(optimum.left.size, 1)
    step = DRAWN_TOGETHER * max(1, int(piece_bytes(CHUNK_BYTES) / size))
    for begin in range(0, count, step):
        end = min(count, begin + step)
        yield np.concatenate(
            [
                simulated_noise(optimum, min(DRAWN_TOGETHER, end - at), random)
                for at in range(begin, end, DRAWN_TOGETHER)
            ]
        )


def simulated_noise(optimum: Estimate, count: int, random: np.random.Generator) -> np.ndarray:
    """Noise as the fit takes it to be: autoregressive, a constant in every phase, and what a shared
    zeta scatters by from run to run."""
    residual, whitening = optimum.left, optimum.whitening
    counts = whitening.scale > 0
    intervals = np.asarray(optimum.problem.batch.observed.intervals)
    noise = np.zeros((count, *residual.shape))
    for run, channel in np.ndindex(residual.shape[:2]):
        here = counts[run, channel]
        if not here.any():
            continue
        rho = lag_one_correlation(residual[run, channel], here, intervals[run])
        shares = rho ** intervals[run]
        spread = max(float(np.sqrt(np.mean(residual[run, channel, here] ** 2))), FINEST_RUN)
        fresh = random.standard_normal((count, len(here)))
        carried = np.empty_like(fresh)
        carried[:, 0] = fresh[:, 0]
        for sample, share in enumerate(shares[1:], start=1):
            carried[:, sample] = (
                share * carried[:, sample - 1] + np.sqrt(1 - share**2) * fresh[:, sample]
            )
        noise[:, run, channel] = np.where(here, spread * carried, 0)
        # Units of the unit vectors are whitened ones; back to weighted.
        offset = np.divide(
            whitening.unit[run, channel],
            whitening.scale[run, channel],
            out=np.zeros(len(here)),
            where=here,
        )
        for phase in np.unique(whitening.phase[run]):
            inside = whitening.phase[run] == phase
            constant = random.standard_normal(count)
            noise[:, run, channel, inside] += constant[:, None] * offset[inside]
    for shared, variance in enumerate(optimum.scatter):
        apart = np.sqrt(variance) * random.standard_normal((count, len(residual)))
        noise += apart[:, :, None, None] * optimum.solution.blocks[..., shared]
    return noise


def one_step_draws(optimum: Estimate, noise: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Coordinates after one Gauss-Newton step towards recordings with this noise.

    Args:
        optimum: Where the fit ended.
        noise: Weighted residuals of noise alone, shape (draws, runs, channels, samples).
        random: Of the noise of what was believed.
    """
    solution, runs = optimum.solution, len(optimum.candidates)
    blocks = solution.blocks[:runs]
    size = len(optimum.flat)
    along = np.zeros((len(noise), size))
    for run in range(runs):
        rows = blocks[run].reshape(-1, blocks.shape[-1])
        both = noise[:, run].reshape(len(noise), -1) @ rows
        along[:, : optimum.shared] += both[:, : optimum.shared]
        place = optimum.shared + run * optimum.own
        along[:, place : place + optimum.own] = both[:, optimum.shared :]
    if optimum.share is not None:
        believed = solution.belief_slope[:size] * random.standard_normal(along.shape)
        told = along @ optimum.share[:size, :size].T
        return optimum.flat + (told + believed) @ optimum.covariance[:size, :size]
    information, _ = normal_equations(blocks, optimum.shared, solution.residual)
    return optimum.flat + along @ inverse(information)


def refit_draws(optimum: Estimate, noise: np.ndarray) -> np.ndarray:
    """Coordinates after a whole fit to the simulation at the optimum with this noise on it."""
    descent = BatchedLevenbergMarquardt(
        optimum.problem, len(optimum.candidates), None, optimum.solution.active
    )
    shift = -optimum.solution.residual - noise
    ends = descent.run(np.tile(optimum.flat, (len(noise), 1)), shift=shift)
    return np.where(np.isfinite(ends.loss)[:, None], ends.points, np.nan)


def resample_runs(optimum: Estimate, count: int, random: np.random.Generator) -> np.ndarray:
    """Changes of the shared coordinates as runs are drawn with replacement, one step each.

    Each run's own coordinates follow the shared ones; what is left of its information and slope
    weighs as often as the run was drawn.
    """
    solution, shared = optimum.solution, optimum.shared
    active = np.flatnonzero(solution.active[: len(optimum.candidates)])
    information = np.zeros((len(active), shared, shared))
    slope = np.zeros((len(active), shared))
    for index, run in enumerate(active):
        rows = solution.blocks[run].reshape(-1, shared + optimum.own)
        whole = rows.T @ rows
        along = rows.T @ solution.residual[run].ravel()
        follow = whole[:shared, shared:] @ inverse(whole[shared:, shared:])
        information[index] = whole[:shared, :shared] - follow @ whole[shared:, :shared]
        slope[index] = along[:shared] - follow @ along[shared:]
    drawn = random.multinomial(len(active), np.full(len(active), 1 / len(active)), size=count)
    total = np.einsum("dr,rij->dij", drawn, information)
    along = drawn @ slope
    return np.stack([-inverse(t) @ a for t, a in zip(total, along, strict=True)])


# Bands ------------------------------------------------------------------------------------------


def predictive_bands(
    optimum: Estimate, moves: np.ndarray, random: np.random.Generator
) -> dict[str, dict[str, tuple[np.ndarray, np.ndarray]]]:
    """Where readings are expected: the simulation over the draws, with noise on it.

    Args:
        optimum: Where the fit ended.
        moves: Changes of all coordinates, shape (draws, coordinates).
        random: Of the noise.
    """
    plain = eqx.tree_at(
        lambda p: p.correlation, optimum.problem, jnp.zeros_like(optimum.problem.correlation)
    )
    residual, blocks = linearize(plain, optimum.solution.coordinates)
    weight = np.asarray(plain.batch.observed.weight)
    recorded = np.asarray(plain.batch.observed.values)
    moves = moves[np.isfinite(moves).all(axis=1)]
    tail = (1 - LEVEL) / 2
    bands: dict[str, dict[str, tuple[np.ndarray, np.ndarray]]] = {}
    for run, each in enumerate(optimum.candidates):
        if not optimum.solution.active[run]:
            continue
        place = optimum.shared + run * optimum.own
        mine = np.c_[moves[:, : optimum.shared], moves[:, place : place + optimum.own]]
        length = len(each.observation.time)
        bands[each.name] = {}
        for channel in each.observation.channels:
            row = plain.batch.channels.index(channel)
            here = np.flatnonzero(weight[run, row, :length] > 0)
            off = optimum.model_error.get(channel, 0.0)
            noise = np.sqrt(np.mean((residual[run, row, here] / weight[run, row, here]) ** 2))
            low, high = np.full(length, np.nan), np.full(length, np.nan)
            step = max(1, int(piece_bytes(CHUNK_BYTES) / (8 * max(len(mine), 1))))
            for begin in range(0, len(here), step):
                some = here[begin : begin + step]
                scale = weight[run, row, some]
                centre = recorded[run, row, some] + residual[run, row, some] / scale
                drawn = centre + mine @ (blocks[run, row, some] / scale[:, None]).T
                # Sample by sample, so that steps of any size draw the same.
                drawn += np.hypot(noise, off) * random.standard_normal(drawn.T.shape).T
                low[some], high[some] = np.quantile(drawn, (tail, 1 - tail), axis=0)
            bands[each.name][channel] = low, high
    return bands
