"""Runs in the loop on a virtual rig, in virtual time, with a log of all that was sent."""

import functools
import math

from drftjax.setups.setup import CommandSetUp, IntegratorSetUp, SetUp, WheelSetUp
from drftjax.tuning.registry import TunerSetUp
from hils.clock import VirtualClock
from hils.control.limits import CommandLimits
from hils.control.loop_config import LoopSetUp
from hils.control.stop_request import StopRequest
from hils.events import Event
from hils.link.link import InProcessLink
from hils.procedure.operator_prompts import UnattendedPrompts
from hils.procedure.procedure import Procedure, RunReport, run
from hils.recording.recorder import Recorder
from hils.recording.sinks import InMemorySink
from hils.rig_sim.config import VirtualSetUp
from hils.rig_sim.in_process import QUICK, SoftRig, rig_physics
from hils.rig_sim.rig import VirtualRig
from hils.rig_sim.sensors import Instruments

TICK = 0.01
# Held 0.5 s, up to 30 deg/s in 1 s, 1 s of it, and back.
PROFILE = CommandSetUp([0.0, 0.5, 1.5, 2.5, 3.5, 4.0], [0, 0, 30, 30, 0, 0], omega_unit="deg/s")
TICKS = 400
# HILS (sim) and HILS (real) in the paper differ by less than this [m].
CLOSE = 5e-4
# Of a wheel's weight, what the force that bears it differs by while grousers come and go.
BORNE = 0.05
# A drive at rest turns nowhere, but for the last of a slew; sand at rest gives way no faster than
# its width at rest, 0.6 um/s under a wheel that stands [rad/s], [m/s].
TURNS, CREEPS = 1e-6, 1e-6


def loop_setup(tuner: str = "step", **changes) -> LoopSetUp:
    setup = SetUp(
        command=PROFILE,
        wheel=WheelSetUp(plate_size=8e-3),
        integrator=IntegratorSetUp(step=2e-3),
    )
    return LoopSetUp(
        setup=setup, commands=CommandLimits(2.0, 0.3), tuner=TunerSetUp(tuner), tick=TICK, **changes
    )


class Made:
    """Finished run: its report, its rows, and the messages to the rig."""

    def __init__(self, report: RunReport | None, rows: InMemorySink, soft: SoftRig, said: list):
        self.report, self.rows, self.soft, self.said = report, rows, soft, said

    def kinds(self) -> list[int]:
        return [code for _, code, _ in self.rows.events]

    def events(self, code: Event) -> list[float]:
        return [arg for _, each, arg in self.rows.events if each == code]


class LoggedLink(InProcessLink):
    """In-process link that logs the messages of the host and their times."""

    def __init__(self, rig, clock):
        super().__init__(rig, clock)
        self.said = []

    def send(self, message):
        self.said.append((self._clock.now(), message))
        return super().send(message)


class LateClock(VirtualClock):
    """Virtual clock that wakes late once, after a given time [s]."""

    def __init__(self, start: float, when: float, late: float):
        super().__init__(start)
        self._when, self._late = when, late

    def sleep_until(self, deadline: float) -> None:
        if deadline >= self._when:
            deadline, self._when = deadline + self._late, math.inf
        super().sleep_until(deadline)


class Cue:
    """Calls a function once the clock of the rig reaches a time."""

    def __init__(self, clock: VirtualClock, when: float, act):
        self._when, self._act = when, act
        clock.attach(self)

    def advance(self, now: float) -> None:
        if now >= self._when:
            self._when = math.inf
            self._act()


START = 1000.0
# From the first HELLO to the profile's start, as these runs take it [s].
BEFORE = 3.4


def make(
    loop: LoopSetUp | None = None,
    *,
    cue=None,
    at: float = 0.0,
    late: float = 0.0,
    rows: InMemorySink | Recorder | None = None,
    link: type[LoggedLink] = LoggedLink,
    scales: Instruments | None = None,
    **procedure,
) -> Made:
    """Make a run; `cue(stop, link)` is called, or the clock wakes late, `at` s into the profile."""
    setup = VirtualSetUp(physics=QUICK, instruments=scales or Instruments())
    clock = LateClock(START, START + BEFORE + at if late else math.inf, late)
    rig = VirtualRig(setup, rig_physics(setup), None, 0, 0, 0.0, START)
    line = link(rig, clock)
    stop, rows = StopRequest(), rows or InMemorySink()
    if cue is not None:
        Cue(clock, START + BEFORE + at, lambda: cue(stop, line))
    given = Procedure(loop=loop or loop_setup(), **{"countdown": 0.3} | procedure)
    soft = SoftRig(rig, line, clock)
    report = run(given, line, clock, rows, UnattendedPrompts(quiet=True), stop)
    return Made(report, rows, soft, line.said)


@functools.cache
def whole(tuner: str) -> Made:
    return make(loop_setup(tuner))


def resting(made: Made) -> bool:
    """True if the rig is at rest one second later."""
    made.soft.clock.sleep_until(made.soft.clock.now() + 1.0)
    motion = made.soft.rig.motion
    return abs(motion.omega) < TURNS and abs(motion.vx) < CREEPS
