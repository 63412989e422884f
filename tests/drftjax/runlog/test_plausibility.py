"""Runs whose numbers the format allows and that cannot be meant: a wrong sign, another unit."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.recorded.prepared_run import prepare_run
from drftjax.runlog.content import Level
from drftjax.runlog.hdf5.api import read_run, survey_run, write_run
from drftjax.runlog.plausibility import height_problems
from drftjax.runlog.record import Measured, RecordedCommand, RunLog

RUNS = Path(__file__).parents[3] / "data" / "runs"
WHEEL = {"wheel_radius": 0.15, "wheel_width": 0.12, "mass_z": 18.837}
GROUSERS = WHEEL | {"grouser_count": 12, "grouser_height": 0.018}


def scaled(z: float = 1.0, omega: float = 1.0) -> RunLog:
    run = read_run(RUNS / "fast.h5")
    assert run.measured.z is not None
    return dataclasses.replace(
        run,
        command=dataclasses.replace(run.command, omega=omega * run.command.omega),
        measured=dataclasses.replace(run.measured, z=z * run.measured.z),
    )


def found(path: Path, run: RunLog) -> list[tuple[str, str, Level]]:
    write_run(path, run)
    return [(each.where, each.reason, each.level) for each in survey_run(path)[1]]


def test_a_run_with_z_downward_is_refused_where_it_is_compared(drft, tmp_path):
    path = tmp_path / "down.h5"
    ((where, reason, level),) = found(path, scaled(z=-1))
    assert (where, level) == ("/measured/z", Level.FORMAT)
    assert reason.startswith("stands 16.9 mm or more above touch-down throughout")
    assert reason.endswith("z counts upward from touch-down, so sinkage is -z")
    with pytest.raises(InputError, match=r"^down: measured z stands 16\.9 mm .* sinkage is -z$"):
        prepare_run("down", scaled(z=-1))
    for command in (["fit"], ["crosscheck"], ["diagnose"], ["simulate", "--like"]):
        refusal = drft(*command, path).refusal
        assert str(path) in refusal
        assert "above touch-down" in refusal


@pytest.mark.parametrize("name", ["fast", "medium", "slow_a", "slow_b"])
def test_a_run_as_it_is_has_nothing_found(tmp_path, name):
    assert not survey_run(RUNS / f"{name}.h5")[1]


def test_a_light_wheel_may_stand_on_its_grousers():
    light = GROUSERS | {"mass_z": 1.0}
    assert not [*height_problems(np.array([0.010, 0.012]), light)]
    assert [*height_problems(np.array([0.019, 0.020]), light)]  # over the tips


def test_a_wheel_is_judged_where_it_is_lowest_and_only_if_it_is_known():
    up_a_slope = np.array([-0.017, 0.010, 0.060])
    assert not [*height_problems(up_a_slope, GROUSERS)]
    assert [*height_problems(np.array([0.005, 0.060]), WHEEL)]
    assert not [*height_problems(np.array([0.0004, 0.060]), WHEEL)]  # touch-down is not that sure
    assert not [*height_problems(np.array([0.005]), {"wheel_radius": 0.15})]


def test_millimetres_and_degrees_are_noted(tmp_path):
    ((where, reason, level),) = found(tmp_path / "mm.h5", scaled(z=1e3))
    assert (where, level) == ("/measured/z", Level.NOTE)
    assert "perhaps these are mm" in reason
    ((where, reason, level),) = found(tmp_path / "deg.h5", scaled(omega=180 / np.pi))
    assert (where, level) == ("/command/omega", Level.NOTE)
    assert "reaches 240 rad/s" in reason
    assert "perhaps these are deg/s" in reason


def test_refusals_of_such_numbers_ask_for_the_unit():
    with pytest.raises(InputError, match=r"start sinkage is 16\.9.* are these mm\?"):
        prepare_run("mm", scaled(z=1e3))
    with pytest.raises(InputError, match=r"omega is 240, .* are these deg/s\?"):
        prepare_run("deg", scaled(omega=180 / np.pi))


def test_a_static_sinkage_above_the_sand_is_refused_where_it_is_used(drft, tmp_path):
    run = scaled()
    assert run.setup.sinkage_static is not None
    upward = dataclasses.replace(run.setup, sinkage_static=-run.setup.sinkage_static)
    path = tmp_path / "upward.h5"
    ((where, reason, level),) = found(path, dataclasses.replace(run, setup=upward))
    assert (where, level) == ("/setup/sinkage_static", Level.FORMAT)
    assert reason.endswith("sinkage counts downward from touch-down")
    out = ("-o", tmp_path / "out")
    for command in (["simulate", "--like"], ["design", "--like"], ["protocol", *out, "--like"]):
        refusal = drft(*command, path).refusal
        assert refusal.startswith(f"{path}: setup sinkage_static is -1")
    # A fit starts from the recorded sinkage.
    assert prepare_run("upward", dataclasses.replace(run, setup=upward)).setup.start.sinkage > 0


def moved(
    omega: float = 0.5,
    x: float = 0.06,
    z: tuple[float, float] = (-0.017, -0.02),
    clock: float = 1.0,
) -> RunLog:
    """A free wheel of 150 mm that turns evenly for 20 s and goes x metres a second."""
    run, time = read_run(RUNS / "fast.h5"), np.linspace(0.0, 20.0, 201)
    return dataclasses.replace(
        run,
        command=RecordedCommand(clock * time, np.full_like(time, omega)),
        measured=Measured(clock * time, x=x * time, z=np.linspace(*z, time.size)),
    )


@pytest.mark.parametrize(
    ("run", "where", "reason"),
    [
        (moved(clock=1000.0), "/measured/time", r"has 0\.01 readings a second; .* milliseconds"),
        (moved(clock=200.0, x=3e-4), "/measured/time", "has 0.05 readings a second"),
        (
            moved(omega=0.5 * 30 / np.pi),
            "/measured/x",
            r"14\.3 m, 11\.9 .* perhaps omega is in rpm, unless",
        ),
        (
            moved(omega=0.06, x=6e-4),
            "/measured/x",
            r"goes 0\.012 m while the rim goes 0\.18 m, 15\.0",
        ),
        (
            moved(x=0.5),
            "/measured/x",
            r"goes 10 m while the rim goes 1\.5 m; a free wheel does not",
        ),
        (moved(z=(-0.017, 0.03)), "/measured/z", r"ends 27\.8 mm above touch-down while"),
    ],
)
def test_time_path_and_height_that_do_not_fit_are_noted_once(tmp_path, run, where, reason):
    ((found_at, said, level),) = found(tmp_path / "run.h5", run)
    assert (found_at, level) == (where, Level.NOTE)
    assert re.search(reason, said)


def test_a_run_of_hours_is_noted(tmp_path):
    time = np.linspace(0.0, 7200.0, 7300)
    run = dataclasses.replace(
        read_run(RUNS / "fast.h5"),
        command=RecordedCommand(time, np.full_like(time, 0.002)),
        measured=Measured(time, x=0.00025 * time, z=np.full_like(time, -0.02)),
    )
    ((where, said, level),) = found(tmp_path / "run.h5", run)
    assert (where, level) == ("/measured/time", Level.NOTE)
    assert said.startswith("is 2 h long; perhaps these are milliseconds")


@pytest.mark.parametrize(
    "run",
    [
        moved(),
        moved(x=0.03),  # half of it slips
        moved(x=0.0, omega=0.005),  # it hardly turns
        moved(z=(-0.01, 0.005)),  # on its grousers
    ],
)
def test_a_run_that_fits_together_has_no_note(tmp_path, run):
    assert not found(tmp_path / "run.h5", run)
