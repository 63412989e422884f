"""Which stage of the simulation an unknown error would have to act in, to explain the runs simply.

For each stage in turn an error that varies smoothly in time is estimated through the simulation's
own derivatives: a factor on zeta, a force, an error of the drive's speed, the surface's height, an
error of a reading.
The stage whose error explains most for the simplest signal has the largest evidence.
"""

from collections.abc import Sequence
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
from diagnose.linear.linear_fit import FLOOR
from diagnose.linear.residual_blocks import SlowFastSplit
from diagnose.localization.shares import (
    PROBABILITY,
    SEED,
    GapShare,
    bootstrap_counts,
)
from diagnose.model.augmented_model import AugmentedModel
from diagnose.model.linearized_run import FORCES, MOTION, LinearizedRun
from diagnose.model.unknown_inputs import INPUTS
from diagnose.unknown.gaussian_smoother import GramSums, SmoothedSignal, fit_zeta_only, smooth
from drftjax.effects.correction import READING, STAGES

# Time between a signal's knots [s], and what their number is padded to: programs are shared.
KNOT = 0.5


ROOM = 64


# Stages that act within the run, and what the error is; the others are of readings.
WITHIN = {
    "zeta": "an unknown factor on zeta (logarithm)",
    "force_x": "an unknown horizontal force",
    "force_z": "an unknown vertical force",
    "speed": "an unknown error of the drive's speed",
    "height": "an unknown height of the surface under the wheel",
}


@dataclass(frozen=True, eq=False)
class DisturbanceRegressors:
    """A stage's columns in every run: what is compared, in floors.

    Attributes:
        time: Times of the knots that lie in each run [s].
        columns: By channel and run: derivatives by (own log zeta, every knot), shape (data, 1 +
            knots); the slow part of the channel, see `diagnose.linear.residual_blocks`.
        data: By channel and run: recorded less simulated.
    """

    time: list[np.ndarray]
    columns: list[list[np.ndarray]]
    data: list[list[np.ndarray]]


@dataclass(frozen=True, eq=False)
class Disturbance:
    """An unknown error in one stage.

    Attributes:
        name: zeta, force_x, force_z, speed, height, or "reading " and a channel.
        unit: Of the signal.
        meaning: What the signal is.
        evidence: Logarithm of how much more probable it makes the runs than no signal.
        explained: Share of the squared slow part of the gap, in floors, that it takes away.
        freedom: Effective number of values that make up the signal, over all runs.
        left: What it leaves: root mean square of each channel's slow part [m, N, N m].
        time: By run, times of the signal's knots [s].
        signal: By run, the signal there.
        error: By run, its standard error.
        own: By run, change of its own log zeta that goes with it.
        level: Standard deviation of the signals' level.
        noise: By channel, the noise that goes with it, in floors.
        columns: What it was estimated from.
        power: By run, squares of the slow part in every half second, in floors: without the signal
            and with it, shape (half seconds, 2).
    """

    name: str
    unit: str
    meaning: str
    evidence: float
    explained: float
    freedom: float
    left: dict[str, float]
    time: list[np.ndarray]
    signal: list[np.ndarray]
    error: list[np.ndarray]
    own: np.ndarray
    level: float
    noise: np.ndarray
    columns: DisturbanceRegressors
    power: list[np.ndarray]


def estimate_disturbances(
    case: RigDataset, log_zeta: np.ndarray, residual: Sequence[np.ndarray] | None = None
) -> list[Disturbance]:
    """The stages by evidence, best first.

    Args:
        case: The runs.
        log_zeta: Each run's, over its set-up's, where all is linearised.
        residual: Simulated less recorded, shape (channels, samples): the reference model's where
            none is given, or what some explanation leaves.
    """
    names = [*WITHIN, *(READING + channel for channel in case.channels)]
    found = case.map_runs(lambda run: _of_run(case, run, float(log_zeta[run]), residual))
    times = [time for time, _, _ in found]
    count = 1 + max(len(time) for time in times)
    data = [[d[c] for _, _, d in found] for c in range(len(case.channels))]

    def of(name: str) -> Disturbance | None:
        columns = [[a[name][c][:, :count] for _, a, _ in found] for c in range(len(case.channels))]
        if not any(np.any(a[:, 1:]) for runs in columns for a in runs):
            return None
        return _stage(case, name, DisturbanceRegressors(times, columns, data))

    made = [each for each in case.threads.map(of, names) if each is not None]
    return sorted(made, key=lambda each: -each.evidence)


def described(name: str) -> tuple[str, float, str]:
    """Unit, typical size and meaning of a stage's signal."""
    _, unit, typical = STAGES[name]
    of_a_reading = f"an unknown error of the reading of {name.removeprefix(READING)}"
    return unit, typical, WITHIN.get(name, of_a_reading)


def floor_of(channel: str) -> float:
    """A model's own error in the slow part of a channel [m, N, N m]."""
    return FLOOR[channel, "slow"]


def _stage(case: RigDataset, name: str, columns: DisturbanceRegressors) -> Disturbance:
    unit, typical, meaning = described(name)
    sums = GramSums.of(columns.columns, columns.data)
    nothing, fit = fit_zeta_only(sums), smooth(sums, typical)
    number = sums.number.sum(axis=1)
    before, after = float(nothing.residual_power @ number), float(fit.residual_power @ number)
    lengths = [len(time) for time in columns.time]
    error = np.sqrt(np.maximum(np.einsum("rii->ri", fit.covariance), 0))
    return Disturbance(
        name,
        unit,
        meaning,
        fit.evidence - nothing.evidence,
        max(0.0, 1 - after / before) if before > 0 else 0.0,
        fit.freedom,
        _left(case, fit),
        columns.time,
        [fit.mean[r, 1 : 1 + n] for r, n in enumerate(lengths)],
        [error[r, 1 : 1 + n] for r, n in enumerate(lengths)],
        fit.mean[:, 0],
        fit.level,
        fit.noise,
        columns,
        [_power(columns, run, nothing.mean[run], fit.mean[run]) for run in range(len(lengths))],
    )


def _power(
    columns: DisturbanceRegressors, run: int, nothing: np.ndarray, signal: np.ndarray
) -> np.ndarray:
    """Squares that own zeta alone, and with the signal, leave in every half second of a run."""
    left = []
    for runs, data in zip(columns.columns, columns.data, strict=True):
        alone = data[run] - runs[run][:, : len(nothing)] @ nothing
        left.append(np.stack([alone, data[run] - runs[run] @ signal], axis=1) ** 2)
    # A change between two half seconds counts in the later one.
    total = np.zeros((max(map(len, left)), 2))
    for each in left:
        total[len(total) - len(each) :] += each
    return total


def _left(case: RigDataset, fit: SmoothedSignal) -> dict[str, float]:
    return {
        channel: float(np.sqrt(left)) * floor_of(channel)
        for channel, left in zip(case.channels, fit.residual_power, strict=True)
    }


def _of_run(case: RigDataset, run: int, log_zeta: float, residual: Sequence[np.ndarray] | None):
    """Knot times, columns by stage and channel, and data by channel of one run."""
    path = case.linearized(run, log_zeta)
    time = case.time(run)
    if residual is None:
        given = case.prediction(AugmentedModel(), run, log_zeta, np.zeros(0)) - case.recording(run)
    else:
        given = residual[run]
    splitter = SlowFastSplit.of(time)
    knots = KNOT * np.arange(int(np.ceil(time[-1] / KNOT)) + 1)
    longest = max(float(case.time(each)[-1]) for each in range(len(case.runs)))
    room = ROOM * int(np.ceil((longest / KNOT + 2) / ROOM))
    hats = _hats(path, room)
    nodes = np.asarray(path.time)[: int(path.nodes) + 1]
    slow = _Slow(case.channels, splitter, time, nodes, given)
    own = slow.of(np.asarray(propagate(path, zeta_sensitivity(path))))
    columns = {
        name: _beside(own, slow.of(np.asarray(propagate(path, _kick(path, hats, name)))))
        for name in WITHIN
    }
    at_samples = _hat(time[:, None], KNOT * np.arange(room))
    for channel in case.channels:
        read = [at_samples if c == channel else 0 * at_samples for c in case.channels]
        columns[READING + channel] = _beside(own, slow.of_samples(read))
    data = [-part[:, 0] for part in slow.of_samples(list(given[:, :, None]))]
    return knots, columns, data


@dataclass(frozen=True, eq=False)
class _Slow:
    """The slow part of every channel of a run, in floors; nothing of channels not recorded."""

    channels: tuple[str, ...]
    splitter: SlowFastSplit
    time: np.ndarray
    nodes: np.ndarray
    given: np.ndarray

    def of(self, response: np.ndarray) -> list[np.ndarray]:
        """From readings at nodes, shape (nodes, 5, columns)."""
        place = np.clip(np.searchsorted(self.nodes, self.time) - 1, 0, len(self.nodes) - 2)
        share = (self.time - self.nodes[place]) / (self.nodes[place + 1] - self.nodes[place])
        share = np.clip(share, 0, 1)[:, None]
        found = []
        for channel in self.channels:
            rows = response[:, READINGS.index(channel)]
            found.append(rows[place] * (1 - share) + rows[place + 1] * share)
        return self.of_samples(found)

    def of_samples(self, values: Sequence[np.ndarray]) -> list[np.ndarray]:
        """From samples, shape (samples, columns) for each channel."""
        found = []
        for index, (channel, rows) in enumerate(zip(self.channels, values, strict=True)):
            seen = np.isfinite(self.given[index]).all()
            means = self.splitter.bin_means @ np.where(seen, rows, 0)
            slow = np.diff(means, axis=0) if channel == "x" else means
            found.append((slow if seen else slow[:0]) / floor_of(channel))
        return found


def _beside(own: list[np.ndarray], columns: list[np.ndarray]) -> list[np.ndarray]:
    return [np.concatenate(both, axis=1) for both in zip(own, columns, strict=True)]


def _hat(time, knots):
    """One at its own knot, zero from the next ones on, straight between."""
    return np.maximum(0, 1 - np.abs(time - knots) / KNOT)


def _hats(path: LinearizedRun, room: int) -> Float[Array, "nodes knots"]:
    return jnp.asarray(_hat(np.asarray(path.middle_time)[:, None], KNOT * np.arange(room)))


def _kick(path: LinearizedRun, hats: Float[Array, "nodes knots"], name: str) -> InputSensitivity:
    nodes, room = hats.shape
    inputs = jnp.zeros((nodes, len(INPUTS), room)).at[:, INPUTS.index(name)].set(hats)
    return InputSensitivity(
        inputs,
        jnp.zeros((nodes, MOTION, room)),
        jnp.zeros((nodes, len(FORCES), room)),
        jnp.zeros((nodes, len(READINGS), room)),
        jnp.zeros((1, MOTION, room)),
    )


def by_stage(found: Sequence[Disturbance]) -> list[GapShare]:
    """What an unknown error in each stage would take away of the gap's slow part.

    Each stage is taken alone, so that these shares do not add up to one.
    """
    if not found:
        return []
    sizes = [len(each) for each in found[0].power]
    draws = bootstrap_counts(np.random.default_rng(SEED), sizes, [0] * len(sizes))

    def of(stage: Disturbance) -> GapShare:
        before, after = (draws @ np.concatenate(stage.power)).T
        share = float(stage.explained)
        drawn = np.where(before > 0, 1 - after / np.maximum(before, 1e-300), share)
        tail = 50 * (1 - PROBABILITY)
        low, high = np.percentile(np.clip(drawn, 0, 1), [tail, 100 - tail])
        interval = (float(min(low, share)), float(max(high, share)))
        return GapShare("stage", f"{stage.name}: {stage.meaning}", share, interval)

    return [of(each) for each in found]
