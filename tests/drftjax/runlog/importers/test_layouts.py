"""Tables as spreadsheets and loggers write them: signs, encodings, extra lines, gaps and clocks."""

from pathlib import Path

import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.runlog.importers.mapped_runs import import_named_runs, import_table
from drftjax.runlog.importers.one_clock import TimedChannel, on_one_clock
from drftjax.runlog.importers.units import unit

# Reading is a product of a cell and a factor: a few roundings of a double.
ROUNDING = 1e-14
# A time of 24 s is the difference of two whole numbers, and one product.
CLOCK = 1e-12

TIME = 0.05 * np.arange(20)
RPM = np.linspace(0.0, 5.0, 20)
TRAVEL = 3.25 * np.arange(20)
SINKAGE = 17.0 + 0.125 * np.arange(20)
ROWS = [f"{t:.4f},{w:.6f},{x:.4f},{z:.4f}" for t, w, x, z in zip(TIME, RPM, TRAVEL, SINKAGE)]  # noqa: B905
PLAIN = "t,speed,travel,sinkage\n" + "\n".join(ROWS) + "\n"

MAPPING = """
rows = "samples"
title = "{file}"
[time]
column = "t"
[command]
omega = { column = "speed", unit = "rpm" }
[measured]
x = { column = "travel", unit = "mm" }
z = { column = "sinkage", unit = "mm", sign = -1 }
"""


@pytest.fixture
def read(tmp_path):
    """Import a table by a mapping; a run and its losses for each."""

    def made(table: str | bytes, mapping: str = MAPPING, name: str = "table.csv"):
        data = table.encode() if isinstance(table, str) else table
        (tmp_path / name).write_bytes(data)
        (tmp_path / "map.toml").write_text(mapping)
        return import_named_runs(tmp_path / name, tmp_path / "map.toml")

    return made


def assert_whole(imported) -> None:
    ((run, losses),) = [(each.run, each.losses) for each in imported]
    assert not losses
    np.testing.assert_allclose(run.command.time, TIME, rtol=0, atol=CLOCK)
    np.testing.assert_allclose(run.command.omega, RPM.round(6) * np.pi / 30, rtol=ROUNDING)
    np.testing.assert_allclose(run.measured.x, TRAVEL * 1e-3, rtol=ROUNDING)
    np.testing.assert_allclose(run.measured.z, -SINKAGE * 1e-3, rtol=ROUNDING)


GERMAN = (
    "Zeit;Drehzahl;Weg;Einsinkung\r\n[s];[U/min];[mm];[mm]\r\n"
    + "\r\n".join(ROWS).replace(",", ";").replace(".", ",")
    + "\r\n"
)
GERMAN_MAPPING = (
    MAPPING.replace('"t"', '"Zeit"')
    .replace('"speed", unit = "rpm"', '"Drehzahl", unit = "U/min"')
    .replace("travel", "Weg")
    .replace("sinkage", "Einsinkung")
)
BELOW = PLAIN.replace("sinkage\n", "sinkage\ns,rpm,mm,mm\n")
FOOTED = PLAIN + "\nEnd of file,,,\nmean,1,2,3\n"
NUMBERED = "headings = false\n" + (
    MAPPING.replace('"t"', "1")
    .replace('"speed"', "2")
    .replace('"travel"', "3")
    .replace('"sinkage"', '"4"')
)
DEGREE = MAPPING.replace("speed", "speed °")


@pytest.mark.parametrize(
    ("table", "mapping"),
    [
        (PLAIN, MAPPING),
        ("\ufeff" + GERMAN, 'decimal = ","\nskip_below = 1\n' + GERMAN_MAPPING),
        (GERMAN, 'separator = ";"\ndecimal = ","\nskip_below = 1\n' + GERMAN_MAPPING),
        (BELOW, "skip_below = 1\n" + MAPPING),
        (FOOTED, 'end_at = "End of"\n' + MAPPING),
        (FOOTED, 'end_at = ""\n' + MAPPING),
        ("\n".join(ROWS), NUMBERED),
        (PLAIN.replace(",", "\t").encode("utf-16"), MAPPING),
        (PLAIN.encode("utf-16-be"), 'encoding = "utf-16-be"\n' + MAPPING),
        (PLAIN.replace("speed", "speed °").encode("cp1252"), 'encoding = "cp1252"\n' + DEGREE),
        (PLAIN.replace("\n", ",\n"), MAPPING),
        ("sep=;\r\n" + PLAIN.replace(",", ";"), MAPPING),
        (PLAIN.replace("\n", "\r\n") + ",,,\r\n,,,\r\n", MAPPING),
    ],
)  # fmt: skip
def test_the_same_rows_in_another_layout_are_the_same_run(read, table, mapping):
    assert_whole(read(table, mapping))


@pytest.mark.parametrize(
    ("table", "mapping", "reason"),
    [
        (GERMAN, "skip_below = 1\n" + GERMAN_MAPPING, r'line 3: Zeit is .0,0000.*decimal = ","'),
        (GERMAN, GERMAN_MAPPING, r"line 2: Zeit is '\[s\]'.*skip_below = 1"),
        (BELOW, MAPPING, r"line 2: t is 's'.*skip_below = 1"),
        (FOOTED, MAPPING, r'line 23: t is .End of file.*end_at = "End of file"'),
        (PLAIN + "End\n", MAPPING, r'line 22: has 1 cells under 4 headings.*end_at = "End"'),
        (PLAIN.replace("speed", "°").encode("cp1252"), MAPPING, r'line 1.*encoding = "cp1252"'),
        (PLAIN, 'decimal = ";"\n' + MAPPING, r'decimal is .;., it must be "." or ","'),
        (PLAIN, 'encoding = "klingon"\n' + MAPPING, "encoding is 'klingon', which is not known"),
        (PLAIN, 'separator = ","\ndecimal = ","\n' + MAPPING, "both ',', they must differ"),
        (PLAIN, "skip_below = -1\n" + MAPPING, "skip_below is -1, it must not be negative"),
        (PLAIN, MAPPING.replace('"t"', "9"), "numbers 1 to 4"),
        (PLAIN.replace("t,s", "t,t,s"), MAPPING, "'t' stands over two columns.*headings = false"),
        (PLAIN.replace("0.1000,", "0.0000,"), MAPPING, r"line 4: time must .* in line 3 \(1 such"),
        (PLAIN.replace("0.1000,", ","), MAPPING, r"line 4: t is '', it must be a time, since"),
        (PLAIN, MAPPING + 'torque = { column = "t", unit = "s" }', "torque comes out in s"),
        (PLAIN.replace("0.1000", "10:00:00"), MAPPING, r"line 4: t is .10:00:00.*iso8601"),
        (b"PK\x03\x04", MAPPING, "is a workbook or another zip archive"),
    ],
)  # fmt: skip
def test_a_refusal_names_the_line_of_the_file_and_the_remedy(read, table, mapping, reason):
    with pytest.raises(InputError, match=reason) as caught:
        read(table, mapping)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("unit", "stamp"),
    [
        ("ns", lambda t: f"{1732340000123456789 + round(t * 1e9)}"),
        ("us", lambda t: f"{1732340000123456 + round(t * 1e6)}"),
        ("ms", lambda t: f"{1732340000123 + round(t * 1e3)}"),
        ("iso8601", lambda t: f"2026-03-01T10:00:{t:06.3f}Z"),
        ("iso8601", lambda t: f"2026-03-01 12:00:{t:06.3f}+02:00"),
        ("iso8601", lambda t: f"23:59:{t:06.3f}"),
        ("%d.%m.%Y %H:%M:%S.%f", lambda t: f"01.03.2026 10:00:{t:06.3f}"),
    ],
)
def test_clocks_of_robots_and_of_the_wall_begin_at_the_first_row(read, unit, stamp):
    rows = [row.replace(f"{t:.4f}", stamp(t), 1) for row, t in zip(ROWS, TIME, strict=True)]
    text = "t,speed,travel,sinkage\n" + "\n".join(rows) + "\n"
    clock = f'column = "t"\nunit = "{unit}"\nzero_at_first_row = true\n'
    assert_whole(read(text, MAPPING.replace('column = "t"\n', clock)))


def test_a_stamp_that_is_none_is_refused_with_its_line(read):
    with pytest.raises(InputError, match=r"line 2: t is '0\.0000', it must be an ISO 8601 date"):
        read(PLAIN, MAPPING.replace('column = "t"', 'column = "t"\nunit = "iso8601"'))


def test_rows_without_a_time_follow_at_an_even_interval(read):
    mapping = MAPPING.replace('column = "t"', 'interval = "50 ms"')
    assert_whole(read(PLAIN, mapping))
    with pytest.raises(InputError, match=r"interval comes out in m, it must come out in s"):
        read(PLAIN, mapping.replace("50 ms", "50 mm"))


@pytest.mark.parametrize("gap", ["", "NaN", "n/a", "-"])
def test_a_slow_sensor_and_a_gap_keep_their_own_times(read, gap):
    lines = PLAIN.splitlines()
    kept = [0, 3, 6, 15, 18]
    for row in set(range(20)) - set(kept):
        lines[row + 1] = lines[row + 1].rpartition(",")[0] + "," + gap
    (imported,) = read("\n".join(lines))
    np.testing.assert_allclose(imported.run.measured.time, TIME[kept], rtol=0, atol=CLOCK)
    np.testing.assert_allclose(imported.run.measured.x, TRAVEL[kept] * 1e-3, rtol=ROUNDING)
    np.testing.assert_allclose(imported.run.measured.z, -SINKAGE[kept] * 1e-3, rtol=ROUNDING)
    assert imported.run.command.time.size == 20
    (loss,) = imported.losses
    assert loss.startswith("z has 5 values (x 20); the run keeps 5 of its times")


def test_channels_with_time_columns_of_their_own_are_interpolated_inside_their_times(read):
    # z is read every 0.08 s from 0.02 s on by another logger, in ms, beside x every 0.05 s.
    own = [f"{1000 * t:.1f},{100 * t:.4f}" for t in 0.02 + 0.08 * np.arange(8)]
    lines = [f"{row},{mine}" for row, mine in zip(ROWS, [*own, *[","] * 12], strict=True)]
    text = "t,speed,travel,sinkage,t2,depth\n" + "\n".join(lines)
    z = 'z = { column = "depth", unit = "mm", time = { column = "t2", unit = "ms" } }'
    mapping = MAPPING[: MAPPING.index("z = {")] + z
    (imported,) = read(text, mapping)
    run, times = imported.run, 0.02 + 0.08 * np.arange(8)
    np.testing.assert_allclose(run.measured.time, times, rtol=0, atol=CLOCK)
    np.testing.assert_allclose(run.measured.z, 0.1 * times, rtol=1e-9)
    np.testing.assert_allclose(run.measured.x, 3.25e-3 * times / 0.05, rtol=1e-9)
    (other,) = read(text, 'clock = "x"\n' + mapping)
    np.testing.assert_allclose(other.run.measured.time, TIME[1:12], rtol=0, atol=CLOCK)


def test_a_long_pause_of_the_command_is_told(read):
    lines = PLAIN.splitlines()
    for row in range(5, 12):
        t, _, *rest = lines[row + 1].split(",")
        lines[row + 1] = ",".join([t, "", *rest])
    (imported,) = read("\n".join(lines))
    assert imported.run.command.time.size == 13
    assert imported.run.measured.time.size == 20
    (loss,) = imported.losses
    assert loss.startswith("command.omega has no value for 0.4 s after 0.2 s; it is taken to")


def test_no_value_is_made_up_across_a_gap():
    fast = TimedChannel(TIME, TRAVEL)
    away = np.r_[0:5, 12:20]
    other = TimedChannel(TIME[away] + 0.01, SINKAGE[away])
    time, values, losses = on_one_clock({"x": fast, "z": other}, "x")
    inside = [1, 2, 3, 4, 13, 14, 15, 16, 17, 18, 19]
    np.testing.assert_array_equal(time, TIME[inside])
    expected = np.interp(TIME[inside], TIME + 0.01, SINKAGE)
    np.testing.assert_allclose(values["z"], expected, rtol=ROUNDING)
    assert len(losses) == 1
    with pytest.raises(InputError, match="x, z have no time in common"):
        on_one_clock({"x": fast, "z": TimedChannel(TIME + 100, SINKAGE)})


@pytest.mark.parametrize(
    ("written", "known"),
    [("°/s", "deg/s"), ("[U/min]", "rpm"), ("(mm)", "mm"), ("µm", "um"), ("μs", "us"),
     ("Nm", "N m"), ("N·m", "N m"), ("kg/m³", "kg/m^3"), ("min^-1", "rpm"), ("m s-1", "m/s")],
)  # fmt: skip
def test_units_are_known_as_people_write_them(written, known):
    assert unit(written) == unit(known)


def test_the_example_that_ships_is_five_runs(tmp_path):
    data = Path(__file__).parents[4] / "data"
    runs = import_table(data / "example.csv", data / "example.toml")
    assert [run.title for run in runs] == [f"example run {number}" for number in range(1, 6)]
    assert (data / "example.csv").stat().st_size < 300_000
    # The grousers' tips stand in the sand from the first reading on, and all wheels go forward.
    assert all(run.measured.sinkage[0] > 0.01 and run.measured.x[-1] > 0.4 for run in runs)
