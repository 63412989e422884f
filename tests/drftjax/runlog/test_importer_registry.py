"""Importers are chosen by suffix, and packages add their own."""

import os
import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.runlog.hdf5.api import read_run
from drftjax.runlog.importers.base import ImportedRun
from drftjax.runlog.importers.layout import Layout
from drftjax.runlog.importers.mapped_runs import import_named_runs
from drftjax.runlog.importers.readers import registry as readers
from drftjax.runlog.importers.readers.registry import READERS
from drftjax.runlog.importers.registry import GROUP, importer_for, suffixes
from drftjax.runlog.importers.table import Table
from drftjax.runlog.record import Measured, RecordedCommand, RecordedSetup, RunLog

BAG_IMPORTER = """
import numpy as np
from drftjax.runlog.importers.base import ImportedRun
from drftjax.runlog.importers.table import Table
from drftjax.runlog.record import Measured, RecordedCommand, RecordedSetup, RunLog

def read_bag(path, mapping):
    values = np.array([float(each) for each in path.read_text().split()])
    time = 0.1 * np.arange(values.size)
    yield ImportedRun(path.stem, RunLog(
        setup=RecordedSetup(), command=RecordedCommand(time, 0 * time + 1),
        measured=Measured(time, z=values), source="imported", title=f"bag {mapping}",
    ))
"""


def read_bag(path: Path, mapping: Path | None) -> list[ImportedRun]:
    time = np.arange(2.0)
    command, measured = RecordedCommand(time, time), Measured(time, z=-time)
    run = RunLog(
        setup=RecordedSetup(), command=command, measured=measured, source="imported", title="a bag"
    )
    return [ImportedRun(path.stem, run)]


NO_FUNCTION = "a bag"


def read_dump(path: Path, layout: Layout) -> list[Table]:
    columns = (np.array([0.0, 0.1]), np.array([60.0, 60.0]), np.array([-1.0, -2.0]))
    return [Table(path, ("t", "w", "z"), columns, [1, 2], row_word="record", units={"z": "mm"})]


@pytest.fixture
def install(monkeypatch):
    """Pretend that packages add these importers: suffix and function of this module."""

    def added(*pairs: tuple[str, str], to: str = GROUP) -> None:
        entries = [EntryPoint(name, f"{__name__}:{value}", to) for name, value in pairs]
        monkeypatch.setattr(readers, "entry_points", lambda group: entries if group == to else [])

    return added


@pytest.mark.parametrize("name", ["a.csv", "a.tsv", "a.txt.gz", "a.dat", "a", "a.CSV.gz", ".csv"])
def test_tables_and_unknown_files_are_read_as_tables(name):
    assert importer_for(Path(name)) is import_named_runs


@pytest.mark.parametrize("name", ["run.rig", "run.RIG", "run.rig.gz"])
def test_a_package_adds_an_importer(install, name):
    install(("rig", "read_bag"))
    (imported,) = importer_for(Path(name))(Path(name), None)
    assert imported.run.title == "a bag"
    assert importer_for(Path("run.csv")) is import_named_runs
    assert suffixes() == [*READERS, ".rig"]


def test_a_package_adds_a_reader_whose_columns_a_mapping_explains(install, tmp_path):
    install(("dump", "read_dump"), to=readers.GROUP)
    (tmp_path / "run.dump").write_text("")
    (tmp_path / "map.toml").write_text(
        'rows = "samples"\ntitle = "{file}"\n[time]\ncolumn = "t"\n'
        '[command]\nomega = { column = "w", unit = "rpm" }\n[measured]\nz = { column = "z" }\n'
    )
    path = tmp_path / "run.dump"
    ((run, name),) = [(r.run, r.name) for r in importer_for(path)(path, tmp_path / "map.toml")]
    assert name == "run"
    np.testing.assert_allclose(run.command.omega, 2 * np.pi)
    np.testing.assert_allclose(run.measured.z, [-0.001, -0.002])
    assert suffixes()[-1] == ".dump"
    install(("mat", "read_dump"), to=readers.GROUP)
    with pytest.raises(InputError, match=r"files \.mat are claimed by drftjax and .*:read_dump"):
        readers.reader_for(tmp_path / "run.mat")


def test_an_importer_that_cannot_be_used_is_named(install):
    install(("rig", "absent"), ("rec", "NO_FUNCTION"), ("csv", "read_bag"))
    with pytest.raises(InputError, match=r"the importer \.rig of .*:absent fails: "):
        importer_for(Path("run.rig"))
    with pytest.raises(InputError, match=r"the importer \.rec of .* is no function"):
        importer_for(Path("run.rec"))
    with pytest.raises(InputError, match=r"files \.csv are claimed by drftjax and .*:read_bag"):
        importer_for(Path("run.csv"))
    assert importer_for(Path("run.tsv")) is import_named_runs


def test_drft_imports_the_format_of_an_installed_package(tmp_path):
    metadata = tmp_path / "site" / "sandbox-1.2.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: sandbox\nVersion: 1.2\n")
    (metadata / "entry_points.txt").write_text("[drft.importers]\nrig = sandbox_bag:read_bag\n")
    (tmp_path / "site" / "sandbox_bag.py").write_text(BAG_IMPORTER)
    (tmp_path / "dune.rig").write_text("0.0 -0.01 -0.02")
    path = os.pathsep.join([str(tmp_path / "site"), os.environ.get("PYTHONPATH", "")])

    def drft(*arguments: str) -> str:
        command = [sys.executable, "-m", "drftjax.commands.main", "log", "import", *arguments]
        environment = os.environ | {"PYTHONPATH": path, "COLUMNS": "100"}
        answer = subprocess.run(
            command, env=environment, cwd=Path(__file__).parents[3], capture_output=True, text=True
        )
        assert answer.returncode == 0, answer.stderr
        return answer.stdout

    drft(str(tmp_path / "dune.rig"), "-o", str(tmp_path / "runs"))
    run = read_run(tmp_path / "runs" / "dune.h5")
    assert (run.title, run.measured.z.tolist()) == ("bag None", [0.0, -0.01, -0.02])
    assert ".csv, .tsv, .txt," in drft("--help")
    assert ".rig; others" in drft("--help")


def test_a_table_without_a_mapping_is_refused(drft, tmp_path):
    (tmp_path / "table.csv").write_text("t,z\n0,0\n")
    answer = drft("log", "import", tmp_path / "table.csv", "-o", tmp_path / "runs")
    assert "give --mapping, which says what the columns of a table mean" in answer.refusal
