"""Mappings proposed for tables: the run that comes out is the one that went in."""

import json

import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.runlog.importers.guess.proposal import propose_mapping
from drftjax.runlog.importers.guess.words import score, taken_apart
from drftjax.runlog.importers.mapped_runs import import_table

# Cells carry nine digits.
DIGITS = 1e-7
# Stamps are counted from the first row: a few roundings of a double.
CLOCK = 1e-9

RADIUS, SLIP = 0.15, 0.2
TIME = 0.05 * np.arange(100)
OMEGA = np.interp(TIME, [0.0, 1.0, 3.0], [0.0, 0.0, 0.5])
TURNED = np.r_[0.0, np.cumsum(np.diff(TIME) * (OMEGA[1:] + OMEGA[:-1]) / 2)]
TRAVEL = (1 - SLIP) * RADIUS * TURNED
SINKAGE = 0.017 + 0.01 * (1 - np.exp(-TIME))

PER_SECOND = {"rad/s": 1.0, "deg/s": 180 / np.pi, "rpm": 30 / np.pi}


def table(
    headings: str,
    columns,
    separator: str = ",",
    decimal: str = ".",
    above: str = "",
    below: str = "",
) -> str:
    rows = [separator.join(f"{each:.9g}" for each in row) for row in zip(*columns, strict=True)]
    return above + headings + "\n" + "\n".join(rows).replace(".", decimal) + "\n" + below


def assert_right(run, zero: float = 0.0) -> None:
    np.testing.assert_allclose(run.measured.time, TIME + zero, rtol=0, atol=CLOCK)
    np.testing.assert_allclose(run.command.omega, OMEGA, rtol=DIGITS, atol=DIGITS)
    np.testing.assert_allclose(run.measured.x, TRAVEL, rtol=DIGITS, atol=DIGITS)
    np.testing.assert_allclose(run.measured.z, -SINKAGE, rtol=DIGITS, atol=DIGITS)


MILLIMETRES = (TIME, OMEGA, 1e3 * TRAVEL, 1e3 * SINKAGE)
RPM = (TIME, OMEGA * PER_SECOND["rpm"], 1e3 * TRAVEL, 1e3 * SINKAGE)
EPOCH = 1_732_340_000_000

CASES = {
    "units in brackets": table("t [s],omega [rad/s],x [mm],sinkage [mm]", MILLIMETRES),
    "units by underscores": table("t_s,omega_rad_s,x_mm,sinkage_mm", MILLIMETRES),
    "german": table(
        "Zeit;Drehzahl;Weg;Einsinkung\n[s];[U/min];[mm];[mm]", RPM, ";", ",", "Messung 3;;;\n\n"
    ),
    "french": table("temps\tvitesse (tr/min)\tdistance (mm)\tenfoncement (mm)", RPM, "\t"),
    "no unit": table("time,speed,travel,depth", RPM),
    "height upward": table("time,w,x,z", (TIME, OMEGA, TRAVEL, -SINKAGE)),
    "footer": table("t,omega,x,sinkage", MILLIMETRES, below="\nEnd of file,,,\n"),
    "lines above": table("t,omega,x,sinkage", MILLIMETRES, above="logger of ours\nrig: 3\n"),
}


@pytest.mark.parametrize("name", CASES)
def test_a_proposed_mapping_brings_the_run_back(tmp_path, name):
    path, mapping = tmp_path / "run.csv", tmp_path / "map.toml"
    path.write_text(CASES[name])
    mapping.write_text(propose_mapping(path).text)
    (run,) = import_table(path, mapping)
    assert_right(run)
    assert run.title == "run"


@pytest.mark.parametrize("unit", PER_SECOND)
@pytest.mark.parametrize("radius", [0.05, 0.15, 0.25])
def test_the_unit_of_a_wheel_speed_is_told_by_the_travel(tmp_path, unit, radius):
    travel = radius * TURNED
    columns = (TIME, OMEGA * PER_SECOND[unit], 1e3 * travel, 1e3 * SINKAGE)
    (tmp_path / "run.csv").write_text(table("t,wheel,travel [mm],sinkage [mm]", columns))
    proposal = propose_mapping(tmp_path / "run.csv")
    assert f'omega = {{ column = "wheel", unit = "{unit}" }}' in proposal.text
    (doubt,) = [each for each in proposal.doubts if "'wheel'" in each]
    assert f"in {unit} on {1e3 * radius:.3g} mm" in doubt


def test_a_stated_unit_that_the_travel_denies_is_unsure(tmp_path):
    (tmp_path / "run.csv").write_text(table("t [s],w [rad/s],x [mm],sinkage [mm]", RPM))
    proposal = propose_mapping(tmp_path / "run.csv")
    assert 'unit = "rad/s"' in proposal.text
    assert any("would roll in rad/s on 12.6 mm" in each for each in proposal.doubts)


@pytest.mark.parametrize(
    ("unit", "factor", "start"),
    [("ms", 1e3, 0), ("ms", 1e3, EPOCH), ("us", 1e6, 1000 * EPOCH), ("ns", 1e9, 1_000_000 * EPOCH)],
)
def test_the_unit_of_a_clock_is_told_by_its_size(tmp_path, unit, factor, start):
    stamps = [start + round(t * factor) for t in TIME]
    rows = [
        f"{stamp},{w:.9g},{x:.9g},{z:.9g}"
        for stamp, w, x, z in zip(stamps, *MILLIMETRES[1:], strict=True)
    ]
    (tmp_path / "run.csv").write_text("time,omega,x,sinkage\n" + "\n".join(rows))
    proposal = propose_mapping(tmp_path / "run.csv")
    (tmp_path / "map.toml").write_text(proposal.text)
    (run,) = import_table(tmp_path / "run.csv", tmp_path / "map.toml")
    assert f'unit = "{unit}"' in proposal.text
    assert_right(run)


def test_runs_below_one_another_are_told_apart(tmp_path):
    lines = [f"{run},{t:.2f},1,{z:.4f}" for run in "ab" for t, z in zip(TIME, SINKAGE, strict=True)]
    (tmp_path / "runs.csv").write_text("drive,t,omega,z\n" + "\n".join(lines))
    proposal = propose_mapping(tmp_path / "runs.csv")
    (tmp_path / "map.toml").write_text(proposal.text)
    assert [r.title for r in import_table(tmp_path / "runs.csv", tmp_path / "map.toml")] == [
        "runs a",
        "runs b",
    ]
    (tmp_path / "runs.csv").write_text("t,omega,z\n" + "\n".join(row[2:] for row in lines))
    (doubt,) = [e for e in propose_mapping(tmp_path / "runs.csv").doubts if "goes back" in e]
    assert "line 102: time goes back" in doubt


def test_topics_of_a_robot_are_proposed_by_their_whole_names(tmp_path):
    from mcap.writer import Writer

    with (tmp_path / "run.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        channels = {t: writer.register_channel(t, "json", 0) for t in ("/wheel", "/height")}
        for t, w, x, z in zip(*MILLIMETRES, strict=True):
            stamp = EPOCH * 1_000_000 + round(t * 1e9)
            for topic, message in (
                ("/wheel", {"omega": w, "travel": x}),
                ("/height", {"depth": z}),
            ):
                writer.add_message(channels[topic], stamp, json.dumps(message).encode(), stamp)
        writer.finish()
    (tmp_path / "map.toml").write_text(propose_mapping(tmp_path / "run.mcap").text)
    (run,) = import_table(tmp_path / "run.mcap", tmp_path / "map.toml")
    # The unit of omega is told only where the travel stands beside it, and here it does not.
    np.testing.assert_allclose(run.measured.z, -SINKAGE, rtol=DIGITS)
    np.testing.assert_allclose(run.measured.time, TIME, rtol=0, atol=CLOCK)


@pytest.mark.parametrize(
    ("heading", "role", "unit"),
    [
        ("Weg [mm]", "x", "mm"),
        ("Drehzahl (U/min)", "omega", "rpm"),
        ("vx_mm_s", "vx", "mm/s"),
        ("profondità [cm]", "z", "cm"),
        ("drawbarPull_N", "fx", "N"),
        ("couple (Nm)", "torque", "N m"),
        ("ω", "omega", None),
    ],
)
def test_headings_of_several_languages_are_understood(heading, role, unit):
    named = taken_apart(heading)
    assert named.unit == unit
    assert score(role, named) > 0


def test_a_file_without_numbers_is_refused(tmp_path):
    (tmp_path / "prose.csv").write_text("dear diary\nnothing was measured, as usual\n")
    with pytest.raises(InputError, match=r"prose\.csv: no row of numbers is found"):
        propose_mapping(tmp_path / "prose.csv")


def test_the_command_prints_a_mapping_or_writes_it_once(drft, tmp_path):
    (tmp_path / "run.csv").write_text(CASES["no unit"])
    answer = drft("log", "import", tmp_path / "run.csv", "--guess")
    assert answer.code == 0
    assert answer.out == propose_mapping(tmp_path / "run.csv").text
    assert answer.err.startswith(
        "unsure: 'time': its unit is not stated; steps of 0.05 look like s"
    )
    mapping = tmp_path / "map.toml"
    assert drft("log", "import", tmp_path / "run.csv", "--guess", "-o", mapping).code == 0
    assert mapping.read_text() == answer.out
    again = drft("log", "import", tmp_path / "run.csv", "--guess", "-o", mapping)
    assert "is already there; give --force to replace" in again.refusal
    other = drft("log", "import", tmp_path / "run.csv", "--guess", "-o", tmp_path / "map.h5")
    assert "must end in .toml" in other.refusal
    both = drft("log", "import", tmp_path / "run.csv", "--guess", "--mapping", mapping)
    assert "leave out --mapping" in both.refusal
    assert "give -o" in drft("log", "import", tmp_path / "run.csv", "--mapping", mapping).refusal
