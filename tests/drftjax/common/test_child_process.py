"""Child processes import the very packages that their parent does."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]

PARENT = """
import importlib, subprocess, sys
import drftjax
start = importlib.import_module(sys.argv[1])._START
call = start.rpartition("; ")[2]
look = "import drftjax; print(drftjax.__file__)"
child = [sys.executable, "-I", "-c", start.removesuffix(call) + look]
print(drftjax.__file__, subprocess.check_output(child, text=True), sep="\\n")
"""


@pytest.fixture(scope="module")
def copy(tmp_path_factory) -> Path:
    """Another copy of the packages than the installed one."""
    folder = tmp_path_factory.mktemp("copy of the packages")
    for each in ("drftjax", "hils"):
        kept = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / each, folder / each, ignore=kept)
    return folder


@pytest.mark.parametrize(
    "module", ["hils.recording.recorder", "hils.monitor.live_view", "drftjax.runlog.safe_reader"]
)
@pytest.mark.parametrize("found", ["by PYTHONPATH", "in the working directory"])
def test_a_child_imports_the_copy_that_its_parent_runs(copy, module, found):
    environment = {each: value for each, value in os.environ.items() if each != "PYTHONPATH"}
    if found == "by PYTHONPATH":
        environment["PYTHONPATH"] = str(copy)
    said = subprocess.check_output(
        [sys.executable, "-c", PARENT, module],
        cwd=copy if found == "in the working directory" else copy.parent,
        env=environment,
        text=True,
    )
    parent, child, *_ = said.splitlines()
    assert parent == child == str(copy / "drftjax" / "__init__.py")


def test_a_child_finds_what_its_parent_finds(monkeypatch, tmp_path):
    from drftjax.common.child_process import program

    (tmp_path / "beside_it.py").write_text("def speak():\n    print('heard')\n")
    monkeypatch.syspath_prepend(tmp_path)
    said = subprocess.check_output([sys.executable, "-I", "-c", program("beside_it", "speak")])
    assert said == b"heard\n"
