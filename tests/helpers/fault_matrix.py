"""Every scripted fault in every phase of a run; docs/reference/hils-faults.md states what follows.

Whatever the fault: nothing moves before ARM, only one sentence is raised, the wheel rests in the
end, the recorder is told why, and no command was beyond the limits or not finite.
"""

import math
import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

import jax

from drftjax.common.errors import InputError
from drftjax.setups.setup import CommandSetUp, IntegratorSetUp, SetUp, WheelSetUp
from hils.control.limits import CommandLimits, ReadingLimits
from hils.control.loop_config import LoopSetUp
from hils.control.stop_request import StopRequest
from hils.events import Event
from hils.link.messages import RigState
from hils.procedure.operator_prompts import UnattendedPrompts
from hils.procedure.procedure import Procedure, RunReport, run
from hils.recording.sinks import InMemorySink
from hils.rig_sim.config import PhysicsSetUp, VirtualSetUp
from hils.rig_sim.faults import (
    CreepingClock,
    DamagedFrames,
    DelayedBytes,
    DelayedFrames,
    Disconnect,
    DriveFault,
    DuplicatedBytes,
    DuplicatedFrames,
    Fault,
    FaultKind,
    FaultScript,
    FlippedBytes,
    LostBytes,
    LostFrames,
    ReorderedBytes,
    ReorderedFrames,
    Reset,
    ReversedCarriage,
    ReversedDrive,
    Runaway,
    SaturatedDrive,
    ScaleJump,
    SlowLine,
    StuckScale,
    Window,
)
from hils.rig_sim.in_process import SoftRig, soft_rig

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "hils-faults.md"
LIMITS = CommandLimits(omega=2.0, vx=0.3)
# No run of this profile may take longer, with every try and patience that there is [s].
LONGEST = 30.0
WATCHDOG, TICK = 0.1, 0.02

# When each phase is struck: after what, from when and for how long [s].
PHASES = {
    "connect": ("power", 0.0),
    "zero": ("hello", 0.1),
    "settle": ("arm", 1.9),
    "countdown": ("arm", 2.25),
    "accelerate": ("motion", 0.15),
    "steady": ("motion", 0.6),
    "decelerate": ("motion", 1.1),
    "ramp-down": ("motion", 1.52),
    "stop": ("stop", 0.0),
}
# The countdown is no longer than it must be where it is not struck [s].
COUNTDOWN, STRUCK_COUNTDOWN = 0.1, 0.6
SHORT, FOR_GOOD = 0.3, math.inf

WIRE_FAULTS: dict[str, tuple[FaultKind, float]] = {
    "lost frames, 1 in 10": (LostFrames(0.1), SHORT),
    "damaged frames, 1 in 10": (DamagedFrames(0.1), SHORT),
    "duplicated frames, 1 in 2": (DuplicatedFrames(0.5), SHORT),
    "reordered frames, 1 in 5 by 30 ms": (ReorderedFrames(0.2, delay=0.03), SHORT),
    "delayed frames, 1 in 5 by 30 ms": (DelayedFrames(0.2, delay=0.03), SHORT),
    "lost bytes, 3 in 1000": (LostBytes(0.003), SHORT),
    "flipped bytes, 3 in 1000": (FlippedBytes(0.003), SHORT),
    "duplicated bytes, 3 in 1000": (DuplicatedBytes(0.003), SHORT),
    "reordered bytes, 3 in 1000": (ReorderedBytes(0.003), SHORT),
    "delayed bytes, 1 frame in 5 by 30 ms": (DelayedBytes(0.2, delay=0.03), SHORT),
    "all frames lost towards the rig": (LostFrames(towards="rig"), SHORT),
    "all frames lost towards the host": (LostFrames(towards="host"), SHORT),
    "all frames damaged": (DamagedFrames(), SHORT),
    "all frames lost for good": (LostFrames(), FOR_GOOD),
    "delayed by 200 ms towards the rig": (DelayedFrames(towards="rig", delay=0.2), SHORT),
    "delayed by 200 ms towards the host": (DelayedFrames(towards="host", delay=0.2), SHORT),
}
RIG_FAULTS: dict[str, tuple[FaultKind, float]] = {
    "disconnect": (Disconnect(), SHORT),
    "reset": (Reset(), SHORT),
    "reset within 50 ms": (Reset(), 0.05),
    "drive fault": (DriveFault(7), SHORT),
    "drive saturated": (SaturatedDrive(0.1), SHORT),
    "runaway wheel": (Runaway(1.5), SHORT),
    "reversed drive": (ReversedDrive(), SHORT),
    "reversed carriage for good": (ReversedCarriage(), FOR_GOOD),
    "slow line for good": (SlowLine(9600.0), FOR_GOOD),
    "creeping clock for good": (CreepingClock(-0.01), FOR_GOOD),
    "stuck scale": (StuckScale("z"), SHORT),
    "stuck scale for good": (StuckScale("z"), FOR_GOOD),
    "stuck scale of x for good": (StuckScale("x"), FOR_GOOD),
    "absurd readings": (ScaleJump("z"), SHORT),
    "absurd readings of x": (ScaleJump("x"), SHORT),
    "absurd readings, 1 in 4": (ScaleJump("z", rate=0.25), SHORT),
}

FAULTS = WIRE_FAULTS | RIG_FAULTS

# What the words of the table promise: how the run ends, and whether it was seen to rest.
ENDS = {
    "SAFE": (r"went SAFE", True),
    "silent": (r"no measurement", None),
    "unreached": (r"link lost", False),
    "reset": (r"was reset", None),
    "drive fault": (r"fault|emergency stop", True),
    "readings": (r"readings in a row|height has changed", True),
    "runaway": (r"the wheel turns at .* commanded were", True),
    "moves": (r"while it is to stand", True),
    "carriage": (r"the carriage went", True),
    "stays stuck": (r"the scale is stuck", True),
    "old readings": (r"newest reading is .* s old", None),
}
FLAGS = {
    "stuck": Event.SENSOR_STUCK,
    "stuck x": Event.X_STUCK,
    "readings": Event.READING_REFUSED,
    "drive": Event.DRIVE_OFF,
    "stale": Event.READINGS_STALE,
}


class Cell(NamedTuple):
    """One run with one fault."""

    soft: SoftRig
    rows: InMemorySink
    report: RunReport | None
    refusal: str

    @property
    def events(self) -> set[int]:
        if self.report is None or self.report.loop is None:  # it ended before its first tick
            return set()
        log = self.rows.run()
        return set() if log.events is None else set(log.events.code.tolist())


@cache
def loop() -> LoopSetUp:
    """Coarse and quick set-up of the loop; the tests ask only how runs end."""
    setup = SetUp(
        command=CommandSetUp([0, 0.1, 0.6, 1.1, 1.6], [0, 0, 30, 30, 10], omega_unit="deg/s"),
        wheel=WheelSetUp(plate_size=0.01),
        integrator=IntegratorSetUp(step=5e-3),
    )
    return LoopSetUp(
        setup=setup,
        commands=LIMITS,
        tick=TICK,
        readings=ReadingLimits(still=0.2, drive_time=0.1),
    )


def cell(what: FaultKind | None, phase: str = "connect", duration: float = SHORT) -> Cell:
    """A run with one fault, or none, in one phase."""
    faults = () if what is None else (Fault(what, Window(*PHASES[phase], duration)),)
    return struck(faults, STRUCK_COUNTDOWN if phase == "countdown" else COUNTDOWN)


@cache
def answer_at_once() -> None:
    """Dispatch small steps without JAX's queue; has an effect before the first computation only."""
    jax.config.update("jax_cpu_enable_async_dispatch", False)


def struck(faults: tuple[Fault, ...], countdown: float = COUNTDOWN) -> Cell:
    answer_at_once()
    rig = VirtualSetUp(physics=PhysicsSetUp(step=2.5e-3, plate_size=0.01))
    soft, rows = soft_rig(rig, FaultScript(faults, seed=1), grain=2e-3), InMemorySink()
    report, refusal = None, ""
    procedure = Procedure(loop=loop(), countdown=countdown)
    try:
        report = run(
            procedure, soft.link, soft.clock, rows, UnattendedPrompts(quiet=True), StopRequest()
        )
    except InputError as error:
        refusal = str(error)
    soft.rig.advance_unplugged(soft.clock.now() + 3.0)  # a slow line brings BYE late
    return Cell(soft, rows, report, refusal)


def require_safety(cell: Cell) -> None:
    """Check the rules of safety, which hold in every cell."""
    soft, occasions = cell.soft, cell.soft.rig.occasions
    assert soft.clock.now() - occasions["power"] < LONGEST
    assert soft.rig.motion.omega == 0.0
    assert soft.rig.state in (RigState.IDLE, RigState.SAFE, RigState.FAULT)
    assert occasions.get("motion", math.inf) > occasions.get("arm", math.inf) or (
        "motion" not in occasions
    )
    if cell.report is None:
        assert cell.refusal
        assert "\n" not in cell.refusal
        assert "motion" not in occasions
    if cell.report is not None and cell.report.loop is not None:
        command = cell.rows.run().command
        assert abs(command.omega).max() <= LIMITS.omega
        assert command.vx is not None
        assert abs(command.vx).max() <= LIMITS.vx
    for change in soft.rig.changes:
        assert change.silence <= WATCHDOG + TICK or change.state is not RigState.SAFE


def require_outcome(cell: Cell, outcome: str) -> None:
    """Check the outcome that the table states for this cell."""
    report = cell.report
    if outcome.startswith("refused"):
        assert report is None
        assert cell.soft.rig.is_held is (outcome == "refused")
        return
    assert report is not None, cell.refusal
    if outcome.startswith("ends: "):
        pattern, rested = ENDS[outcome.removeprefix("ends: ")]
        assert not report.completed
        assert re.search(pattern, report.reason), report.reason
        assert rested is None or report.rested is rested
        return
    outcome, _, unseen = outcome.partition(", ")
    assert report.completed, report.reason
    assert report.rested is (unseen != "rest unseen")
    flags = set() if outcome == "completes" else set(outcome.removeprefix("flags: ").split(" and "))
    assert flags <= set(FLAGS)
    assert {flag for flag, event in FLAGS.items() if event in cell.events} == flags


def table() -> dict[str, list[str]]:
    """Stated outcomes of each fault, in the order of the phases."""
    rows = {}
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        name, *outcomes = [each.strip() for each in line.strip().strip("|").split("|")]
        if len(outcomes) == len(PHASES):
            rows[name] = outcomes
    return rows


def require_row(name: str) -> None:
    """Check that a fault has its stated outcome in every phase."""
    what, duration = FAULTS[name]
    for phase, outcome in zip(PHASES, table()[name], strict=True):
        made = cell(what, phase, duration)
        try:
            require_safety(made)
            require_outcome(made, outcome)
        except AssertionError as error:
            reason = made.report.reason if made.report else made.refusal
            raise AssertionError(f"{name} in {phase}: {outcome!r}, but {reason!r}") from error
