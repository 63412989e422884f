"""Steady driving of both wheels: one zeta, what it predicts, and the zeta that each slip needs."""

from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from drftjax.physics.stress import Dynamic
from drftjax.physics.wheel import GrouserWheel, PlainWheel
from drftjax.simulation.simulator import Simulator
from tests.studies.cmu_data import (
    GROUSER,
    GROUSER_HEIGHT,
    OUTER_RADIUS,
    SMOOTH,
    Reals,
    SteadyRows,
    steady_rows,
)
from tests.studies.cmu_steady import (
    BULK_DENSITY,
    LAMBDA,
    Setting,
    Steady,
    driven,
    fit_zeta,
    held_force,
    held_sinkage,
    steady_states,
)

WIDTH = 0.060
RIM_RADIUS = OUTER_RADIUS - GROUSER_HEIGHT
GROUSERS, TIP_WIDTH = 24, 0.008

FITTED_ON = {
    "0 to 0.2": (0, 0.2),
    "-0.2 to 0.2": (-0.2, 0.2),
    "-1 to 0.2": (-1, 0.2),
    "0 to 0.9": (0, 0.9),
}


@dataclass(frozen=True)
class Reading:
    """A way to read the table: which wheel is simulated, and where its sinkage counts from.

    Attributes:
        name: For tables: geometry, and whether the zero of sinkage is at the tips or the rim.
        simulator: The wheel on the sand.
        below_rim: Height of the simulated rim over the circle that the table counts from [m].
        rim_speed_radius: Radius whose speed the table's rim speed is [m].
    """

    name: str
    simulator: Simulator
    below_rim: float = 0.0
    rim_speed_radius: float = OUTER_RADIUS

    def setting(self, rows: SteadyRows) -> Setting:
        """The rows' speeds and loads."""
        omega = rows.omega * OUTER_RADIUS / self.rim_speed_radius
        return Setting(jnp.asarray(rows.vx), jnp.asarray(omega), jnp.asarray(rows.load))


def circle(law: Dynamic | None = None) -> Reading:
    """One circle of 62.5 mm: the smooth wheel, or the grousered one filled to its tips."""
    wheel = PlainWheel(OUTER_RADIUS, WIDTH, plate_size=1e-3)
    return Reading("circle", driven(wheel, law))


def grousered(
    name: str,
    fraction: float = 1.0,
    below_rim: float = GROUSER_HEIGHT,
    radius: float = OUTER_RADIUS,
) -> Reading:
    """The grousered wheel's own geometry, its grousers at `fraction` of their height."""
    wheel = GrouserWheel(
        RIM_RADIUS, WIDTH, GROUSERS, GROUSER_HEIGHT, TIP_WIDTH, fraction, plate_size=2e-3
    )
    return Reading(name, driven(wheel), below_rim, radius)


def readings() -> list[Reading]:
    """The ways to read the grousered wheel's table."""
    return [
        circle(),
        grousered("24 grousers, tips"),
        grousered("24 grousers, rim", below_rim=0.0),
        grousered("height / 3, tips", fraction=1 / 3),
        grousered("24, tips, rim speed", radius=RIM_RADIUS),
    ]


def rms(values: Reals) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else float("nan")


@dataclass(frozen=True)
class OneZeta:
    """One zeta fitted to the sinkage of some rows, and what it says of all.

    Attributes:
        zeta: Scaling factor [-].
        fitted: Rows it was fitted to, shape (rows,).
        driven: Rows from slip 0 to 0.9, shape (rows,).
        sinkage_error: Simulated minus measured [m], shape (rows,).
        force_error: Forward, simulated minus measured [N], shape (rows,).
    """

    zeta: float
    fitted: NDArray[np.bool_]
    driven: NDArray[np.bool_]
    sinkage_error: Reals
    force_error: Reals

    @property
    def predicted(self) -> NDArray[np.bool_]:
        """Driven rows it was not fitted to."""
        return self.driven & ~self.fitted


def one_zeta(reading: Reading, rows: SteadyRows, low: float, high: float) -> OneZeta:
    """Fit one zeta to the sinkages of the settings from `low` to `high`."""
    setting = reading.setting(rows)
    measured = jnp.asarray(rows.sinkage - reading.below_rim)
    fitted = rows.between(low, high)
    zeta = fit_zeta(reading.simulator, setting, measured, jnp.asarray(fitted, float))
    found = held_sinkage(reading.simulator, setting, zeta)
    force = held_force(reading.simulator, setting, found).forward(jnp.full_like(found, zeta))
    return OneZeta(
        float(zeta),
        fitted,
        rows.between(0, 0.9),
        np.asarray(found - measured),
        np.asarray(force) - rows.forward,
    )


def needed_zeta(reading: Reading, rows: SteadyRows) -> Reals:
    """The zeta at which each row's sinkage carries its load [-], shape (rows,)."""
    setting = reading.setting(rows)
    held = held_force(reading.simulator, setting, jnp.asarray(rows.sinkage - reading.below_rim))
    return np.asarray(held.zeta(setting.load))


def by_setting(rows: SteadyRows, values: Reals) -> dict[float, float]:
    """Mean of a row's values at each nominal slip."""
    return {
        float(each): float(values[rows.nominal == each].mean()) for each in np.unique(rows.nominal)
    }


@dataclass(frozen=True)
class Check:
    """Simulated with a free axis against the height that carries the load, driven rows.

    Attributes:
        step: [s].
        difference: Largest difference of steady sinkage [m].
        ripple: Largest standard deviation of the sinkage over the pitches [m].
    """

    step: float
    difference: float
    ripple: float


CHECKED = (1e-3, 2.5e-3, 5e-3)


def check_steady(
    reading: Reading,
    rows: SteadyRows,
    zeta: float,
    steps: tuple[float, ...] = CHECKED,
) -> list[Check]:
    """Simulate the driven rows for 20 s from 1 mm below their steady height."""
    chosen = np.flatnonzero(rows.between(0, 0.9))
    setting = jax.tree.map(lambda column: column[chosen], reading.setting(rows))
    held = held_sinkage(reading.simulator, setting, jnp.asarray(zeta))
    checks = []
    for step in steps:
        found: Steady = steady_states(
            reading.simulator, jnp.full_like(held, zeta), setting, held + 1e-3, step=step
        )
        checks.append(
            Check(
                step,
                float(jnp.abs(found.sinkage - held).max()),
                float(found.ripple.max()),
            )
        )
    return checks


@dataclass(frozen=True)
class DynamicTerms:
    """How far the dynamic terms move the smooth wheel's steady sinkage at zeta 1 [m].

    Attributes:
        momentum: Largest change without lambda.
        height: Largest change without the height decrease.
    """

    momentum: float
    height: float


def dynamic_terms(rows: SteadyRows) -> DynamicTerms:
    """Take lambda and the height decrease off in turn; driven rows."""

    def sinkage(law: Dynamic) -> Reals:
        reading = circle(law)
        return np.asarray(held_sinkage(reading.simulator, reading.setting(rows), jnp.asarray(1.0)))

    driven_rows = rows.between(0, 0.9)
    full = sinkage(Dynamic(LAMBDA, BULK_DENSITY))[driven_rows]
    without_lambda = sinkage(Dynamic(0.0, BULK_DENSITY))[driven_rows]
    without_height = sinkage(Dynamic(LAMBDA, BULK_DENSITY, 0.0))[driven_rows]
    return DynamicTerms(
        float(np.abs(full - without_lambda).max()), float(np.abs(full - without_height).max())
    )


def both_tables(folder: Path) -> dict[str, SteadyRows]:
    """Steady means of both wheels."""
    return {wheel: steady_rows(folder, wheel) for wheel in (SMOOTH, GROUSER)}
