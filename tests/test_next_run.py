"""What to run next: a run on which two explanations of the same runs part."""

import numpy as np
import pytest

from diagnose.next_run import TELLING, _stop_and_go, next_run
from diagnose.search import search
from drftjax.effects.catalogue import effect_class
from drftjax.integrator import STEPS
from tests.virtual_cases import case_with

FLOORS = {"x": 80e-6, "z": 30e-6}
NAMES = ("drawbar", "horizontal_coulomb")


@pytest.fixture(scope="module")
def pulled():
    return case_with({"name": "drawbar", "force": -3.0})


@pytest.fixture(scope="module")
def advice(pulled):
    # Both push back, or on, all the while as long as the carriage only goes forward.
    singles = {each.names: each for each in search(pulled, [*map(effect_class, NAMES)]).singles}
    return next_run(pulled, *(singles[(name,)] for name in NAMES), FLOORS)


def test_it_names_the_run_that_parts_two_explanations(advice):
    assert advice["tells"] == list(NAMES)
    assert "backward" in advice["run"]["run"]
    assert advice["run"]["floors"] > TELLING


def test_it_names_a_channel_that_would_part_them_on_a_run_as_made(advice):
    assert advice["channel"]["channel"] == "torque"
    assert advice["channel"]["floors"] > TELLING
    assert advice["channel"]["unit"] == "N m"


def test_stop_and_go_is_as_sharp_as_fits_can_step(pulled):
    trial = _stop_and_go(pulled.trials[0], top=0.8)
    time, omega = np.asarray(trial.time), np.asarray(trial.omega)
    assert float(trial.step) == STEPS[-1]
    assert omega[0] == omega[1] == 0
    assert set(np.unique(omega)) == {0.0, 0.8}
    # What is simulated of it holds a start and a stop at least.
    until = time <= trial.rows * trial.every * float(trial.step)
    assert np.count_nonzero(np.diff(omega[until] > 0)) >= 2
