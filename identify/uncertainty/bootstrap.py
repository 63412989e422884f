r"""Bootstrap: scatter of values and simulated channels over recordings that might have been made.

Parametric: noise like the residuals' own (first-order autoregressive, of each run's and channel's
size, and a constant in every phase of the command that the simulation may be off by; what a zeta
that runs share scatters by from run to run) is put on the fitted simulation, and the fit made
again. Over runs: as many runs are drawn with replacement, which needs no model of the noise but
several runs, and speaks of shared values only.

Each refit is one Gauss-Newton step from the estimate with the derivative stored there,
$-(J^T J)^{-1} J^T r$: exact where the simulation is a straight line over the errors. `refit=True`
goes all the way instead, every draw side by side.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from drftjax.common.errors import InputError
from drftjax.common.memory import chunk_bytes
from identify.solver.batched_levenberg_marquardt import BatchedLevenbergMarquardt
from identify.solver.multistart import DRAWS_SEED
from identify.solver.problem import linearize, normal_equations
from identify.uncertainty.covariance import regularized_inverse
from identify.uncertainty.estimate import Estimate

# Draws that a bootstrap may be asked for, at least and at most.
MIN_DRAWS, MAX_DRAWS = 20, 100_000


# Noise and bands of so many bytes at most are held at once.
CHUNK_BYTES = 1e8


# Draws of the noise that are made together, so that they are the same in pieces of any size.
DRAWN_TOGETHER = 20


@dataclass(frozen=True)
class BootstrapSettings:
    """Numbers of the bootstrap.

    Attributes:
        level: Level of intervals and bands [-].
        min_runs: Runs from which on they are resampled; fewer say nothing of the scatter from run
            to run.
    """

    level: float = 0.90
    min_runs: int = 3


BOOTSTRAP_SETTINGS = BootstrapSettings()


@dataclass(frozen=True, eq=False)
class Bootstrap:
    """Draws of values, with intervals.

    Attributes:
        over: "noise" or "runs".
        refit: True where every draw was fitted to convergence, not by one Gauss-Newton step.
        labels: Name of each value.
        draws: Values, shape (draws, values).
        low, high: Ends of each value's interval, shape (values,).
        error: Standard deviation of each, shape (values,).
        level: Level of intervals and bands.
        bands: Lower and upper end of the readings expected at the recorded times, by run and
            channel [m, N, N m]; NaN where nothing was compared.
    """

    over: str
    refit: bool
    labels: tuple[str, ...]
    draws: np.ndarray
    low: np.ndarray
    high: np.ndarray
    error: np.ndarray
    level: float = BootstrapSettings.level
    bands: dict[str, dict[str, tuple[np.ndarray, np.ndarray]]] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        over: str,
        refit: bool,
        labels: tuple[str, ...],
        draws: np.ndarray,
        bands: dict | None = None,
        level: float = BootstrapSettings.level,
    ) -> "Bootstrap":
        """Return intervals and errors of these draws."""
        tail = (1 - level) / 2
        low, high = np.nanquantile(draws, (tail, 1 - tail), axis=0)
        error = np.nanstd(draws, axis=0, ddof=1)
        return cls(over, refit, labels, draws, low, high, error, level, bands or {})

    def sentences(self) -> list[str]:
        """Return a sentence with each value's interval."""
        how = "refitted" if self.refit else "linearised"
        lines = [f"bootstrap over {self.over}, {len(self.draws)} draws, {how}:"]
        lines += [
            f"  {name} {low:.5g} to {high:.5g} ({100 * self.level:.0f} %)"
            for name, low, high in zip(self.labels, self.low, self.high, strict=True)
        ]
        return lines


def require_draws(count: int) -> None:
    """Raise InputError for a number of draws that makes no interval, or takes too long."""
    if not MIN_DRAWS <= count <= MAX_DRAWS:
        raise InputError(
            f"the number of draws is {count}, must lie between {MIN_DRAWS} and {MAX_DRAWS} "
            "(--bootstrap)"
        )


def bootstrap(
    estimate: Estimate,
    count: int,
    *,
    seed: int = DRAWS_SEED,
    refit: bool = False,
    settings: BootstrapSettings = BOOTSTRAP_SETTINGS,
) -> list[Bootstrap]:
    """Draw values over the noise, and over the runs where there are enough of them.

    Args:
        estimate: Of the fit.
        count: Number of draws.
        seed: Of the draws.
        refit: Fit every draw of the noise to convergence.
        settings: Decision numbers.

    Raises:
        InputError: for too few or too many draws, or full refits of a fit with priors.
    """
    require_draws(count)
    if refit and estimate.slope_rescaling is not None:
        raise InputError(
            "full refits of draws weigh every sample alike and would outweigh the priors; "
            "leave refit out"
        )
    random_priors = np.random.default_rng([seed, 3])
    points = np.concatenate(
        [
            refit_draws(estimate, noise)
            if refit
            else one_step_draws(estimate, noise, random_priors)
            for noise in noise_chunks(estimate, count, np.random.default_rng(seed))
        ]
    )
    draws = estimate.values(points)
    bands = predictive_bands(
        estimate, points - estimate.flat, np.random.default_rng([seed, 1]), settings
    )
    level = settings.level
    found = [Bootstrap.of("noise", refit, estimate.labels, draws, bands, level)]
    active = np.flatnonzero(estimate.solution.active[: len(estimate.runs)])
    # Nothing says how resampled runs and a prior outweigh each other.
    if estimate.shared and len(active) >= settings.min_runs and estimate.slope_rescaling is None:
        moves = resample_runs(estimate, count, np.random.default_rng([seed, 2]))
        flat = np.tile(estimate.flat, (count, 1))
        flat[:, : estimate.shared] += moves
        values = estimate.values(flat)[:, : estimate.shared]
        labels = estimate.labels[: estimate.shared]
        found.append(Bootstrap.of("runs", False, labels, values, None, level))
    return found


# Draws ------------------------------------------------------------------------------------------


def noise_chunks(
    estimate: Estimate, count: int, random: np.random.Generator
) -> Iterator[np.ndarray]:
    """Noise like the residuals', a bounded number of draws at a time.

    Yields:
        Weighted residuals of noise alone, shape (draws, runs, channels, samples).
    """
    size = 8 * DRAWN_TOGETHER * max(estimate.noise_residual.size, 1)
    step = DRAWN_TOGETHER * max(1, int(chunk_bytes(CHUNK_BYTES) / size))
    for begin in range(0, count, step):
        end = min(count, begin + step)
        yield np.concatenate(
            [
                simulated_noise(estimate, min(DRAWN_TOGETHER, end - at), random)
                for at in range(begin, end, DRAWN_TOGETHER)
            ]
        )


def simulated_noise(estimate: Estimate, count: int, random: np.random.Generator) -> np.ndarray:
    """Draw weighted residuals of noise alone, as the fit takes it to be.

    By the noise model, plus a constant in every phase, plus the scatter of a shared zeta.

    Returns:
        Shape (draws, runs, channels, samples).
    """
    residual, whitening = estimate.noise_residual, estimate.whitening
    model = estimate.problem.noise
    counts = whitening.scale > 0
    intervals = np.asarray(estimate.problem.batch.observed.intervals)
    noise = np.zeros((count, *residual.shape))
    for run, channel in np.ndindex(residual.shape[:2]):
        here = counts[run, channel]
        if not here.any():
            continue
        spread = max(float(np.sqrt(np.mean(residual[run, channel, here] ** 2))), whitening.finest)
        drawn = model.sample(random, count, residual[run, channel], here, intervals[run])
        noise[:, run, channel] = np.where(here, spread * drawn, 0)
        # The unit vectors are whitened; back to weighted residuals.
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
    for shared, variance in enumerate(estimate.run_variance):
        deviation = np.sqrt(variance) * random.standard_normal((count, len(residual)))
        noise += deviation[:, :, None, None] * estimate.solution.blocks[..., shared]
    return noise


def one_step_draws(
    estimate: Estimate, noise: np.ndarray, random: np.random.Generator
) -> np.ndarray:
    """Return coordinates after one Gauss-Newton step towards recordings with this noise.

    Args:
        estimate: Of the fit.
        noise: Weighted residuals of noise alone, shape (draws, runs, channels, samples).
        random: Source of draws from the priors.

    Returns:
        Shape (draws, coordinates).
    """
    solution, runs = estimate.solution, len(estimate.runs)
    blocks = solution.blocks[:runs]
    size = len(estimate.flat)
    along = np.zeros((len(noise), size))
    for run in range(runs):
        rows = blocks[run].reshape(-1, blocks.shape[-1])
        both = noise[:, run].reshape(len(noise), -1) @ rows
        along[:, : estimate.shared] += both[:, : estimate.shared]
        place = estimate.shared + run * estimate.own
        along[:, place : place + estimate.own] = both[:, estimate.shared :]
    if estimate.slope_rescaling is not None:
        from_priors = solution.prior_slope[:size] * random.standard_normal(along.shape)
        from_runs = along @ estimate.slope_rescaling[:size, :size].T
        return estimate.flat + (from_runs + from_priors) @ estimate.covariance[:size, :size]
    information, _ = normal_equations(blocks, estimate.shared, solution.residual)
    return estimate.flat + along @ regularized_inverse(information)


def refit_draws(estimate: Estimate, noise: np.ndarray) -> np.ndarray:
    """Return coordinates after a whole fit to the simulation with this noise added."""
    descent = BatchedLevenbergMarquardt(
        estimate.problem, len(estimate.runs), None, estimate.solution.active
    )
    shift = -estimate.solution.residual - noise
    ends = descent.run(np.tile(estimate.flat, (len(noise), 1)), shift=shift)
    return np.where(np.isfinite(ends.loss)[:, None], ends.points, np.nan)


def resample_runs(estimate: Estimate, count: int, random: np.random.Generator) -> np.ndarray:
    """Return changes of the shared coordinates as runs are drawn with replacement, one step each.

    Each run's own coordinates are eliminated (Schur complement); the rest of its information and
    slope counts as often as the run was drawn. Shape (draws, shared).
    """
    solution, shared = estimate.solution, estimate.shared
    active = np.flatnonzero(solution.active[: len(estimate.runs)])
    information = np.zeros((len(active), shared, shared))
    slope = np.zeros((len(active), shared))
    for index, run in enumerate(active):
        rows = solution.blocks[run].reshape(-1, shared + estimate.own)
        whole = rows.T @ rows
        along = rows.T @ solution.residual[run].ravel()
        follow = whole[:shared, shared:] @ regularized_inverse(whole[shared:, shared:])
        information[index] = whole[:shared, :shared] - follow @ whole[shared:, :shared]
        slope[index] = along[:shared] - follow @ along[shared:]
    drawn = random.multinomial(len(active), np.full(len(active), 1 / len(active)), size=count)
    total = np.einsum("dr,rij->dij", drawn, information)
    along = drawn @ slope
    return np.stack([-regularized_inverse(t) @ a for t, a in zip(total, along, strict=True)])


# Bands ------------------------------------------------------------------------------------------


def predictive_bands(
    estimate: Estimate,
    moves: np.ndarray,
    random: np.random.Generator,
    settings: BootstrapSettings = BOOTSTRAP_SETTINGS,
) -> dict[str, dict[str, tuple[np.ndarray, np.ndarray]]]:
    """Return the band of expected readings: the simulation over the draws, with noise added.

    Args:
        estimate: Of the fit.
        moves: Changes of all coordinates, shape (draws, coordinates).
        random: Source of the noise.
        settings: Decision numbers.

    Returns:
        By run and channel, lower and upper end [m, N, N m], shape (samples,).
    """
    problem = estimate.problem
    plain = replace(problem, noise=problem.noise.for_channels(len(problem.batch.channels)))
    residual, blocks = linearize(plain, estimate.solution.coordinates)
    weight = np.asarray(plain.batch.observed.weight)
    recorded = np.asarray(plain.batch.observed.values)
    moves = moves[np.isfinite(moves).all(axis=1)]
    tail = (1 - settings.level) / 2
    bands: dict[str, dict[str, tuple[np.ndarray, np.ndarray]]] = {}
    for run, each in enumerate(estimate.runs):
        if not estimate.solution.active[run]:
            continue
        place = estimate.shared + run * estimate.own
        mine = np.c_[moves[:, : estimate.shared], moves[:, place : place + estimate.own]]
        length = len(each.observation.time)
        bands[each.name] = {}
        for channel in each.observation.channels:
            row = plain.batch.channels.index(channel)
            here = np.flatnonzero(weight[run, row, :length] > 0)
            off = float(estimate.model_error[channel][run])
            noise = np.sqrt(np.mean((residual[run, row, here] / weight[run, row, here]) ** 2))
            low, high = np.full(length, np.nan), np.full(length, np.nan)
            step = max(1, int(chunk_bytes(CHUNK_BYTES) / (8 * max(len(mine), 1))))
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
