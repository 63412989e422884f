"""Finding the data that ships with the project, in a checkout and in an installed copy."""

from pathlib import Path
from typing import Final

from drftjax.common.errors import InputError

_PACKAGE: Final = Path(__file__).resolve().parents[1]


_HOMES: Final = (_PACKAGE / "_data", _PACKAGE.parent / "data")


def data_file(name: str) -> Path:
    """The file of that name below data/, such as "import/cmu_intrusion.toml"."""
    for home in _HOMES:
        if (home / name).is_file():
            return home / name
    raise InputError(f"there is no {name} in the data that ships with the project")


def data_names(folder: str, suffix: str) -> list[str]:
    """Names, without the suffix, of the files in a folder below data/."""
    found = {each.stem for home in _HOMES for each in (home / folder).glob(f"*{suffix}")}
    return sorted(found)
