"""Batch of runs: one compiled program simulates and differentiates all of them.

Runs differ in length and in their recorded times, so all are padded to the longest and masked:
a padded row has weight zero. The batch is spread over the machine's devices, a share of the runs
on each.
"""

import math
from collections.abc import Callable, Sequence
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, Mesh, PartitionSpec
from jaxtyping import Array, Float, Int

from drftjax.common.errors import InputError
from drftjax.physics.state import Output
from drftjax.recorded.observation import Observation
from drftjax.runlog.record import CHANNELS
from drftjax.simulation.trial import Trial, pad_trial

Values = TypeVar("Values")


OTHER_KIND = "has another kind of wheel, terrain, carriage or integrator"


class PaddedObservations(eqx.Module):
    """Padded recordings of a batch, runs leading.

    Attributes:
        row: Row of the simulation before each recorded time, shape (runs, samples).
        share: Place between that row and the next [-], 0 to 1, shape (runs, samples).
        intervals: Usual intervals from the sample before, more than one after a gap, shape (runs,
            samples).
        values: Recorded channels, shape (runs, channels, samples).
        step_error: Error of simulated channels by their step, which is taken off, like `values`.
        weight: 1 / noise of a sample that counts, 0 of a padded one, like `values`.
        compared_rows, all_rows: Rows of the simulation up to the last sample that counts, and up
            to the last one, shape (runs,).
    """

    row: Int[Array, "runs samples"]
    share: Float[Array, "runs samples"]
    intervals: Float[Array, "runs samples"]
    values: Float[Array, "runs channels samples"]
    step_error: Float[Array, "runs channels samples"]
    weight: Float[Array, "runs channels samples"]
    compared_rows: Int[Array, " runs"]
    all_rows: Int[Array, " runs"]


class Batch(eqx.Module):
    """Trials and their recordings, ready for one compiled program.

    Attributes:
        trials: Trials stacked along a leading axis of runs.
        observed: Their recordings.
        channels: Names of the channels compared; one that a run lacks has weight zero there.
        runs: Number of true runs; the rest are padding of weight zero.
        order: Runs in the order in which the devices take them, an equal number each.
    """

    trials: Trial
    observed: PaddedObservations
    channels: tuple[str, ...] = eqx.field(static=True)
    runs: Int[Array, ""]
    order: Int[Array, " runs"]


def make_batch(
    trials: Sequence[Trial],
    observations: Sequence[Observation],
    multiple: int = 1,
    size: Callable[[int], int] | None = None,
) -> Batch:
    """Stack trials and observations, padded to a multiple of the devices.

    Args:
        trials: One for each run, all of the same kind of wheel, law and carriage.
        observations: One for each run.
        multiple: The number of runs is padded to a multiple of this.
        size: Padded length by length; `padded_size` where none is given.

    Raises:
        InputError: the trials do not share one compiled program.
    """
    for number, trial in enumerate(trials[1:], start=2):
        if not share_program(trial, trials[0]):
            raise InputError(f"run {number} {OTHER_KIND} than the first; fit such runs apart")
    channels = tuple(c for c in CHANNELS if any(c in o.channels for o in observations))
    size = padded_size if size is None else size
    rows = size(max(trial.rows for trial in trials))
    knots = size(max(len(trial.time) for trial in trials))
    samples = size(max(len(o.time) for o in observations))
    padded = [pad_trial(trial, rows, knots) for trial in trials]
    recorded = [
        _pad_observation(o, channels, samples, trial)
        for o, trial in zip(observations, trials, strict=True)
    ]
    padding = multiple * padded_size(math.ceil(len(trials) / multiple)) - len(trials)
    padded += padded[:1] * padding
    nothing = 0 * recorded[0].weight, jnp.asarray(0), jnp.asarray(0)
    silent = eqx.tree_at(lambda o: (o.weight, o.compared_rows, o.all_rows), recorded[0], nothing)
    recorded += [silent] * padding
    stack = lambda *leaves: jnp.asarray(np.stack([np.asarray(x) for x in leaves]))  # noqa: E731
    return Batch(
        jax.tree.map(stack, *padded),
        jax.tree.map(stack, *recorded),
        channels,
        jnp.asarray(len(trials)),
        jnp.asarray(_shares([int(each.compared_rows) for each in recorded], multiple)),
    )


def _shares(work: list[int], devices: int) -> np.ndarray:
    """Order of the runs that gives each device as many runs, and about as much work."""
    places = len(work) // devices
    shares: list[list[int]] = [[] for _ in range(devices)]
    for run in sorted(range(len(work)), key=lambda run: -work[run]):
        open_shares = [share for share in shares if len(share) < places]
        min(open_shares, key=lambda share: sum(work[r] for r in share)).append(run)
    return np.array([run for share in shares for run in share])


def padded_size(count: int) -> int:
    """The next of 1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 16, 20, ...: a size that batches share.

    A program is compiled for sizes; padded to these, batches of about one size share it, for at
    most a quarter more to compute.
    """
    unit = 2 ** max(0, (count - 1).bit_length() - 3)
    return unit * math.ceil(count / unit)


def share_program(trial: Trial, other: Trial) -> bool:
    """True where one compiled program runs both: same kind of wheel, terrain, rig and method."""

    def kind(trial: Trial) -> tuple:
        # The numbers of rows and of knots are padded.
        leaves, structure = jax.tree.flatten((trial.simulator, trial.start))
        return structure, trial.every, [each.shape for each in leaves]

    return kind(trial) == kind(other)


def _pad_observation(
    observation: Observation, channels: tuple[str, ...], samples: int, trial: Trial
) -> PaddedObservations:
    """Recording of one run, padded to a number of samples, at rows of its trial."""
    interval = trial.every * float(trial.step)
    place = np.clip(observation.time / interval, 0, None)
    row = np.clip(np.floor(place + 1e-9), 0, trial.rows - 1)
    share = np.clip(place - row, 0, 1)
    extra = samples - len(observation.time)
    values = np.zeros((len(channels), len(observation.time)))
    weight, step_error = np.zeros_like(values), np.zeros_like(values)
    for channel, (recorded, noise) in observation.by_channel().items():
        values[channels.index(channel)] = recorded
        weight[channels.index(channel)] = observation.counts / noise
    if observation.step_error is not None:
        step_error[[channels.index(each) for each in observation.channels]] = observation.step_error

    def padded(values: np.ndarray, dtype: type = float, filling: float = 0) -> Array:
        width = [(0, 0)] * (values.ndim - 1) + [(0, extra)]
        return jnp.asarray(np.pad(values, width, constant_values=filling).astype(dtype))

    return PaddedObservations(
        padded(row, int),
        padded(share),
        padded(observation.intervals, filling=1),
        padded(values),
        padded(step_error),
        padded(weight),
        jnp.asarray(int(row[observation.counts].max(initial=-1)) + 1),
        jnp.asarray(int(row.max(initial=-1)) + 1),
    )


def sample_channels(
    output: Output, observed: PaddedObservations, channels: tuple[str, ...]
) -> Array:
    """Simulated channels of one run at its recorded times, shape (channels, samples)."""
    return between_rows(jnp.stack([getattr(output, each) for each in channels]), observed)


def between_rows(rows: Float[Array, "channels rows"], observed: PaddedObservations) -> Array:
    """Channels at the recorded times of a run, their error by the step taken off.

    Args:
        rows: Simulated channels, shape (channels, rows).
        observed: The run's recording.

    Returns:
        Shape (channels, samples).
    """
    before, after = rows[:, observed.row], rows[:, observed.row + 1]
    return before + observed.share * (after - before) - observed.step_error


def map_over_runs(batch: Batch, mesh: Mesh, one: Callable, shared, own):
    """Map a function over all runs, a share of them on each device.

    Args:
        batch: The runs.
        mesh: The devices.
        one: Function of a run's trial, its recording, `shared`, and the run's share of `own`.
        shared: Tree of arrays that is the same for every run.
        own: Tree of arrays with a leading axis of runs.

    Returns:
        Results of `one`, arrays with a leading axis of runs, in the batch's order.
    """
    spread, whole = PartitionSpec("runs"), PartitionSpec()
    trials, observed, each = jax.tree.map(
        lambda leaf: leaf[batch.order], (batch.trials, batch.observed, own)
    )

    # One run after the other on a device: each ends with its own rows, and none is padded.
    def in_turn(trials: Trial, observed: PaddedObservations, shared, own):
        return jax.lax.map(lambda run: one(run[0], run[1], shared, run[2]), (trials, observed, own))

    shares = jax.shard_map(
        in_turn,
        mesh=mesh,
        in_specs=(spread, spread, whole, spread),
        out_specs=spread,
        check_vma=False,
    )(trials, observed, shared, each)
    return jax.tree.map(lambda leaf: leaf[jnp.argsort(batch.order)], shares)


def device_mesh() -> Mesh:
    """All of JAX's devices in a row, to share the runs of a batch."""
    return jax.make_mesh((jax.device_count(),), ("runs",), axis_types=(AxisType.Auto,))
