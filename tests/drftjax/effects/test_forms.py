"""Forms of effects, against what another program, another law or a few lines of algebra say."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.physics.state import State
from drftjax.physics.stress import ArcBisector, Dynamic, QuasiStatic
from drftjax.physics.terrain import Terrain
from drftjax.simulation.simulator import Simulator
from tests.helpers.effect_runs import GROUSERS, KNOWN, RIM, rows, simulator

# Sums and products of some doubles in another order.
CLOSE = 1e-12
# Two programs of the same arithmetic: a search for a root stops at 1e-8 of sqrt(r g) [m].
REACHED = 2e-8
# An implementation that shares no code with this one has 64 and 30 mm, in whole millimetres; coarse
# plates make up for the rest [m].
WHOLE_MILLIMETRES = 1e-3
RADIUS, GRAVITY = 0.150, 9.81


# Height decrease by the arc that truly touches


def with_arc(share: float, wheel=GROUSERS) -> Simulator:
    return replace(simulator(wheel), effects=(KNOWN["height_decrease_arc"](share=share),))


def test_sand_is_lower_behind_the_middle_of_the_arc_by_hand():
    # Axle 0.12 m over the sand, which is 0.02 m lower behind: the rim of 0.15 m enters it at
    # acos(0.8) ahead of straight down and leaves it at acos(0.14 / 0.15) behind. The arc's middle
    # is 7.9 degrees ahead.
    entry, leave, loss = np.arccos(0.8), np.arccos(0.14 / 0.15), 0.02
    middle = (entry - leave) / 2
    omega = np.sqrt(loss * GRAVITY) / RADIUS
    at = (
        jnp.array([0.0, 0.12 - RADIUS]),
        jnp.array([0.1, -0.05]),
        jnp.zeros(()),
        jnp.asarray(omega),
        jnp.asarray(0.8),
    )
    # A law without the inertial term is straight in depth.
    law = Dynamic(inertial_coefficient=0.0)
    level = Simulator(RIM, Terrain(law=replace(law, height_decrease=0.0))).plate_load(*at)
    ahead = np.arctan2(np.asarray(level.plates.x), -np.asarray(level.plates.z))
    depth = np.asarray(level.motion.depth)
    deep = depth > 1e-3
    for share in (0.0, 0.5, 1.0):
        sim = Simulator(RIM, Terrain(law=law), effects=(KNOWN["height_decrease_arc"](share=share),))
        behind = (1 - share) * (ahead < 0) + share * (ahead < middle)
        left = np.maximum(depth - loss * behind, 0) / np.where(deep, depth, 1)
        found = sim.plate_load(*at)
        for part in ("stress_x", "stress_z"):
            expected = left * np.asarray(getattr(level, part))
            np.testing.assert_allclose(
                np.asarray(getattr(found, part))[deep], expected[deep], rtol=CLOSE, atol=CLOSE
            )
    # Between straight down and the middle there are plates, or the two lines were one.
    assert np.sum(deep & (ahead > 0) & (ahead < middle)) > 2


def test_at_300_deg_s_the_line_decides_how_deep_a_wheel_runs():
    dt = 1e-3
    time = dt * np.arange(1, 6001)
    omega = np.interp(time, [0.0, 0.5, 3.0], np.radians([0.0, 0.0, 300.0]))
    start = State.at_rest(0.0176)

    def run(sim):
        return rows(sim, start, omega, dt, 10)

    vertical, arc = jax.jit(jax.vmap(lambda share: run(with_arc(share)).z))(jnp.array([0.0, 1.0]))
    assert np.mean(vertical[-200:]) == pytest.approx(-0.030, abs=WHOLE_MILLIMETRES)
    assert np.mean(arc[-200:]) == pytest.approx(-0.064, abs=WHOLE_MILLIMETRES)
    # The whole share is the law that has the arc's line to begin with.
    law = Simulator(GROUSERS, Terrain(law=Dynamic(bisector=ArcBisector())))
    np.testing.assert_allclose(arc, jax.jit(lambda: run(law).z)(), rtol=0, atol=REACHED)


def test_the_arc_needs_a_law_with_a_height_decrease():
    sim = Simulator(RIM, Terrain(law=QuasiStatic()), effects=(KNOWN["height_decrease_arc"](),))
    with pytest.raises(InputError, match="height_decrease_arc needs the dynamic stress law"):
        sim.check()
