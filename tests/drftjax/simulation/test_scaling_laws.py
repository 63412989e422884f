"""Scaling of granular locomotion (Slonaker et al. 2017): a test without an oracle.

Lengths and width times a, masses times a cubed and times times the root of a leave the path as it
is in units of the radius, under the quasi-static law; so does gravity times q with speeds times the
root of q. Factors whose roots are powers of two make them exact to rounding.
"""

import equinox as eqx
import numpy as np
import pytest

from drftjax.physics.stress import QuasiStatic
from drftjax.physics.terrain import Terrain
from drftjax.setups.setup import (
    CommandSetUp,
    IntegratorSetUp,
    RigSetUp,
    SetUp,
    StartSetUp,
    WheelSetUp,
)
from drftjax.simulation.trial import Trial

# A search for the root ends within 1e-8 of sqrt(r g), whatever rounding of its path; over 2,000
# steps of 5 ms that is 1e-8 of the travel.
ROUNDING = 1e-8

run = eqx.filter_jit(Trial.run)


def path(length: float = 1.0, gravity: float = 1.0) -> np.ndarray:
    """x and z over the radius, of the paper's wheel with other lengths or gravity [-]."""
    pace = np.sqrt(length / gravity)
    setup = SetUp(
        command=CommandSetUp(
            (np.array([0, 1, 3, 7, 9, 10]) * pace).tolist(),
            (np.radians([0, 0, 40, 40, 0, 0]) / pace).tolist(),
        ),
        wheel=WheelSetUp(
            radius=0.15 * length,
            width=0.12 * length,
            grouser_height=0.018 * length,
            grouser_thickness=0.009 * length,
            plate_size=0.004 * length,
        ),
        rig=RigSetUp(13.902 * length**3, 18.837 * length**3, gravity=9.81 * gravity),
        start=StartSetUp(sinkage=0.0176 * length),
        integrator=IntegratorSetUp("implicit", 5e-3 * pace),
    )
    trial = setup.trial(5e-2 * pace)
    law = Terrain(trial.simulator.terrain.zeta, QuasiStatic())
    output = run(eqx.tree_at(lambda t: t.simulator.terrain, trial, law))
    return np.stack([output.x, output.z]) / (0.15 * length)


@pytest.mark.parametrize(("length", "gravity"), [(4.0, 1.0), (0.25, 1.0), (1.0, 4.0), (1.0, 0.25)])
def test_the_path_in_units_of_the_radius_is_the_same(length, gravity):
    np.testing.assert_allclose(path(length, gravity), path(), rtol=0, atol=ROUNDING)
