"""Every notebook runs from top to bottom, in a copy, and leaves nothing behind."""

import os
import shutil
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))

# Only so that a cell that hangs ends: a whole notebook takes under a minute by itself, and some
# more beside other tests where nothing is compiled yet. How fast it is, no test says.
HANGS_S = 240.0


def test_there_are_notebooks():
    assert NOTEBOOKS


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path, tmp_path, monkeypatch):
    # Notebooks set JAX up themselves; what the tests chose for it must not carry them.
    for name in ("JAX_ENABLE_X64", "JAX_NUMPY_DTYPE_PROMOTION"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), str(ROOT / "tests")]))
    # The kernel draws in the notebook, as a reader's does.
    monkeypatch.delenv("MPLBACKEND", raising=False)
    copy = tmp_path / "notebooks" / path.name
    copy.parent.mkdir()
    shutil.copy(path, copy)
    (tmp_path / "data").symlink_to(ROOT / "data")
    notebook = nbformat.read(copy, as_version=4)
    nbformat.validate(notebook)
    client = NotebookClient(
        notebook,
        timeout=HANGS_S,
        kernel_name="python3",
        resources={"metadata": {"path": str(copy.parent)}},
    )
    client.execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    # A result shows itself once: its table is not printed beside.
    for cell in notebook.cells:
        assert sum("text/html" in each.get("data", {}) for each in cell.get("outputs", [])) <= 1


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_kept_without_outputs(path):
    for cell in nbformat.read(path, as_version=4).cells:
        assert not cell.get("outputs")
        assert cell.get("execution_count") is None
