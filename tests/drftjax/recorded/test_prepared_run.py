"""How a recorded run is made ready for a fit: where it starts, and which samples are compared."""

import dataclasses

import numpy as np
import pytest

from drftjax.recorded.commanded_motion import MotionSettings, is_commanded_to_move
from drftjax.recorded.observation import ObservationSettings, observe, white_noise
from drftjax.recorded.prepared_run import RECORDED_STEPS, prepare_run, standing_setup
from drftjax.recorded.start_state import StartSettings
from drftjax.runlog.record import Measured, RecordedCommand
from drftjax.simulation.step_choice import choose_step
from tests.helpers.synthetic_runs import BELIEVED_ZETA, DEEPER, recorded, setup_of

RADIUS = 0.150
# Second differences of 5,000 samples tell a standard deviation to 1.4 %; three times that.
WHITE = 0.05
# A line through 26 readings of 20 um is off by 8 um at its end [m]; a mean over 0.2 s, of a wheel
# that creeps so fast [m/s], by 45 um.
LINE, CREEP = 20e-6, 5e-4
# Times of rows are sums of steps [s].
CLOCK = 1e-9
# It slows down after so much [m], within 0.2 s.
SLOWING = 3e-4


def test_a_guess_of_zeta_that_lets_the_wheel_fall_asks_for_no_shorter_steps():
    """A fall at the start takes shorter steps than the run, and no comparison makes it."""
    setup = setup_of(([0.0, 0.5, 1.0, 3.0], [0.0, 0.0, 0.5, 0.5]), zeta=4.0)
    run = recorded(setup)
    falling = prepare_run("run", run)
    assert falling.setup.terrain.zeta == BELIEVED_ZETA
    told = prepare_run("run", run, zeta=4.0)
    assert falling.step_choice is not None
    assert told.step_choice is not None
    assert falling.step_choice.step == told.step_choice.step
    assert choose_step(falling.trial, RECORDED_STEPS).step < falling.step_choice.step


def test_the_step_of_a_wheel_that_does_fall_is_chosen_for_the_fall():
    setup = setup_of(([0.0, 0.5, 1.0, 3.0], [0.0, 0.0, 0.5, 0.5]))
    setup.start.sinkage = setup.start.sinkage / 8
    found = prepare_run("run", recorded(setup))
    assert found.step_choice == choose_step(found.trial, RECORDED_STEPS)


def test_the_step_of_a_wheel_that_starts_above_the_sand_is_chosen_with_the_set_ups_zeta():
    setup = setup_of()
    setup.start.sinkage = -0.01
    assert standing_setup(setup) == setup


@pytest.mark.parametrize(("rest", "counted"), [(0.0, 1), (0.01, 1), (0.1, 6), (0.2, 11), (0.4, 11)])
def test_start_is_read_before_the_wheel_sets_off(rest, counted):
    """A wheel that sets off at once has travelled millimetres within the first 0.2 s."""
    time = [0.0, rest, rest + 0.1, 2.0] if rest else [0.0, 0.1, 2.0]
    omega = [0.0, 0.0, 2.0, 2.0] if rest else [0.0, 2.0, 2.0]
    run = recorded(setup_of((time, omega)))
    start = prepare_run("run", run).setup.start
    assert start.x == run.measured.x[:counted].mean()
    assert start.sinkage == -run.measured.z[:counted].mean()


def test_the_sinkage_that_a_standing_wheel_creeps_by_is_none_of_its_start():
    # A wheel that was put down to stand creeps at some tenths of a millimetre a second.
    run = recorded(setup_of(([0.0, 1.0, 1.5, 2.0], [0.0, 0.0, 0.5, 0.5])))
    time = run.measured.time
    noise = 20e-6 * np.random.default_rng(2).standard_normal(len(time))
    z = -0.0176 - CREEP * time + noise
    creeping = dataclasses.replace(run, measured=Measured(time, x=run.measured.x, z=z))
    start = prepare_run("run", creeping).setup.start
    assert start.sinkage == pytest.approx(0.0176, abs=LINE)
    assert -z[:11].mean() - 0.0176 > LINE
    assert start.x == run.measured.x[:11].mean()
    # Where it creeps ever slower, a straight line would be off by as much as the mean.
    curved = -0.0176 - SLOWING * (1 - np.exp(-time / 0.2)) + noise / 2
    assert -np.polyfit(time[:26], curved[:26], 1)[1] - 0.0176 > 2 * LINE
    slowing = dataclasses.replace(run, measured=Measured(time, x=run.measured.x, z=curved))
    assert prepare_run("run", slowing).setup.start.sinkage == pytest.approx(0.0176, abs=LINE)


@pytest.mark.parametrize("noise", [0.0, 20e-6])
def test_start_of_a_wheel_that_still_settles_is_its_first_sample(noise):
    setup = setup_of(([0.0, 0.5, 1.0, 2.0], [0.0, 0.0, 0.5, 0.5]))
    setup.start.sinkage = setup.start.sinkage / DEEPER - 1.2e-3
    run = recorded(setup, noise=noise)
    start = prepare_run("run", run).setup.start
    assert start.sinkage == -run.measured.z[0]
    assert start.x == run.measured.x[0]
    # A mean over 0.2 s is that much deeper.
    assert -run.measured.z[:11].mean() > start.sinkage + 0.3e-3


def test_what_was_recorded_before_the_command_begins_is_neither_start_nor_compared():
    """A rig that records its touch-down: the wheel comes down from above, then stands."""
    plain = recorded(setup_of())
    before = np.arange(-5.0, 0.0, 0.02)
    measured = Measured(
        time=np.r_[before, plain.measured.time],
        x=np.r_[0 * before, plain.measured.x],
        z=np.r_[np.linspace(0.02, 0.0, len(before)), plain.measured.z],
    )
    early = prepare_run("run", dataclasses.replace(plain, measured=measured))
    late = prepare_run("run", plain)
    assert early.setup.start == late.setup.start
    np.testing.assert_array_equal(early.observation.counts[len(before) :], late.observation.counts)
    assert not early.observation.counts[: len(before)].any()


@pytest.mark.parametrize("dust", [1e-7, -1e-6])
def test_a_command_that_was_measured_stands_where_it_is_as_good_as_zero(dust):
    plain = recorded(setup_of(([0.0, 1.0, 2.0, 3.0, 5.0], [0.0, 0.5, 0.5, 0.0, 0.0])))
    command = plain.command
    dusty = dataclasses.replace(command, omega=np.where(command.omega == 0, dust, command.omega))
    np.testing.assert_array_equal(
        observe(dataclasses.replace(plain, command=dusty), RADIUS).counts,
        observe(plain, RADIUS).counts,
    )


def test_dust_on_a_wheel_that_is_locked_does_not_keep_its_carriage_moving():
    time, vx = [0.0, 1.0, 2.0, 3.0, 5.0], [0.0, 0.05, 0.05, 0.0, 0.0]
    plain = recorded(setup_of((time, [0.0] * 5), vx=vx))
    dusty = dataclasses.replace(plain.command, omega=np.array([2e-7, -2e-7, 2e-7, -2e-7, 2e-7]))
    found = observe(dataclasses.replace(plain, command=dusty), RADIUS)
    np.testing.assert_array_equal(found.counts, observe(plain, RADIUS).counts)
    assert not found.counts[found.time > 3.0 + CLOCK].any()
    trial = prepare_run("dusty", dataclasses.replace(plain, command=dusty)).trial
    np.testing.assert_array_equal(
        is_commanded_to_move(trial, np.array([0.5, 2.5, 3.5])), [True, True, False]
    )


def test_samples_after_the_last_stop_are_left_out_unless_kept():
    command = RecordedCommand(time=[2.0, 3.0, 4.0, 6.0], omega=[0.0, 1.0, 0.0, 0.0])
    measured = Measured(time=np.arange(2.0, 8.0, 0.5), z=np.zeros(12))
    base = recorded(setup_of())
    run = dataclasses.replace(base, command=command, measured=measured)
    moving, kept = observe(run, RADIUS), observe(run, RADIUS, keep_rest=True)
    np.testing.assert_array_equal(moving.counts, moving.time <= 2)
    # Past the command's end nothing is simulated.
    np.testing.assert_array_equal(kept.counts, kept.time <= 4)


def test_the_settings_decide_how_much_of_the_rest_is_the_start():
    run = recorded(setup_of(([0.0, 0.4, 0.5, 2.0], [0.0, 0.0, 2.0, 2.0])))
    start = prepare_run("run", run, start_settings=StartSettings(window=0.11)).setup.start
    assert start.x == run.measured.x[:6].mean()
    assert start.x != prepare_run("run", run).setup.start.x


def test_the_settings_decide_what_stands_and_how_little_noise_there_is():
    plain = recorded(setup_of(([0.0, 1.0, 2.0, 3.0, 5.0], [0.0, 0.5, 0.5, 0.01, 0.01])))
    slow = ObservationSettings(min_noise={"x": 1.0, "z": 1.0, "torque": 1.0})
    slow = dataclasses.replace(slow, motion=MotionSettings(standing_share=0.1))
    found = observe(plain, RADIUS, settings=slow)
    np.testing.assert_array_equal(found.noise, 1.0)
    assert observe(plain, RADIUS).counts[found.time > 3.0 + CLOCK].any()
    assert not found.counts[found.time > 3.0 + CLOCK].any()


def test_white_noise_is_told_from_a_slow_signal():
    random = np.random.default_rng(0)
    time = np.linspace(0, 10, 5000)
    assert white_noise(np.sin(time) + 0.01 * random.standard_normal(5000)) == pytest.approx(
        0.01, rel=WHITE
    )
    assert white_noise(np.array([1.0, 2.0])) == 0
