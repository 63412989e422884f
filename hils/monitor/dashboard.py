"""What the live view draws: a scene and the sinkage of the last seconds, as lines of text."""

import math
from collections import deque
from collections.abc import Sequence
from itertools import groupby
from typing import NamedTuple

from rich.align import Align
from rich.box import HEAVY
from rich.console import Console, Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from hils.events import Phase
from hils.monitor.status import INTERVAL, RunStatus

REAL, SIMULATED, BOTH = "bright_cyan", "bright_yellow", "bright_white"


# A window narrower or lower than this shows less.
LEAST_PLOT, MOST_PLOT = 3, 14


# From this width on the keys are told at length.
ROOMY = 70


# A number with its name [characters].
CELL = 23


# The least span of the plotted sinkage [m].
LEAST_SPAN = 2e-3


# A run at work whose scenes stop coming for so long is worth a word [s].
SILENT = 1.0


# Braille cells are two dots wide and four high.
WIDE, HIGH = 2, 4


_DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))


class Point(NamedTuple):
    """Sinkage at one time, NaN where it is not known [s, m]."""

    time: float
    real: float
    simulated: float


class Dashboard:
    """The last scene, and those before it."""

    def __init__(self):
        self._scene = RunStatus()
        self._points: deque[Point] = deque(maxlen=2000)
        self._came = -math.inf

    def add(self, scene: RunStatus, now: float) -> None:
        """A scene that came at this time [s]."""
        self._scene, self._came = scene, now
        real, simulated = _number(scene.real), _number(scene.simulated)
        if scene.time is not None and not (math.isnan(real) and math.isnan(simulated)):
            self._points.append(Point(scene.time, real, simulated))

    def lines(self, width: int, height: int, now: float, keys: bool) -> list[str]:
        """The picture at this time [s], no larger than that; keys: whether they can be read."""
        console = Console(width=width, height=height, force_terminal=True, legacy_windows=False)
        above = [self._head(now, width), self._numbers(width)]
        below = [self._told(now), _keys(keys, bool(self._scene.stopping), width)]
        rest = height - sum(_height(console, each) for each in (*above, *below)) - 2
        shown = above
        if rest >= LEAST_PLOT:
            shown = [*above, self._plot(width - 4, min(rest, MOST_PLOT))]
        with console.capture() as drawn:
            console.print(Group(*shown, *below), end="")
        lines = drawn.get().rstrip("\n").split("\n")
        # Of what does not fit, the keys are what is needed.
        return lines if len(lines) <= height else lines[: height - 3] + lines[-3:]

    # Its parts ----------------------------------------------------------------------------------

    def _head(self, now: float, width: int) -> RenderableType:
        scene = self._scene
        color = "green" if scene.phase is Phase.RUNNING and not scene.stopping else "yellow"
        phase = (f" {scene.phase.value.upper()} ", f"bold reverse {color}")
        line = Table.grid(expand=True)
        line.add_column(no_wrap=True)
        line.add_column(justify="right", no_wrap=True)
        line.add_row(Text.assemble(phase, "  ", _time(scene, now - self._came)), Text(scene.port))
        about = Text(f"{scene.title}  →  {scene.output}", style="dim", no_wrap=True)
        about.truncate(width, overflow="ellipsis")
        return Group(line, about, _bar(scene, width))

    def _numbers(self, width: int) -> RenderableType:
        scene = self._scene
        error = None
        if scene.real is not None and scene.simulated is not None:
            error = scene.real - scene.simulated
        said = [
            _said("H_real", scene.real, 1e3, "mm", 2, f"bold {REAL}"),
            _said("H_sim", scene.simulated, 1e3, "mm", 2, f"bold {SIMULATED}"),
            _said("apart", error, 1e3, "mm", 2, "bold", "+"),
            _said("zeta", scene.zeta, 1, "", 4, "bold"),
            _said("slip", scene.slip, 1, "", 3),
            _said("omega", scene.omega, 180 / math.pi, "deg/s", 1),
            _said("carriage", scene.vx, 1e3, "mm/s", 1),
            _said("reading's age", scene.age, 1e3, "ms", 1),
            _counted("deadlines missed", scene.missed),
            _said("late at most", scene.latest, 1e3, "ms", 2, "bold red" if scene.missed else ""),
            _counted("readings refused", scene.refused),
            _counted("frames dropped", scene.dropped),
            _said("sent", scene.sent, 1, "/s", 0),
            _said("received", scene.received, 1, "/s", 0),
        ]
        columns = max(1, width // CELL)
        table = Table.grid(*[""] * columns, padding=(0, 2, 0, 0))
        for column in table.columns:
            column.width, column.no_wrap = CELL - 2, True
        for first in range(0, len(said), columns):
            table.add_row(*said[first : first + columns])
        return table

    def _plot(self, width: int, height: int) -> RenderableType:
        window = (width - 8) * WIDE * INTERVAL
        title = Text.assemble(
            "sinkage [mm]  ", ("real", REAL), "  ", ("simulated", SIMULATED), f"  {window:.0f} s"
        )
        return Panel(Group(*plot(list(self._points), width, height)), title=title, padding=(0, 1))

    def _told(self, now: float) -> RenderableType:
        scene, silent = self._scene, now - self._came
        words = [Text(each, overflow="ellipsis", no_wrap=True) for each in scene.words]
        if scene.stopping:
            words.append(Text(f"Ending: {scene.stopping}", style="bold yellow"))
        if silent > SILENT and scene.phase in (Phase.RUNNING, Phase.RAMPING):
            words.append(
                Text(f"The control program has said nothing for {silent:.0f} s", style="bold red")
            )
        return Group(*words)


# Pieces -------------------------------------------------------------------------------------------


def plot(points: list[Point], width: int, height: int) -> list[Text]:
    """Real and simulated sinkage over the last seconds, deeper lower, a dot each scene.

    Args:
        points: In time.
        width, height: In characters, eight of the width for the scale.
    """
    columns, rows = max(width - 8, 1) * WIDE, height * HIGH
    end = points[-1].time if points else 0.0
    recent = [each for each in points if each.time > end - (columns - 0.5) * INTERVAL]
    values = [value for each in recent for value in each[1:] if math.isfinite(value)]
    low, high = _span(values)
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


def _span(values: list[float]) -> tuple[float, float]:
    if not values:
        return 0.0, LEAST_SPAN
    low, high = min(values), max(values)
    lacking = max(LEAST_SPAN - (high - low), 0.0) / 2
    return low - lacking, high + lacking


def _scale(row: int, height: int, low: float, high: float) -> str:
    if row not in (0, height // 2, height - 1):
        return " " * 7 + "│"
    middle = low + (high - low) * (row + 0.5) / height
    return f"{middle * 1e3:6.2f} ┤"


def _time(scene: RunStatus, since: float) -> Text:
    if scene.time is None:
        return Text("")
    time = scene.time
    if scene.phase is Phase.COUNTDOWN:
        return Text(f"start in {max(-time - since, 0.0):.1f} s", style="bold")
    whole = "" if scene.duration is None else f" of {scene.duration:.1f}"
    return Text(f"{time:.1f}{whole} s", style="bold")


def _bar(scene: RunStatus, width: int) -> Text:
    done = 0.0
    if scene.time is not None and scene.duration:
        done = min(max(scene.time / scene.duration, 0.0), 1.0)
    full = round(done * width)
    return Text.assemble(("━" * full, "green"), ("─" * (width - full), "dim"))


def _said(
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


def _counted(name: str, count: int) -> Text:
    return Text.assemble((f"{name} ", "dim"), (str(count), "bold red" if count else ""))


def _keys(there: bool, stopping: bool, width: int) -> RenderableType:
    if not there:
        return Text("Ctrl-C, or drft hils stop in another terminal, ends the run", style="bold")
    keys = Table.grid(expand=True, padding=(0, 1))
    keys.add_column(ratio=3)
    keys.add_column(ratio=2)
    wide = width >= ROOMY
    stop = "STOPPING" if stopping else "STOP   press S or SPACE" if wide else "STOP: S"
    keys.add_row(
        _key(stop, "bold white on red" if not stopping else "bold red"),
        _key("EMERGENCY STOP   E" if wide else "NOW: E", "bold red"),
    )
    return keys


def _key(text: str, style: str) -> RenderableType:
    return Panel(Align.center(Text(text, no_wrap=True)), box=HEAVY, style=style)


def _height(console: Console, part: RenderableType) -> int:
    return len(console.render_lines(part))


def _number(value: float | None) -> float:
    return math.nan if value is None else value
