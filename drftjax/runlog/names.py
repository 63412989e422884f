"""File names for runs, from whatever a table calls them."""

import re
import unicodedata
from collections import Counter
from collections.abc import Sequence
from typing import Final

LONGEST: Final = 100


def safe_names(names: Sequence[str]) -> list[str]:
    """One file name each, without the suffix: no path, no surprise to a shell, no two alike.

    Names that fall together are numbered in their order: drive, drive_2, drive_3.
    """
    seen: Counter[str] = Counter()
    given: list[str] = []
    for name in map(_safe, names):
        # Names that differ only in case are one file on some systems.
        seen[name.lower()] += 1
        numbered = name if seen[name.lower()] == 1 else f"{name}_{seen[name.lower()]}"
        while numbered.lower() in {each.lower() for each in given}:
            seen[name.lower()] += 1
            numbered = f"{name}_{seen[name.lower()]}"
        given.append(numbered)
    return given


def _safe(name: str) -> str:
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    return re.sub(r"[^A-Za-z0-9.+-]+", "_", plain).strip("_.-")[:LONGEST] or "run"
