"""Zero of the vertical scale: told by a run, or not."""

import dataclasses

import numpy as np
import pytest

from drftjax.runlog.record import RecordedCommand, RunLog
from identify.fit_constant import fit
from identify.parameters.parameter import parameter
from identify.results.result import FitResult
from identify.uncertainty.height_zero import zero_of_height
from tests.helpers.synthetic_runs import coarse, recorded, setup_of

# The zero of a public file, off by so much [m].
OFF = 7.4e-3
TRUE = 0.75
# Linearised over a tenth of a millimetre beside a difference of two whole fits: the sinkage of a
# grousered wheel is not quite linear in zeta.
CURVED = 0.05
# Five errors of a fit are never chance.
ERRORS = 5.0
ZETA, ZERO = "terrain.zeta", "sinkage_offset.offset"
# The wheel starts from rest at the wrong depth and is at another within the first samples; of the
# whole offset so much is left on average.
LEFT = 0.02
GOING = ([0.0, 0.5, 1.5, 3.0, 4.0], [0.0, 0.0, 0.5, 0.5, 0.0])
STEADY = ([0.0, 0.25, 1.0, 3.0], [0.0, 0.0, 0.5, 0.5])


def off_by(log: RunLog, offset: float) -> RunLog:
    z = log.measured.z + offset
    return dataclasses.replace(log, measured=dataclasses.replace(log.measured, z=z))


def from_the_middle(log: RunLog, begin: float) -> RunLog:
    """The same run, recorded from when the wheel already ran steadily."""
    keep, knots = log.measured.time >= begin, log.command.time >= begin
    measured = dataclasses.replace(
        log.measured, time=log.measured.time[keep], x=None, z=log.measured.z[keep]
    )
    time = np.r_[begin, log.command.time[knots]]
    omega, vx = (np.interp(time, log.command.time, v) for v in (log.command.omega, log.command.vx))
    return dataclasses.replace(log, measured=measured, command=RecordedCommand(time, omega, vx))


def fitted(log: RunLog, *own: str) -> FitResult:
    names = own or ("zeta",)
    run = coarse("run", log, fitted=names)
    return fit([run], [parameter(each, shared=False) for each in names])


@pytest.fixture(scope="module")
def steady() -> RunLog:
    driven = setup_of(STEADY, TRUE, vx=[0.0, 0.0, 0.04, 0.04])
    return from_the_middle(recorded(driven, rate=100.0), 2.0)


@pytest.fixture(scope="module")
def standing() -> RunLog:
    return recorded(setup_of(GOING, TRUE), rate=100.0)


def test_a_steady_run_under_a_wrong_zero_says_that_zeta_hangs_on_it(steady):
    right, wrong = fitted(steady), fitted(off_by(steady, -OFF))
    (found,), (other,) = right.runs, wrong.runs
    assert abs(found.values[ZETA].value - TRUE) < ERRORS * found.values[ZETA].error
    # The wrong one is as sure, and hardly any residual betrays it.
    assert abs(other.values[ZETA].value - TRUE) > ERRORS * other.values[ZETA].error
    assert other.rmse()["z"] < LEFT * OFF
    for each in (right, wrong):
        told = [line for line in each.findings if "zero of the height" in line]
        assert len(told) == 1
        assert f"--own {ZERO}" in told[0]


def test_the_share_told_is_what_another_fit_finds(steady):
    moved = 1e-4
    here, there = fitted(off_by(steady, -moved)), fitted(off_by(steady, moved))
    change = np.log([each.runs[0].values[ZETA].value for each in (here, there)])
    error, shift = zero_of_height(fitted(steady).estimate, [0])
    # A reading that is raised needs a firmer sand, and a zero that is raised a softer one.
    assert -shift[0, 0] == pytest.approx((change[1] - change[0]) / (2 * moved), rel=CURVED)
    assert error[0] > OFF


def test_a_run_that_stands_first_tells_its_zero(standing):
    plain = fitted(standing)
    assert not any("zero of the height" in line for line in plain.findings)
    error, _ = zero_of_height(plain.estimate, [0])
    assert error[0] < 1e-3
    found = fitted(off_by(standing, -1e-3), "zeta", ZERO).runs[0].values
    assert abs(found[ZERO].value + 1e-3) < ERRORS * found[ZERO].error
    assert abs(found[ZETA].value - TRUE) < ERRORS * found[ZETA].error
    assert found[ZERO].error < 1e-3
