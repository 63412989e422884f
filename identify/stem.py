"""Where results go: files that share a stem and differ in their endings."""

from collections.abc import Sequence
from pathlib import Path

from drftjax.errors import InputError


def stem_of(output: Path, endings: Sequence[str]) -> Path:
    """What was given for a stem, without the ending if it has one of the results'.

    Raises:
        InputError: where it is a folder.
    """
    if output.is_dir() or not output.name:
        raise InputError(f"{output} is a folder; name the result too, such as {output / 'fit'}")
    return output.with_suffix("") if output.suffix in endings else output


def files_of(stem: Path, endings: Sequence[str]) -> list[Path]:
    """A file for each ending, after all of the stem's name: it may hold dots."""
    return [stem.with_name(stem.name + ending) for ending in endings]
