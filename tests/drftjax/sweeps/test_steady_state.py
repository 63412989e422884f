"""Steady running at imposed slip, against a balance of forces by SciPy and against long runs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

from drftjax.common.errors import InputError
from drftjax.setups.api import simulate
from drftjax.setups.setup import SetUp
from drftjax.sweeps.steady_state import slip_curve, steady_state

WEIGHT = 18.837 * 9.81  # N
SLIPS = (-0.1, 0.0, 0.3, 0.7)
OMEGA = 0.8

# The means still change by 1e-4 of the load, radius or both from one stretch to the next; they
# come closer as a geometric series, of which ten terms are the last.
CHANGE = 1e-3

# Steps of 5 ms against the step of the run, whose ripple is some newton and 0.2 mm.
PULL, SINKAGE, TORQUE = 0.3, 1e-4, 0.05

COMMAND = {"time": [0, 1], "omega": [0, OMEGA]}


@pytest.fixture(scope="module")
def plain() -> SetUp:
    return SetUp(COMMAND, wheel={"shape": "plain", "plate_size": 0.01}, integrator={"step": 5e-3})


@pytest.fixture(scope="module")
def curve(plain):
    return slip_curve(plain, SLIPS)


def test_plain_wheel_runs_where_the_forces_balance(plain, curve):
    simulator, radius = plain.trial().simulator, plain.wheel.radius

    @jax.jit
    def wrench(sinkage, speed):
        place, velocity = jnp.stack([0.0, -sinkage]), jnp.stack([speed, 0.0])
        return simulator.wrench(
            place, velocity, jnp.array(0.0), jnp.array(OMEGA), jnp.array(0.7823)
        )

    for row, slip in enumerate(SLIPS):
        speed = radius * OMEGA * (1 - slip)
        depth = brentq(lambda h, v=speed: float(wrench(h, v)[1]) - WEIGHT, 1e-3, 0.1, xtol=1e-12)
        pull, _, torque = np.asarray(wrench(depth, speed))
        assert curve.sinkage[row] == pytest.approx(depth, abs=CHANGE * radius)
        assert curve.drawbar_pull[row] == pytest.approx(pull, abs=CHANGE * WEIGHT)
        assert curve.torque[row] == pytest.approx(torque, abs=CHANGE * WEIGHT * radius)
    assert curve.is_steady.all()
    assert curve.load == pytest.approx(WEIGHT, rel=CHANGE)


def test_sand_takes_power_from_the_drive(curve):
    assert (curve.torque * OMEGA > curve.drawbar_pull * curve.speed).all()


def test_grousered_wheel_runs_as_at_the_end_of_a_long_driven_run():
    slip, turns = 0.4, 2
    wheel = {"plate_size": 0.01}
    setup = SetUp(COMMAND, wheel=wheel, integrator={"step": 5e-3})
    steady = steady_state(setup, slip)
    end = 2 * np.pi * turns / OMEGA
    speed = 0.15 * OMEGA * (1 - slip)
    command = {"time": [0, end], "omega": [OMEGA] * 2, "vx": [speed] * 2}
    driven = SetUp(command, wheel=wheel, rig={"carriage": "driven"}, start={"speed": speed})
    run = simulate(driven, at=np.linspace(end / 2, end, 2401)[1:])
    assert steady.drawbar_pull == pytest.approx(run.measured.fx.mean(), abs=PULL)
    assert steady.sinkage == pytest.approx(run.measured.sinkage.mean(), abs=SINKAGE)
    assert steady.torque == pytest.approx(run.measured.torque.mean(), abs=TORQUE)
    assert steady.drawbar_ripple == pytest.approx(run.measured.fx.std(), abs=PULL)


def test_curve_shows_and_tables_its_numbers(curve):
    assert "at 4 slips, 0 of them not steady; most at slip 0.7" in repr(curve)
    assert "drawbar_pull [N]" in curve._repr_html_()
    assert float(curve.to_xarray().sel(slip=0.3).torque) == curve.torque[2]
    assert curve.to_xarray().sinkage.attrs["units"] == "m"
    assert curve.to_dataframe().loc[0.7, "drawbar_pull"] == curve.drawbar_pull[3]
    assert curve.plot().axes[0].lines[0].get_ydata() == pytest.approx(curve.drawbar_pull)


def test_one_slip_is_the_same_as_among_several(plain, curve):
    one = steady_state(plain, 0.3)
    assert float(one.torque) == pytest.approx(curve.torque[2], rel=1e-9)
    assert "at slip 0.3: drawbar pull" in repr(one)


def test_wheel_that_digs_itself_in_is_told(plain):
    with pytest.raises(InputError, match=r"at slip 0\.9 the wheel digs itself in"):
        steady_state(plain, 0.9, zeta=0.15)


@pytest.mark.parametrize(
    ("slips", "more", "said"),
    [
        ([1.2], {}, "slip is .*1.2.*, must lie between -10 and 1"),
        ([], {}, "slips have shape"),
        (0.2, {}, "slips have shape"),
        ([0.2], {"omega": 0.0}, "omega is 0, must lie"),
        ([float("nan")], {}, "slip is"),
        ([0.2], {"zeta": -1}, "zeta is -1"),
    ],
)
def test_impossible_slips_are_refused(plain, slips, more, said):
    with pytest.raises(InputError, match=said):
        slip_curve(plain, slips, **more)
