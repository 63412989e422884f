"""Files that are no run logs, or pose as one: refused, with the file and the reason."""

import dataclasses
import gzip
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

from drftjax.commands.log import app
from drftjax.common.errors import InputError
from drftjax.runlog.check import check_file, check_files
from drftjax.runlog.content import Level
from drftjax.runlog.hdf5.api import SIZE_LIMIT, read_run, write_run
from tests.helpers.run_logs import example_run

F8 = np.dtype("<f8")


def replaced(name: str, **how: object) -> Callable[[h5py.File], None]:
    """Put another dataset of that name in its place; its units stay."""

    def spoil(file: h5py.File) -> None:
        units = file[name].attrs["units"]
        del file[name]
        file.create_dataset(name, **how).attrs["units"] = units  # pyright: ignore[reportArgumentType]

    return spoil


def changed(name: str, row: int, value: float) -> Callable[[h5py.File], None]:
    def spoil(file: h5py.File) -> None:
        file[name][row] = value

    return spoil


def attribute(place: str, name: str, value: object) -> Callable[[h5py.File], None]:
    def spoil(file: h5py.File) -> None:
        file[place].attrs[name] = value

    return spoil


def removed(place: str, name: str | None = None) -> Callable[[h5py.File], None]:
    def spoil(file: h5py.File) -> None:
        if name is None:
            del file[place]
        else:
            del file[place].attrs[name]

    return spoil


def soft_link(file: h5py.File) -> None:
    file["measured/extra"] = h5py.SoftLink("/measured/z")


def external_link(file: h5py.File) -> None:
    file["measured/extra"] = h5py.ExternalLink("/etc/passwd", "/")


def second_hard_link(file: h5py.File) -> None:
    file["measured/fx2"] = file["measured/fx"]


def cycle(file: h5py.File) -> None:
    file["measured/up"] = file["/"]


def external_storage(file: h5py.File) -> None:
    del file["measured/z"]
    external = [("/etc/passwd", 0, 480)]
    file.create_dataset("measured/z", (60,), F8, external=external).attrs["units"] = "m"


def virtual(file: h5py.File) -> None:
    del file["measured/z"]
    layout = h5py.VirtualLayout((60,), F8)
    layout[:] = h5py.VirtualSource("/etc/passwd", "z", (60,))
    file.create_virtual_dataset("measured/z", layout).attrs["units"] = "m"


def named_type(file: h5py.File) -> None:
    file["measured/kind"] = F8


def many_objects(file: h5py.File) -> None:
    for number in range(2500):
        file.create_group(f"measured/l{number}")


def deep_groups(file: h5py.File) -> None:
    node = file["setup"]
    for _ in range(1500):
        node = node.create_group("g")


CASES: dict[str, tuple[Callable[[h5py.File], None], str]] = {
    "no schema": (removed("/", "schema"), "is not a run log"),
    "another schema": (attribute("/", "schema", "drft-fit"), "is a 'drft-fit' file"),
    "newer version": (attribute("/", "schema_version", 2), "newer than 1"),
    "version as text": (attribute("/", "schema_version", "1"), "has schema_version '1'"),
    "infinite version": (attribute("/", "schema_version", np.inf), "has schema_version inf"),
    "version is no number": (attribute("/", "schema_version", np.nan), "has schema_version nan"),
    "no title": (removed("/", "title"), "no attribute title"),
    "no source": (removed("/", "source"), "no attribute source"),
    "unknown source": (attribute("/", "source", "guessed"), "source is 'guessed'"),
    "not closed": (attribute("/", "complete", 0), "was not closed"),
    "no command time": (removed("command/time"), "/command/time is missing"),
    "no omega": (removed("command/omega"), "/command/omega is missing"),
    "no measured time": (removed("measured/time"), "/measured/time is missing"),
    "no measured group": (removed("measured"), "/measured/time is missing"),
    "no command group": (removed("command"), "/command/omega is missing"),
    "no online zeta": (removed("online/zeta"), "/online/zeta is missing"),
    "no tick": (removed("online", "tick"), "/online has no attribute tick"),
    "no event code": (removed("events/code"), "/events/code is missing"),
    "lengths": (replaced("measured/z", data=np.zeros(59), chunks=(59,)), "59 rows but"),
    "no rows": (
        replaced("command/time", shape=(0,), maxshape=(None,), chunks=(1,), dtype=F8),
        "no rows",
    ),
    "repeated time": (changed("command/time", 5, 0.04), "/command/time .* must increase"),
    "falling time": (changed("measured/time", 5, -1.0), "/measured/time .* must increase"),
    "falling event": (changed("events/event_time", 2, 0.0), "/events/event_time .* increase"),
    "nan": (changed("measured/z", 7, np.nan), "/measured/z .*not finite, the first in row 7"),
    "infinity": (changed("measured/time", 7, np.inf), "/measured/time .*not finite"),
    "fraction": (replaced("online/tuned", data=np.full(30, 0.5)), "/online/tuned .*whole"),
    "setup nan": (attribute("setup", "mass_z", np.nan), "mass_z is nan"),
    "setup sign": (attribute("setup", "wheel_radius", -0.1), "wheel_radius is -0.1"),
    "setup text": (attribute("setup", "mass_z", "heavy"), "mass_z = 'heavy'"),
    "huge attribute": (attribute("setup", "mass_z", np.zeros(4000)), "4000 rows"),
    "huge fixed text": (attribute("/", "notes", np.bytes_("n" * 20000)), "notes of 20000 bytes"),
    "wrong units": (attribute("measured/z", "units", "mm"), "units 'mm', they must be 'm'"),
    "matrix": (replaced("measured/z", data=np.zeros((60, 2))), "must be one column"),
    "scalar": (replaced("measured/z", data=1.0), "must be one column"),
    "nothing": (replaced("measured/z", data=h5py.Empty("f8")), "no values at all"),
    "compound": (replaced("measured/z", data=np.zeros(60, [("a", F8)])), "compound type"),
    "complex": (replaced("measured/z", data=np.zeros(60, "c16")), "must be plain numbers"),
    "fixed text": (replaced("measured/z", data=np.full(60, b"x")), "text of fixed length"),
    "free text": (replaced("measured/z", data=["x"] * 60), "text of variable length"),
    "array type": (replaced("measured/z", shape=(60,), dtype="(3,)f8"), "plain numbers"),
    "soft link": (soft_link, "is a soft link to /measured/z"),
    "external link": (external_link, "is an external link to /etc/passwd"),
    "second hard link": (second_hard_link, "is a second link"),
    "cycle": (cycle, "/measured/up is a second link"),
    "external storage": (external_storage, "keeps its data in another file, /etc/passwd"),
    "virtual": (virtual, "is a virtual dataset"),
    "named type": (named_type, "neither a group nor a dataset"),
    "many objects": (many_objects, "has more than 2000 objects"),
    "deep groups": (deep_groups, "deep|damaged|2000 objects"),
    "huge": (replaced("measured/z", shape=(10**12,), chunks=(100,), dtype=F8), "declares"),
    "huge chunk": (
        replaced("measured/z", shape=(60,), maxshape=(None,), chunks=(SIZE_LIMIT // 8,), dtype=F8),
        "declares",
    ),
    "never written": (replaced("measured/z", shape=(60,), chunks=(30,), dtype=F8), "never written"),
}


def plain(file: Path) -> None:
    file.write_text("time,omega\n0,1\n")


def truncated(file: Path) -> None:
    write_run(file, example_run())
    file.write_bytes(file.read_bytes()[:-3000])


def cut_header(file: Path) -> None:
    write_run(file, example_run())
    file.write_bytes(file.read_bytes()[:40])


def part(file: Path) -> None:
    write_run(file, example_run())


def packed(file: Path) -> None:
    write_run(file.with_suffix(".h5"), example_run())
    file.write_bytes(gzip.compress(file.with_suffix(".h5").read_bytes()))


FILES: dict[str, tuple[str, Callable[[Path], None], str]] = {
    "missing": ("a.h5", lambda file: None, "no such file"),
    "empty": ("a.h5", Path.touch, "is empty"),
    "folder": ("a.h5", Path.mkdir, "is a folder"),
    "pipe": ("a.h5", os.mkfifo, "is not an ordinary file"),
    "text": ("a.h5", plain, "is not an HDF5 file"),
    "zipped": ("a.h5.gz", packed, "is not an HDF5 file"),
    "truncated": ("a.h5", truncated, "is cut short"),
    "cut header": ("a.h5", cut_header, "is cut short|is damaged"),
    "recording": ("a.h5.part", part, "was cut off; .*drft log repair"),
}

# Attributes of the format that a reader can do without, and the check cannot.
MILD: dict[str, tuple[Callable[[h5py.File], None], str]] = {
    "no units": (removed("measured/z", "units"), "no attribute units"),
    "contiguous": (replaced("measured/z", data=np.zeros(60)), "is not chunked"),
    "no checksum": (replaced("measured/z", data=np.zeros(60), chunks=(60,)), "no fletcher32"),
    "no scale": (replaced("measured/z", data=np.zeros(60)), "/measured/time as its dimension"),
    "no setup": (removed("setup"), "/setup is missing"),
    "fixed title": (attribute("/", "title", np.bytes_("t")), "title as fixed-length text"),
    "number without a value": (attribute("setup", "mass_z", h5py.Empty("f4")), "mass_z without a"),
    "code as text": (attribute("events/code", "flag_values", "abc"), "'abc' in flag_values"),
    "code that is no number": (
        attribute("events/code", "flag_values", np.array([np.nan, 3.0])),
        "nan in flag_values",
    ),
    "odd attribute": (attribute("/", "map", np.zeros((2, 2))), "neither number nor text"),
}


@pytest.fixture(scope="module")
def hostile(tmp_path_factory) -> dict[str, tuple[Path, str]]:
    """Every case as a file on disk, with the reason that must be given."""
    folder = tmp_path_factory.mktemp("hostile")
    write_run(folder / "good.h5", example_run())
    good = (folder / "good.h5").read_bytes()
    made: dict[str, tuple[Path, str]] = {}
    for name, (spoil, reason) in (CASES | MILD).items():
        path = folder / f"{name}.h5"
        path.write_bytes(good)
        with h5py.File(path, "r+") as file:
            spoil(file)
        made[name] = (path, reason)
    for name, (title, make, reason) in FILES.items():
        path = folder / name.replace(" ", "_") / title
        path.parent.mkdir()
        make(path)
        made[name] = (path, reason)
    return made


@pytest.mark.parametrize("name", [*CASES, *FILES])
def test_a_hostile_file_is_refused_with_its_name_and_the_reason(hostile, name):
    path, reason = hostile[name]
    with pytest.raises(InputError, match=reason) as caught:
        read_run(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_check_finds_what_is_wrong_with_every_file(hostile):
    found = check_files([path for path, _ in hostile.values()])
    for (name, (_, reason)), violations in zip(hostile.items(), found, strict=True):
        reasons = [str(each) for each in violations if each.level is not Level.NOTE]
        assert re.search(reason, "\n".join(reasons)), (name, reasons)


@pytest.mark.parametrize("name", MILD)
def test_what_only_the_check_minds_is_read(hostile, name):
    assert read_run(hostile[name][0]).measured.time.size == 60


@pytest.mark.parametrize("kind", ["S1", h5py.string_dtype()])
def test_text_without_a_value_is_empty_text(tmp_path, kind):
    path = tmp_path / "run.h5"
    write_run(path, example_run())
    with h5py.File(path, "r+") as file:
        file.attrs["title"] = h5py.Empty(kind)
        file["measured/x"].attrs["comment"] = h5py.Empty(kind)
    assert read_run(path).title == ""
    assert all("as fixed-length text" in each.reason for each in check_file(path))


def test_a_code_that_is_no_whole_number_has_no_meaning(hostile):
    events = read_run(hostile["code that is no number"][0]).events
    assert events is not None
    assert list(events.meanings) == [3]


def test_the_check_lists_every_violation(tmp_path):
    path = tmp_path / "run.h5"
    write_run(path, example_run())
    with h5py.File(path, "r+") as file:
        soft_link(file)
        file["measured/z"][3] = np.nan
        file["command/time"][5] = 0.0
        file.attrs["source"] = "me"
        file["setup"].attrs["mass_x"] = -1.0
        del file["measured/fz"].attrs["units"]
    places = {each.where for each in check_file(path)}
    assert places == {
        *("/measured/extra", "/measured/z", "/command/time"),
        *("/", "/setup", "/measured/fz"),
    }


def test_a_name_that_is_not_read_is_a_note(tmp_path):
    path = tmp_path / "run.h5"
    write_run(path, example_run())
    with h5py.File(path, "r+") as file:
        file["measured"].create_dataset("torqe", data=np.zeros(60), chunks=(60,), fletcher32=True)
        file["setup"].attrs["whell_radius"] = 0.1
    violations = check_file(path)
    assert {each.level for each in violations} == {Level.NOTE}
    assert any("did you mean 'torque'" in each.reason for each in violations)
    assert any("did you mean 'wheel_radius'" in each.reason for each in violations)
    assert CliRunner().invoke(app, ["check", str(path)]).exit_code == 0


def test_a_file_cannot_steer_the_terminal(tmp_path):
    path = tmp_path / "run.h5"
    write_run(path, dataclasses.replace(example_run(), title="a\x1b[2Jb", notes="c\x07\nd"))
    shown = CliRunner().invoke(app, ["show", str(path)]).stdout
    assert "a\ufffd[2Jb" in shown
    with h5py.File(path, "r+") as file:
        file["measured/e\nf\x1b"] = h5py.SoftLink("/g\nh")
    (violation,) = check_file(path)
    assert "\n" not in str(violation)
    assert "\x1b" not in str(violation)


def test_a_run_that_is_being_recorded_is_refused(tmp_path):
    path = tmp_path / "run.h5"
    with h5py.File(path, "w", libver=("v110", "v110")) as file:
        file.attrs["schema"] = "drft-run"
        file.swmr_mode = True
        (violation,) = check_file(path)
    assert "still being recorded" in violation.reason or "open for writing" in violation.reason


def test_the_check_command_names_every_file_and_exits_with_2(hostile):
    names = ["nan", "cycle", "text", "truncated"]
    paths = [str(hostile[name][0]) for name in names]
    result = CliRunner().invoke(app, ["check", *paths])
    assert result.exit_code == 2
    lines = result.stdout.splitlines()
    for path in paths:
        assert any(line.startswith(f"{path}: ") for line in lines)
    assert not any(line.endswith(": ok") for line in lines)


def test_the_program_refuses_with_a_sentence_and_no_traceback(hostile, tmp_path):
    path, reason = hostile["nan"]
    command = [sys.executable, "-m", "drftjax.commands.main", "log"]
    figure = str(tmp_path / "a.png")
    done = subprocess.run(
        [*command, "plot", str(path), "-o", figure], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert re.search(reason, done.stderr)
    assert "Traceback" not in done.stderr
    assert not Path(figure).exists()


def test_a_reader_imports_neither_jax_nor_a_plotting_library():
    code = (
        "import sys; import drftjax.commands.log, drftjax.runlog.hdf5.api, drftjax.runlog.check; "
        "sys.exit(bool({'jax', 'matplotlib', 'scipy'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
