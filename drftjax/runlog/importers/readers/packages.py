"""Packages that read a format of their own, imported when such a file is read."""

import errno
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from drftjax.common.errors import InputError


def required_package(module: str, distribution: str, path: Path, what: str = "reading") -> Any:
    """Import a module of the optional packages.

    Args:
        module: Name of the module.
        distribution: Name under which it is installed.
        path: File that needs it.
        what: Verb for the file, "reading" or "writing".

    Raises:
        InputError: it is not installed; names the extra that brings it.
    """
    try:
        return import_module(module)
    except ImportError:
        suffix = path.suffix.lower() or "this folder"
        raise InputError(
            f"{path}: {what} {suffix} needs {distribution}: pip install 'drftjax[formats]'"
        ) from None


@contextmanager
def silenced() -> Iterator[None]:
    """Keep packages from warning and logging, which would reach the user in their own words."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(before)


def unreadable(path: Path, kind: str, error: Exception) -> InputError:
    """Refusal of a file that a format's package cannot read.

    Args:
        path: The file.
        kind: Format that it must have, with its article.
        error: What the package raised; only a reason of the system is passed on.
    """
    # A reader that leaps outside a damaged file gets EINVAL, which says nothing of the file.
    if isinstance(error, OSError) and error.strerror and error.errno != errno.EINVAL:
        return InputError(f"{path}: cannot be read: {error.strerror.lower()}")
    return InputError(f"{path}: cannot be read as {kind}; it is damaged, or of another kind")
