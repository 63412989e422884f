"""Where x of a diagnosis counts from."""

import dataclasses

import numpy as np
import pytest

from diagnose.interface import gathered_from
from drftjax.runlog.record import RunLog
from identify.candidate import candidate
from tests.virtual_runs import recorded, setup_of


@pytest.fixture(scope="module")
def run() -> RunLog:
    return recorded(setup_of())


def from_x(run: RunLog, start: float) -> RunLog:
    assert run.measured.x is not None
    x = run.measured.x + start
    return dataclasses.replace(run, measured=dataclasses.replace(run.measured, x=x))


def test_runs_that_start_elsewhere_count_from_there_and_keep_their_places(run):
    at_zero = gathered_from({"a": run, "b": from_x(run, 0.3)}).candidates
    away = gathered_from({"a": from_x(run, 2.0), "b": from_x(run, 2.3)}).candidates
    assert away[0].setup.start.x == pytest.approx(0.0, abs=1e-12)
    assert away[1].setup.start.x == pytest.approx(0.3, abs=1e-12)
    for one, other in zip(at_zero, away, strict=True):
        moved = one.observation.values[0][0] - other.observation.values[0][0]
        difference = other.observation.values[0] + moved - one.observation.values[0]
        np.testing.assert_allclose(difference, 0, rtol=0, atol=1e-12)
        assert other.trial.start.position[0] == pytest.approx(other.setup.start.x, abs=1e-12)


def test_runs_that_start_at_zero_stay_as_they_are(run):
    (each,) = gathered_from({"a": run}).candidates
    plain = candidate("a", run)
    assert each.setup.start.x == plain.setup.start.x
    np.testing.assert_array_equal(each.observation.values, plain.observation.values)
