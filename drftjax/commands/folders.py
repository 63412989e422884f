"""Folders of results, where a command is refused after it has made them."""

from collections.abc import Callable
from contextlib import suppress
from functools import wraps
from pathlib import Path


def leaves_no_empty_folder(command: Callable[..., None]) -> Callable[..., None]:
    """The command, but a folder for its results that it made goes again if it stays empty."""

    @wraps(command)
    def tidy(*given: object, **named: object) -> None:
        places = [each for each in (*given, *named.values()) if isinstance(each, Path)]
        new = {folder for each in places for folder in (each, *each.parents) if not folder.exists()}
        try:
            command(*given, **named)
        finally:
            for folder in sorted(new, reverse=True):  # those inside others first
                with suppress(OSError):
                    folder.rmdir()

    return tidy
