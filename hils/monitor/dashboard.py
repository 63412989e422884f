"""Picture of the live view: the state of a run, and its sinkage over the last seconds."""

import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

from rich.align import Align
from rich.box import HEAVY
from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.panel import Panel
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from hils.events import Phase
from hils.monitor.status import INTERVAL, RunStatus

REAL, SIMULATED, BOTH = "bright_cyan", "bright_yellow", "bright_white"

# Braille cells are two dots wide and four high.
WIDE, HIGH = 2, 4

# The three lines of the keys are shown in any window.
KEY_LINES = 3

_DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))


class Point(NamedTuple):
    """Sinkage at one time, NaN where it is not known [s, m]."""

    time: float
    real: float
    simulated: float


@dataclass(frozen=True)
class DashboardSettings:
    """Layout of the picture.

    Attributes:
        min_width, min_height: Of the picture [characters]; a smaller window shows its corner.
        min_plot, max_plot: Height of the plot [lines]; a lower window shows none.
        roomy_width: Width from which on the keys are explained at length [characters].
        cell_width: Of a number with its name [characters].
        min_span: Span of the plotted sinkage, at least [m].
        silent_time: Time without news of a run at work that is worth a sentence [s].
    """

    min_width: int = 20
    min_height: int = 4
    min_plot: int = 3
    max_plot: int = 14
    roomy_width: int = 70
    cell_width: int = 23
    min_span: float = 2e-3
    silent_time: float = 1.0


DEFAULT_DASHBOARD = DashboardSettings()


class Dashboard:
    """Picture of the last status and those before it, which rich draws into any window.

    Args:
        keys: True where keys can be read.
        clock: Time of the drawing [s], on the clock of `add`.
        settings: Layout.
    """

    def __init__(
        self,
        keys: bool,
        clock: Callable[[], float] = time.monotonic,
        settings: DashboardSettings = DEFAULT_DASHBOARD,
    ):
        self._keys, self._clock, self._settings = keys, clock, settings
        self._status = RunStatus()
        self._points: deque[Point] = deque(maxlen=2000)
        self._came = -math.inf

    def add(self, status: RunStatus, now: float) -> None:
        """Take over a status that came at this time [s]."""
        self._status, self._came = status, now
        real, simulated = _number(status.real), _number(status.simulated)
        if status.time is not None and not (math.isnan(real) and math.isnan(simulated)):
            self._points.append(Point(status.time, real, simulated))

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        settings, now = self._settings, self._clock()
        width = max(options.max_width, settings.min_width)
        height = max(options.height or options.max_height, settings.min_height)
        options = options.update(width=width).reset_height()

        def lines(*parts: RenderableType) -> list[list[Segment]]:
            return console.render_lines(Group(*parts), options, pad=False)

        shown = lines(self._head(now, width), self._numbers(width))
        below = lines(self._messages(now), self._key_panels(width))
        rest = height - len(shown) - len(below) - 2  # the plot has a frame
        if rest >= settings.min_plot:
            shown += lines(self._plot(width - 4, min(rest, settings.max_plot)))
        shown += below
        if len(shown) > height:
            shown = shown[: height - KEY_LINES] + shown[-KEY_LINES:]
        for number, line in enumerate(shown):
            if number:
                yield Segment.line()
            yield from line

    # Its parts ----------------------------------------------------------------------------------

    def _head(self, now: float, width: int) -> RenderableType:
        status = self._status
        color = "green" if status.phase is Phase.RUNNING and not status.stopping else "yellow"
        phase = (f" {status.phase.value.upper()} ", f"bold reverse {color}")
        line = Table.grid(expand=True)
        line.add_column(no_wrap=True)
        line.add_column(justify="right", no_wrap=True)
        line.add_row(Text.assemble(phase, "  ", _time(status, now - self._came)), Text(status.port))
        about = Text(f"{status.title}  →  {status.output}", style="dim", no_wrap=True)
        about.truncate(width, overflow="ellipsis")
        return Group(line, about, _bar(status, width))

    def _numbers(self, width: int) -> RenderableType:
        status = self._status
        error = None
        if status.real is not None and status.simulated is not None:
            error = status.real - status.simulated
        values = [
            _value("H_real", status.real, 1e3, "mm", 2, f"bold {REAL}"),
            _value("H_sim", status.simulated, 1e3, "mm", 2, f"bold {SIMULATED}"),
            _value("apart", error, 1e3, "mm", 2, "bold", "+"),
            _value("zeta", status.zeta, 1, "", 4, "bold"),
            _value("slip", status.slip, 1, "", 3),
            _value("omega", status.omega, 180 / math.pi, "deg/s", 1),
            _value("carriage", status.vx, 1e3, "mm/s", 1),
            _value("reading's age", status.age, 1e3, "ms", 1),
            _count("deadlines missed", status.missed),
            _value(
                "late at most", status.latest, 1e3, "ms", 2, "bold red" if status.missed else ""
            ),
            _count("readings refused", status.refused),
            _count("frames dropped", status.dropped),
            _value("sent", status.sent, 1, "/s", 0),
            _value("received", status.received, 1, "/s", 0),
        ]
        columns = max(1, width // self._settings.cell_width)
        table = Table.grid(*[""] * columns, padding=(0, 2, 0, 0))
        for column in table.columns:
            column.width, column.no_wrap = self._settings.cell_width - 2, True
        for first in range(0, len(values), columns):
            table.add_row(*values[first : first + columns])
        return table

    def _plot(self, width: int, height: int) -> RenderableType:
        window = (width - 8) * WIDE * INTERVAL
        title = Text.assemble(
            "sinkage [mm]  ", ("real", REAL), "  ", ("simulated", SIMULATED), f"  {window:.0f} s"
        )
        return Panel(
            Group(*plot(list(self._points), width, height, self._settings.min_span)),
            title=title,
            padding=(0, 1),
        )

    def _messages(self, now: float) -> RenderableType:
        status, silent = self._status, now - self._came
        words = [Text(each, overflow="ellipsis", no_wrap=True) for each in status.words]
        if status.stopping:
            words.append(Text(f"Ending: {status.stopping}", style="bold yellow"))
        if silent > self._settings.silent_time and status.phase in (Phase.RUNNING, Phase.RAMPING):
            words.append(
                Text(f"The control program has said nothing for {silent:.0f} s", style="bold red")
            )
        return Group(*words)

    def _key_panels(self, width: int) -> RenderableType:
        if not self._keys:
            return Text("Ctrl-C, or drft hils stop in another terminal, ends the run", style="bold")
        keys = Table.grid(expand=True, padding=(0, 1))
        keys.add_column(ratio=3)
        keys.add_column(ratio=2)
        wide, stopping = width >= self._settings.roomy_width, bool(self._status.stopping)
        stop = "STOPPING" if stopping else "STOP   press S or SPACE" if wide else "STOP: S"
        keys.add_row(
            _key(stop, "bold white on red" if not stopping else "bold red"),
            _key("EMERGENCY STOP   E" if wide else "NOW: E", "bold red"),
        )
        return keys


# Pieces -------------------------------------------------------------------------------------------


def plot(
    points: list[Point], width: int, height: int, min_span: float = DEFAULT_DASHBOARD.min_span
) -> list[Text]:
    """Real and simulated sinkage over the last seconds, deeper lower, a dot each status.

    Args:
        points: In time.
        width, height: In characters, eight of the width for the scale.
        min_span: Of the sinkage, at least [m].
    """
    columns, rows = max(width - 8, 1) * WIDE, height * HIGH
    end = points[-1].time if points else 0.0
    recent = [each for each in points if each.time > end - (columns - 0.5) * INTERVAL]
    values = [value for each in recent for value in each[1:] if math.isfinite(value)]
    low, high = _span(values, min_span)
    cells: dict[tuple[int, int], list[int]] = {}
    for each in recent:
        column = columns - 1 - round((end - each.time) / INTERVAL)
        for kind, value in enumerate(each[1:]):
            if math.isfinite(value) and 0 <= column < columns:
                row = min(int((value - low) / (high - low) * rows), rows - 1)
                cell = cells.setdefault((row // HIGH, column // WIDE), [0, 0])
                cell[kind] |= _DOTS[row % HIGH][column % WIDE]
    lines = []
    for row in range(height):
        line = Text.assemble((_scale(row, height, low, high) if values else " " * 8, "dim"))
        dots = [cells.get((row, column), (0, 0)) for column in range(columns // WIDE)]
        for style, run in groupby(dots, _style):
            text = "".join(chr(0x2800 | real | simulated) for real, simulated in run)
            line.append(text if style else " " * len(text), style=style)
        lines.append(line)
    return lines


def _style(dots: Sequence[int]) -> str:
    real, simulated = dots
    if real and simulated:
        return BOTH
    return REAL if real else SIMULATED if simulated else ""


def _span(values: list[float], min_span: float) -> tuple[float, float]:
    if not values:
        return 0.0, min_span
    low, high = min(values), max(values)
    lacking = max(min_span - (high - low), 0.0) / 2
    return low - lacking, high + lacking


def _scale(row: int, height: int, low: float, high: float) -> str:
    if row not in (0, height // 2, height - 1):
        return " " * 7 + "│"
    middle = low + (high - low) * (row + 0.5) / height
    return f"{middle * 1e3:6.2f} ┤"


def _time(status: RunStatus, since: float) -> Text:
    if status.time is None:
        return Text("")
    time = status.time
    if status.phase is Phase.COUNTDOWN:
        return Text(f"start in {max(-time - since, 0.0):.1f} s", style="bold")
    whole = "" if status.duration is None else f" of {status.duration:.1f}"
    return Text(f"{time:.1f}{whole} s", style="bold")


def _bar(status: RunStatus, width: int) -> Text:
    done = 0.0
    if status.time is not None and status.duration:
        done = min(max(status.time / status.duration, 0.0), 1.0)
    full = round(done * width)
    return Text.assemble(("━" * full, "green"), ("─" * (width - full), "dim"))


def _value(
    name: str,
    value: float | None,
    scale: float,
    unit: str,
    digits: int,
    style: str = "",
    sign: str = "",
) -> Text:
    number = "-" if value is None else f"{value * scale:{sign}.{digits}f}"
    return Text.assemble((f"{name} ", "dim"), (f"{number} {unit}".rstrip(), style))


def _count(name: str, count: int) -> Text:
    return Text.assemble((f"{name} ", "dim"), (str(count), "bold red" if count else ""))


def _key(text: str, style: str) -> RenderableType:
    return Panel(Align.center(Text(text, no_wrap=True)), box=HEAVY, style=style)


def _number(value: float | None) -> float:
    return math.nan if value is None else value
