"""Command line of a child process that imports the same packages as its parent."""

import sys
from pathlib import Path

# As this package was found; a resolved link would be a different entry of the path.
_ROOT = str(Path(__file__).absolute().parents[2])


def program(module: str, function: str) -> str:
    """Return the text for `python -I -c` that calls a function with this process's import path.

    Without that path the child would import the installed packages where this process runs
    another copy of them.

    Args:
        module: Full name of the module.
        function: Name of a function without arguments.
    """
    path = list(dict.fromkeys(each or _ROOT for each in sys.path))
    if _ROOT not in path:
        path.insert(0, _ROOT)
    return f"import sys; sys.path[:] = {path!r}; from {module} import {function}; {function}()"
