"""Steady running of a driven wheel at imposed slip: drawbar pull, sinkage and torque.

The carriage is driven at v = r omega (1 - s), and the wheel is let run until it changes no more
from one stretch to the next. A stretch is a whole number of grouser pitches, so that its means are
free of the ripple that grousers make.
"""

import dataclasses
import math
from dataclasses import dataclass
from os import PathLike
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from numpy.typing import ArrayLike
from rich.markup import escape

from drftjax.common.arrays import as_real, require_between
from drftjax.common.errors import InputError
from drftjax.common.packages import optional_package
from drftjax.common.rich_text import WholeWordTable, summary_html
from drftjax.physics.command import Command
from drftjax.physics.rig import DrivenCarriage
from drftjax.physics.state import State
from drftjax.setups.api import as_setup
from drftjax.setups.numbers import with_numbers
from drftjax.setups.setup import MAX_OMEGA, SetUp
from drftjax.simulation.ensemble import map_runs
from drftjax.simulation.simulator import Simulator

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

UNITS = {
    "slip": "1", "drawbar_pull": "N", "sinkage": "m", "torque": "N m", "load": "N",
    "drawbar_ripple": "N", "sinkage_ripple": "m", "turned": "rad", "speed": "m/s", "is_steady": "1",
}  # fmt: skip

SLIPS = (-10.0, 1.0)
"""Least slip, of a wheel that is dragged, and that of one that spins on the spot [-]."""

FEWEST_STRETCHES = 10
"""Stretches before a wheel is given up, however fast it turns."""

MEANS = ("fx", "sinkage", "torque", "fz")
"""Channels whose means are taken."""


@dataclass(frozen=True)
class SteadySettings:
    """Numbers by which a wheel counts as running steadily.

    Attributes:
        turn: Angle that the wheel turns by in a step at most [rad], as in `StepSettings`: a plate
            begins to lead within 3e-3.
        step: Longest step [s], as there.
        stretch: Shortest time over which means are taken [s]: a wheel that bobs on its sand does
            so within half a second.
        pitches: Pitches of a wheel without grousers in a turn [-]: a stretch is then a twelfth of
            a turn or more, as of the paper's wheel.
        change: Largest change of the means from one stretch to the next [-], of forces as a share
            of the load, of torque as a share of load times radius, of sinkage as a share of the
            radius: a tenth of what sensors of a test bed tell apart.
        turns: Turns of the wheel after which it is given up [-]; the stretches are at least ten.
    """

    turn: float = 5.3e-3
    step: float = 1e-2
    stretch: float = 0.5
    pitches: int = 12
    change: float = 1e-4
    turns: float = 5.0


DEFAULT_STEADY = SteadySettings()


@dataclass(frozen=True, eq=False, repr=False)
class SteadyState:
    """Steady running of a driven wheel at one slip, or at several along one axis.

    Attributes:
        slip: 1 - v / (r omega) [-].
        drawbar_pull: Mean forward force of the sand on the wheel [N].
        sinkage: Mean sinkage [m].
        torque: Mean drive torque [N m].
        load: Mean upward force of the sand [N]: in a steady state, the load on the wheel.
        drawbar_ripple, sinkage_ripple: Standard deviations within a stretch [N], [m].
        turned: Angle turned until the state was steady [rad].
        speed: Speed of the carriage [m/s].
        is_steady: False where the wheel still changed when it was given up, or dug itself in
            deeper than its plates reach; its other values are then NaN.
        omega: Angular velocity [rad/s].
        title: Title of the set-up.
    """

    slip: np.ndarray
    drawbar_pull: np.ndarray
    sinkage: np.ndarray
    torque: np.ndarray
    load: np.ndarray
    drawbar_ripple: np.ndarray
    sinkage_ripple: np.ndarray
    turned: np.ndarray
    speed: np.ndarray
    is_steady: np.ndarray
    omega: float
    title: str

    def to_xarray(self) -> "xarray.Dataset":
        """The values over slip, each with its unit.

        Raises:
            InputError: xarray is not installed.
        """
        xarray = optional_package("xarray", "to_xarray")
        columns = {name: ("slip", each, {"units": UNITS[name]}) for name, each in self._columns()}
        data = xarray.Dataset(columns, attrs={"title": self.title, "omega": self.omega})
        return data.set_coords("slip")

    def to_dataframe(self) -> "pandas.DataFrame":
        """The values as one table with a row for each slip.

        Raises:
            InputError: pandas is not installed.
        """
        pandas = optional_package("pandas", "to_dataframe")
        return pandas.DataFrame(dict(self._columns())).set_index("slip")

    def plot(self) -> "Figure":
        """Drawbar pull, sinkage and torque over slip."""
        from drftjax.sweeps.figures import slip_figure

        return slip_figure(self)

    def __repr__(self) -> str:
        one = dict(self._columns())
        slip, pull = one["slip"], one["drawbar_pull"]
        best = int(np.argmax(np.where(one["is_steady"], pull, -np.inf)))
        at = (
            f"slip {slip[best]:.3g}: drawbar pull {pull[best]:.4g} N, sinkage "
            f"{1e3 * one['sinkage'][best]:.4g} mm, torque {one['torque'][best]:.4g} N m"
        )
        if slip.size == 1:
            return f"<SteadyState at {at}>"
        lost = int((~one["is_steady"]).sum())
        return f"<SteadyState at {slip.size} slips, {lost} of them not steady; most at {at}>"

    def _repr_html_(self) -> str:
        table = WholeWordTable(title=f"{self.title}, omega {self.omega:.4g} rad/s")
        for name, _ in self._columns():
            table.add_column(escape(f"{name} [{UNITS[name]}]"), justify="right")
        for row in zip(*(each for _, each in self._columns()), strict=True):
            table.add_row(*(f"{value:.4g}" for value in row))
        return summary_html([table])

    def _columns(self) -> list[tuple[str, np.ndarray]]:
        """Name and values of each column, shape (slips,)."""
        return [(name, np.atleast_1d(getattr(self, name))) for name in UNITS]


def steady_state(
    setup: SetUp | str | PathLike[str],
    slip: float,
    *,
    omega: float | None = None,
    settings: SteadySettings = DEFAULT_STEADY,
    **numbers: Any,
) -> SteadyState:
    """Steady running of a set-up's wheel at one slip; arguments as of `slip_curve`.

    Returns:
        The state, each of its values a number.

    Raises:
        InputError: as `slip_curve`, or the wheel comes to no steady state.
    """
    require_between("slip", slip, *SLIPS)
    curve = slip_curve(setup, [slip], omega=omega, settings=settings, **numbers)
    columns = {name: getattr(curve, name)[0] for name in UNITS}
    return dataclasses.replace(curve, **columns)


def slip_curve(
    setup: SetUp | str | PathLike[str],
    slips: ArrayLike,
    *,
    omega: float | None = None,
    settings: SteadySettings = DEFAULT_STEADY,
    **numbers: Any,
) -> SteadyState:
    """Steady running of a set-up's wheel, driven at imposed slips.

    Wheel, sand, effects and the mass on the wheel are the set-up's. It starts at the set-up's
    sinkage, at the speed commanded. All slips share one compiled program.

    Args:
        setup: Set-up, or the path of its file; its carriage and command are not used, but for
            the speed of the wheel.
        slips: Slips 1 - v / (r omega) [-], shape (slips,).
        omega: Angular velocity [rad/s]; the fastest of the set-up's command where none is given.
        settings: Numbers by which a wheel counts as running steadily.
        numbers: Numbers in place of the set-up's, by name, as of `simulate`.

    Returns:
        Means over the last stretch at each slip.

    Raises:
        InputError: a number is out of bounds, or the wheel comes to no steady state at any slip.
    """
    asked = np.asarray(slips, dtype=float)
    if asked.ndim != 1 or not asked.size:
        raise InputError(f"slips have shape {asked.shape}, must be a list of one slip or more")
    require_between("slip", asked, *SLIPS)
    setup = with_numbers(as_setup(setup), numbers)
    speed = float(np.abs(setup.command.build().omega).max()) if omega is None else omega
    require_between("omega", speed, 1e-3, MAX_OMEGA, " rad/s, of a wheel that drives forward")
    trial = setup.trial()
    rig = dataclasses.replace(trial.simulator.rig, carriage=DrivenCarriage())
    simulator = dataclasses.replace(trial.simulator, rig=rig)
    stretch, steps = _stretch(setup, speed, settings)
    most = max(FEWEST_STRETCHES, math.ceil(2 * math.pi * settings.turns / stretch))
    wheel = simulator, trial.start, as_real(speed), as_real(stretch / speed / steps)
    limits = jnp.asarray(steps), jnp.asarray(most), as_real(settings.change)
    means, spread, deepest, count, is_steady = map(
        np.asarray, _program(as_real(asked), *wheel, *limits)
    )
    limit = float(simulator.adjusted().wheel.cut().sinkage_limit)
    is_covered = np.isfinite(means).all(axis=1) & (deepest <= limit)
    if not (is_covered & is_steady).any():
        why = f"is not steady after {most * stretch / (2 * math.pi):.3g} turns"
        if not is_covered.any():
            why = f"digs itself in past {1e3 * limit:.4g} mm, as deep as its plates reach"
        raise InputError(f"at slip {', '.join(f'{each:g}' for each in asked)} the wheel {why}")
    means, spread = (np.where(is_covered[:, None], each, np.nan) for each in (means, spread))
    named = dict(zip(("drawbar_pull", "sinkage", "torque", "load"), means.T, strict=True))
    return SteadyState(
        slip=asked,
        **named,
        drawbar_ripple=spread[:, 0],
        sinkage_ripple=spread[:, 1],
        turned=count * stretch,
        speed=setup.wheel.radius * speed * (1 - asked),
        is_steady=is_covered & is_steady,
        omega=speed,
        title=setup.title,
    )


def _stretch(setup: SetUp, omega: float, settings: SteadySettings) -> tuple[float, int]:
    """Angle over which means are taken [rad], and the number of steps that it is made in."""
    wheel = setup.wheel
    per_turn = {"grouser": wheel.grouser_count, "plain": settings.pitches, "outline": 1}
    pitch = 2 * math.pi / per_turn[wheel.shape]
    angle = pitch * math.ceil(settings.stretch * omega / pitch)
    longest = setup.integrator.step or min(settings.step, settings.turn / omega)
    return angle, math.ceil(angle / omega / longest)


@eqx.filter_jit
def _program(slips: Float[Array, " slips"], *shared: Any) -> tuple[Array, ...]:
    return map_runs(_run_until_steady, slips, *shared)


def _run_until_steady(
    slip: Float[Array, ""],
    simulator: Simulator,
    start: State,
    omega: Float[Array, ""],
    dt: Float[Array, ""],
    steps: Int[Array, ""],
    most: Int[Array, ""],
    change: Float[Array, ""],
) -> tuple[Array, ...]:
    """Stretches until the means change no more.

    Args:
        slip: Slip [-].
        simulator: With a driven carriage.
        start: Place of the wheel.
        omega: Angular velocity [rad/s].
        dt: Step [s].
        steps: Steps of a stretch.
        most: Most stretches.
        change: Largest change of the means that is none [-].

    Returns:
        Means of `MEANS` and their standard deviations, shape (4,) each; the deepest sinkage [m],
        the number of stretches, and whether the last two are alike.
    """
    simulator = simulator.prepared()
    radius, nought = simulator.wheel.radius, jnp.zeros_like(omega)
    command = Command(omega, radius * omega * (1 - slip), nought)
    velocity = jnp.stack([command.vx, nought])
    state = simulator.remembered(
        dataclasses.replace(start, velocity=velocity, omega=omega), command
    )
    weight = -simulator.rig.load(jnp.zeros_like(velocity))[1]
    scales = jnp.stack([weight, radius, weight * radius, weight])
    none = jnp.zeros_like(scales)

    def stretch(carried: tuple) -> tuple:
        state, before, _, _, number, _ = carried

        def step(_: Array, inner: tuple) -> tuple:
            state, total, squares, deepest = inner
            state, output = simulator.step(state, command, dt)
            off = jnp.stack([getattr(output, each) for each in MEANS]) - before
            return state, total + off, squares + off**2, jnp.maximum(deepest, output.sinkage)

        begun = state, none, none, nought - jnp.inf
        state, total, squares, deepest = jax.lax.fori_loop(0, steps, step, begun)
        off = total / steps.astype(dt.dtype)
        spread = jnp.sqrt(jnp.maximum(squares / steps.astype(dt.dtype) - off**2, 0))
        alike = (jnp.abs(off) <= change * scales).all() & (number > 0)
        return state, before + off, spread, deepest, number + 1, alike

    def goes_on(carried: tuple) -> Array:
        _, means, _, _, number, alike = carried
        return (number < most) & ~alike & jnp.isfinite(means).all()

    begun = state, none, none, nought, jnp.zeros_like(most), jnp.asarray(False)
    return jax.lax.while_loop(goes_on, stretch, begun)[1:]
