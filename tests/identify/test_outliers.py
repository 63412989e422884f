"""What a fit says of readings that stand out, of runs in motion, and of numbers thrown far off."""

import dataclasses

import numpy as np
import pytest

import drftjax
from drftjax.common.errors import InputError
from drftjax.recorded.observation import white_noise
from drftjax.recorded.prepared_run import prepare_run
from drftjax.runlog.record import Measured, RecordedSetup
from drftjax.setups.setup import CommandSetUp, SetUp
from drftjax.setups.simulated_run import simulated_run
from drftjax.simulation.statics import sinkage_under_load
from identify.fit_constant import FIT_SETTINGS, _in_short_steps, _problem, fit
from identify.parameters.parameter import parameter
from identify.results.outliers import OUTLIER_SETTINGS, outlier_times
from identify.solver.initial_zeta import zeta_from_mean_sinkage
from identify.solver.levenberg_marquardt import solve
from tests.helpers.synthetic_runs import BELIEVED_ZETA, NOISE, SLOW, coarse, recorded, setup_of

SPIKES = (30, 31, 60)
# Of the true speed: readings of 20 um over the first tenths of a second, in which sand stops it.
SPEED = 0.1
# Noise of 20 um that a fit of a true model leaves, and its own steps and plates.
LEFT = 3e-5
# A wheel of 80 deg/s that stops: two steps of 2 ms pass the turn of the force.
TOP = float(np.deg2rad(80))
STEADY = float(np.deg2rad(60))
# Two ways to one least sum of squares end within a tenth of a residual's variance of it, of the
# several hundred that it is made of.
STOPPED = 1 + 1e-3
STOPPING = ([0.0, 0.25, 0.8, 1.9, 2.4, 3.0], [0.0, 0.0, TOP, TOP, 0.0, 0.0])


def spiked(size: float):
    run = recorded(setup_of(SLOW, 0.75), 3)
    z = run.measured.z.copy()
    z[list(SPIKES)] += size
    return dataclasses.replace(run, measured=Measured(run.measured.time, x=run.measured.x, z=z))


def own_zeta():
    return [parameter("zeta", shared=False)]


def test_readings_that_stand_out_are_told_with_their_place():
    result = fit([coarse("run", spiked(5e-3))], own_zeta())
    (run,) = result.runs
    assert set(outlier_times(run)) == {"z"}
    assert outlier_times(run)["z"].tolist() == run.time[list(SPIKES)].tolist()
    assert any(each.startswith("run: 3 readings of z stand out") for each in result.findings)


def test_noise_does_not_stand_out():
    result = fit([coarse("run", spiked(0.0))], own_zeta())
    assert outlier_times(result.runs[0]) == {}
    assert not any("stand out" in each for each in result.findings)
    # What is told is far beyond what the noise makes.
    assert OUTLIER_SETTINGS.noises * OUTLIER_SETTINGS.smallest_noise["z"] > 10 * white_noise(
        result.runs[0].residuals["z"]
    )


def in_motion():
    setup = setup_of(([0.0, 1.5], [1.0, 1.0]), 0.75)
    setup.start.speed = 0.14
    return recorded(setup, 4)


def rigged(command, seed: int, speed: float = 0.0):
    """Runs of 4 mm plates and fine steps, the second a little slower than the first."""
    random = np.random.default_rng(seed)
    for number in range(2):
        zeta = 0.75 * (1 + 0.02 * random.standard_normal())
        setup = SetUp(
            command=CommandSetUp(command[0], [(1 - 0.15 * number) * w for w in command[1]])
        )
        setup.terrain.zeta = zeta
        setup.start.sinkage = float(sinkage_under_load(setup.trial().simulator, zeta))
        setup.start.speed = speed * (1 - 0.15 * number)
        log = simulated_run(setup, 0.01)
        read = {
            name: getattr(log.measured, name)
            + NOISE * random.standard_normal(len(log.measured.time))
            for name in "xz"
        }
        believed = RecordedSetup(**log.setup.known() | {"scaling_factor_initial": BELIEVED_ZETA})
        yield dataclasses.replace(log, setup=believed, measured=Measured(log.measured.time, **read))


def test_a_run_that_begins_in_motion_is_told_and_fitted_with_its_speed():
    run = coarse("run", in_motion())
    told = fit([run], own_zeta()).findings
    assert any("begins in motion" in each and "start.speed" in each for each in told)
    wanted = [*own_zeta(), parameter("start.speed", shared=False)]
    result = fit([run], wanted)
    assert not any("in motion" in each for each in result.findings)
    assert result.runs[0].values["start.speed"].value == pytest.approx(0.14, rel=SPEED)
    assert np.sqrt(np.mean(result.runs[0].residuals["x"] ** 2)) < LEFT


def test_a_step_that_gains_part_of_the_way_is_taken():
    # In steps of 2 ms the whole step does not gain, and optimistix's damping hardly shortens it.
    runs = [
        prepare_run(f"run {number}", run, step=2e-3)
        for number, run in enumerate(rigged(STOPPING, 500))
    ]
    result = fit(runs, [*own_zeta(), parameter("lambda", shared=True)])
    assert [each.status for each in result.runs] == ["converged"] * 2


def test_a_number_that_is_thrown_to_its_bound_is_looked_for_without_it_first():
    """Steady runs whose carriage's speed at the start is unknown tell next to nothing of lambda."""
    runs = rigged(([0.0, 2.0], [STEADY, STEADY]), 1, 0.3 * STEADY)
    candidates = [prepare_run(f"run {number}", run) for number, run in enumerate(runs)]
    alone, _, _ = _problem(candidates, tuple(own_zeta()))
    without = solve(alone, zeta_from_mean_sinkage(alone, alone.start()))
    problem, _, _ = _problem(candidates, (*own_zeta(), parameter("lambda", shared=True)))
    start = zeta_from_mean_sinkage(problem, problem.start())
    shared, own = start
    far = (shared - 2 * FIT_SETTINGS.farthest, own)
    thrown = dataclasses.replace(without, coordinates=far, residual=np.full((2, 1, 1), np.inf))
    end = _in_short_steps(problem, 2, start, thrown, [True, False], lambda *_: None)
    assert end.loss <= without.loss * STOPPED
    assert abs(float((end.coordinates[0] - shared)[0])) < FIT_SETTINGS.farthest


def test_a_copy_of_a_run_is_no_repeat():
    run = recorded(setup_of(SLOW, 0.75), 3)
    result = drftjax.fit({"a": run, "b": run}, parameters="zeta")
    assert not any(each.startswith("repeated runs") for each in result.findings)


def test_a_run_of_two_samples_tells_no_noise():
    run = recorded(setup_of(SLOW, 0.75), 3)
    late = slice(-2, None)
    few = Measured(run.measured.time[late], x=run.measured.x[late], z=run.measured.z[late])
    result = drftjax.fit({"few": dataclasses.replace(run, measured=few)}, parameters="zeta")
    assert any("none has samples enough" in each for each in result.findings)


@pytest.mark.parametrize(
    ("prior", "why"),
    [((0.9, 1e-300), "its error must be over 9e-10"), ((np.inf, 0.1), "its mean must be finite")],
)
def test_priors_that_no_fit_can_hold_are_refused(prior, why):
    with pytest.raises(InputError, match=why):
        parameter("zeta", shared=False, prior=prior)
