"""Differences between two JSON files of one kind of result: numbers and texts by their place."""

import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class DifferenceSettings:
    """Numbers by which a difference is more than rounding.

    Attributes:
        relative: Difference, as a share of a number, of a value or its error if larger, or of the
            largest number in its list, up to which it is rounding. Other sums and other compilers
            move a fit by 1e-13 of its values; solvers stop at 1e-6 and more of an error, so that
            a fit that stops elsewhere is seen.
        absolute: Difference up to which it is rounding, whatever the number: sums of numbers of
            the size of one, which cancel, leave as much [units of the number].
        ignored: Entries of the file that say when and by what it was made.
    """

    relative: float = 1e-9
    absolute: float = 1e-14
    ignored: tuple[str, ...] = ("provenance", "software")


DIFFERENCE_SETTINGS = DifferenceSettings()


@dataclass(frozen=True)
class ResultDifference:
    """One place at which two results differ by more than rounding.

    Attributes:
        place: Its path in the file, such as "runs[slow_a].values.terrain.zeta.value".
        before, after: What stands there, in words; "-" for nothing.
        relative: ResultDifference as a share of the larger number; None where it is no number.
        errors: ResultDifference in standard errors, where one stands beside the number.
    """

    place: str
    before: str
    after: str
    relative: float | None = None
    errors: float | None = None

    @property
    def size(self) -> str:
        """Size of the difference in words; empty for a text."""
        if self.errors is not None:
            return f"{self.errors:.2g} errors"
        return "" if self.relative is None else f"{self.relative:.2g} of it"

    @property
    def rank(self) -> tuple[int, float]:
        """Key by which the weightiest come first: values with errors, texts, other numbers."""
        if self.errors is not None:
            return 0, -self.errors
        return (1, 0.0) if self.relative is None else (2, -self.relative)


@dataclass(frozen=True)
class ResultComparison:
    """Two results, entry by entry.

    Attributes:
        numbers: How many numbers both hold.
        rounded: How many of them differ, but by no more than rounding.
        largest_rounding: Largest of those differences, as a share of its number.
        differences: All else that differs, the weightiest first.
    """

    numbers: int
    rounded: int
    largest_rounding: float
    differences: tuple[ResultDifference, ...]


def compare_results(
    before: Mapping[str, Any],
    after: Mapping[str, Any],
    settings: DifferenceSettings = DIFFERENCE_SETTINGS,
) -> ResultComparison:
    """Compare two results entry by entry.

    Lists of numbers count as one entry, whose largest difference is reported; tables with a name
    are matched by it.

    Args:
        before, after: Plain values of their JSON files.
        settings: Numbers by which a difference is more than rounding.
    """
    walk = _Walk(settings)
    found = list(walk.tables(before, after, "", settings.ignored))
    found.sort(key=lambda each: each.rank)
    return ResultComparison(walk.numbers, walk.rounded, walk.largest, tuple(found))


class _Walk:
    """Walk through two documents that counts the numbers which it passes."""

    def __init__(self, settings: DifferenceSettings):
        self._settings = settings
        self.numbers = self.rounded = 0
        self.largest = 0.0

    def tables(
        self,
        before: Mapping[str, Any],
        after: Mapping[str, Any],
        place: str,
        ignored: Sequence[str] = (),
    ) -> Iterator[ResultDifference]:
        """Differences of two tables of entries."""
        error = before.get("error")
        for key in dict.fromkeys([*before, *after]):
            if key in ignored:
                continue
            inner = f"{place}.{key}" if place else key
            if key not in after or key not in before:
                yield ResultDifference(inner, _words(before.get(key)), _words(after.get(key)))
            else:
                beside = error if key == "value" and _is_number(error) else None
                yield from self._entries(before[key], after[key], inner, beside)

    def _entries(
        self, before: Any, after: Any, place: str, error: float | None = None
    ) -> Iterator[ResultDifference]:
        """Differences of two entries of any kind.

        Args:
            before, after: The entries.
            place: Their path.
            error: Standard error that stands beside them.
        """
        if isinstance(before, dict) and isinstance(after, dict):
            yield from self.tables(before, after, place)
        elif _is_number(before) and _is_number(after):
            yield from self._arrays(np.array(before, float), np.array(after, float), place, error)
        elif isinstance(before, list) and isinstance(after, list):
            yield from self._lists(before, after, place)
        elif before != after or isinstance(before, bool) != isinstance(after, bool):
            yield ResultDifference(place, _words(before), _words(after))

    def _lists(self, before: list, after: list, place: str) -> Iterator[ResultDifference]:
        """Differences of two lists: arrays of numbers, tables by name, or other entries."""
        first, second = _array(before), _array(after)
        if first is not None and second is not None and first.size and first.shape == second.shape:
            yield from self._arrays(first, second, place)
        elif names := _names(before, after):
            tables = [{each["name"]: each for each in listed} for listed in (before, after)]
            for name in names:
                one, other = (table.get(name) for table in tables)
                yield from self._entries(one, other, f"{place}[{name}]")
        elif len(before) == len(after):
            for number, pair in enumerate(zip(before, after, strict=True)):
                yield from self._entries(*pair, f"{place}[{number}]")
        elif all(isinstance(each, str) for each in before + after):
            yield from (ResultDifference(place, each, "-") for each in before if each not in after)
            yield from (ResultDifference(place, "-", each) for each in after if each not in before)
        else:
            yield ResultDifference(place, _words(before), _words(after))

    def _arrays(
        self, before: np.ndarray, after: np.ndarray, place: str, error: float | None = None
    ) -> Iterator[ResultDifference]:
        """Difference of two arrays of one shape, or of two numbers; NaN stands for no number."""
        self.numbers += before.size
        both = np.isfinite(before) & np.isfinite(after)
        with np.errstate(over="ignore"):
            apart = np.where(both, np.abs(np.where(both, after - before, 0.0)), 0.0)
        size = max(float(np.abs(each[both]).max(initial=0.0)) for each in (before, after))
        scale = max(size, abs(error) if error is not None else 0.0)
        same = (before == after) | (np.isnan(before) & np.isnan(after))
        allowed = max(self._settings.relative * scale, self._settings.absolute)
        beyond = ~same & ~(both & (apart <= allowed))
        if beyond.any():
            worst = np.where(both, apart, np.where(same, 0.0, np.inf)).argmax()
            at = np.unravel_index(worst, apart.shape)
            index = "".join(f"[{each}]" for each in at)
            relative = float(apart[at]) / size if both[at] else math.inf
            errors = float(apart[at] / abs(error)) if error and both[at] else None
            first, second = (_words(each[at].item()) for each in (before, after))
            yield ResultDifference(place + index, first, second, relative, errors)
        else:
            self.rounded += int((~same).sum())
            if size:
                self.largest = max(self.largest, float(apart.max(initial=0.0)) / size)


def _is_number(value: Any) -> bool:
    """True for a number of a size that floating-point numbers have."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return isinstance(value, float) or abs(value) <= sys.float_info.max


def _array(values: list) -> np.ndarray | None:
    """Nested list of numbers and nulls as an array; None for any other list."""
    flat = list(_leaves(values))
    if not any(map(_is_number, flat)) or not all(v is None or _is_number(v) for v in flat):
        return None
    try:
        return np.array(values, float)
    except (ValueError, OverflowError):  # lists of several lengths
        return None


def _leaves(value: Any) -> Iterator[Any]:
    if isinstance(value, list):
        for each in value:
            yield from _leaves(each)
    else:
        yield value


def _names(*lists: list) -> list[str]:
    """Names of the tables in lists, each once; none where one lacks a name, or has another's."""
    found: dict[str, None] = {}
    for each in lists:
        names = [t["name"] for t in each if isinstance(t, dict) and isinstance(t.get("name"), str)]
        if len(names) < len(each) or len(set(names)) < len(names):
            return []
        found |= dict.fromkeys(names)
    return list(found)


def _words(value: Any) -> str:
    """An entry in words of one line."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    if isinstance(value, dict):
        return f"a table of {len(value)} entries"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    return f"{value:.10g}" if isinstance(value, float) else str(value)
