"""Text summary of one run: its set-up, and rows, rate, range and last value of each channel."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Group as Stack
from rich.text import Text

from drftjax.common.rich_text import WholeWordTable, summary_html
from drftjax.common.text import replace_unprintable
from drftjax.runlog.record import Events, RunLog
from drftjax.runlog.schema import UNITS


@dataclass(frozen=True)
class Channel:
    """Numbers of one channel, in its unit.

    Attributes:
        name: Group and column, such as "measured/z".
        unit: SI unit.
        rows: Number of rows.
        rate: Mean number of rows in a second [1/s]; None for a single row.
        low: Smallest value.
        high: Largest value.
        last: Last value.
    """

    name: str
    unit: str
    rows: int
    rate: float | None
    low: float
    high: float
    last: float


def channels(run: RunLog) -> Iterator[Channel]:
    """Channels of a run, group by group."""
    for title, record in (
        ("command", run.command),
        ("measured", run.measured),
        ("online", run.online),
    ):
        if record is None:
            continue
        rate = _rate(record.time)
        for name, unit in UNITS[title].items():
            values: NDArray[Any] | None = getattr(record, name)
            if values is not None:
                ends = float(values.min()), float(values.max()), float(values[-1])
                yield Channel(f"{title}/{name}", unit, values.size, rate, *ends)


def show(path: str, run: RunLog) -> Stack:
    """Text that `drft log show` prints for one file.

    Args:
        path: Name of the file.
        run: Its contents.
    """
    lines = [
        Text(path, style="bold"),
        Text(f"{replace_unprintable(run.title)} ({run.source})"),
        *(Text(f"{name}: {text}") for name, text in _provenance(run)),
        Text("set-up: " + (", ".join(_setup(run)) or "nothing is known")),
    ]
    if run.events is not None:
        lines.append(Text(f"events: {run.events.code.size}"))
        lines += [Text(f"  {each}") for each in _events(run.events)]
    return Stack(*lines, _table(run))


def one_line(run: RunLog) -> str:
    """A run in a line: title, source, duration, and the last value of each channel."""
    measured = run.measured
    lasts = measured.time[-1] - measured.time[0]
    ends = (
        f"{name} {values[-1]:.4g} {UNITS['measured'][name]}"
        for name, values in measured.channels().items()
    )
    title = replace_unprintable(run.title)
    return f"{title!r} ({run.source}): {lasts:.4g} s, at the end {', '.join(ends)}"


def as_html(run: RunLog) -> str:
    """A run as a table for a notebook: rows, rate, range and last value of each channel."""
    known = "set-up: " + (", ".join(_setup(run)) or "nothing is known")
    return summary_html([one_line(run), known, _table(run)])


def _table(run: RunLog) -> WholeWordTable:
    """Table of the channels of a run."""
    table = WholeWordTable(box=None, pad_edge=False)
    table.add_column("channel")
    table.add_column("unit")
    for heading in ("rows", "rows/s", "lowest", "highest", "last"):
        table.add_column(heading, justify="right")
    for each in channels(run):
        rate = "-" if each.rate is None else f"{each.rate:.4g}"
        ends = (f"{value:.6g}" for value in (each.low, each.high, each.last))
        table.add_row(each.name, each.unit, str(each.rows), rate, *ends)
    return table


def _events(events: Events) -> Iterator[str]:
    """Each kind of event in words, by its first time, with its number, and how often it came."""
    codes, first, count = np.unique(events.code, return_index=True, return_counts=True)
    for place in np.argsort(first):
        row, code = first[place], int(codes[place])
        word = replace_unprintable(events.meanings.get(code, f"code {code}"))
        number = f" ({events.arg[row]:.4g})" if events.arg[row] else ""
        times = f", {count[place]} times from then on" if count[place] > 1 else ""
        yield f"{events.event_time[row]:.3f} s: {word}{number}{times}"


def _rate(time: NDArray[np.float64]) -> float | None:
    """Mean number of rows in a second [1/s]."""
    return None if time.size < 2 else (time.size - 1) / float(time[-1] - time[0])


def _setup(run: RunLog) -> Iterator[str]:
    """Known numbers of the set-up, in words."""
    return (f"{name} {value:g}" for name, value in run.setup.known().items())


def _provenance(run: RunLog) -> Iterator[tuple[str, str]]:
    """Texts on the origin of a run, by name."""
    for name in ("created", "run_id", "software", "software_version", "end_reason", "notes"):
        text = getattr(run, name)
        if text is not None:
            yield name, "\n".join(map(replace_unprintable, text.splitlines()))
