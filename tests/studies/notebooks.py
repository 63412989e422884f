"""The notebooks with their outputs: runs all, or those named, and stores what they show.

    python -m tests.studies.notebooks [NAME ...]

A name is that of a file without its suffix, or its beginning.
"""

import sys
import tempfile
from pathlib import Path

import nbformat

from tests.helpers.notebooks import (
    FOLDER,
    NOTEBOOKS,
    copy_of,
    errors,
    plain,
    run_notebooks,
)


def main(names: list[str]) -> int:
    chosen = [path for path in NOTEBOOKS if not names or path.stem.startswith(tuple(names))]
    failed = False
    with tempfile.TemporaryDirectory() as folder:
        copies = copy_of(Path(folder), chosen, measured=True)
        for path, run in zip(chosen, run_notebooks(copies), strict=True):
            print(f"{path.stem}: {run.cpu_s:.1f} s of processor time", *errors(run.notebook))
            failed |= bool(errors(run.notebook))
            nbformat.write(plain(run.notebook), path)
    size = sum(path.stat().st_size for path in FOLDER.iterdir())
    print(f"{FOLDER.name}: {size / 1e3:.0f} kB")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
