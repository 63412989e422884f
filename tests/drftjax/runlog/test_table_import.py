"""Tables of an experimenter as run logs: units, signs, selection, and what is refused."""

import gzip
import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from drftjax.commands.log import app
from drftjax.common.errors import InputError
from drftjax.common.packages import data_file, data_names
from drftjax.runlog.check import check_files
from drftjax.runlog.hdf5.api import read_run, write_run
from drftjax.runlog.importers.file_names import safe_names
from drftjax.runlog.importers.mapped_runs import import_named_runs, import_table
from drftjax.runlog.importers.mapping import read_mapping
from drftjax.runlog.importers.units import UNITS, quantity, unit

# Reading is a product of a cell and a factor: a few roundings of a double.
ROUNDING = 1e-14
# A carriage that is driven at 10 mm/s keeps that to a few per mille [m/s].
CARRIAGE = 3e-5

SAMPLES = """
rows = "samples"
title = "drive {drive}"
group_by = ["drive"]

[select]
t = { from = 20 }

[time]
column = "t"
unit = "ms"
zero_at_first_row = true

[command]
omega = { column = "rim", unit = "mm/s", divide_by = "50 mm" }

[measured]
x = { column = "x", unit = "cm", zero_at_first_row = true }
z = { column = "depth", unit = "mm", sign = -1, offset = "2 mm" }
torque = { column = "torque", unit = "N mm" }

[setup]
wheel_radius = "5 cm"
gravity = 9.81
grouser_count = 12
mass_z = { column = "load", unit = "kN", divide_by = "9.81 m/s^2" }
"""

TABLE = """drive,t,rim,x,depth,torque,load
a,10,0,0,0,0,0
a,20,100,1.5,10,500,0.00981
a,30,200,2.5,12,600,0.02943
b,20,-100,7,11,700,0.0981
b,35,0,8,13,800,0.0981
"""

STEADY = """
rows = "steady"
duration = "4 s"
title = "slip {slip}"

[select]
angle = { equals = 0 }
kind = { one_of = ["sand", "fine sand"] }

[command]
omega = { column = "rpm", unit = "rpm" }
vx = { constant = "10 mm/s" }

[measured]
z = { column = "z", unit = "mm" }
fz = { column = "up", unit = "N" }
"""

MEANS = """slip,angle,kind,rpm,z,up
0.1,0,sand,60,-12,20
0.2,15,sand,60,-13,21
0.3,0,fine sand,90,-14,22
0.4,0,mud,90,-14,22
"""


@pytest.fixture
def made(tmp_path):
    """Write a table and a mapping, and import the one by the other."""

    def make(table: str, mapping: str, name: str = "table.csv"):
        (tmp_path / name).write_text(table)
        (tmp_path / "map.toml").write_text(mapping)
        return import_table(tmp_path / name, tmp_path / "map.toml")

    return make


def test_samples_become_one_run_for_each_group_in_si(made):
    first, second = made(TABLE, SAMPLES)
    assert (first.title, second.title) == ("drive a", "drive b")
    np.testing.assert_allclose(first.command.time, [0.0, 0.01], rtol=ROUNDING, atol=ROUNDING)
    np.testing.assert_allclose(first.command.omega, [2.0, 4.0], rtol=ROUNDING)
    np.testing.assert_allclose(first.measured.x, [0.0, 0.01], rtol=ROUNDING, atol=ROUNDING)
    np.testing.assert_allclose(first.measured.z, [-0.008, -0.010], rtol=ROUNDING)
    np.testing.assert_allclose(first.measured.torque, [0.5, 0.6], rtol=ROUNDING)
    assert first.command.vx is None
    assert first.measured.fz is None
    assert math.isclose(first.setup.mass_z, 2.0, rel_tol=ROUNDING)
    assert (first.setup.wheel_radius, first.setup.grouser_count) == (0.05, 12)
    np.testing.assert_allclose(second.command.omega, [-2.0, 0.0], rtol=ROUNDING)
    np.testing.assert_allclose(second.measured.time, [0.0, 0.015], rtol=ROUNDING, atol=ROUNDING)


def test_a_steady_row_is_a_constant_command_and_one_sample_at_its_end(made):
    first, second = made(MEANS, STEADY)
    assert (first.title, second.title) == ("slip 0.1", "slip 0.3")
    np.testing.assert_array_equal(first.command.time, [0.0, 4.0])
    np.testing.assert_allclose(first.command.omega, [2 * math.pi] * 2, rtol=ROUNDING)
    np.testing.assert_allclose(first.command.vx, [0.01] * 2, rtol=ROUNDING)
    np.testing.assert_array_equal(first.measured.time, [4.0])
    np.testing.assert_allclose(first.measured.z, [-0.012], rtol=ROUNDING)
    assert second.measured.fz.tolist() == [22.0]


def test_the_mean_of_a_noisy_column_is_a_constant_command(made):
    runs = made(
        TABLE, SAMPLES.replace('divide_by = "50 mm"', 'divide_by = "50 mm", average = true')
    )
    np.testing.assert_allclose(runs[0].command.omega, [3.0, 3.0], rtol=ROUNDING)


def test_tabs_packing_marks_and_lines_above_the_headings_are_read(made, tmp_path):
    wanted = made(TABLE, SAMPLES)[1].measured.z
    tabbed = made(TABLE.replace(",", "\t"), SAMPLES, "table.tsv")
    (tmp_path / "table.csv.gz").write_bytes(gzip.compress(b"\xef\xbb\xbf" + TABLE.encode()))
    packed = import_table(tmp_path / "table.csv.gz", tmp_path / "map.toml")
    below = made("a logger\nof 2020\n" + TABLE, "skip_lines = 2\n" + SAMPLES)
    semicolons = made(TABLE.replace(",", ";"), 'separator = ";"\n' + SAMPLES)
    found_out = made(TABLE.replace(",", ";"), SAMPLES)
    for runs in (tabbed, packed, below, semicolons, found_out):
        np.testing.assert_array_equal(runs[1].measured.z, wanted)


def test_byte_order_mark_of_an_editor_is_no_obstacle_to_a_mapping(made):
    assert [run.title for run in made(TABLE, "\ufeff" + SAMPLES)] == ["drive a", "drive b"]


@pytest.mark.parametrize(
    ("written", "value", "powers"),
    [
        ("62.5 mm", 0.0625, (1, 0, 0)),
        ("30 deg/s", math.pi / 6, (0, 0, -1)),
        ("60 rpm", 2 * math.pi, (0, 0, -1)),
        ("-1e3 N mm", -1.0, (2, 1, -2)),
        ("2 kN", 2000.0, (1, 1, -2)),
        ("250 g", 0.25, (0, 1, 0)),
        ("1.33 g/cm^3", 1330.0, (-3, 1, 0)),
        ("10 mm/s", 0.01, (1, 0, -1)),
        ("5", 5.0, (0, 0, 0)),
    ],
)
def test_a_quantity_is_a_number_and_a_unit(written, value, powers):
    found = quantity(written)
    assert math.isclose(found.factor, value, rel_tol=ROUNDING)
    assert found.powers == powers


def test_every_unit_is_found_by_its_name():
    assert all(unit(name) == each for name, each in UNITS.items())


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ('"rim"', '"rym"', r"table\.csv.* no column 'rym'; did you mean 'rim'"),
        ('"mm/s"', '"mm/sec"', r"'mm/sec' is no unit known here; did you mean 'mm/s'"),
        (', divide_by = "50 mm"', "", r"command\.omega comes out in m s\^-1, .* rad/s"),
        ('divide_by = "50 mm"', 'divide_by = "0 mm"', "division by 0"),
        ('divide_by = "50 mm"', 'divided_by = "50 mm"', r"no key 'divided_by'.*'divide_by'"),
        ('title = "drive', 'title = "a\\u0000', r"title holds the character '\\x00'"),
        ('title = "drive', 'notes = "\\u0000"\ntitle = "drive', "notes holds the character"),
        ('title = "drive', 'skip_lines = 1000000000000\ntitle = "drive', "has 6 lines, but skip"),
        ('rows = "samples"', "rows = " + "[" * 100_000, "lie too deep"),
        ("[measured]", "[measurd]", r"no key 'measurd'; did you mean 'measured'"),
        ("sign = -1", "sign = 2", r"measured\.z\.sign.* 2"),
        ("sign = -1", 'sign = "minus"', r"measured\.z\.sign"),
        (
            'rows = "samples"',
            'rows = "sample"',
            r"rows is 'sample', must be one of 'samples', 'steady'",
        ),
        ('rows = "samples"', 'rows = "steady"', "steady rows need a duration"),
        ('rows = "samples"', "rows = samples", "line 2"),
        ('title = "drive {drive}"', "", r"the entry 'title' is missing$"),
        ('"drive {drive}"', '"drive {driv}"', "names no column 'driv'; did you mean 'drive'"),
        ("from = 20", "from = 99", "no row is selected by t"),
        ("{ from = 20 }", "{ one_of = [] }", r"select\.t\.one_of is empty"),
        ("{ from = 20 }", "{}", r"select\.t must have equals, one_of, from or to"),
        ("from = 20", "form = 20", "no key 'form'.*'from'"),
        ('[time]\ncolumn = "t"', "[time]", "time must have either a column or an interval"),
        ('offset = "2 mm"', 'offset = "2 s"', r"measured\.z\.offset comes out in s"),
        ('wheel_radius = "5 cm"', 'wheel_radius = "5 c"', "'c' is no unit"),
        ('wheel_radius = "5 cm"', 'wheel_radius = "-5 cm"', "wheel_radius is -0.05"),
        ('wheel_radius = "5 cm"', 'wheel_radius = "wide"', "'wide' is no quantity"),
        ("grouser_count = 12", "grouser_count = 12.5", "whole number"),
        ('group_by = ["drive"]', "", r"table\.csv, line 5: time must increase.* line 4 .*group_by"),
        ('group_by = ["drive"]', 'group_by = ["driver"]', "no column 'driver'"),
        ('group_by = ["drive"]', 'separator = ";;"', "must be one character"),
        ('title = "drive', 'source = "me"\ntitle = "drive', "source is 'me'"),
        ('group_by = ["drive"]', 'files = ["other*"]', r"is for other\*, not for table\.csv"),
    ],
)
def test_a_mapping_that_cannot_be_meant_is_refused_with_a_hint(made, old, new, reason):
    assert old in SAMPLES
    with pytest.raises(InputError, match=reason) as caught:
        made(TABLE, SAMPLES.replace(old, new))
    assert "map.toml" in str(caught.value) or "table.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("a,30,200", "a,30,fast", r"table\.csv, line 4: rim is 'fast', it must be a finite number"),
        ("a,30,200", "a,30,inf", r"line 4: rim is 'inf'"),
        ("a,30,200", "a,30,2_0", r"line 4: rim is '2_0', it must be a finite number"),
        ("a,30,200", "a,20,200", r"table\.csv, line 4: time must increase"),
        ("a,30,200", "a,30,1,200", r"line 4: has 8 cells under 7 headings"),
        ("a,", "a\0,", r"lines 3-4.*: title holds the character '\\x00'"),
        (",load", ",torque", "'torque' stands over two columns"),
        (TABLE, "", "line 1 must hold the headings"),
        (TABLE, "drive,t,rim,x,depth,torque,load\n", "no row is selected"),
    ],
)
def test_a_table_that_cannot_be_read_is_refused_with_the_line(made, old, new, reason):
    with pytest.raises(InputError, match=reason):
        made(TABLE.replace(old, new), SAMPLES)


def test_a_table_that_is_no_text_is_refused(made, tmp_path):
    made(TABLE, SAMPLES)
    packed = gzip.compress(TABLE.encode())
    for name, data, reason in [
        ("a.csv", b"\xff\xfe\x00", "line 1: is not a table of utf-16 text"),
        (
            "run.h5",
            b"\x89HDF\r\n\x1a\n\0",
            "run.h5: is an HDF5 file; a file of this name must be CSV or TSV$",
        ),
        ("a.csv.gz", TABLE.encode(), "no file of gzip"),
        ("b.csv.gz", packed[:-12], "damaged, or was cut off"),
        ("c.csv.gz", packed[:20] + b"\xff\xff\xff" + packed[23:], "damaged|UTF-8"),
    ]:
        (tmp_path / name).write_bytes(data)
        with pytest.raises(InputError, match=reason):
            import_table(tmp_path / name, tmp_path / "map.toml")
    with pytest.raises(InputError, match="no such file"):
        import_table(tmp_path / "none.csv", tmp_path / "map.toml")
    with pytest.raises(InputError, match=r"none.toml: there is no such file"):
        import_table(tmp_path / "table.csv", tmp_path / "none.toml")


@pytest.mark.parametrize(
    ("name", "file"),
    [("run.1.csv", "run.1"), ("run.TXT", "run"), ("a.csv.csv", "a.csv"), ("run.2", "run.2")],
)
def test_a_table_gives_its_name_without_its_ending(made, name, file):
    mapping = SAMPLES.replace("drive {drive}", "{file} {drive}")
    sep = 'separator = ","\n'
    assert [run.title for run in made(TABLE, sep + mapping, name)] == [f"{file} a", f"{file} b"]


def test_a_packed_table_gives_its_name_without_both_endings(made, tmp_path):
    made(TABLE, SAMPLES.replace("drive {drive}", "{file}"))
    (tmp_path / "run.1.csv.gz").write_bytes(gzip.compress(TABLE.encode()))
    first, _ = import_table(tmp_path / "run.1.csv.gz", tmp_path / "map.toml")
    assert first.title == "run.1"


def test_names_of_files_are_safe_and_differ():
    assert safe_names(["a/b", "a_b", "A_B", "../../etc", "Räder № 1", "", "."]) == [
        *("a_b", "a_b_2", "A_B_3", "etc", "Rader_No_1", "run", "run_2")
    ]
    assert safe_names(["a", "a", "a_2"]) == ["a", "a_2", "a_2_2"]
    assert max(map(len, safe_names(["x" * 300] * 3))) < 120


@pytest.fixture
def table(tmp_path) -> tuple[str, str]:
    (tmp_path / "table.csv").write_text(TABLE)
    (tmp_path / "map.toml").write_text(SAMPLES)
    return str(tmp_path / "table.csv"), str(tmp_path / "map.toml")


def test_the_import_command_writes_a_folder_of_good_run_logs(table, tmp_path):
    command = ["import", table[0], "--mapping", table[1], "-o", str(tmp_path / "runs")]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0
    written = sorted((tmp_path / "runs").iterdir())
    assert [each.name for each in written] == ["drive_a.h5", "drive_b.h5"]
    assert all(f"wrote {each}" in done.stdout for each in written)
    assert check_files(written) == [[], []]
    again = CliRunner().invoke(app, command)
    assert isinstance(again.exception, InputError)
    assert "and 1 more are already there; give --force" in str(again.exception)
    assert CliRunner().invoke(app, [*command, "--force"]).exit_code == 0


def test_columns_whose_unit_was_left_out_are_noted(table, tmp_path):
    text = Path(table[1]).read_text()
    unit = ', unit = "mm"'
    assert text.count(unit) > 0
    Path(table[1]).write_text(text.replace(unit, ""))
    folder = tmp_path / "runs"
    done = CliRunner().invoke(app, ["import", table[0], "--mapping", table[1], "-o", str(folder)])
    assert done.exit_code == 0
    assert f"note: {folder / 'drive_a.h5'}: /measured/z reaches" in done.stderr
    assert "perhaps these are mm" in done.stderr


@pytest.mark.parametrize("name", ["run.h5", "run.hdf5"])
def test_many_runs_do_not_go_into_one_file(table, tmp_path, name):
    command = ["import", *table[:1], "--mapping", table[1], "-o", str(tmp_path / name)]
    done = CliRunner().invoke(app, command)
    assert "is one file, but the table holds 2 runs" in str(done.exception)
    assert not (tmp_path / name).exists()


def test_an_unknown_mapping_is_refused_with_the_nearest_names(table, tmp_path):
    command = ["import", table[0], "--mapping", "cmu_intrusoin", "-o", str(tmp_path / "runs")]
    done = CliRunner().invoke(app, command)
    assert isinstance(done.exception, InputError)
    assert "did you mean 'cmu_intrusion'" in str(done.exception)


def test_the_mappings_that_ship_are_whole():
    names = data_names("import", ".toml")
    assert "cmu_smooth_steady" in names
    for name in names:
        assert read_mapping(data_file(f"import/{name}.toml")).title


def test_a_run_is_drawn_and_shown(table, tmp_path):
    (run, *_) = import_named_runs(*table)
    assert run.name == "drive a"
    path = str(tmp_path / "run_{}.h5")
    CliRunner().invoke(app, ["import", table[0], "--mapping", table[1], "-o", str(tmp_path)])
    path = str(tmp_path / "drive_a.h5")
    shown = CliRunner().invoke(app, ["show", path])
    assert shown.exit_code == 0
    assert "drive a (measured)" in shown.stdout
    assert "wheel_radius 0.05" in shown.stdout
    assert "measured/torque" in shown.stdout
    figure = tmp_path / "a.png"
    assert CliRunner().invoke(app, ["plot", path, "-o", str(figure)]).exit_code == 0
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert read_run(path).title == "drive a"
    refused = CliRunner().invoke(app, ["plot", path, "-o", str(tmp_path / "a.bmp")])
    assert "must end in .png" in str(refused.exception)
    new = tmp_path / "new" / "a.pdf"
    assert CliRunner().invoke(app, ["plot", path, "-o", str(new)]).exit_code == 0
    assert new.read_bytes().startswith(b"%PDF")
    refused = CliRunner().invoke(app, ["plot", path, "-o", path])
    assert isinstance(refused.exception, InputError)


@pytest.mark.parametrize("column", ["x", "t"])
def test_a_run_whose_numbers_overflow_an_axis_is_not_drawn(made, tmp_path, column):
    huge = {"x": ("b,35,0,8", "b,35,0,1e307"), "t": ("b,35", "b,1e307")}[column]
    _, run = made(TABLE.replace(*huge), SAMPLES)
    path = tmp_path / "huge.h5"
    write_run(path, run)
    done = CliRunner().invoke(app, ["plot", str(path), "-o", str(tmp_path / "a.png")])
    assert isinstance(done.exception, InputError)
    assert str(done.exception).startswith(f"{path}: /")
    assert "too large to draw" in str(done.exception)
    assert not (tmp_path / "a.png").exists()


# The shared measurements ------------------------------------------------------------------------


@pytest.fixture
def cmu(shared: Path) -> Path:
    folder = shared / "measured" / "cmu"
    if not folder.is_dir():
        pytest.skip("the shared measurements are not beside the project")
    return folder


def imported(table: Path, mapping: str):
    return import_table(table, data_file(f"import/{mapping}.toml"))


def test_steady_means_of_the_smooth_wheel_are_in_the_frame_of_a_run_log(cmu):
    runs = imported(cmu / "all_smooth_data.csv", "cmu_smooth_steady")
    speeds = np.array([run.command.vx[0] for run in runs])
    rims = np.array([run.command.omega[0] for run in runs]) * 0.0625
    forward = np.array([run.measured.fx[0] for run in runs])
    sinkages = np.array([run.measured.sinkage[0] for run in runs])
    weights = np.array([run.setup.mass_z for run in runs]) * 9.81
    # The note of the test bed: the carriage at 10 mm/s, a dead load of 19 to 27 N.
    np.testing.assert_allclose(speeds, 0.010, rtol=0, atol=CARRIAGE)
    assert (weights > 18).all()
    assert (weights < 27.5).all()
    # A locked wheel digs deepest, by 5 cm and more, and is dragged back; one that slips forward
    # sinks by one to three.
    locked = rims < 1e-4
    assert (forward[locked] < -30).all()
    assert (sinkages[locked] > 0.045).all()
    assert (sinkages[~locked] > 0.01).all()
    assert (sinkages[~locked] < 0.035).all()


def test_the_zero_of_the_grousered_wheel_is_moved_from_tip_to_rim(cmu):
    moved = imported(cmu / "all_grouser_data.csv", "cmu_grouser_steady")
    text = data_file("import/cmu_grouser_steady.toml").read_text()
    assert 'offset = "5 mm"' in text
    assert moved[0].setup.wheel_radius + moved[0].setup.grouser_height == pytest.approx(0.0625)


@pytest.mark.parametrize("wheel", ["smooth", "grouser"])
def test_series_in_time_are_taken_where_they_are_clean(cmu, wheel):
    table = cmu / "processed_timeseries" / f"beta0_{wheel}.csv.gz"
    runs = imported(table, f"cmu_{wheel}_timeseries")
    for run in runs:
        assert run.command.time[0] == 0.0
        # The 35 s that the mapping takes, to a row or two.
        assert 34.9 < run.command.time[-1] <= 35.0
        # The authors' two columns disagree, as the mapping says: x grows 2 to 4 % faster than vx.
        travel = run.measured.x[-1] / run.command.time[-1]
        assert 1.015 < travel / run.command.vx[0] < 1.04


@pytest.mark.parametrize(
    ("wheel", "mapping"), [("smooth", "cmu_intrusion"), ("grouser", "cmu_intrusion_grouser")]
)
def test_an_intrusion_goes_down_and_pushes_up(cmu, wheel, mapping):
    tables = sorted((cmu / "processed_intrusion").glob(f"*wheel_{wheel}.csv"))
    assert tables
    for table in tables:
        (run,) = imported(table, mapping)
        # By 4 cm, at some hundred newtons and more.
        assert run.measured.z[-1] < run.measured.z[0] - 0.03
        assert run.measured.fz[-1] > 100
        assert not run.command.omega.any()
        assert not run.command.vx.any()
    with pytest.raises(InputError, match="is for"):
        imported(next((cmu / "processed_intrusion").glob("*plate*.csv")), mapping)


def test_the_mapping_in_the_documentation_reads_a_table(tmp_path):
    text = (Path(__file__).parents[3] / "docs" / "guide" / "import-data.md").read_text()
    block = text[text.index('    rows = "samples"') : text.index("| Key | Meaning |")]
    (tmp_path / "map.toml").write_text("\n".join(line[4:] for line in block.splitlines()))
    (tmp_path / "table.csv").write_text(
        "sand,drive,t,rim_speed,sinkage,drawbar,load\n"
        "dry,7,20,62.5,12,3,19.62\ndry,7,21,62.5,13,3,19.62\nwet,7,22,0,0,0,0\n"
    )
    (run,) = import_table(tmp_path / "table.csv", tmp_path / "map.toml")
    assert run.title == "sand dry, drive 7"
    np.testing.assert_allclose(run.command.omega, [1.0, 1.0], rtol=ROUNDING)
    np.testing.assert_allclose(run.measured.z, [-0.010, -0.011], rtol=ROUNDING)
    assert run.setup.mass_z == pytest.approx(2.0, rel=ROUNDING)


def test_the_example_of_the_readme_is_a_run(tmp_path):
    lines = (Path(__file__).parents[3] / "README.md").read_text().split("## Bring your own runs")[1]

    def block(first: str, last: str) -> str:
        text = lines[lines.index(f"    {first}") : lines.index(last)]
        return "\n".join(line[4:] for line in text.splitlines())

    (tmp_path / "table.csv").write_text(block("t,speed", "\nit is"))
    (tmp_path / "map.toml").write_text(block('rows = "samples"', "\nThe page on the"))
    (run,) = import_table(tmp_path / "table.csv", tmp_path / "map.toml")
    assert run.title == "table"
    np.testing.assert_allclose(run.measured.sinkage, [0.0171, 0.0171])
