"""Runs of a set-up over a grid of its numbers, as arrays with coordinates."""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import msgspec
import numpy as np
from jaxtyping import Array, Float

from drftjax.common.errors import InputError
from drftjax.common.packages import optional_package
from drftjax.common.rich_text import summary_html
from drftjax.physics.state import Output
from drftjax.setups.api import as_setup
from drftjax.setups.chosen_step import step_within
from drftjax.setups.numbers import with_numbers
from drftjax.setups.setup import SetUp
from drftjax.setups.simulated_run import CHANNELS, ROUNDING
from drftjax.simulation.ensemble import map_runs, stack
from drftjax.simulation.step_choice import choose_step
from drftjax.simulation.trial import ROW_INTERVAL, Trial, check_output

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

OUTPUT_UNITS = {
    "time": "s", "x": "m", "z": "m", "vx": "m/s", "vz": "m/s", "angle": "rad", "omega": "rad/s",
    "fx": "N", "fz": "N", "torque": "N m", "slip": "1", "sinkage": "m", "zeta": "1",
}  # fmt: skip

MAX_VALUES = 2e8
"""Most numbers that a sweep may keep: 1.6 GB."""


@dataclass(frozen=True, eq=False, repr=False)
class ParameterSweep:
    """Trajectories over a grid of numbers of a set-up.

    Attributes:
        setup: Set-up whose numbers were replaced.
        axes: Values of each number that was swept, by name, in the order of the dimensions.
        time: Times of the rows [s], shape (rows,).
        channels: Fields of `Output` by name, shape (*axes, rows).
        step: Step of the runs [s].
    """

    setup: SetUp
    axes: Mapping[str, np.ndarray]
    time: np.ndarray
    channels: Mapping[str, np.ndarray]
    step: float

    def __getitem__(self, channel: str) -> np.ndarray:
        """A channel, shape (*axes, rows), in SI units."""
        if channel not in self.channels:
            raise InputError(
                f"a sweep has no channel {channel!r}; it has {', '.join(self.channels)}"
            )
        return self.channels[channel]

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values along each axis."""
        return tuple(len(values) for values in self.axes.values())

    def to_xarray(self) -> "xarray.Dataset":
        """The trajectories with their coordinates, each with its unit.

        Raises:
            InputError: xarray is not installed.
        """
        xarray = optional_package("xarray", "to_xarray")
        axes, channels = self._names(), self._named_channels()
        columns = {
            name: ((*axes, "time"), values, {"units": OUTPUT_UNITS[name]})
            for name, values in channels.items()
        }
        coordinates = dict(zip(axes, self.axes.values(), strict=True))
        time = ("time", self.time, {"units": "s"})
        attributes = {"title": self.setup.title, "step": self.step}
        return xarray.Dataset(columns, {**coordinates, "time": time}, attributes)

    def to_dataframe(self) -> "pandas.DataFrame":
        """The trajectories as one table, its index the swept numbers and the time.

        Raises:
            InputError: pandas is not installed.
        """
        pandas = optional_package("pandas", "to_dataframe")
        names = [*self._names(), "time"]
        index = pandas.MultiIndex.from_product([*self.axes.values(), self.time], names=names)
        columns = {name: values.ravel() for name, values in self._named_channels().items()}
        return pandas.DataFrame(columns, index)

    def _names(self) -> list[str]:
        """Names of the axes beside the channels: the x of [start] is no channel x."""
        return [f"start.{name}" if name in self._named_channels() else name for name in self.axes]

    def _named_channels(self) -> dict[str, np.ndarray]:
        """The channels, without zeta where it is swept: it would be there twice."""
        swept = {"zeta"} & {*self.axes}
        return {name: each for name, each in self.channels.items() if name not in swept}

    def plot(self) -> "Figure":
        """Sinkage and travel of every run over time, coloured by the first number swept."""
        from drftjax.sweeps.figures import sweep_figure

        return sweep_figure(self)

    def __repr__(self) -> str:
        return f"<ParameterSweep of {' and '.join(self._sentences())}>"

    def _repr_html_(self) -> str:
        return summary_html([f"Sweep of {each}" for each in self._sentences()])

    def _sentences(self) -> Iterator[str]:
        runs = int(np.prod(self.shape))
        over = ", ".join(f"{name} ({len(values)})" for name, values in self.axes.items())
        final = 1e3 * self["sinkage"][..., -1]
        yield (
            f"{runs} runs of {self.time[-1]:.4g} s over {over}: final sinkage {final.min():.2f} to "
            f"{final.max():.2f} mm"
        )


def sweep(
    setup: SetUp | str | PathLike[str],
    *,
    interval: float = ROW_INTERVAL,
    **numbers: Sequence[Any] | np.ndarray,
) -> ParameterSweep:
    """Simulate a set-up over a grid of its numbers.

    Runs that differ in their numbers only share one compiled program; those that differ in their
    plates, as wheels of other radii do, have one each. Where the set-up gives no step, the
    shortest of the steps that suit the corners of the grid is taken. The error of the step is
    taken off, as in `simulate`.

    Args:
        setup: Set-up, or the path of its file.
        interval: Time between rows [s], rounded to whole steps.
        numbers: Values of each number to sweep, by name as in `simulate`: `zeta=[0.6, 0.7, 0.8]`.

    Returns:
        Trajectories at every combination of the values.

    Raises:
        InputError: a number is unknown or out of bounds, there is nothing to sweep, or the model
            does not cover a run; names the values of that run.
    """
    setup = as_setup(setup)
    axes = {name: _axis(name, values) for name, values in numbers.items()}
    if not axes:
        raise InputError("nothing is swept; give values of a number, as in zeta=[0.6, 0.8]")
    lasts = setup.command.time[-1] - setup.command.time[0]
    kept = math.prod(map(len, axes.values())) * (lasts / interval + 1) * len(CHANNELS)
    if kept > MAX_VALUES:
        raise InputError(
            f"the sweep would keep {kept:.2g} numbers, must be {MAX_VALUES:.2g} or fewer; sweep "
            "fewer values, or ask for rows at a longer interval"
        )
    values = [each.tolist() for each in axes.values()]
    points = [dict(zip(axes, each, strict=True)) for each in itertools.product(*values)]
    setups = [with_numbers(setup, point) for point in points]
    step = _step(setup, axes, interval)
    trials = [_with_step(each, step).trial(interval) for each in setups]
    outputs = _outputs(trials)
    for point, trial, output in zip(points, trials, outputs, strict=True):
        try:
            check_output(Output(*output), trial.simulator)
        except InputError as problem:
            where = ", ".join(f"{name} = {value}" for name, value in point.items())
            raise InputError(f"at {where}: {problem}") from None
    time = outputs[0][CHANNELS.index("time")] + setup.command.time[0]
    rows = time <= setup.command.time[-1] + ROUNDING
    table = np.stack(outputs, axis=1)[..., rows]
    table = table.reshape(len(CHANNELS), *(len(each) for each in values), -1)
    channels = {name: each for name, each in zip(CHANNELS, table, strict=True) if name != "time"}
    return ParameterSweep(setup, axes, time[rows], channels, step)


def _axis(name: str, values: Any) -> np.ndarray:
    """Values of one number, shape (values,)."""
    given = np.asarray(values)
    if given.ndim != 1 or not given.size:
        raise InputError(f"{name} has shape {given.shape}, must be a list of one value or more")
    if name.rpartition(".")[2] in ("time", "omega", "vx", "omega_unit", "step"):
        raise InputError(f"{name} cannot be swept: all runs of a sweep share command and step")
    return given


def _step(setup: SetUp, axes: Mapping[str, np.ndarray], interval: float) -> float:
    """The set-up's step [s], or the shortest that suits the corners of the grid."""
    if setup.integrator.step is not None:
        return setup.integrator.step
    ends = [(min(values.tolist()), max(values.tolist())) for values in axes.values()]
    corners = [dict(zip(axes, each, strict=True)) for each in {*itertools.product(*ends)}]
    steps = [choose_step(with_numbers(setup, corner).trial()).step for corner in corners]
    return step_within(interval, min(steps))


def _with_step(setup: SetUp, step: float) -> SetUp:
    integrator = msgspec.structs.replace(setup.integrator, step=step)
    return msgspec.structs.replace(setup, integrator=integrator)


def _outputs(trials: Sequence[Trial]) -> list[np.ndarray]:
    """Channels of every trial, each of shape (channels, rows), in the order of the trials.

    Those of the same structure and shapes run as one program.
    """
    groups: dict[Any, list[int]] = {}
    for place, trial in enumerate(trials):
        shapes = tuple(leaf.shape for leaf in jax.tree.leaves(trial) if eqx.is_array(leaf))
        groups.setdefault((jax.tree.structure(trial), shapes), []).append(place)
    found: dict[int, np.ndarray] = {}
    for places in groups.values():
        outputs = _program(stack([trials[place] for place in places]))
        found |= dict(zip(places, np.asarray(outputs), strict=True))
    return [found[place] for place in range(len(trials))]


@eqx.filter_jit
def _program(trials: Trial) -> Float[Array, "runs channels rows"]:
    return map_runs(lambda trial: trial.extrapolated(jnp.asarray(trial.rows), CHANNELS), trials)
