r"""Hold of a free carriage: the sand's force less the carriage's inertia.

Of a free carriage the sand's force on the wheel, as a load cell at the axle reads it, is

$$F_x = m_x \ddot x + H_x, \qquad F_z = m_z \ddot z + H_z,$$

so that x and z, twice differentiated, tell it already, but for H: what pulls at the carriage
(friction, a cable, a slope of the rail) and the weight that the sand bears. H is a statement about
the rig that no law of the sand has a part in, so H is what is compared. A simulation tells it step
by step. Of a recording, force and motion are averaged with the weights $(1 - (t/\tau)^2)^2$ over
$\pm\tau$ before second differences are taken, as those of single readings are mostly noise; the
simulated H is averaged likewise.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.ndimage import correlate1d

from diagnose.model.interpolation import rows_at
from drftjax.physics.rig import FreeCarriage
from drftjax.recorded.prepared_run import PreparedRun
from drftjax.simulation.trial import Trial

# Half the time over which force and motion are averaged [s]: a pull that changes faster is not
# seen.
HALF_WINDOW = 0.25

# A load that has just begun may let a wheel slip in less time than a row [s]: it is taken from here
# on.
LET_GO = 0.2

# By channel, the one whose motion it is beside, and the mass that moves.
BESIDE = {"fx": ("x", "mass_x"), "fz": ("z", "mass_z")}

# Outputs of a simulation that its forces are taken beside, in the order of those.
SPEEDS = ("vx", "vz")


def holds_carriage(blocks: Sequence[tuple[str, str]]) -> list[bool]:
    """By (channel, kind) of a block: it tells what holds a free carriage, which x is read of."""
    is_free = any(channel == "x" for channel, _ in blocks)
    return [is_free and channel in BESIDE for channel, _ in blocks]


@dataclass(frozen=True, eq=False)
class CarriageHold:
    """Readings of one run whose forces, of a free carriage, are those that hold it.

    Attributes:
        channels: Names of the rows of all arrays.
        time: Times of the samples [s], shape (samples,).
        masses: Mass that moves with the wheel, by channel of force [kg]; none of a driven carriage,
            whose forces stay as they are read.
    """

    channels: tuple[str, ...]
    time: np.ndarray
    masses: dict[str, float]

    @classmethod
    def of(cls, run: PreparedRun, channels: tuple[str, ...], time: np.ndarray) -> "CarriageHold":
        """Of one run, at the times compared [s]."""
        is_free, rig = run.setup.rig.carriage == "free", run.setup.rig
        masses = {
            force: float(getattr(rig, mass))
            for force, (motion, mass) in BESIDE.items()
            if is_free and {force, motion} <= {*channels}
        }
        return cls(channels, time, masses)

    def of_readings(self, values: np.ndarray) -> np.ndarray:
        """Channels as they are read, their forces as they are compared [m, N, N m].

        Args:
            values: Readings, or changes of them, shape (channels, samples, ...).

        Returns:
            The same shape; a force is NaN in a run shorter than two averages.
        """
        held = np.array(values, float)
        for force, mass in self.masses.items():
            place, motion = self.channels.index(force), self.channels.index(BESIDE[force][0])
            held[place] = self._averaged(values[place], mass, values[motion])
        return held

    def of_simulation(self, values: np.ndarray) -> np.ndarray:
        """Simulated channels, whose forces hold the carriage already, averaged alike.

        Args:
            values: Channels, or derivatives of them, shape (channels, samples, ...).
        """
        if not self.masses:
            return values
        held = np.array(values, float)
        for force in self.masses:
            held[self.channels.index(force)] = self._averaged(values[self.channels.index(force)])
        return held

    def noise(self, channel: str, sigma: float) -> float:
        """White noise of a channel as it is compared [m, N, N m].

        That of the motion adds some mN to a force and is left out.

        Args:
            channel: Name of the channel.
            sigma: White noise of its readings, likewise.
        """
        if channel not in self.masses or len(self.time) < 2:
            return sigma
        weight = _weights(float(np.median(np.diff(self.time))))
        return sigma * float(np.sqrt((weight**2).sum()))

    def _averaged(
        self, force: np.ndarray, mass: float = 0.0, motion: np.ndarray | None = None
    ) -> np.ndarray:
        """Average of a force [N], less a mass times the acceleration of some motion."""
        if len(self.time) < 2:
            return np.full_like(force, np.nan)
        interval = float(np.median(np.diff(self.time)))
        weight = _weights(interval)
        first, last = (round(each / interval) for each in self.time[[0, -1]])
        even = interval * np.arange(first, last + 1)
        # An average reaches so far, and a second difference of averages by two further.
        edge = len(weight) // 2 + 2
        if len(even) <= 2 * edge:
            return np.full_like(force, np.nan)

        def average(rows: np.ndarray) -> np.ndarray:
            evenly = rows_at(self.time, rows, even)
            return correlate1d(evenly, weight, axis=0, mode="nearest")

        whole = average(force)
        if motion is not None:
            speed = np.gradient(average(motion), interval, axis=0)
            whole = whole - mass * np.gradient(speed, interval, axis=0)
        # Near its ends a run has no whole average: the next one stands for it.
        inner = np.clip(np.arange(len(even)), edge, len(even) - 1 - edge)
        return rows_at(even, whole[inner], self.time)


def _weights(interval: float) -> np.ndarray:
    """Weights of an average over readings so far apart [s]; they sum to one."""
    half = max(1, round(HALF_WINDOW / interval))
    weight = (1 - (np.arange(-half, half + 1) / (half + 1)) ** 2) ** 2
    return weight / weight.sum()


def holding_forces(table: Array, channels: tuple[str, ...], trial: Trial) -> Array:
    """Channels of a run; the forces on a free carriage less what moves its masses.

    A step's force is that of its change of speed, so that what is left is what holds the carriage.
    Where a row takes n steps, its force is that of the last one: the mean of all, which changed the
    speed, is earlier by (n - 1) / 2 of them.

    Args:
        table: Channels, then `SPEEDS` [m, N, N m, m/s], shape (channels + 2, rows).
        channels: Their names, without the speeds.
        trial: The run.

    Returns:
        Shape (channels, rows).
    """
    rig, interval = trial.simulator.rig, trial.every * trial.step
    rows, steps = table[: len(channels)], trial.every * trial.parts
    if not isinstance(rig.carriage, FreeCarriage):
        return rows
    for (force, (_, mass)), speed in zip(BESIDE.items(), table[-2:], strict=True):
        if force in channels:
            place = channels.index(force)
            mean = rows[place, 1:] - (steps - 1) / (2 * steps) * jnp.diff(rows[place])
            held = mean - getattr(rig, mass) * jnp.diff(speed) / interval
            first = jnp.ceil(LET_GO / interval).astype(int)
            taken = jnp.maximum(jnp.arange(rows.shape[1]) - 1, first)
            rows = rows.at[place].set(held[taken])
    return rows
