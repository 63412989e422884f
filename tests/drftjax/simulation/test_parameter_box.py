"""Derivatives are finite and bounded over the whole range of rigs that a user may have.

`python -m tests.drftjax.simulation.test_parameter_box 500` draws 500 rigs instead of 30.
"""

import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from drftjax import configure_jax
from drftjax.common.arrays import as_real
from drftjax.physics.rig import DrivenCarriage, FreeCarriage
from drftjax.setups.setup import CommandSetUp, IntegratorSetUp, SetUp
from drftjax.simulation.step_choice import choose_step
from drftjax.simulation.trial import Trial

# Zeta [-], vertical mass [kg], radius [m], gravity [m/s2], angular velocity [deg/s].
RANGES = {"zeta": (0.05, 30), "mass": (0.2, 500), "radius": (0.02, 0.6), "gravity": (1, 25)}
FASTEST = 600.0
# A share of the radius, or of the way of the rim, that no change of a parameter by its own size
# moves a wheel by: a run that explodes has 1e5 and more.
LARGEST = 30.0

# It stands, speeds up to one speed, turns back to another, and stops.
TIME = np.array([0.0, 0.2, 1.0, 1.5, 2.5, 3.0, 3.5, 4.0])


def drawn(random: np.random.Generator, driven: bool) -> Trial:
    """A rig of the box, starting up to a tenth of its radius above or below the surface."""
    value = {k: float(np.exp(random.uniform(*np.log(v)))) for k, v in RANGES.items()}
    first, second = random.uniform(-FASTEST, FASTEST, 2)
    speed = np.radians([0, 0, first, first, second, second, 0, 0])
    setup = SetUp(
        command=CommandSetUp(TIME.tolist(), [0.0] * 8), integrator=IntegratorSetUp("implicit", 5e-3)
    )
    trial = setup.trial()
    size, radius = value["radius"] / 0.15, value["radius"]
    # The carriage goes at the speed of the rim less a slip.
    vx = radius * speed * (1 - random.uniform(-0.5, 0.9)) * driven
    return eqx.tree_at(
        lambda t: (
            t.time, t.omega, t.vx,
            t.simulator.terrain.zeta.value, t.simulator.rig.mass_x, t.simulator.rig.mass_z,
            t.simulator.rig.gravity, t.simulator.wheel.radius, t.simulator.wheel.width,
            t.simulator.wheel.grouser_height, t.simulator.wheel.grouser_thickness,
            t.start.position, t.simulator.rig.carriage,
        ),
        trial,
        (
            as_real(TIME), as_real(speed), as_real(vx),
            as_real(value["zeta"]), as_real(0.7 * value["mass"]), as_real(value["mass"]),
            as_real(value["gravity"]), as_real(radius), as_real(0.12 * size),
            as_real(0.018 * size), as_real(0.009 * size),
            as_real([0.0, random.uniform(-0.1, 0.1) * radius]),
            DrivenCarriage() if driven else FreeCarriage(),
        ),
    )  # fmt: skip


@eqx.filter_jit
def derivatives(trial: Trial) -> jax.Array:
    """z and x at every row, over the radius, by the logarithms of four parameters."""
    leaves = (
        lambda t: t.simulator.terrain.zeta.value,
        lambda t: t.simulator.wheel.radius,
        lambda t: t.simulator.wheel.grouser_height,
        lambda t: t.simulator.rig.mass_z,
    )

    def path(logarithms):
        changed = trial
        for leaf, by in zip(leaves, logarithms, strict=True):
            changed = eqx.tree_at(leaf, changed, leaf(changed) * jnp.exp(by))
        output = changed.run()
        return jnp.stack([output.z, output.x]) / trial.simulator.wheel.radius

    return jax.jacfwd(path)(jnp.zeros(4))


def beyond(count: int) -> tuple[int, float]:
    """How many of the drawn rigs have larger derivatives than `LARGEST`, and the largest otherwise.

    Each of them is one of which the choice of a step says that its error is too large.
    """
    random = np.random.default_rng(20261125)
    exploded, largest = 0, 0.0
    for number in range(count):
        trial = drawn(random, driven=number % 3 == 2)
        found = np.asarray(derivatives(trial))
        assert np.isfinite(found).all(), f"rig {number}"
        turned = float(np.trapezoid(np.abs(trial.omega), trial.time))
        size = float(np.abs(found).max()) / (1 + turned)
        if size < LARGEST:
            largest = max(largest, size)
        else:
            exploded += 1
            assert not choose_step(trial).within, f"rig {number}"
    return exploded, largest


def test_derivatives_are_finite_and_bounded_or_said_to_be_wrong():
    # Of 30 rigs two are light wheels on sand that is far too stiff for steps of 5 ms.
    assert beyond(30)[0] <= 2


if __name__ == "__main__":
    configure_jax()
    number, largest = beyond(int(sys.argv[1]))
    print(f"{number} beyond {LARGEST:g}; the largest of the others: {largest:.3g}")
