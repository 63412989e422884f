"""`drft crosscheck`: comparisons on series with known answers, and the command end to end."""

import dataclasses
import io
import json
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from drftjax.common.errors import RunError
from drftjax.recorded.prepared_run import prepare_run
from drftjax.runlog.hdf5.api import write_run
from drftjax.runlog.record import Online
from drftjax.setups.setup import IntegratorSetUp
from identify.commands.crosscheck import result_files
from identify.crosscheck.comparison import compare_series, lag, ripple, sustained_part
from identify.crosscheck.crosscheck import crosscheck
from identify.crosscheck.figure import plot_crosscheck
from identify.crosscheck.replays import TunerSetting
from identify.crosscheck.report import tables
from tests.helpers.synthetic_runs import DEEPER
from tests.studies.crosscheck import known_run, known_setup

PLATE_SIZE, STEP, TICK = 8e-3, 2e-3, 0.01
TIME, OMEGA = (0.0, 0.5, 1.5, 4.0, 5.0, 5.2), (0.0, 0.0, 45.0, 45.0, 0.0, 0.0)
# Lags are whole ticks.
LAG = TICK / 2
# A straight line through ten seconds of a wave takes a twentieth of it, and a spectrum of ten
# seconds tells 0.1 Hz apart.
SIZE, FREQUENCY = 0.1, 0.1
# A step of the tuner is its step, but for the rounding of zeta.
ROUNDING = 1e-12
# 20 um of noise, and as much again of what knots 1.5 s apart leave [m].
LEFT = 4e-5
GRID = np.linspace(0.0, 5.2, 105)
SETTING = TunerSetting(TICK, 1e-3, 1e-4)


def fast(time):
    """Changes at 0.24 a second, more than twice what the tuner can."""
    return 0.74 + 0.06 * np.sin(2 * np.pi * (time - 1.5) / 1.6) * (time > 1.5)


def faint(time):
    """Moves the sinkage by some hundredths of a millimetre, less than the tolerance."""
    return 0.7823 + 0.001 * np.sin(2 * np.pi * time / 3.0)


def recorded(name, path, seed=1):
    setup = known_setup(name, path, GRID, TIME, OMEGA, PLATE_SIZE)
    setup.integrator = IntegratorSetUp(step=STEP)
    setup.start.sinkage *= DEEPER
    return known_run(setup, np.random.default_rng(seed))


def ready(name, path):
    each = prepare_run(name, recorded(name, path), step=STEP)
    each.setup.wheel.plate_size = PLATE_SIZE
    return dataclasses.replace(each, trial=each.setup.trial(2 * STEP))


@pytest.fixture(scope="module")
def checked():
    truths = {"fast": fast, "faint": faint}
    runs = [ready(name, path) for name, path in truths.items()]
    return crosscheck(runs, SETTING, truths=truths, knot_spacing=0.4)


# Comparisons --------------------------------------------------------------------------------------


def test_lag_is_the_delay():
    time = np.arange(0, 8, TICK)
    early, late = np.sin(time), 0.7 * np.sin(time - 0.35) + 0.1
    found, correlation = lag(late, early, TICK)
    assert found == pytest.approx(0.35, abs=LAG)
    # The same wave: all but rounding.
    assert correlation == pytest.approx(1, abs=ROUNDING)
    assert lag(early, late, TICK)[0] == pytest.approx(-0.35, abs=LAG)


@pytest.mark.parametrize("early", [np.ones(500), np.linspace(0, 1, 500)])
def test_lag_behind_nothing_or_a_straight_line_is_not_told(early):
    assert lag(np.linspace(0, 1, 500), early, TICK) == (None, None)


def test_lag_behind_a_zeta_that_stays_within_a_step_of_the_tuner_is_not_told():
    time = np.arange(0, 8, TICK)
    late, early = 0.75 + 0.01 * np.sin(time - 0.35), np.sin(time)
    assert lag(late, 0.75 + 1e-5 * early, TICK) == (None, None)
    assert lag(late, 0.75 + 1e-3 * early, TICK)[0] == pytest.approx(0.35, abs=LAG)


def test_ripple_is_its_size_and_frequency():
    time = np.arange(0, 10, TICK)
    size, frequency = ripple(0.7 + 0.01 * time + 0.002 * np.sin(2 * np.pi * 3 * time), TICK)
    assert size == pytest.approx(0.002 / np.sqrt(2), rel=SIZE)
    assert frequency == pytest.approx(3.0, abs=FREQUENCY)
    assert ripple(np.full(500, 0.7), TICK) == (0.0, None)


def test_only_long_rows_of_ticks_count_as_sustained():
    steps = np.r_[np.ones(20), np.tile([1, -1], 10), np.zeros(10), np.ones(5), np.zeros(5)]
    # 20 ticks, and the first of the alternation that continues them
    assert sustained_part(steps, steps != 0) == pytest.approx(21 / 60)
    assert sustained_part(steps, steps == 0) == pytest.approx(10 / 60)


def test_shares_add_up():
    time = np.arange(0, 5, TICK)
    direction = np.sign(np.sin(7 * time)).astype(int)
    zeta = 0.7 + 1e-3 * np.cumsum(direction)
    moving = time > 1
    each = compare_series(time, zeta, direction, moving, lambda t: 0.7 + 0 * t)
    assert each.up + each.down + each.idle == pytest.approx(1.0)
    assert each.difference == pytest.approx(np.sqrt(np.mean((zeta[moving] - 0.7) ** 2)))


# Known paths --------------------------------------------------------------------------------------


def test_fast_path_outruns_the_tuner_but_not_the_fit(checked):
    run = checked.runs[0]
    assert run.closer == "offline"
    # The fit is off by 0.006, and the tuner by nine times that.
    assert run.offline_from_truth < 0.2 * run.tuner.from_truth
    # At its limit most of the time, and so late by more than half a second, sixty ticks.
    assert run.tuner.slew_limit > 0.5
    assert run.tuner.lag > 0.5
    assert np.abs(np.diff(run.zeta)).max() <= SETTING.zeta_step * (1 + ROUNDING)


def test_faint_path_stays_in_the_dead_band(checked):
    run = checked.runs[1]
    # Most of the time.
    assert run.tuner.dead_band > 0.5
    assert run.offline_from_truth < run.tuner.from_truth


def test_sweep_varies_one_factor_at_a_time(checked):
    run = checked.runs[0]
    first = run.sweep[0]
    assert first.setting == SETTING
    assert first.comparison == run.tuner
    for row in run.sweep[1:]:
        changed = [
            getattr(row.setting, f.name) != getattr(SETTING, f.name)
            for f in dataclasses.fields(SETTING)
        ]
        assert sum(changed) == 1
    by_step = {r.setting.zeta_step: r.comparison for r in run.sweep[5:9]}
    assert by_step[2.5e-4].slew_limit > by_step[4e-3].slew_limit
    assert by_step[2.5e-4].ripple < by_step[4e-3].ripple


def test_document_is_json(checked):
    document = json.loads(json.dumps(checked.document(), allow_nan=False))
    assert document["schema"] == "drft-crosscheck"
    assert document["schema_version"] == 1
    assert [run["name"] for run in document["runs"]] == ["fast", "faint"]


def test_tables_are_whole_in_a_pipe_of_80_characters(checked):
    named = [dataclasses.replace(run, name=f"{run.name}_on_[loose]_sand") for run in checked.runs]
    said = io.StringIO()
    for table in tables(dataclasses.replace(checked, runs=named)):
        Console(file=said, width=80).print(table)
    assert "…" not in said.getvalue()
    assert "[loose]" in said.getvalue()
    assert "difference" in said.getvalue()
    assert "replayed" in said.getvalue()
    assert max(map(len, said.getvalue().splitlines())) <= 80


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_path_of_which_no_knot_is_told_is_drawn(checked):
    run = checked.runs[0]
    offline = dataclasses.replace(run.offline, identified=np.zeros_like(run.offline.identified))
    untold = dataclasses.replace(
        checked, runs=[dataclasses.replace(run, offline=offline), checked.runs[1]]
    )
    left, *_ = plot_crosscheck(untold).axes
    low, high = left.get_ylim()
    assert low < run.zeta.min() < run.zeta.max() < high


def test_a_run_that_moves_for_too_few_ticks_is_left_out():
    brief, name = (0.0, 0.5, 0.55, 0.6, 0.68), "brief"
    setup = known_setup(name, faint, GRID, brief, (0.0, 0.0, 45.0, 45.0, 0.0), PLATE_SIZE)
    setup.integrator = IntegratorSetUp(step=STEP)
    each = prepare_run(name, known_run(setup, np.random.default_rng(1)), step=STEP)
    each.setup.wheel.plate_size = PLATE_SIZE
    short = dataclasses.replace(each, trial=each.setup.trial(2 * STEP))
    runs = [ready("faint", faint), short]
    found = crosscheck(runs, SETTING, knot_spacing=0.4, sweep=False)
    assert [run.name for run in found.runs] == ["faint"]
    assert "too few to compare" in found.failures[name]
    with pytest.raises(RunError, match=f"{name}: the wheel moves over"):
        crosscheck([short], SETTING, knot_spacing=0.4, sweep=False)


# The command --------------------------------------------------------------------------------------


def with_online(run):
    """The run with a log of a tuner that holds 0.75."""
    time = np.arange(0, TIME[-1], TICK)
    nought = np.zeros_like(time)
    columns = dict.fromkeys(
        ("x_sim", "z_sim", "vx_sim", "fx_sim", "tuned", "late", "age", "flags"), nought
    ) | dict.fromkeys(("seq_sent", "seq_received", "rig_time"), nought)
    online = Online(
        time=time, zeta=nought + 0.75, tick=TICK, zeta_step=1e-3, tolerance=1e-4, **columns
    )
    return dataclasses.replace(run, online=online)


def test_command_end_to_end(drft, tmp_path):
    path = tmp_path / "short.h5"
    write_run(path, with_online(recorded("short", faint)))
    stem = tmp_path / "new" / "check"
    picture = tmp_path / "pictures" / "zeta.svg"
    given = ("--knots", "1.5", "--no-sweep", "--plot", picture)
    answer = drft("crosscheck", path, "-o", stem, *given)
    assert answer.code == 0, answer
    assert "<svg" in picture.read_text()
    assert "online tuner beside offline zeta(t)" in answer.out
    assert "logged" in answer.out
    assert stem.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    document = json.loads(stem.with_suffix(".json").read_text())
    assert document["provenance"]["command"][:2] == ["crosscheck", str(path)]
    (run,) = document["runs"]
    assert run["online"]["idle"] == 1.0
    assert run["rmse"]["offline"]["z"] < LEFT


@pytest.mark.parametrize(
    ("given", "name"),
    [("fit", "fit"), ("fit.v2", "fit.v2"), ("fit_0.5", "fit_0.5"), ("fit.png", "fit")],
)
def test_stem_keeps_its_dots(given, name):
    expected = [Path(f"out/{name}.json"), Path(f"out/{name}.png")]
    assert result_files(Path("out") / given) == expected


def test_wrong_input_is_one_sentence(drft, tmp_path):
    missing = tmp_path / "none.h5"
    answer = drft("crosscheck", missing)
    assert answer.refusal.startswith(f"{missing}: there is no such file")
    assert "left out" not in answer.out
    assert drft("crosscheck", missing, "--tick", "0").refusal.startswith("tick is 0, must lie")
    assert "is a folder; name the result too" in drft("crosscheck", missing, "-o", ".").refusal
    assert "zeta-step is -1" in drft("crosscheck", missing, "--zeta-step", "-1").refusal
    assert "tolerance is nan" in drft("crosscheck", missing, "--tolerance", "nan").refusal
