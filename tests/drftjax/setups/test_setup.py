"""Set-up files: what they may say, and one helpful sentence for what they may not."""

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.physics.integrator import ImplicitEuler
from drftjax.physics.outline_wheel import OutlineWheel
from drftjax.physics.rig import DrivenCarriage, FreeCarriage
from drftjax.physics.stress import Dynamic, QuasiStatic, StressCoefficients
from drftjax.physics.terrain import KnotZeta
from drftjax.physics.wheel import GrouserWheel, PlainWheel
from drftjax.runlog.record import Measured, RecordedCommand, RecordedSetup, RunLog
from drftjax.setups.from_run import setup_from_run
from drftjax.setups.setup import CommandSetUp, SetUp, WheelSetUp, read_setup

PAPER = Path(__file__).parents[3] / "data" / "paper.toml"

COMMAND = "[command]\ntime = [0, 1]\nomega = [0, 1]\n"
SQUARE = [(-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1)]
OUTLINE = "[wheel]\nshape = 'outline'\noutline = 'corners.csv'\nradius = 0.1\n" + COMMAND


def written(folder: Path, text: str | bytes, name: str = "rig.toml") -> Path:
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def corners(points) -> str:
    return "x,z\n" + "".join(f"{x},{z}\n" for x, z in [*points, points[0]])


def test_paper_set_up_spells_out_the_defaults():
    paper = read_setup(PAPER)
    bare = SetUp(command=paper.command, title=paper.title)
    assert msgspec.to_builtins(paper) == msgspec.to_builtins(bare)


@pytest.mark.parametrize(("shape", "length"), [("grouser", 0.004), ("plain", 0.001)])
def test_bare_rims_and_small_wheels_have_shorter_plates_unless_the_set_up_says_so(shape, length):
    assert WheelSetUp(shape=shape).plate_size == length
    assert WheelSetUp(shape=shape, radius=0.3).plate_size == length
    assert WheelSetUp(shape=shape, radius=0.075).plate_size == length / 2
    assert WheelSetUp(shape=shape, radius=0.075, plate_size=0.002).plate_size == 0.002


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[wheel]\nradus = 0.1\n" + COMMAND, "unknown entry 'radus' in [wheel]; did you mean 'rad"),
        ("[weel]\nradius = 0.1\n" + COMMAND, "unknown entry 'weel'; did you mean 'wheel'"),
        (
            "[terrain]\nzeta = {tme = [0]}\n" + COMMAND,
            "'tme' in [terrain.zeta]; did you mean 'time",
        ),
        ("[wheel]\nradius = '0.1'\n" + COMMAND, "wheel.radius: expected a number, got text"),
        (
            "[wheel]\ngrouser_count = 2.5\n" + COMMAND,
            "grouser_count: expected a whole number",
        ),
        ("[command]\ntime = [0, 1]\nomega = [0, true]\n", "command.omega[1]: expected a number"),
        ("command = 3\n", "command: expected a table of entries, got a whole number"),
        ("[wheel]\nradius = 0.1\n", "the entry 'command' is missing"),
        ("[command]\ntime = [0, 1]\n", "the entry 'omega' is missing in [command]"),
        ("", "the entry 'command' is missing"),
        ("[wheel\n", "is not TOML: line 1, '[wheel', cannot be read from column 7 on"),
        ("a = " + "[" * 100_000, "its entries lie too deep in one another"),
        (b"\xff\xfe[wheel]", "is not text; must be TOML"),
        (b"\x89HDF\r\n\x1a\n\xff", "is an HDF5 file, must be TOML; commands that take a run log"),
        (
            "[wheel]\nshape = 'round'\n" + COMMAND,
            "wheel.shape is 'round', must be one of 'gro",
        ),
        (
            "[terrain]\nlaw = 'static'\n" + COMMAND,
            "terrain.law is 'static', must be one of 'dyn",
        ),
        ("[rig]\ncarriage = 'towed'\n" + COMMAND, "must be one of 'free', 'driven'"),
        (
            "[integrator]\nmethod = 'rk4'\n" + COMMAND,
            "integrator.method is 'rk4', must be 'implicit'",
        ),
        (COMMAND + "omega_unit = 'rpm'\n", "omega_unit is 'rpm', must be one of 'rad/s', 'deg/s'"),
        (
            "[terrain]\ncoefficients = 'gravel'\n" + COMMAND,
            "coefficients 'gravel' are not known; give one of 'generic', 'loose poppy seeds'",
        ),
        ("[terrain]\ncoefficients = [1, 2]\n" + COMMAND, "are 2 numbers, must be nine"),
        ("[terrain]\nzeta = -0.1\n" + COMMAND, "zeta is -0.1, must lie between 0 and"),
        ('title = "a\\u0000b"\n' + COMMAND, r"title holds the character '\x00'"),
        ("[terrain]\nzeta = nan\n" + COMMAND, "zeta is nan"),
        ("[terrain]\nzeta = {time = [0, 0], value = [1, 1]}\n" + COMMAND, "zeta knots"),
        ("[terrain]\nzeta = {time = [], value = []}\n" + COMMAND, "needs at least one knot"),
        ("[terrain]\nzeta = {time = [0, 1], value = [1]}\n" + COMMAND, "one value for each knot"),
        (
            "[wheel]\nradius = 150\n" + COMMAND,
            "wheel radius is 150, must lie between 0.005 and 2",
        ),
        ("[wheel]\nradius = 150\n" + COMMAND, "(lengths are in metres)"),
        ("[wheel]\nplate_size = 0\n" + COMMAND, "plate size is 0"),
        ("[wheel]\nshape = 'outline'\n" + COMMAND, "needs points, or outline = a CSV file"),
        ("[wheel]\npoints = [[0, 1]]\n" + COMMAND, "its shape is 'grouser'; say shape = 'outline'"),
        (
            "[wheel]\ngrouser_count = 99999999999999999999999\n" + COMMAND,
            "grouser count is 1e+23, must lie between 1 and 1000",
        ),
        (f"[wheel]\ngrouser_count = {10**400}\n" + COMMAND, "grouser"),
        ("[rig]\nmass_z = 0\n" + COMMAND, "mass_z is 0"),
        ("[rig]\ncarriage = 'driven'\n" + COMMAND, "is driven, so [command] needs vx in m/s"),
        (COMMAND + "vx = [0, 1]\n", "gives vx, but the carriage of [rig] is free"),
        ("[start]\nsinkage = 20\n" + COMMAND, "start sinkage is 20"),
        ("[start]\nx = nan\n" + COMMAND, "start x is nan"),
        ("[integrator]\nstep = 0\n" + COMMAND, "integrator step is 0"),
        (
            "[command]\ntime = [0, 2, 1]\nomega = [0, 1, 1]\n",
            "command.time must increase from row to row",
        ),
        (
            "[command]\ntime = [0, 1, 1]\nomega = [0, 1, 1]\n",
            "command.time must increase from row to row",
        ),
        ("[command]\ntime = [0, nan]\nomega = [0, 1]\n", "time has 1 values that are not finite"),
        (
            "[command]\ntime = [0, 1]\nomega = [0, nan]\n",
            "command omega is nan, must lie between -100 and 100 rad/s",
        ),
        (
            "[command]\ntime = [0, 1]\nomega = [0, nan]\nomega_unit = 'deg/s'\n",
            "command omega is nan, must lie between -5729.58 and 5729.58 deg/s",
        ),
        (
            "[command]\ntime = [0, 1]\nomega = [0, 1800]\n",
            "command omega is 1800, must lie",
        ),
        ("[command]\ntime = [0, 1]\nomega = [0, 1, 2]\n", "omega has 3 rows but time has 2 rows"),
        ("[command]\ntime = [0]\nomega = [1]\n", "the command has one knot in time, needs two"),
        ("[command]\ntime = []\nomega = []\n", "time has no rows"),
        ("[command]\ntime = [0, 1e9]\nomega = [0, 1]\n", "(times are in seconds)"),
    ],
)
def test_what_a_set_up_may_not_say_is_refused_in_one_sentence(drft, tmp_path, text, said):
    path = written(tmp_path, text)
    refusal = drft("simulate", path, "-o", tmp_path / "run.h5").refusal
    assert refusal.startswith(f"{path}: ")
    assert said in refusal
    assert "are these deg/s?" not in refusal or "1800" in refusal
    assert not (tmp_path / "run.h5").exists()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "is not JSON: line 1, '{', cannot be read from column 2 on"),
        ("[1, 2]", "must hold named entries, holds a list"),
        ("[" * 100_000, "its entries lie too deep"),
        ('{"wheel": {"radius": ' + "1" * 5000 + "}}", "a number of too many digits"),
        ('{"command": {"time": [0, 1], "omega": [0, NaN]}}', "command omega is nan"),
        (
            '{"command": {"time": [0, 1e999], "omega": [0, 1]}}',
            "time has 1 values that are not fin",
        ),
        (
            '{"title": "\\ud800", "command": {"time": [0, 1], "omega": [0, 1]}}',
            r"title holds the character '\ud800'",
        ),
        ('{"comand": {}}', "unknown entry 'comand'; did you mean 'command'"),
    ],
)
def test_json_set_up_is_refused_in_the_same_way(drft, tmp_path, text, said):
    path = written(tmp_path, text, "rig.JSON")
    refusal = drft("simulate", path).refusal
    assert refusal.startswith(f"{path}: ")
    assert said in refusal


def test_folder_or_absent_file_is_no_set_up(drft, tmp_path):
    assert drft("simulate", tmp_path).refusal == f"{tmp_path}: is a folder, must be a file"
    gone = tmp_path / "gone.toml"
    assert drft("simulate", gone).refusal == f"{gone}: there is no such file"


def test_json_and_toml_say_the_same(tmp_path):
    paper = read_setup(PAPER)
    twin = written(tmp_path, json.dumps(msgspec.to_builtins(paper)), "paper.json")
    assert msgspec.to_builtins(read_setup(twin)) == msgspec.to_builtins(paper)


def test_byte_order_mark_of_an_editor_is_no_obstacle(tmp_path):
    marked = written(tmp_path, b"\xef\xbb\xbf" + PAPER.read_bytes())
    assert read_setup(marked).title == read_setup(PAPER).title


def test_words_of_a_set_up_choose_the_parts(tmp_path):
    text = (
        "[terrain]\nlaw = 'quasi-static'\ncoefficients = 'loose poppy seeds'\n"
        "zeta = {time = [0, 2], value = [0.8, 0.6]}\n"
        "[wheel]\nshape = 'plain'\n[rig]\ncarriage = 'driven'\n[integrator]\nmethod = 'implicit'\n"
        "[command]\ntime = [3, 4]\nomega = [0, 90]\nvx = [0, 0.1]\nomega_unit = 'deg/s'\n"
    )
    trial = read_setup(written(tmp_path, text)).trial()
    simulator = trial.simulator
    assert isinstance(simulator.wheel, PlainWheel)
    assert isinstance(simulator.rig.carriage, DrivenCarriage)
    assert isinstance(simulator.terrain.zeta, KnotZeta)
    law = simulator.terrain.law
    assert isinstance(law, QuasiStatic)
    loose = StressCoefficients.loose_poppy_seeds().values
    np.testing.assert_array_equal(law.coefficients.values, loose)
    np.testing.assert_allclose(trial.omega, [0, np.pi / 2], rtol=1e-15)  # a rounding
    np.testing.assert_array_equal(trial.time, [0, 1])
    np.testing.assert_array_equal(trial.vx, [0, 0.1])


def test_defaults_are_the_papers_wheel_law_and_method():
    simulator = SetUp(command=CommandSetUp([0, 1], [0, 1])).trial().simulator
    assert isinstance(simulator.wheel, GrouserWheel)
    assert isinstance(simulator.terrain.law, Dynamic)
    assert isinstance(simulator.rig.carriage, FreeCarriage)
    assert isinstance(simulator.integrator, ImplicitEuler)


@pytest.mark.parametrize("method", ["rosenbrock", "held pace", "explicit"])
def test_a_removed_integrator_is_refused_in_one_sentence(tmp_path, method):
    text = f"[integrator]\nmethod = '{method}'\nstep = 5e-4\n" + COMMAND
    with pytest.raises(InputError, match=f"integrator.method '{method}' was removed, and its step"):
        read_setup(written(tmp_path, text))


def test_nine_numbers_are_coefficients(tmp_path):
    numbers = [0.1 * k for k in range(9)]
    text = f"[terrain]\ncoefficients = {numbers}\n" + COMMAND
    law = read_setup(written(tmp_path, text)).trial().simulator.terrain.law
    assert isinstance(law, Dynamic)
    np.testing.assert_array_equal(law.coefficients.values, numbers)


def test_omega_is_rad_per_second_unless_said(tmp_path):
    np.testing.assert_array_equal(read_setup(written(tmp_path, COMMAND)).trial().omega, [0, 1])


def test_outline_is_found_beside_its_set_up(tmp_path, monkeypatch):
    monkeypatch.chdir(Path(__file__).parent)
    written(tmp_path, corners(SQUARE), "corners.csv")
    wheel = read_setup(written(tmp_path, OUTLINE)).trial().simulator.wheel
    assert isinstance(wheel, OutlineWheel)
    np.testing.assert_array_equal(wheel.points, SQUARE)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "corners.csv: there is no such file"),
        (corners(SQUARE[::-1]), "runs clockwise"),
        ("x,z\n0,0.1\nleft,0.1\n", "must be two numbers, x and z in metres"),
        (corners([(100 * x, 100 * z) for x, z in SQUARE]), "(lengths are in metres)"),
        ("", "the outline is open"),
    ],
)
def test_outline_that_is_none_is_refused_with_its_file(drft, tmp_path, text, said):
    if text is not None:
        written(tmp_path, text, "corners.csv")
    setup = written(tmp_path, OUTLINE)
    refusal = drft("simulate", setup).refusal
    assert refusal.startswith(f"{setup}: outline of [wheel]: ")
    assert str(tmp_path / "corners.csv") in refusal
    assert said in refusal


def test_outline_and_points_at_once_are_refused(drft, tmp_path):
    written(tmp_path, corners(SQUARE), "corners.csv")
    both = OUTLINE.replace("radius", "points = [[0, 1]]\nradius")
    assert "both points and an outline" in drft("simulate", written(tmp_path, both)).refusal


# Set-ups of recorded runs -----------------------------------------------------------------------

KNOWN = {
    "wheel_radius": 0.1,
    "wheel_width": 0.2,
    "grouser_count": 8,
    "grouser_height": 0.01,
    "grouser_thickness": 0.003,
    "mass_x": 11.0,
    "mass_z": 12.0,
    "gravity": 1.62,
    "bulk_density": 1700.0,
    "sinkage_static": 0.013,
    "scaling_factor_initial": 0.55,
}


def recorded(vx=None, **changes) -> RunLog:
    """A run whose set-up is `KNOWN` with changes; None leaves an entry out."""
    return RunLog(
        setup=RecordedSetup(**(KNOWN | changes)),
        command=RecordedCommand(time=[0.0, 2.0, 3.0], omega=[0.0, 0.5, 0.5], vx=vx),
        measured=Measured(time=[0.0, 3.0], z=[-0.013, -0.02]),
        source="measured",
        title="a run on the moon",
    )


def test_every_number_of_a_run_is_taken_over():
    setup = setup_from_run(recorded())
    taken = {
        "wheel_radius": setup.wheel.radius,
        "wheel_width": setup.wheel.width,
        "grouser_count": setup.wheel.grouser_count,
        "grouser_height": setup.wheel.grouser_height,
        "grouser_thickness": setup.wheel.grouser_thickness,
        "mass_x": setup.rig.mass_x,
        "mass_z": setup.rig.mass_z,
        "gravity": setup.rig.gravity,
        "bulk_density": setup.terrain.bulk_density,
        "sinkage_static": setup.start.sinkage,
        "scaling_factor_initial": setup.terrain.zeta,
    }
    assert taken == KNOWN
    assert setup.title == "a run on the moon"
    assert (setup.command.time, setup.command.omega) == ([0, 2, 3], [0, 0.5, 0.5])
    assert setup.command.omega_unit == "rad/s"
    assert (setup.wheel.shape, setup.rig.carriage) == ("grouser", "free")


@pytest.mark.parametrize("name", ["wheel_radius", "wheel_width", "mass_z"])
def test_run_without_a_number_that_none_can_guess_is_refused(name):
    with pytest.raises(InputError, match=rf"/setup lacks {name}, without which"):
        setup_from_run(recorded(**{name: None}))


@pytest.mark.parametrize("name", ["grouser_height", "grouser_thickness"])
def test_run_with_grousers_of_unknown_shape_is_refused(name):
    with pytest.raises(InputError, match=f"has grousers but lacks {name}"):
        setup_from_run(recorded(**{name: None}))


@pytest.mark.parametrize("count", [0, None])
def test_run_without_grousers_has_a_plain_wheel(count):
    run = recorded(grouser_count=count, grouser_height=None, grouser_thickness=None)
    wheel = setup_from_run(run).trial().simulator.wheel
    assert isinstance(wheel, PlainWheel)
    assert (float(wheel.radius), float(wheel.width)) == (0.1, 0.2)


def test_run_with_more_grousers_than_fit_is_refused():
    with pytest.raises(InputError, match=r"grouser count is 1e\+300, must lie between"):
        setup_from_run(recorded(grouser_count=1e300)).trial()


def test_what_else_a_run_leaves_out_is_the_papers():
    bare = {name: None for name in KNOWN if name not in ("wheel_radius", "wheel_width", "mass_z")}
    setup = setup_from_run(recorded(**bare))
    plain = SetUp(command=setup.command)
    assert (setup.rig.mass_x, setup.rig.gravity) == (plain.rig.mass_x, plain.rig.gravity)
    assert setup.terrain == plain.terrain
    assert setup.start == plain.start


def test_run_with_a_commanded_vx_has_a_driven_carriage():
    setup = setup_from_run(recorded(vx=[0.0, 0.04, 0.04]))
    assert setup.command.vx == [0, 0.04, 0.04]
    trial = setup.trial()
    assert isinstance(trial.simulator.rig.carriage, DrivenCarriage)
    np.testing.assert_array_equal(trial.vx, [0, 0.04, 0.04])
