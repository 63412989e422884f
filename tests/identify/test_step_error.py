"""The step's error is taken off simulated channels, at the values it was found at and at others."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.recorded.batch import device_mesh, make_batch
from drftjax.recorded.observation import Observation
from drftjax.setups.setup import CommandSetUp, SetUp
from drftjax.simulation.statics import sinkage_under_load
from drftjax.simulation.step_error import parts_within_turn, step_error
from drftjax.simulation.trial import Trial
from identify.parameters.parameter import own
from identify.solver.problem import Problem, predict
from identify.uncertainty.noise_model import White

STEP, FINE = 1e-2, 1.5625e-4
ZETA, OTHER = 0.7823, 0.72
RAMP = ([0.0, 0.2, 1.2, 3.0], [0.0, 0.0, 90.0, 90.0])


def trial_of(zeta: float, step: float, speed: float = 1.0) -> Trial:
    time, omega = RAMP
    setup = SetUp(command=CommandSetUp(time, [speed * w for w in omega], None, "deg/s"))
    setup.terrain.zeta = zeta
    setup.start.sinkage = 1.1 * float(sinkage_under_load(setup.trial().simulator, zeta))
    setup.integrator.step = step
    return setup.trial(interval=0)


@eqx.filter_jit
def swept(trial: Trial):
    return trial.run_to(jnp.asarray(trial.rows), ("x", "z"))


def test_a_row_in_several_steps_is_the_run_of_shorter_steps():
    whole, part = trial_of(ZETA, STEP), trial_of(ZETA, STEP / 4)
    finer = eqx.tree_at(lambda t: t.parts, whole, jnp.asarray(4))
    # The same steps; the command's times are rounded otherwise, and 300 steps gather it.
    np.testing.assert_allclose(swept(finer), swept(part)[:, ::4], atol=1e-12)


@pytest.mark.parametrize(("speed", "parts"), [(0.1, 1), (1.0, 9), (3.0, 27)])
def test_a_faster_wheel_is_made_in_more_steps(speed, parts):
    # Of 10 ms: a tenth of a degree each.
    assert parts_within_turn(trial_of(ZETA, STEP, speed)) == parts


def test_a_run_that_diverges_in_shorter_steps_is_left_as_it_is():
    each = trial_of(ZETA, STEP, 0.1)
    found = step_error(lambda parts: np.array([1.0, np.nan if parts > 1 else 2.0]), each)
    assert found.tolist() == [0.0, 0.0]


def test_what_is_known_stands_where_a_run_diverges_in_shorter_steps():
    each = trial_of(ZETA, STEP, 0.1)
    known = np.array([0.3, 0.4])
    found = step_error(
        lambda parts: np.array([1.0, np.nan if parts > 1 else 2.0]), each, known=known
    )
    assert found.tolist() == [0.0, 0.4]


def test_the_error_is_taken_against_shorter_steps_extrapolated():
    each = eqx.tree_at(lambda t: t.parts, trial_of(ZETA, STEP, 0.1), jnp.asarray(3))
    # An error of first order is taken off whole: 7 + step.
    found = step_error(lambda parts: np.array([7.0 + 1.0 / parts]), each)
    np.testing.assert_allclose(found, 1 / 3, rtol=1e-12)


def test_what_is_left_at_another_zeta_is_a_small_part():
    """Against steps of 0.16 ms, of which neither side was told."""
    each = trial_of(ZETA, STEP)
    time = STEP * np.arange(each.rows + 1)
    seen = Observation(
        time, ("x", "z"), np.zeros((2, len(time))), np.ones(2), np.ones(len(time), bool)
    )
    parameters = (own("zeta"),)
    white = White().for_channels(2)
    problem = Problem(
        make_batch([each], [seen], jax.device_count()), parameters, white, device_mesh()
    )
    corrected = problem.without_step_error(problem.start())
    for zeta, share in ((ZETA, 0.05), (OTHER, 0.2)):
        other = trial_of(ZETA, STEP)
        other = eqx.tree_at(lambda t: t.simulator.terrain.zeta.value, other, jnp.asarray(zeta))
        fine = eqx.tree_at(lambda t: t.parts, other, jnp.asarray(round(STEP / FINE)))
        true = np.asarray(swept(fine))
        (parameter,) = parameters
        shared, each_own = problem.start()
        at = shared, jnp.full_like(each_own, parameter.coordinate(other))
        samples = slice(0, len(time))
        before = predict(problem, at)[0, :, samples] - true
        after = predict(corrected, at)[0, :, samples] - true
        assert np.sqrt(np.mean(before[0] ** 2)) > 3e-5
        for channel in range(2):
            left, was = (np.sqrt(np.mean(e[channel] ** 2)) for e in (after, before))
            assert left < share * was
