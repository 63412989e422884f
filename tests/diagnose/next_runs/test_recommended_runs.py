"""Nine runs that tell effects apart: what they hold, and what limits make of them."""

import copy
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from diagnose.blind.plant.run_plan import RECOMMENDED_RUNS as BLIND_RUNS
from diagnose.commands.protocol import app
from diagnose.next_runs.recommended_runs import RECOMMENDED_RUNS, recommended_runs
from drftjax.commands.options import USUAL_OMEGA_MAX
from drftjax.common.errors import InputError
from drftjax.common.packages import data_file
from drftjax.runlog.hdf5.api import write_run
from drftjax.runlog.record import Measured, RecordedCommand, RecordedSetup, RunLog
from drftjax.setups.setup import SetUp, read_setup
from hils.control.limits import CommandLimits
from hils.control.loop_config import LoopSetUp, profile

RIG = read_setup(data_file("paper.toml"))


def test_they_go_backward_stop_and_repeat_one():
    runs = {run.name: (run, setup.command.build()) for run, setup in recommended_runs(RIG)}
    assert len(runs) == len(RECOMMENDED_RUNS) == 9
    assert [name for name, (_, each) in runs.items() if each.omega.min() < 0] == ["backward"]
    assert runs["paper"][0].speed == runs["again"][0].speed
    stop = runs["stop_and_go"][1]
    assert np.count_nonzero(np.diff(np.abs(stop.omega) > 0) > 0) == 6  # three starts, three stops


def test_loads_are_shares_of_the_rigs_and_starts_are_at_rest():
    rig = copy.deepcopy(RIG)
    rig.rig.mass_z = 10.0
    sinkages = {}
    for run, setup in recommended_runs(rig):
        assert setup.rig.mass_z == pytest.approx(10.0 * run.load)
        sinkages[run.load] = setup.start.sinkage
    ordered = [sinkages[load] for load in sorted(sinkages)]
    assert ordered == sorted(ordered)
    assert ordered[0] < ordered[-1]


@pytest.mark.parametrize("limit", [114.59, 57.29, 29.97, 2.86])
def test_no_rounding_passes_a_limit(limit):
    for _, setup in recommended_runs(RIG, max_speed=limit, max_travel=0.3):
        command = setup.command.build()
        assert np.degrees(np.abs(command.omega).max()) <= limit
        way = RIG.wheel.radius * np.trapezoid(np.abs(command.omega), command.time)
        assert way <= 0.3


def test_limits_are_kept():
    for _, setup in recommended_runs(RIG, max_speed=50.0, max_travel=0.4):
        command = setup.command.build()
        assert np.degrees(np.abs(command.omega).max()) <= 50.0
        way = 0.150 * np.trapezoid(np.abs(command.omega), command.time)
        assert way <= 0.4
        assert np.all(np.diff(command.time) > 0)


def test_ramps_stay_as_they_are_where_only_the_way_is_limited():
    for (run, setup), limit in zip(
        recommended_runs(RIG, max_travel=1.4), RECOMMENDED_RUNS, strict=True
    ):
        assert np.allclose(setup.command.omega, limit.speed), run.name


def test_a_driven_carriage_is_refused():
    rig = copy.deepcopy(RIG)
    rig.rig.carriage = "driven"
    with pytest.raises(InputError, match="driven"):
        list(recommended_runs(rig))


def test_sand_that_does_not_bear_the_wheel_is_refused():
    soft = copy.deepcopy(RIG)
    soft.terrain.zeta = 0.02
    with pytest.raises(InputError, match=r"a zeta of 0\.02 carries .* its load is 184.8 N, must"):
        list(recommended_runs(soft))


def test_the_blind_sets_are_of_the_same_runs():
    for run, blind in zip(RECOMMENDED_RUNS, BLIND_RUNS, strict=True):
        assert blind.time == run.time
        assert blind.speed == run.speed


def test_the_command_writes_nine_set_ups(tmp_path):
    folder = tmp_path / "runs"
    arguments = [str(data_file("paper.toml")), "-o", str(folder)]
    result = CliRunner().invoke(app, arguments, env={"COLUMNS": "70"})
    assert result.exit_code == 0, result.output
    written = sorted(folder.iterdir())
    assert all(f" {each.name} " in result.output for each in written)
    assert [each.name for each in written] == [
        f"{n}_{t.name}.toml" for n, t in enumerate(RECOMMENDED_RUNS, 1)
    ]
    for path, (_, setup) in zip(written, recommended_runs(RIG), strict=True):
        assert read_setup(path) == setup


def test_runs_that_a_short_way_slows_down_say_that_they_tell_little(tmp_path):
    folder = tmp_path / "runs"
    paper = str(data_file("paper.toml"))
    result = CliRunner().invoke(app, [paper, "--max-travel", "0.02", "-o", str(folder)])
    assert result.exit_code == 0, result.output
    fast = (folder / "8_fast_light.toml").read_text()
    assert fast.startswith("# Tells little, slowed down from 200 deg/s: momentum of the sand")
    folder = tmp_path / "long"
    assert CliRunner().invoke(app, [paper, "-o", str(folder)]).exit_code == 0
    assert not [each.name for each in folder.iterdir() if "Tells little" in each.read_text()]


def test_a_folder_that_is_not_empty_is_refused(tmp_path):
    (tmp_path / "kept.h5").write_bytes(b"")
    result = CliRunner().invoke(app, [str(data_file("paper.toml")), "-o", str(tmp_path)])
    assert isinstance(result.exception, InputError)
    assert "not an empty folder" in str(result.exception)


def accepted(setup: SetUp, omega_max: float) -> bool:
    """Whether `drft hils run --omega-max` takes the set-up for its profile."""
    try:
        profile(LoopSetUp(setup=setup, commands=CommandLimits(omega_max, 0.3)), 1)
    except InputError:
        return False
    return True


def written_by(drft, folder: Path, *arguments: object) -> tuple[str, list[SetUp]]:
    answer = drft("protocol", *arguments, "-o", folder)
    assert answer.code == 0, answer
    return answer.out, [read_setup(each) for each in sorted(folder.iterdir())]


def test_fast_runs_are_told_with_the_limit_and_the_way_out_that_they_need(drft, tmp_path):
    paper = data_file("paper.toml")
    said, setups = written_by(drft, tmp_path / "nine", paper)
    refused = [not accepted(each, USUAL_OMEGA_MAX) for each in setups]
    assert refused == [False] * 7 + [True] * 2
    assert all(unit in said for unit in ("load [kg]", "speed [deg/s]", "lasts [s]"))
    assert "8_fast_light.toml and 9_fast_heavy.toml need drft hils run --omega-max 3.5" in said
    needed = re.search(r"--omega-max (\S+),", said)
    slower = re.search(r"--max-speed (\S+) ", said)
    assert needed
    assert slower
    assert all(accepted(each, float(needed[1])) for each in setups)

    said, setups = written_by(drft, tmp_path / "slower", paper, "--max-speed", slower[1])
    assert all(accepted(each, USUAL_OMEGA_MAX) for each in setups)
    assert "--omega-max" not in said


def driven_run(path: Path, mass_x: float | None = None) -> Path:
    """A run log as `drft hils run` leaves it: the carriage at the simulated speed."""
    time = np.linspace(0.0, 1.0, 11)
    known = RecordedSetup(
        wheel_radius=0.15, wheel_width=0.12, mass_x=mass_x, mass_z=18.0, sinkage_static=0.0176
    )
    write_run(
        path,
        RunLog(
            setup=known,
            command=RecordedCommand(time, 0.1 * time, 0.01 * time),
            measured=Measured(time, x=0.005 * time**2, z=np.full(11, -0.0176)),
            source="measured",
            title="in the loop",
        ),
    )
    return path


def test_a_rig_whose_carriage_was_driven_by_the_loop_is_let_go(drft, tmp_path):
    run = driven_run(tmp_path / "run.h5", mass_x=13.0)
    said, setups = written_by(drft, tmp_path / "nine", "--like", run)
    assert f"note: the carriage of {run} was driven" in said
    assert {each.rig.carriage for each in setups} == {"free"}
    assert {each.rig.mass_x for each in setups} == {13.0}


def test_driven_carriages_that_cannot_be_let_go_are_refused_by_file(drft, tmp_path):
    run = driven_run(tmp_path / "run.h5")
    said = drft("protocol", "--like", run, "-o", tmp_path / "nine").refusal
    assert said.startswith(f"{run}: ")
    assert "lacks mass_x" in said
    assert drft("protocol", "-o", tmp_path).refusal == "name one set-up file, or --like RUN"
    setup = tmp_path / "driven.toml"
    setup.write_text(
        '[rig]\ncarriage = "driven"\n[command]\ntime = [0, 1]\nomega = [0, 0]\nvx = [0, 0]\n'
    )
    said = drft("protocol", setup, "-o", tmp_path / "nine").refusal
    assert said.startswith(f"{setup}: ")
    assert "leave out carriage, and vx" in said
    assert not (tmp_path / "nine").exists()
