"""A run made in the loop, replayed in that loop with effects: how much less the tuner moves."""

import json
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
from typer.testing import CliRunner

import drftjax
from diagnose.commands.evaluate import app
from drftjax.common.errors import InputError
from drftjax.effects.terrain import Loosening
from drftjax.runlog.hdf5.api import read_run
from drftjax.runlog.record import RunLog
from drftjax.setups.setup import CommandSetUp, SetUp
from drftjax.setups.setup_toml import setup_toml
from drftjax.tuning.registry import TunerSetUp
from hils.control.limits import CommandLimits
from hils.control.loop_config import LoopSetUp
from hils.control.stop_request import StopRequest
from hils.procedure.operator_prompts import UnattendedPrompts
from hils.procedure.procedure import Procedure, run
from hils.recording.recorder import Recorder
from hils.replay import replay, replay_tuning
from hils.rig_sim.config import VirtualSetUp
from hils.rig_sim.in_process import QUICK, soft_rig

LOOSENING = {"name": "loosening", "loss": 0.4, "decay": 0.5}
PROFILE = ([0.0, 0.3, 0.8, 4.5, 5.0], [0.0, 0.0, 0.6, 0.6, 0.0])
# With the effect that the rig has, noise and plates alone move the tuner: it goes to and fro by
# its step, where it followed a loss of four tenths of zeta before.
RANGE, MOVED = 0.2, 0.5
# x moves by tenths of a millimetre a tick on top of another start: roundings of some 1e-16 m, which
# the loop carries on over 250 ticks.
ROUNDING = 1e-12
# The same root of the same statics, found twice: rounding.
STATICS = 1e-9
# Plates that bear are 5 to 16 mm deep, and with such a cohesion as if they were 2 mm deeper.
BORNE = (5 / 7, 16 / 18)
# Quick and fine plates sink alike to some tenths of a millimetre [m].
CLOSE = 5e-4


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    """A run in the loop, on a virtual rig whose sand loosens."""
    time, omega = PROFILE
    # Not the numbers that `drft evaluate --tuner` has by default.
    tuner = TunerSetUp("step", {"zeta_step": 0.002, "tolerance": 1.5e-4})
    loop = LoopSetUp(
        setup=SetUp(command=CommandSetUp(time=time, omega=omega)),
        commands=CommandLimits(2.0, 0.3),
        tuner=tuner,
        tick=0.02,
    )
    _, link, clock = soft_rig(VirtualSetUp(effects=[LOOSENING], physics=QUICK), seed=2)
    path = tmp_path_factory.mktemp("retuned") / "hils.h5"
    procedure, prompts = Procedure(loop=loop, free=False), UnattendedPrompts(quiet=True)
    run(procedure, link, clock, Recorder(path), prompts, StopRequest())
    return path


@pytest.fixture(scope="module")
def log(path) -> RunLog:
    return read_run(path)


def test_without_effects_it_is_the_replay(log):
    told = replay_tuning(log, [])
    assert told.zeta.tobytes() == log.online.zeta.tobytes() == replay(log).zeta.tobytes()
    # Where it starts matters to effects alone.
    np.testing.assert_allclose(replay_tuning(log, [], x=0.4).zeta, told.zeta, rtol=0, atol=ROUNDING)


def test_with_its_own_effect_the_tuner_has_less_to_do(log):
    plain, known = replay_tuning(log, []), replay_tuning(log, [LOOSENING])
    assert np.ptp(known.zeta) < RANGE * np.ptp(plain.zeta)
    # A wheel at rest has loosened nothing.
    assert known.zeta[0] == pytest.approx(plain.zeta[0], rel=STATICS)
    assert np.nanmax(np.abs(known.error)) < CLOSE


def test_zeta_at_the_start_is_what_the_sinkage_at_rest_tells(log):
    firmer = replay_tuning(log, [{"name": "cohesion", "depth": 0.002}])
    # A stress that is there from the start bears part of the weight.
    assert BORNE[0] < firmer.zeta[0] / log.online.zeta[0] < BORNE[1]


def test_a_start_that_no_sand_holds_is_refused(log):
    with pytest.raises(InputError, match=r"no zeta lets the wheel rest .* mm deep"):
        replay_tuning(log, [{"name": "vertical_load", "force": -500.0}])


def test_an_evaluation_replays_a_run_in_the_loop_that_it_was_made_in(path, log):
    with jax.enable_x64(False):
        found = drftjax.evaluate(path, [Loosening(loss=0.4, decay=0.5)])
        ((before, after),) = found.tuned()
    assert before.in_its_loop
    moving = np.isin(log.online.time, before.time)
    assert before.zeta.tobytes() == log.online.zeta[moving].tobytes()
    assert after.moved < MOVED * before.moved


def test_a_run_whose_record_of_the_loop_is_lost_is_replayed_by_the_numbers_given(log):
    online = replace(log.online, loop=None)
    bare = replace(log, online=online)
    with jax.enable_x64(False):
        ((before, _),) = drftjax.evaluate(bare, []).tuned(tick=0.02, zeta_step=0.002)
    assert not before.in_its_loop


def test_the_command_says_which_runs_were_replayed_so(path, log, tmp_path):
    model = tmp_path / "model.toml"
    setup = SetUp(command=CommandSetUp(*PROFILE), effects=[LOOSENING])
    model.write_text(setup_toml(setup, [], {}))
    told = tmp_path / "told.json"
    picture = tmp_path / "gap.svg"
    arguments = [str(path), "--model", str(model), "--tuner", "--json", str(told)]
    arguments += ["--plot", str(picture)]
    result = CliRunner().invoke(app, arguments, env={"COLUMNS": "110"})
    assert result.exit_code == 0, result.output
    assert "<svg" in picture.read_text()
    assert "By --tuner, hils replayed in the loop that it was made in." in result.output
    (only,) = json.loads(told.read_text())["tuner"]["runs"]
    assert only["in_its_loop"]
    assert only["after"]["moved"] < MOVED * only["before"]["moved"]
