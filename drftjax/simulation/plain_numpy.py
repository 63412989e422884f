"""The model's run in plain NumPy, step by step: what `drft bench` sets the speed against.

The step is linearly implicit: one linear equation for the change of velocity, with the slope of the
sand's force by differences. At rest, direction and leading-plate rule fade in over `REST_SPEED`, a
hundred times more than in `drftjax.physics.integrator`, without which it would chatter.
"""

import jax.numpy as jnp
import numpy as np

from drftjax.common.errors import InputError
from drftjax.physics.rig import FreeCarriage
from drftjax.physics.stress import NEWTON_PER_CUBIC_CENTIMETRE, Dynamic
from drftjax.physics.terrain import ConstantZeta
from drftjax.physics.wheel import TurningCut
from drftjax.simulation.simulator import EARTH_GRAVITY, Simulator

REST_SPEED = 1e-4
"""Width of a wheel that stands [m/s]."""

CHANGE = 1e-7
"""Change of a velocity by which the slope of the force is taken [m/s]."""


def simulate_in_numpy(
    simulator: Simulator, sinkage: float, omega: np.ndarray, dt: float
) -> tuple[np.ndarray, np.ndarray]:
    """Height and place of a wheel that starts at rest.

    Args:
        simulator: Wheel, terrain of the dynamic law with a constant zeta, and a free carriage.
        sinkage: At the start [m].
        omega: Angular velocity at the end of every step [rad/s], shape (steps,).
        dt: Step [s].

    Returns:
        z and x at the end of every step [m], shape (steps,) each.

    Raises:
        InputError: for effects, or another law, carriage or zeta.
    """
    law, rig, zeta = simulator.terrain.law, simulator.rig, simulator.terrain.zeta
    if not isinstance(law, Dynamic) or not isinstance(zeta, ConstantZeta) or simulator.effects:
        raise InputError("a run in plain NumPy has the dynamic law, a constant zeta and no effects")
    if not isinstance(rig.carriage, FreeCarriage):
        raise InputError("a run in plain NumPy has a free carriage")
    cut = simulator.wheel.cut()
    outline = cut.plates(jnp.zeros(()))
    rx, rz, nx, nz, area = (
        np.asarray(each, float)
        for each in (outline.x, outline.z, outline.normal_x, outline.normal_z, outline.area)
    )
    a00, a10, b11, b01, bm11, c11, c01, cm11, d10 = np.asarray(law.coefficients.values, float)
    rolling = simulator.integrator.rolling
    radius, gravity = float(simulator.wheel.radius), float(rig.gravity)
    masses, damping = np.asarray(rig.mass(), float), np.array([rig.damping_x, rig.damping_z], float)
    loads = np.array([float(rig.drawbar_load), masses[1] * gravity])
    strength = float(zeta.value) * gravity / EARTH_GRAVITY * NEWTON_PER_CUBIC_CENTIMETRE * area
    flux = float(law.inertial_coefficient) * float(law.bulk_density) * area

    def force(z: float, velocity: np.ndarray, angle: float, speed: float) -> np.ndarray:
        cos, sin = np.cos(angle), np.sin(angle)
        x_, z_ = rx * cos + rz * sin, rz * cos - rx * sin
        nx_, nz_ = nx * cos + nz * sin, nz * cos - nx * sin
        px, pz = velocity[0] + speed * z_, velocity[1] - speed * x_
        lead = rolling * radius * abs(speed)
        rest = max(REST_SPEED, lead)
        size = np.sqrt(px**2 + pz**2 + rest**2)
        cosine, sine = px / size, -pz / size
        c, s = nz_**2 - nx_**2, -2 * nx_ * nz_
        alpha_z = a00 + a10 * c + (b01 + (b11 + bm11) * c) * sine + (b11 - bm11) * s * cosine
        alpha_x = (c01 + (c11 + cm11) * c) * cosine + (cm11 - c11) * s * sine + d10 * s
        normal = nx_ * px + nz_ * pz
        loss = float(law.height_decrease) * radius * (radius * speed**2 / gravity)
        depth = np.maximum(-(z + radius + z_) - loss * (x_ < 0), 0)
        load = strength * depth * np.clip(1 + (normal - lead / 2) / rest, 0, 1)
        pressure = flux * np.where(depth > 0, np.maximum(normal, 0) ** 2, 0)
        return np.array(
            [-(alpha_x * load).sum() - (pressure * nx_).sum(),
             (alpha_z * load).sum() - (pressure * nz_).sum()]
        ) - damping * velocity - loads  # fmt: skip

    place, velocity, angle = np.array([0.0, -sinkage]), np.zeros(2), 0.0
    rows = np.empty((len(omega), 2))
    for number, speed in enumerate(omega):
        if isinstance(cut, TurningCut):
            angle += dt * speed
            # The outline repeats every pitch, and only plates near the sand are carried.
            angle -= cut.pitch * round(angle / cut.pitch)
        # With the place moved along, so that depth's own stiffness is in the slope.
        at = lambda v: force(place[1] + dt * v[1], v, angle, speed)  # noqa: E731, B023
        here = at(velocity)
        slope = np.stack([at(velocity + CHANGE * way) - here for way in np.eye(2)], 1) / CHANGE
        change = np.linalg.solve(np.diag(masses) - dt * slope, dt * here)
        velocity = velocity + change
        place = place + dt * velocity
        rows[number] = place
    return rows[:, 1], rows[:, 0]
