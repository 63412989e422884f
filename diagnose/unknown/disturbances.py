r"""Smooth unknown input in each stage of the simulation, estimated from the gap.

For each stage in turn a disturbance u(t), linear between knots, is estimated through the
simulation's own derivatives: a factor on zeta, a force, an error of the drive's speed, the height
of the surface, an error of a reading. With the regressors A of its knots and of each run's own zeta
the slow part of the gap is y = A u + noise, with a smoothness prior on u
(`diagnose.unknown.gaussian_smoother`). The stage whose disturbance explains most by the smoothest
signal has the largest evidence.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diagnose.dataset import RigDataset
from diagnose.linear.input_sensitivity import (
    READINGS,
    InputSensitivity,
    propagate,
    zeta_sensitivity,
)
from diagnose.linear.linear_fit import DEFAULT_LINEAR_FIT, LinearFitSettings
from diagnose.linear.linearized_runs import LinearizedRuns
from diagnose.linear.residual_blocks import SlowFastSplit
from diagnose.localization.settings import DEFAULT_LOCALIZATION, LocalizationSettings
from diagnose.localization.shares import GapShare, bootstrap_counts, interval_of
from diagnose.model.augmented_model import AugmentedModel
from diagnose.model.carriage_hold import CarriageHold
from diagnose.model.interpolation import rows_at
from diagnose.model.linearized_run import FORCES, MOTION
from diagnose.model.unknown_inputs import INPUTS
from diagnose.run_pool import RunPool
from diagnose.unknown.gaussian_smoother import GramSums, fit_zeta_only, smooth
from diagnose.unknown.settings import DEFAULT_UNKNOWN_EFFECT, UnknownEffectSettings
from drftjax.effects.correction import READING, STAGES

KNOT_PADDING = 64
"""The number of knots is padded to a multiple of this, so that programs are shared."""

INNER_STAGES = {
    "zeta": "an unknown factor on zeta (logarithm)",
    "force_x": "an unknown horizontal force",
    "force_z": "an unknown vertical force",
    "speed": "an unknown error of the drive's speed",
    "height": "an unknown height of the surface under the wheel",
}
"""Stages that act on the motion, and their disturbance; the others are of readings."""


@dataclass(frozen=True, eq=False)
class DisturbanceRegressors:
    """Response of every run to the knots of one stage's disturbance, in units of the model error.

    Attributes:
        time: By run, times of the knots that lie in it [s].
        columns: By channel and run, derivatives by (own log zeta, every knot), shape (data, 1 +
            knots); of the slow part of the channel, see `diagnose.linear.residual_blocks`.
        data: By channel and run, recorded minus simulated, shape (data,).
    """

    time: list[np.ndarray]
    columns: list[list[np.ndarray]]
    data: list[list[np.ndarray]]


@dataclass(frozen=True, eq=False)
class Disturbance:
    """Smooth unknown input in one stage.

    Attributes:
        name: zeta, force_x, force_z, speed, height, or "reading " and a channel.
        unit: Of the signal.
        meaning: The signal in words.
        evidence: Log evidence over that of no signal [-].
        explained: Share of the squared slow part of the gap, in units of the model error, that it
            removes [-].
        freedom: Effective number of values that make up the signal, over all runs.
        remaining: RMS of each channel's slow part that remains with it [m, N, N m].
        time: By run, times of the signal's knots [s].
        signal: By run, the signal there.
        error: By run, its standard error.
        log_zeta_change: By run, change of its own log zeta that goes with it, shape (runs,).
        level: Standard deviation of the signals' level.
        noise: By channel, standard deviation of the noise that goes with it, in units of the model
            error.
        regressors: That it was estimated from.
        power: By run, squares of the slow part in every half second, without the signal and with
            it, shape (half seconds, 2).
    """

    name: str
    unit: str
    meaning: str
    evidence: float
    explained: float
    freedom: float
    remaining: dict[str, float]
    time: list[np.ndarray]
    signal: list[np.ndarray]
    error: list[np.ndarray]
    log_zeta_change: np.ndarray
    level: float
    noise: np.ndarray
    regressors: DisturbanceRegressors
    power: list[np.ndarray]


def estimate_disturbances(
    dataset: RigDataset,
    linearized: LinearizedRuns,
    pool: RunPool,
    residual: Sequence[np.ndarray] | None = None,
    settings: UnknownEffectSettings = DEFAULT_UNKNOWN_EFFECT,
    linear_fit: LinearFitSettings = DEFAULT_LINEAR_FIT,
) -> list[Disturbance]:
    """Disturbance of every stage, the largest evidence first.

    Args:
        dataset: The runs.
        linearized: The same, linearised along the reference model.
        pool: Threads.
        residual: By run, simulated minus recorded, shape (channels, samples): of a hypothesis, or
            of the reference model where none is given.
        settings: Spacing of the knots.
        linear_fit: For a model's own error, the unit of all data here.
    """
    errors = {each: linear_fit.model_error[each, "slow"] for each in dataset.channels}
    names = [*INNER_STAGES, *(READING + channel for channel in dataset.channels)]

    def of_run(run: int):
        given = None if residual is None else residual[run]
        return _run_regressors(dataset, run, linearized, given, settings.knot_spacing, errors)

    found = dataset.map(pool, of_run)
    times = [time for time, _, _ in found]
    count = 1 + max(len(time) for time in times)
    channels = range(len(dataset.channels))
    data = [[d[c] for _, _, d in found] for c in channels]

    def of_stage(name: str) -> Disturbance | None:
        columns = [[a[name][c][:, :count] for _, a, _ in found] for c in channels]
        if not any(np.any(a[:, 1:]) for runs in columns for a in runs):
            return None
        return _disturbance(dataset, name, DisturbanceRegressors(times, columns, data), errors)

    made = [each for each in pool.map(of_stage, names) if each is not None]
    return sorted(made, key=lambda each: -each.evidence)


def describe_stage(name: str) -> tuple[str, float, str]:
    """Unit, typical size and meaning of a stage's signal."""
    _, unit, typical = STAGES[name]
    of_a_reading = f"an unknown error of the reading of {name.removeprefix(READING)}"
    return unit, typical, INNER_STAGES.get(name, of_a_reading)


def _disturbance(
    dataset: RigDataset,
    name: str,
    regressors: DisturbanceRegressors,
    errors: Mapping[str, float],
) -> Disturbance:
    """Estimate of one stage's signal; `errors` is the unit of each channel's data [m, N, N m]."""
    unit, typical, meaning = describe_stage(name)
    sums = GramSums.of(regressors.columns, regressors.data)
    nothing, fit = fit_zeta_only(sums), smooth(sums, typical)
    number = sums.number.sum(axis=1)
    before, after = float(nothing.residual_power @ number), float(fit.residual_power @ number)
    lengths = [len(time) for time in regressors.time]
    error = np.sqrt(np.maximum(np.einsum("rii->ri", fit.covariance), 0))
    return Disturbance(
        name=name,
        unit=unit,
        meaning=meaning,
        evidence=fit.evidence - nothing.evidence,
        explained=max(0.0, 1 - after / before) if before > 0 else 0.0,
        freedom=fit.freedom,
        remaining={
            channel: float(np.sqrt(left)) * errors[channel]
            for channel, left in zip(dataset.channels, fit.residual_power, strict=True)
        },
        time=regressors.time,
        signal=[fit.mean[r, 1 : 1 + n] for r, n in enumerate(lengths)],
        error=[error[r, 1 : 1 + n] for r, n in enumerate(lengths)],
        log_zeta_change=fit.mean[:, 0],
        level=fit.level,
        noise=fit.noise,
        regressors=regressors,
        power=[_power(regressors, r, nothing.mean[r], fit.mean[r]) for r in range(len(lengths))],
    )


def _power(
    regressors: DisturbanceRegressors, run: int, zeta_only: np.ndarray, with_signal: np.ndarray
) -> np.ndarray:
    """Squares that remain in every half second of a run, shape (half seconds, 2).

    Args:
        regressors: The data.
        run: Index of the run.
        zeta_only, with_signal: Coefficients of the columns in both fits.
    """
    squares = []
    for runs, data in zip(regressors.columns, regressors.data, strict=True):
        without = data[run] - runs[run][:, : len(zeta_only)] @ zeta_only
        squares.append(np.stack([without, data[run] - runs[run] @ with_signal], axis=1) ** 2)
    # A change between two half seconds counts in the later one.
    total = np.zeros((max(map(len, squares)), 2))
    for each in squares:
        total[len(total) - len(each) :] += each
    return total


def _run_regressors(
    dataset: RigDataset,
    run: int,
    runs: LinearizedRuns,
    residual: np.ndarray | None,
    spacing: float,
    errors: Mapping[str, float],
) -> tuple[np.ndarray, dict[str, list[np.ndarray]], list[np.ndarray]]:
    """Times of the knots, columns by stage and channel, and data by channel of one run.

    Args:
        dataset: The runs.
        run: Index of the run.
        runs: All runs, linearised.
        residual: Simulated minus recorded; the reference model's for None.
        spacing: Of the knots [s].
        errors: Unit of each channel's data [m, N, N m].
    """
    linearized, log_zeta = runs.runs[run], float(runs.log_zeta[run])
    time = dataset.time(run)
    if residual is None:
        simulated = dataset.prediction(AugmentedModel(), run, log_zeta, np.zeros(0))
        residual = simulated - dataset.recording(run)
    knots = spacing * np.arange(int(np.ceil(time[-1] / spacing)) + 1)
    longest = max(float(dataset.time(each)[-1]) for each in range(len(dataset.runs)))
    size = KNOT_PADDING * int(np.ceil((longest / spacing + 2) / KNOT_PADDING))
    padded_knots = spacing * np.arange(size)
    hats = jnp.asarray(_hat(np.asarray(linearized.middle_time)[:, None], padded_knots, spacing))
    nodes = np.asarray(linearized.time)[: int(linearized.nodes) + 1]
    split, hold = SlowFastSplit.of(time), dataset.holds[run]
    slow = _SlowPart(dataset.channels, split, time, nodes, residual, errors, hold)
    own = slow.of_nodes(np.asarray(propagate(linearized, zeta_sensitivity(linearized))))
    columns = {}
    for name in INNER_STAGES:
        response = np.asarray(propagate(linearized, _hat_sensitivity(hats, name)))
        columns[name] = _beside(own, slow.of_nodes(response))
    at_samples = _hat(time[:, None], padded_knots, spacing)
    for channel in dataset.channels:
        read = [at_samples if c == channel else 0 * at_samples for c in dataset.channels]
        columns[READING + channel] = _beside(own, slow.of_readings(read))
    data = [-part[:, 0] for part in slow.of_samples(list(residual[:, :, None]))]
    return knots, columns, data


@dataclass(frozen=True, eq=False)
class _SlowPart:
    """Slow part of every channel of a run, in units of the model error; empty if not recorded."""

    channels: tuple[str, ...]
    splitter: SlowFastSplit
    time: np.ndarray
    nodes: np.ndarray
    residual: np.ndarray
    errors: Mapping[str, float]
    hold: CarriageHold

    def of_nodes(self, response: np.ndarray) -> list[np.ndarray]:
        """By channel, of readings at nodes, shape (nodes, 5, columns)."""
        picked = response[:, [READINGS.index(channel) for channel in self.channels]]
        at_samples = rows_at(self.nodes, picked, self.time)
        return self.of_readings(list(np.moveaxis(at_samples, 1, 0)))

    def of_readings(self, values: Sequence[np.ndarray]) -> list[np.ndarray]:
        """By channel, of readings at samples, shape (samples, columns) each."""
        return self.of_samples(list(self.hold.of_readings(np.stack(values))))

    def of_samples(self, values: Sequence[np.ndarray]) -> list[np.ndarray]:
        """By channel, of values at samples, shape (samples, columns) each."""
        found = []
        for index, (channel, rows) in enumerate(zip(self.channels, values, strict=True)):
            recorded = np.isfinite(self.residual[index]).all()
            means = self.splitter.bin_means @ np.where(recorded, rows, 0)
            slow = np.diff(means, axis=0) if channel == "x" else means
            found.append((slow if recorded else slow[:0]) / self.errors[channel])
        return found


def _beside(own: list[np.ndarray], columns: list[np.ndarray]) -> list[np.ndarray]:
    return [np.concatenate(both, axis=1) for both in zip(own, columns, strict=True)]


def _hat(time: np.ndarray, knots: np.ndarray, spacing: float) -> np.ndarray:
    """Hat functions: one at its own knot, zero from the next ones on, linear between."""
    return np.maximum(0, 1 - np.abs(time - knots) / spacing)


def _hat_sensitivity(hats: Float[Array, "nodes knots"], stage: str) -> InputSensitivity:
    """Derivative of the inputs by the knots of one stage's disturbance."""
    nodes, knots = hats.shape
    inputs = jnp.zeros((nodes, len(INPUTS), knots)).at[:, INPUTS.index(stage)].set(hats)
    return InputSensitivity(
        inputs,
        jnp.zeros((nodes, MOTION, knots)),
        jnp.zeros((nodes, len(FORCES), knots)),
        jnp.zeros((nodes, len(READINGS), knots)),
        jnp.zeros((1, MOTION, knots)),
    )


def by_stage(
    found: Sequence[Disturbance], settings: LocalizationSettings = DEFAULT_LOCALIZATION
) -> list[GapShare]:
    """Share of the gap's slow part that a disturbance in each stage would remove.

    Each stage is taken alone, so these shares do not add up to one.

    Args:
        found: By `estimate_disturbances`.
        settings: Numbers of the intervals.
    """
    if not found:
        return []
    sizes = [len(each) for each in found[0].power]
    random = np.random.default_rng(settings.seed)
    draws = bootstrap_counts(random, sizes, [0] * len(sizes), settings.draws)

    def share_of(each: Disturbance) -> GapShare:
        before, after = (draws @ np.concatenate(each.power)).T
        share = float(each.explained)
        drawn = np.where(before > 0, 1 - after / np.maximum(before, 1e-300), share)
        interval = interval_of(np.clip(drawn, 0, 1), share, settings)
        return GapShare("stage", f"{each.name}: {each.meaning}", share, interval)

    return [share_of(each) for each in found]
