"""Forces on a plain wheel by a public implementation of quasi-static resistive force theory.

qishuny/3D-RFT-wheel, radius 0.13 m, width 0.1599 m, 0.5 rad/s, zeta 3.05, sinkage 12 mm. Its torque
has the other sign; at slip 0 it drops slow plates, so that row is left out.
"""

import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.physics.integrator import Implicit
from drftjax.physics.stress import QuasiStatic
from drftjax.physics.terrain import ConstantZeta, Terrain
from drftjax.physics.wheel import PlainWheel
from drftjax.simulation.simulator import Simulator

# Its plates are of another length, worth a per cent; of forces that nearly cancel, a fifth of a
# newton.
RELATIVE, SMALL, CANCELLED = 0.01, 5.0, 0.2

TABLE = {
    -0.7: (-39.17, 116.80, 2.295),
    -0.3: (-38.59, 141.18, 1.606),
    0.1: (2.54, 173.33, -4.316),
    0.3: (15.20, 129.67, -4.987),
    0.7: (21.61, 98.59, -4.947),
}


@pytest.mark.parametrize("slip", TABLE)
def test_a_plain_wheel_under_slip_has_the_published_wrench(slip):
    radius, omega = 0.13, 0.5
    wheel = PlainWheel(radius, 0.1599, plate_size=1e-3)
    simulator = Simulator(wheel, Terrain(ConstantZeta(3.05), QuasiStatic()), integrator=Implicit())
    velocity = jnp.asarray([radius * omega * (1 - slip), 0.0])
    wrench = simulator.wrench(
        jnp.asarray([0.0, -0.012]), velocity, jnp.zeros(()), jnp.asarray(omega), jnp.asarray(3.05)
    )
    expected = np.array(TABLE[slip]) * [1, 1, -1]
    allowed = np.where(np.abs(expected) < SMALL, CANCELLED, RELATIVE * np.abs(expected))
    allowed[2] = RELATIVE * abs(expected[2])
    assert np.all(np.abs(np.asarray(wrench) - expected) < allowed), np.asarray(wrench)
