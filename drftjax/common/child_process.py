"""Processes of this program's own, started without the environment's say in what they import."""

import sys
from pathlib import Path

# As this package was found; a resolved link would be another entry of the path.
_ROOT = str(Path(__file__).absolute().parents[2])


def program(module: str, function: str) -> str:
    """Text for `python -I -c` that calls a function of a module, found where this process finds it.

    Without this process's path a child would import the installed packages where this one runs
    another copy of them.

    Args:
        module: Its full name.
        function: Takes no arguments.
    """
    path = list(dict.fromkeys(each or _ROOT for each in sys.path))
    if _ROOT not in path:
        path.insert(0, _ROOT)
    return f"import sys; sys.path[:] = {path!r}; from {module} import {function}; {function}()"
