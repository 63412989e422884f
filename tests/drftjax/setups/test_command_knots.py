"""Phases of commands as they were given, measured and rounded."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from drftjax.recorded.prepared_run import prepare_run
from drftjax.runlog.record import RecordedCommand
from drftjax.setups.command_knots import DEFAULT_KNOTS, decimate_command, simplify_command
from drftjax.setups.setup import CommandSetUp, SetUp
from identify.parameters.phase_zeta import phases_of
from identify.uncertainty.estimate import phases_of as phase_numbers
from tests.helpers.synthetic_runs import recorded, setup_of

TIME = [0.0, 0.3, 0.8, 1.9, 2.4, 2.7]
OMEGA = [0.0, 0.0, 2.0, 2.0, 0.0, 0.0]
INTERVAL = 0.01
DENSE = np.arange(0.0, TIME[-1] + 1e-9, INTERVAL)
# A corner is found where noise first exceeds what it was: within a few rows of a logger.
ROWS = 3
# Straight lines through a few hundred rows.
ROUNDING = 1e-12


def noisy(scale: float) -> np.ndarray:
    exact = np.interp(DENSE, TIME, OMEGA)
    return exact + scale * np.random.default_rng(1).standard_normal(len(DENSE))


def rounded(to: float) -> np.ndarray:
    return np.round(np.interp(DENSE, TIME, OMEGA) / to) * to


MEASURED = [noisy(1e-5), noisy(0.001 * 2.0), rounded(1e-4), rounded(2 * np.pi / 60 * 0.3)]


@pytest.mark.parametrize("time", [TIME, [7.0 + t for t in TIME]])
@pytest.mark.parametrize("vx", [None, [0.0, 0.0, 0.25, 0.3, 0.1, 0.0]])
def test_a_profile_as_given_keeps_exactly_its_knots(time, vx):
    given = CommandSetUp(time, OMEGA, vx)
    assert simplify_command(given) == given == decimate_command(given)
    dense = np.interp(DENSE + time[0], time, OMEGA).tolist()
    if vx is None:
        assert simplify_command(
            CommandSetUp((DENSE + time[0]).tolist(), dense)
        ).omega == pytest.approx(OMEGA, abs=ROUNDING)


@pytest.mark.parametrize("omega", MEASURED)
def test_what_a_measured_speed_scatters_by_is_no_phase(omega):
    command = CommandSetUp(DENSE.tolist(), omega.tolist())
    lines = simplify_command(command)
    assert len(lines.time) == len(TIME)
    off = np.interp(DENSE, lines.time, lines.omega) - omega
    assert np.abs(off).max() <= DEFAULT_KNOTS.scatter * np.abs(omega).max() * (1 + ROUNDING)
    found = phases_of(SetUp(command))
    assert [name for *_, name in found] == ["stand", "accelerate", "steady", "decelerate", "rest"]
    np.testing.assert_allclose([end for _, end, _ in found], TIME[1:], rtol=0, atol=ROWS * INTERVAL)


@pytest.mark.parametrize("omega", MEASURED)
def test_constants_of_a_model_last_as_long_as_the_phases_of_a_measured_command(omega):
    time = np.arange(0.0, TIME[-1], 0.02)
    each = SimpleNamespace(
        setup=SetUp(CommandSetUp(DENSE.tolist(), omega.tolist())),
        observation=SimpleNamespace(time=time),
    )
    (phase,) = phase_numbers((each,), np.ones((1, 1, len(time)), bool))  # pyright: ignore
    assert len(np.unique(phase)) == len(TIME) - 1


def test_a_measured_command_rests_while_it_scatters_about_zero():
    run = recorded(setup_of((TIME, OMEGA)))
    measured = dataclasses.replace(run, command=RecordedCommand(time=DENSE, omega=noisy(1e-3)))
    starts = [prepare_run("run", each).setup.start for each in (run, measured)]
    assert starts[0] == starts[1]
    creeping = np.maximum(noisy(0.0), 0.01)
    creeps = dataclasses.replace(run, command=RecordedCommand(time=DENSE, omega=creeping))
    assert run.measured.x is not None
    assert prepare_run("run", creeps).setup.start.x == run.measured.x[0]
