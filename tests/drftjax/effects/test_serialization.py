"""Effects in set-up files and results, on the command line, and from packages of others."""

import copy
import io
import os
import re
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest
from rich.console import Console

from drftjax.effects.catalogue import catalogue
from drftjax.effects.correction import STAGES, correction_variables
from drftjax.effects.listing import effect_markdown, effect_table
from drftjax.effects.serialization import build_effects, entry_of, typical_effect
from drftjax.effects.terrain import Loosening
from drftjax.recorded.prepared_run import prepare_run
from drftjax.runlog.hdf5.api import read_run, write_result
from drftjax.setups.fitted_model import model_group, read_model
from drftjax.setups.setup import CommandSetUp, SetUp, read_setup
from drftjax.setups.simulated_run import simulated_run
from tests.helpers.synthetic_runs import recorded, setup_of

ROOT = Path(__file__).parents[3]
PAGE = ROOT / "docs" / "theory" / "effects.md"
EXAMPLE = ROOT / "docs" / "guide" / "write-an-effect.md"

HEAD = """
[wheel]
plate_size = 0.01

[integrator]
step = 2e-3

[command]
time = [0, 0.2, 0.5, 1]
omega = [0, 0, 0.5, 0.5]
"""
LOOSENING = '[[effect]]\nname = "loosening"\nloss = 0.2\n'
LATE = '[[effect]]\nname = "measurement_filter"\nlag = 0.05\n'


def written(folder: Path, text: str, name: str = "rig.toml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_a_file_gives_the_simulator_its_effects_in_the_order_given(tmp_path):
    setup = read_setup(written(tmp_path, HEAD + LATE + LOOSENING))
    late, loosening = setup.trial().simulator.effects
    assert isinstance(loosening, Loosening)
    assert (float(loosening.loss), float(loosening.decay)) == (0.2, 2.0)
    assert late.about.name == "measurement_filter"


def test_a_set_up_without_effects_says_none_and_keeps_none(tmp_path):
    setup = SetUp(command=CommandSetUp([0, 1], [0, 1]))
    assert setup.effects == []
    assert setup.trial().simulator.effects == ()
    other = SetUp(command=setup.command)
    other.effects.append({"name": "drawbar"})
    assert setup.effects == []


@pytest.mark.parametrize("name", list(catalogue()))
def test_every_effect_comes_back_from_a_file(tmp_path, name):
    entry = entry_of(typical_effect(catalogue()[name]))
    setup = SetUp(command=CommandSetUp([0, 1], [0, 1]), effects=[entry])
    if name == "carriage_gain":
        setup.command.vx = [0, 0.1]
        setup.rig.carriage = "driven"
    path = written(tmp_path, msgspec.json.encode(setup).decode(), "rig.json")
    (effect,) = read_setup(path).trial().simulator.effects
    assert type(effect) is catalogue()[name]
    assert entry_of(effect) == entry
    assert entry_of(build_effects({"name": name}, 1)) == entry_of(catalogue()[name]())


def test_copies_and_results_carry_effects(tmp_path):
    setup = read_setup(written(tmp_path, HEAD + LOOSENING))
    copied = msgspec.structs.replace(copy.deepcopy(setup), title="another")
    assert copied.effects == setup.effects == [{"name": "loosening", "loss": 0.2}]
    write_result(tmp_path / "fit.h5", "drft-fit", {}, {"a": model_group(setup, {}, {})})
    document = {
        "schema": "drft-fit",
        "schema_version": 1,
        "runs": [{"name": "a", "setup": msgspec.to_builtins(setup)}],
    }
    written(tmp_path, msgspec.json.encode(document).decode(), "fit.json")
    for name in ("fit.h5", "fit.json"):
        assert read_model(tmp_path / name).effects == setup.effects


def test_simulate_runs_the_effects(drft, tmp_path):
    z = {}
    for name, text in (("bare", HEAD), ("loose", HEAD + LOOSENING)):
        answer = drft("simulate", written(tmp_path, text), "-o", tmp_path / f"{name}.h5")
        assert answer.code == 0, answer
        z[name] = read_run(tmp_path / f"{name}.h5").measured.z
    # So short a way loosens little: a quarter of a millimetre.
    assert z["loose"][-1] < z["bare"][-1] - 1e-4


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[[effect]]\nname = 'losening'\n", "there is no effect 'losening'; did you mean 'loosen"),
        ("[[effect]]\nloss = 0.1\n", "[[effect]] 1 needs a name; `drft effects` lists them"),
        (LOOSENING + "[[effect]]\nname = 3\n", "[[effect]] 2 needs a name"),
        (LOOSENING + "los = 1\n", "'loosening' has no number 'los'; it has loss [-], decay [rad]"),
        (LOOSENING + "decay = nan\n", "loosening.decay is nan, must be finite"),
        (LOOSENING + "decay = -inf\n", "loosening.decay is -inf, must be finite"),
        (LOOSENING + "decay = 0\n", "loosening.decay is 0, must be above 0"),
        (LOOSENING + "decay = 'much'\n", "loosening.decay is 'much', must be a number"),
        (
            LOOSENING + "decay = true\n",
            "expected a number or text or a list, got true",
        ),
        (LOOSENING.replace("0.2", "10"), "loosening.loss is 10, must be 1 or less"),
        (
            "[[effect]]\nname = 'measurement_delay'\ndelay = 5\n",
            "measurement_delay.delay is 5 s, must be 1 s or less",
        ),
        ("[[effect]]\nname = 'speed_lag'\nlag = -0.1\n", "speed_lag.lag is -0.1, must be 0 or"),
        ("[[effects]]\nname = 'loosening'\n", "unknown entry 'effects'; did you mean 'effect'"),
        ("effect = 3\n", "effect: expected a list, got a whole number"),
        (
            "[[effect]]\nname = 'grouser_height'\nexcess = -0.1\n",
            "the grousers' true height is -0.082, must lie between",
        ),
        (
            "[[effect]]\nname = 'wheel_radius'\nexcess = -3\n",
            "the wheel's true radius is -2.85, must lie between 0.005 and 2 m",
        ),
        (
            "[[effect]]\nname = 'grouser_height'\nexcess = 0.2\n",
            "the true grouser height is 0.218, must lie between 0 and 0.15",
        ),
        (
            "[[effect]]\nname = 'wheel_radius'\nexcess = -0.135\n",
            "the true grouser height is 0.018, must lie between 0 and 0.015",
        ),
        (
            "[[effect]]\nname = 'wheel_radius'\nexcess = -0.134\n"
            "[[effect]]\nname = 'grouser_height'\nexcess = -0.018\n",
            "the true grouser thickness is 0.009, must lie between 0 and 0.0083692",
        ),
    ],
)
def test_what_an_effect_may_not_be_is_refused_in_one_sentence(drft, tmp_path, text, said):
    text = text + HEAD if text.startswith("effect") else HEAD + text
    path = written(tmp_path, text)
    refusal = drft("simulate", path).refusal
    assert refusal.startswith(f"{path}: ")
    assert said in refusal


@pytest.mark.parametrize(
    ("part", "effect", "said"),
    [
        ("[wheel]\nshape = 'plain'\n", "grouser_height", "needs a wheel with grousers"),
        ("[terrain]\nlaw = 'quasi-static'\n", "momentum_flux", "needs the dynamic stress law"),
    ],
)
def test_an_effect_that_the_set_up_cannot_have_is_refused(drft, tmp_path, part, effect, said):
    text = f"{part}[command]\ntime = [0, 1]\nomega = [0, 1]\n[[effect]]\nname = '{effect}'\n"
    assert f"{effect} {said}" in drft("simulate", written(tmp_path, text)).refusal


def test_a_larger_outline_is_larger_all_over(tmp_path):
    square = "[[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]"
    text = (
        f"[wheel]\nshape = 'outline'\nradius = 0.1\npoints = {square}\n"
        "[command]\ntime = [0, 1]\nomega = [0, 1]\n"
        "[[effect]]\nname = 'wheel_radius'\nexcess = 0.01\n"
    )
    simulator = read_setup(written(tmp_path, text)).trial().simulator
    area = [float(s.wheel.cut().outline.area.sum()) for s in (simulator, simulator.prepared())]
    assert area[1] == pytest.approx(1.1 * area[0])


def test_a_fit_compares_runs_with_the_effects_of_its_model():
    model = setup_of()
    model.effects = [{"name": "vertical_load", "force": 30.0}]
    asked = prepare_run("a", recorded(setup_of()), model=model)
    (load,) = asked.trial.simulator.effects
    assert entry_of(load) == asked.setup.effects[0] == model.effects[0]


# Corrections ------------------------------------------------------------------------------------

CORRECTION = """[[effect]]
name = "correction"
stage = "zeta"
variable = "sinkage"
knots = [0.0, 0.02, 0.04]
values = [0.0, 0.0, 0.3]
"""


def test_a_file_may_hold_a_correction_that_comes_back_and_acts(drft, tmp_path):
    path = written(tmp_path, HEAD + CORRECTION)
    setup = read_setup(path)
    (effect,) = setup.trial().simulator.effects
    assert entry_of(effect) == setup.effects[0]
    assert drft("simulate", path, "-o", tmp_path / "firm.h5").code == 0
    again = drft("simulate", "--from", path, "-o", tmp_path / "again.h5")
    assert again.code == 0, again
    assert drft("simulate", written(tmp_path, HEAD), "-o", tmp_path / "bare.h5").code == 0
    z = {n: read_run(tmp_path / f"{n}.h5").measured.z for n in ("firm", "again", "bare")}
    assert (z["again"] == z["firm"]).all()
    # Three quarters of a millimetre.
    assert z["firm"][-1] > z["bare"][-1] + 5e-4


def test_corrections_of_nothing_in_every_stage_are_the_reference_model_to_the_bit():
    plain, corrected = setup_of(), setup_of()
    # Every stage knows one of these.
    corrected.effects = [
        {
            "name": "correction",
            "stage": stage,
            "variable": "sinkage" if "sinkage" in correction_variables(stage) else "turning",
            "knots": [0.0, 0.02, 0.5],
            "values": [0.0, 0.0, 0.0],
        }
        for stage in STAGES
    ]
    for setup in (plain, corrected):
        setup.integrator.step = 2e-3
    bare, nothing = (simulated_run(setup, 0.05).measured for setup in (plain, corrected))
    for channel in ("x", "z", "fx", "fz", "torque"):
        assert (getattr(nothing, channel) == getattr(bare, channel)).all()


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ('stage = "zeta"', 'stage = "weather"', "stage is 'weather', must be one of zeta, force_x"),
        ('stage = "zeta"', 'stage = "speed"', "a correction of speed may follow angular velocity"),
        ('stage = "zeta"', "stage = 3", "correction.stage is 3.0, must be a word"),
        ('stage = "zeta"\n', "", "a correction needs stage too; its entries are stage, vari"),
        ('stage = "zeta"', 'stage = "zeta"\nknot = 3', "a correction has no entry 'knot'; it has"),
        ("0.0, 0.02, 0.04", "0.0, 0.04, 0.02", "the knots of a correction must ascend"),
        ("0.0, 0.02, 0.04", "0.02", "a correction has 2 to 100 knots; 1 were given"),
        ("0.0, 0.3", "0.3", "a value for each of its 3 knots; 2 were given"),
        ("0.0, 0.3", "nan, 0.3", "correction.values is [0.0, nan, 0.3], must be finite"),
        ("[0.0, 0.0, 0.3]", "0.3", "correction.values is 0.3, must be a list of numbers"),
    ],
)
def test_what_a_correction_may_not_be_is_refused_in_one_sentence(
    drft, tmp_path, before, after, said
):
    assert before in CORRECTION
    path = written(tmp_path, HEAD + CORRECTION.replace(before, after))
    refusal = drft("simulate", path).refusal
    assert refusal.startswith(f"{path}: ")
    assert said in refusal


def test_the_correction_is_told_with_lines_that_a_set_up_understands(drft, tmp_path):
    assert "`drft effects correction` explains it" in " ".join(drft("effects").out.split())
    answer = drft("effects", "correction")
    lines = answer.out[answer.out.index("[[effect]]") :]
    (entry,) = read_setup(written(tmp_path, HEAD + lines)).effects
    assert entry["variable"] == "sinkage"
    assert "nothing to draw" in drft("effects", "correction", "--plot", tmp_path / "a.png").refusal


# On the command line ----------------------------------------------------------------------------


def test_the_list_names_every_effect_of_every_stage(drft):
    answer = drft("effects")
    assert answer.code == 0
    for name, effect in catalogue().items():
        assert f"  {name}" in answer.out
        assert effect.about.stage in answer.out


def test_one_effect_is_told_in_full_with_lines_that_a_set_up_understands(drft, tmp_path):
    answer = drft("effects", "terrain_variation")
    assert "zeta depends on the place" in answer.out
    assert "Another form" not in answer.out
    assert "Another form of terrain_variation" in drft("effects", "terrain_wave").out
    assert "width [m]  its standard deviation along x; 0.15 unless said" in answer.out
    lines = answer.out[answer.out.index("[[effect]]") :]
    (entry,) = read_setup(written(tmp_path, HEAD + lines)).effects
    assert entry == {"name": "terrain_variation", "excess": 0.1, "centre": 0.5, "width": 0.15}


def test_an_unknown_effect_is_refused_with_the_nearest(drft):
    assert "did you mean 'eccentricity' or" in drft("effects", "excentricity").refusal
    assert "there is no effect 'q7'; `drft effects` lists" in drft("effects", "q7").refusal


def test_a_plot_shows_what_an_effect_does(drft, tmp_path):
    figure = tmp_path / "new" / "drawbar.png"
    answer = drft("effects", "drawbar", "--plot", figure)
    assert answer.out.endswith(f"figure written to {figure}\n")
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert "leave out 'loosening' or" in drft("effects", "loosening", "--markdown").refusal
    assert "must end in .png" in drft("effects", "--plot", tmp_path / "sheet.jpg").refusal


# Of other packages ------------------------------------------------------------------------------


def test_the_page_holds_the_table_that_the_command_prints(drft):
    assert drft("effects", "--markdown").out == effect_markdown() + "\n"
    assert effect_markdown() in PAGE.read_text()


def code_block(language: str) -> str:
    found = re.search(rf"```{language}\n(.*?)```", EXAMPLE.read_text(), re.S)
    assert found
    return found[1]


@pytest.fixture
def package(tmp_path) -> dict[str, str]:
    """An environment where the page's example is installed."""
    home = tmp_path / "site"
    known = home / "settling-1.0.dist-info"
    known.mkdir(parents=True)
    (home / "settling.py").write_text(code_block("python"))
    (known / "METADATA").write_text("Metadata-Version: 2.1\nName: settling\nVersion: 1.0\n")
    points = code_block("toml").replace('[project.entry-points."drft.effects"]', "[drft.effects]")
    (known / "entry_points.txt").write_text(points.replace('"', ""))
    return os.environ | {"PYTHONPATH": str(home), "COLUMNS": "200"}


def ask(environment: dict[str, str], *arguments: object) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-m", "drftjax.commands.main", *map(str, arguments)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_the_pages_example_is_an_effect_like_any_other(package, drft, tmp_path):
    assert "zeta rises with time after pouring" in ask(package, "effects").stdout
    text = HEAD + "[[effect]]\nname = 'settling'\ngain = 0.5\ntime = 0.1\n"
    answer = ask(package, "simulate", written(tmp_path, text), "-o", tmp_path / "run.h5")
    assert answer.returncode == 0, answer.stderr
    bare = drft("simulate", written(tmp_path, HEAD), "-o", tmp_path / "bare.h5")
    assert bare.code == 0, bare
    runs = [read_run(tmp_path / f"{name}.h5").measured.z[-1] for name in ("run", "bare")]
    # Half as much zeta again: five millimetres.
    assert runs[0] > runs[1] + 4e-3


HALF_MADE = """

from drftjax.effects.base import AbstractZetaFactor


class Nameless(AbstractZetaFactor):
    pass


class Idle(AbstractZetaFactor):
    about = Settling.about
"""


@pytest.mark.parametrize(
    ("point", "said"),
    [
        ("settling:Absent", "the effect 'settling' of settling:Absent fails: "),
        ("settling:Number", "the effect 'settling' of settling:Number is no effect class"),
        (
            "drftjax.effects.rig:Drawbar",
            "of drftjax.effects.rig:Drawbar takes the name 'drawbar', which is there already",
        ),
        ("settling:Nameless", "the effect 'settling' of settling:Nameless has no `about`"),
        ("settling:Idle", "the effect 'settling' of settling:Idle lacks "),
    ],
)
def test_a_package_that_adds_no_effect_is_named(package, drft, tmp_path, monkeypatch, point, said):
    with (tmp_path / "site" / "settling.py").open("a") as module:
        module.write(HALF_MADE)
    points = next((tmp_path / "site").glob("*.dist-info")) / "entry_points.txt"
    points.write_text(f"[drft.effects]\nsettling = {point}\n")
    monkeypatch.syspath_prepend(package["PYTHONPATH"])
    catalogue.cache_clear()
    try:
        assert said in drft("effects").refusal
    finally:
        catalogue.cache_clear()
        sys.modules.pop("settling", None)


def test_names_stay_whole_on_a_narrow_terminal():
    text = io.StringIO()
    Console(file=text, width=80).print(effect_table())
    for name in catalogue():
        assert re.search(rf"^  {name} ", text.getvalue(), re.MULTILINE), name
