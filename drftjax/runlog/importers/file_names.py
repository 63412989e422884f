"""Safe file names for imported runs."""

import re
import unicodedata
from collections import Counter
from collections.abc import Sequence
from typing import Final

MAX_LENGTH: Final = 100


def safe_names(names: Sequence[str]) -> list[str]:
    """File names without suffix: no folder, no character that a shell interprets, no duplicate.

    Duplicates are numbered in their order: drive, drive_2, drive_3.
    """
    taken: set[str] = set()
    numbers: Counter[str] = Counter()
    given: list[str] = []
    for name in map(_safe, names):
        candidate = name
        # Names that differ only in case are one file on some systems.
        while candidate.lower() in taken:
            numbers[name] += 1
            candidate = f"{name}_{numbers[name] + 1}"
        taken.add(candidate.lower())
        given.append(candidate)
    return given


def _safe(name: str) -> str:
    """Name with only letters, digits and a few marks."""
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    return re.sub(r"[^A-Za-z0-9.+-]+", "_", plain).strip("_.-")[:MAX_LENGTH] or "run"
