"""An ensemble is its runs, whatever the number of devices."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.physics.command import Command
from drftjax.physics.state import State
from drftjax.physics.terrain import ConstantZeta, Terrain
from drftjax.physics.wheel import GrouserWheel, PlainWheel
from drftjax.simulation.ensemble import simulate_ensemble, stack
from drftjax.simulation.rollout import simulate
from drftjax.simulation.simulator import Simulator

DT, STEPS, EVERY = 2e-3, 200, 20

# The same operations compiled into another loop: rounding, which the stiff force at rest magnifies.
ROUNDING = {"rtol": 1e-7, "atol": 1e-9}
# Forward and backward sum in another order.
GRADIENT = {"rtol": 1e-9}


def simulator(zeta) -> Simulator:
    return Simulator(GrouserWheel(plate_size=0.01), Terrain(ConstantZeta(zeta)))


def rolling() -> Command:
    omega = jnp.linspace(0.0, 0.5, STEPS)
    return Command(omega, jnp.zeros(STEPS), jnp.zeros(STEPS))


def ensemble(zetas):
    simulators = eqx.filter_vmap(simulator)(zetas)
    states = eqx.filter_vmap(State.at_rest)(jnp.full(zetas.shape, 0.0176))
    return simulate_ensemble(simulators, states, rolling(), DT, every=EVERY)


def alone(zeta):
    return simulate(simulator(zeta), State.at_rest(0.0176), rolling(), DT, every=EVERY)


@pytest.mark.parametrize("runs", [1, 3, 4])
def test_an_ensemble_equals_its_runs_one_by_one(runs):
    zetas = jnp.linspace(0.7, 0.9, runs)
    together = ensemble(zetas)
    singles = stack([jax.jit(alone)(zeta) for zeta in zetas])
    assert together[1].z.shape == (runs, STEPS // EVERY)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, **ROUNDING), together, singles)


def test_devices_only_share_the_work():
    zetas = jnp.linspace(0.7, 0.9, 3)
    simulators = eqx.filter_vmap(simulator)(zetas)
    states = stack([State.at_rest(0.0176)] * 3)
    one, all_of_them = (
        simulate_ensemble(simulators, states, rolling(), DT, every=EVERY, devices=devices)
        for devices in (jax.devices()[:1], None)
    )
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, **ROUNDING), one, all_of_them)


def test_gradients_pass_through_an_ensemble_as_through_a_run():
    zetas = jnp.linspace(0.7, 0.9, 3)
    single = jax.jit(jax.vmap(jax.grad(lambda zeta: alone(zeta)[1].z[-1])))(zetas)

    def last(zetas):
        return ensemble(zetas)[1].z[:, -1]

    backward = jax.jit(jax.grad(lambda zetas: last(zetas).sum()))(zetas)
    forward = jax.jit(lambda zetas: jax.jvp(last, (zetas,), (jnp.ones(3),))[1])(zetas)
    np.testing.assert_allclose(backward, single, **GRADIENT)
    np.testing.assert_allclose(forward, single, **GRADIENT)


def test_runs_that_differ_in_more_than_numbers_are_refused():
    with pytest.raises(InputError, match="numbers only"):
        stack([Simulator(), Simulator(PlainWheel())])


def test_arrays_without_a_common_axis_of_runs_are_refused():
    simulators = stack([Simulator(), Simulator()])
    states = stack([State.at_rest(0.0176)] * 3)
    with pytest.raises(InputError, match="leading axis"):
        simulate_ensemble(simulators, states, rolling(), DT)


def test_nothing_keeps_an_ensemble_from_an_accelerator():
    """Its program is lowered for one, without a call back to the host or a foreign library."""

    def heights(zetas):
        return jax.vmap(lambda zeta: alone(zeta)[1].z)(zetas)

    runs = jax.ShapeDtypeStruct((100_000,), jnp.float64)
    program = jax.export.export(jax.jit(heights), platforms=["cuda"])(runs).mlir_module()
    assert "custom_call" not in program
    assert "callback" not in program
    assert "while" in program, "the runs are one loop of steps"


def test_four_thousand_runs_of_24_s_at_100_hz_fit_a_gigabyte():
    """By the compiler's account of results and working memory, for what a rig measures."""
    runs, rows = 4096, 2400

    def measured(zetas):
        simulators = eqx.filter_vmap(simulator)(zetas)
        states = eqx.filter_vmap(State.at_rest)(jnp.full(zetas.shape, 0.0176))
        omega = jnp.linspace(0.0, 0.5, rows)
        commands = Command(omega, jnp.zeros(rows), jnp.zeros(rows))
        output = simulate_ensemble(simulators, states, commands, 1e-2)[1]
        return output.x, output.z, output.fx, output.fz, output.torque

    program = jax.jit(measured).lower(jax.ShapeDtypeStruct((runs,), jnp.float64)).compile()
    account = program.memory_analysis()
    on_each = account.output_size_in_bytes + account.temp_size_in_bytes
    assert on_each * jax.device_count() < 1e9
    # Working memory is that of a run, not of all.
    assert account.temp_size_in_bytes < 5e6
