"""Publish the state of a run to the live view at up to 10 Hz, by wrapping row sink and prompts.

Neither the recorder nor the procedure knows of it:

    rows, prompts = observer.rows(recorder), observer.prompts(terminal)
"""

import math
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from drftjax.runlog.header import Head
from hils.clock import AbstractClock
from hils.control.stop_request import StopRequest
from hils.events import FINDINGS, Event, Phase, TickFlag
from hils.link.link import AbstractLink, LinkQuality
from hils.monitor.live_view import LiveView
from hils.monitor.status import (
    INTERVAL,
    MOST_MESSAGES,
    RunStatus,
    finite_or_none,
    printable_line,
)
from hils.procedure.active_runs import ActiveRun
from hils.procedure.operator_prompts import AbstractPrompts
from hils.procedure.procedure import Procedure
from hils.recording.row_stream import OnlineRow
from hils.recording.sinks import RowSink, WrappedSink

RAMPING, REFUSED = int(TickFlag.RAMPING), int(TickFlag.REFUSED)


@dataclass(frozen=True)
class ObserverSettings:
    """Numbers of the view that are computed here.

    Attributes:
        min_rolling_speed: Speed of the rim under which there is no slip worth showing [m/s].
        counting_time: Time over which frames are counted [s].
    """

    min_rolling_speed: float = 1e-3
    counting_time: float = 1.0


DEFAULT_OBSERVER = ObserverSettings()


class RunInfo(NamedTuple):
    """Facts that do not change over a run.

    Attributes:
        title: Of the run.
        port, output: Of the rig, and the run log.
        duration: Of the profile [s].
        radius: Of the wheel [m].
    """

    title: str
    port: str
    output: str
    duration: float
    radius: float


class RunObserver:
    """Publishes the status of a run.

    Args:
        run: Facts that do not change.
        show: Takes a status, without waiting.
        clock: Of the loop.
        quality: Of the link.
        stop: Requests to end the run.
        settings: Of the slip and the traffic.
    """

    def __init__(
        self,
        run: RunInfo,
        show: Callable[[RunStatus], None],
        clock: AbstractClock,
        quality: Callable[[], LinkQuality],
        stop: StopRequest,
        settings: ObserverSettings = DEFAULT_OBSERVER,
    ):
        self._settings = settings
        self._run, self._show, self._clock = run, show, clock
        self._named = {
            name: printable_line(getattr(run, name)) for name in ("title", "port", "output")
        }
        self._quality, self._stop = quality, stop
        self._on = False
        self._due = -math.inf
        self._words, self._later = deque[str](maxlen=MOST_MESSAGES), list[str]()
        self._phase, self._time = Phase.CHECKING, math.nan
        self._start = math.nan
        self._counted: LinkQuality | None = None
        self._sent: float | None = None
        self._received: float | None = None
        self._missed = self._refused = 0
        self._omega = self._vx = self._real = math.nan
        self._online: OnlineRow | None = None
        self._latest = 0.0

    def rows(self, rows: RowSink) -> RowSink:
        """Wrap a sink: rows are recorded as before, and observed."""
        return _ObservedRows(rows, self)

    def prompts(self, prompts: AbstractPrompts) -> AbstractPrompts:
        """Wrap prompts: they appear on the view while that has the terminal."""
        return _ObservedPrompts(prompts, self)

    @property
    def is_showing(self) -> bool:
        """True while the view has the terminal."""
        return self._on

    def begin(self) -> None:
        """Let the view have the terminal."""
        self._on = True
        self._publish()

    def end(self) -> list[str]:
        """Note that the view has given it back.

        Returns:
            Messages that came meanwhile.
        """
        self._on = False
        later, self._later = self._later, []
        return later

    # Observation -------------------------------------------------------------------------------

    def on_phase(self, phase: Phase, lasts: float = math.nan) -> None:
        """Take over a phase of the run, which lasts so long [s]."""
        self._phase = phase
        if phase is Phase.COUNTDOWN:
            self._start, self._time = self._clock.now() + lasts, -lasts
        self._publish()

    def on_message(self, text: str) -> None:
        """Take over a message."""
        self._words.append(printable_line(text))
        self._later.append(text)
        self._publish()

    def on_command(self, time: float, omega: float, vx: float | None) -> None:
        """Take over a command; it is the one thing that comes on each tick."""
        self._time, self._omega, self._vx = time, omega, math.nan if vx is None else vx
        self._publish_if_due(self._clock.now())

    def on_sinkage(self, sinkage: float) -> None:
        """Take over a sinkage measured before the loop begins [m]."""
        self._real, now = sinkage, self._clock.now()
        if self._phase is Phase.COUNTDOWN:
            self._time = now - self._start
        self._publish_if_due(now)

    def on_measurement(self, z: float) -> None:
        """Take over a height measured [m]."""
        self._real = -z

    def on_tick(self, row: OnlineRow) -> None:
        """Take over a tick."""
        self._online = row
        self._latest = max(self._latest, row.late)
        if row.flags & REFUSED:
            self._refused += 1
        if row.flags & RAMPING and self._phase is Phase.RUNNING:
            self._phase = Phase.RAMPING

    def on_event(self, code: int, arg: float) -> None:
        """Take over an event."""
        if code == Event.STARTED:
            self._phase = Phase.RUNNING
        elif code == Event.OVERRUN:
            self._missed += 1
            self._latest = max(self._latest, arg)
        elif code == Event.TICKS_SKIPPED:
            self._missed += max(int(arg) - 1, 0)
        elif code in FINDINGS:
            self._words.append(f"{Event(code).name.lower().replace('_', ' ')} ({arg:.4g})")
            self._publish()

    # Publication -------------------------------------------------------------------------------

    def _publish_if_due(self, now: float) -> None:
        if now >= self._due:
            self._due = now + INTERVAL
            self._publish()

    def _publish(self) -> None:
        if not self._on:
            return
        sent, received, dropped = self._traffic()
        run, online, wish = self._run, self._online, self._stop.first_reason
        self._show(
            RunStatus(
                phase=self._phase,
                time=finite_or_none(self._time),
                duration=run.duration,
                **self._named,
                real=finite_or_none(self._real),
                simulated=None if online is None else finite_or_none(-online.z_sim),
                zeta=None if online is None else finite_or_none(online.zeta),
                slip=finite_or_none(self._slip()),
                omega=finite_or_none(self._omega),
                vx=finite_or_none(self._vx),
                latest=self._latest,
                age=None if online is None else finite_or_none(online.age),
                missed=self._missed,
                refused=self._refused,
                sent=sent,
                received=received,
                dropped=dropped,
                stopping="" if wish is None else printable_line(wish.reason),
                words=list(self._words),
            )
        )

    def _slip(self) -> float:
        rolling = self._run.radius * self._omega
        return (
            1 - self._vx / rolling if abs(rolling) > self._settings.min_rolling_speed else math.nan
        )

    def _traffic(self) -> tuple[float | None, float | None, int]:
        """Frames sent and received a second over the last while, and those dropped."""
        quality = self._quality()
        counted = self._counted or quality
        span = quality.time - counted.time
        if span >= self._settings.counting_time:
            self._sent = (quality.sent - counted.sent) / span
            self._received = (quality.received - counted.received) / span
        if span >= self._settings.counting_time or self._counted is None:
            self._counted = quality
        return self._sent, self._received, quality.dropped


class _ObservedRows(WrappedSink):
    """Row sink that an observer sees."""

    def __init__(self, rows: RowSink, observer: RunObserver):
        super().__init__(rows)
        self._observer, self._z = observer, 0

    def begin(self, head: Head) -> None:
        self._z = head.channels.index("z")
        super().begin(head)

    def command(self, time: float, omega: float, vx: float | None = None) -> None:
        super().command(time, omega, vx)
        self._observer.on_command(time, omega, vx)

    def measured(self, time: float, *values: float) -> None:
        super().measured(time, *values)
        self._observer.on_measurement(values[self._z])

    def online(self, row: OnlineRow) -> None:
        super().online(row)
        self._observer.on_tick(row)

    def event(self, time: float, code: int, arg: float = 0.0) -> None:
        super().event(time, code, arg)
        self._observer.on_event(code, arg)

    def close(self, end_reason: str) -> object:
        self._observer.on_phase(Phase.CLOSING)
        return super().close(end_reason)


class _ObservedPrompts(AbstractPrompts):
    """Prompts that go to the view while that has the terminal."""

    def __init__(self, prompts: AbstractPrompts, observer: RunObserver):
        self._prompts, self._observer = prompts, observer

    def say(self, text: str) -> None:
        if self._observer.is_showing:
            self._observer.on_message(text)
        else:
            self._prompts.say(text)

    def say_if_free(self, text: str) -> None:
        if self._observer.is_showing:
            self._observer.on_message(text)
        else:
            self._prompts.say_if_free(text)

    def confirm(self, text: str, meanwhile: Callable[[], None] = lambda: None) -> None:
        self._prompts.confirm(text, meanwhile)

    def accept(self, doubt: str) -> bool:
        return not self._observer.is_showing and self._prompts.accept(doubt)

    def enter_phase(self, phase: Phase, lasts: float = math.nan) -> None:
        self._observer.on_phase(phase, lasts)

    def show_sinkage(self, sinkage: float) -> None:
        self._observer.on_sinkage(sinkage)


class ObservedRun(NamedTuple):
    """Row sink and prompts of a run.

    Attributes:
        rows, prompts: To give to the run.
        begin: Lets the view have the terminal; no question can be asked from then on.
    """

    rows: RowSink
    prompts: AbstractPrompts
    begin: Callable[[], None]


def without_observer(rows: RowSink, prompts: AbstractPrompts) -> ObservedRun:
    """Run without a live view."""
    return ObservedRun(rows, prompts, lambda: None)


@contextmanager
def with_live_view(
    under_way: ActiveRun,
    output: Path,
    procedure: Procedure,
    link: AbstractLink,
    clock: AbstractClock,
    rows: RowSink,
    prompts: AbstractPrompts,
    stop: StopRequest,
) -> Iterator[ObservedRun]:
    """Context of a run with a live view.

    Messages that come while the view has the terminal are said again at the end.
    """
    setup = procedure.loop.setup
    command = setup.command.build()
    seen = RunInfo(
        procedure.title or setup.title,
        under_way.port,
        str(output.absolute()),
        float(command.time[-1] - command.time[0]),
        setup.wheel.radius,
    )
    view = LiveView(under_way)
    observer = RunObserver(seen, view.show, clock, link.quality, stop)
    try:
        yield ObservedRun(observer.rows(rows), observer.prompts(prompts), observer.begin)
    finally:
        view.close()
        for text in observer.end():
            prompts.say(text)
