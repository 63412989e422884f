"""The notebooks, run in copies, one after the other in one kernel.

One kernel imports and compiles once for all of them. Before each notebook its names are emptied, so
that none leans on another; a cell that fails leaves its error among the outputs, and the next
notebook goes on.
"""

import os
import shutil
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode
from nbformat.v4 import new_code_cell, new_notebook

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))

# Only so that a cell that hangs ends: a whole notebook takes under a minute by itself, and many
# times that on a machine that is busy with other work. How fast it is, no test says.
HANGS_S = 600.0

# No name of the notebook before; pictures of a width that is read beside text, so that files are
# small.
FRESH = """%reset -f
%matplotlib inline
%config InlineBackend.print_figure_kwargs = {'dpi': 70, 'bbox_inches': 'tight'}"""
CLOCK = "import time as _t; print(_t.process_time())"

# What tests and commands choose for JAX must not carry the notebooks, which set it up themselves;
# and the kernel draws in the notebook, as a reader's does.
LEFT_OUT = ("JAX_ENABLE_X64", "JAX_NUMPY_DTYPE_PROMOTION", "MPLBACKEND")


def copy_of(folder: Path, notebooks: Sequence[Path], *, measured: bool) -> list[Path]:
    """Copies of notebooks beside the data that they read.

    Args:
        folder: Empty, gets a repository of copies and links.
        notebooks: Files to copy.
        measured: The folder of measured data, if there is one, lies beside the repository.
    """
    copies = folder / "repository" / "notebooks"
    copies.mkdir(parents=True)
    for name in ("data", "docs"):
        (copies.parent / name).symlink_to(ROOT / name)
    shared = ROOT.parent / "shared"
    if measured and shared.is_dir():
        (folder / "shared").symlink_to(shared.resolve())
    return [Path(shutil.copy(path, copies)) for path in notebooks]


class NotebookRun(NamedTuple):
    """A notebook with its outputs, and the processor time that its cells took [s]."""

    notebook: NotebookNode
    cpu_s: float


def run_notebooks(paths: Sequence[Path]) -> list[NotebookRun]:
    """Run notebooks in their folders, in one kernel."""
    found = [nbformat.read(path, as_version=4) for path in paths]
    marks = [new_code_cell(f"{FRESH}\n%cd -q {path.parent}\n{CLOCK}") for path in paths]
    marks.append(new_code_cell(CLOCK))
    cells = [marks[0]]
    for notebook, mark in zip(found, marks[1:], strict=True):
        cells += [*notebook.cells, mark]
    joined = new_notebook()
    joined.cells = cells  # the very cells of the notebooks, so that these get their outputs
    env = {name: value for name, value in os.environ.items() if name not in LEFT_OUT}
    env["PYTHONPATH"] = os.pathsep.join([str(ROOT), *filter(None, [env.get("PYTHONPATH")])])
    client = NotebookClient(
        joined, timeout=HANGS_S, kernel_name="python3", allow_errors=True, coalesce_streams=True
    )
    client.execute(env=env)
    times = [float(mark.outputs[0].text) for mark in marks]
    spans = (after - before for before, after in pairwise(times))
    return [NotebookRun(*each) for each in zip(found, spans, strict=True)]


def errors(notebook: NotebookNode) -> list[str]:
    """Errors among a notebook's outputs, each in one line."""
    return [
        f"{output.ename}: {output.evalue}"
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        if output.output_type == "error"
    ]


def printed(notebook: NotebookNode) -> list[str]:
    """Text of every output, pictures left out."""
    texts = []
    for cell in notebook.cells:
        for output in cell.get("outputs", []):
            text = output.get("text") or output.get("data", {}).get("text/plain", "")
            if text and not text.startswith("<Figure"):
                texts.append(text.strip())
    return texts


def plain(notebook: NotebookNode) -> NotebookNode:
    """The notebook as it is stored: outputs, and nothing of the machine that made them."""
    for cell in notebook.cells:
        cell.metadata = {}
        cell.pop("execution_count", None)
        if cell.cell_type != "code":
            continue
        cell.execution_count = None
        for output in cell.outputs:
            output.pop("transient", None)
            if "execution_count" in output:
                output.execution_count = None
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    notebook.metadata = {"kernelspec": kernel, "language_info": {"name": "python"}}
    return notebook
