"""One tick of the loop as a pure function: readings in, commands out.

Nothing here knows a clock, a link or a file. All inputs of `step_tick` can be read back from a run
log, so a replay calls this very function and gets the same zeta, bit for bit:

| given | in the run log |
|---|---|
| reading | the next row of /measured, on each tick with the flag FRESH |
| skipped | ticks between this row of /online and the one before |
| ramping | the flag RAMPING |
| old | the flag OLD |
"""

import abc
import copy
import math
from typing import NamedTuple

import msgspec
import numpy as np

from hils.control.compiled_step import NO_READING, NUMBERS, CompiledStep, Packed, StepResult
from hils.control.limits import (
    REST,
    Reading,
    ReadingLimits,
    ReadingMonitor,
    RigCommand,
    Verdict,
    check_reading,
    limit_command,
)
from hils.control.loop_config import LoopPhysics, LoopSetUp, Start, profile


class LoopState(NamedTuple):
    """State of the loop between two ticks.

    Attributes:
        number: The next tick.
        packed: Of the simulation and the tuner, at its start.
        watch: Memory of the readings.
        demand: Last command to the rig.
        tuned: Number of the tick on which the tuner last had a reading.
        moved: Packed state of the last tick whose reading had another height than the one before.
    """

    number: int
    packed: Packed
    watch: ReadingMonitor
    demand: RigCommand
    tuned: int
    moved: Packed


class TickInput(NamedTuple):
    """Input of a tick.

    Attributes:
        reading: A measurement not seen before, or None.
        skipped: Ticks that passed unused before this one.
        ramping: True where the wheel is brought to rest, past the profile.
        old: True where the reading answers a command too old for zeta to follow it.
    """

    reading: Reading | None
    skipped: int = 0
    ramping: bool = False
    old: bool = False


class TickOutput(NamedTuple):
    """Output of a tick.

    Attributes:
        number: The tick.
        held: Command to the rig up to it.
        before: The simulation at its start.
        after: The simulation at its end; its zeta and error are those of the tick.
        demand: New command to the rig; None where the limits refuse it.
        asked: Command by the profile and the simulation, before any limit.
        limited: True where a limit held it back.
        verdict: Judgement of the reading; None without one.
        tuned: True where the tuner changed zeta.
        zeta_held: True where a reading was there to tune by and zeta was held all the same: the
            wheel stands, z is stuck or zeta is at a bound.
        at_bound: True where zeta is at a bound of `hils.control.loop_config.ZetaHold`.
    """

    number: int
    held: RigCommand
    before: StepResult
    after: StepResult
    demand: RigCommand | None
    asked: RigCommand
    limited: bool
    verdict: Verdict | None
    tuned: bool
    zeta_held: bool = False
    at_bound: bool = False


class AbstractTick(abc.ABC):
    """Work of the loop on each tick."""

    @property
    @abc.abstractmethod
    def loop(self) -> LoopSetUp:
        """Its numbers."""

    @property
    @abc.abstractmethod
    def ticks(self) -> int:
        """Length of the profile."""

    @property
    @abc.abstractmethod
    def driven(self) -> bool:
        """True where the carriage is driven at the simulated speed; else it runs free."""

    @abc.abstractmethod
    def with_readings(self, readings: ReadingLimits) -> "AbstractTick":
        """The same, with other limits of the readings."""

    @abc.abstractmethod
    def begin(self, start: Start) -> LoopState:
        """The state before the first tick, the wheel at rest."""

    @abc.abstractmethod
    def step(self, state: LoopState, given: TickInput) -> tuple[LoopState, TickOutput]:
        """Judge the reading, and compute the command to the rig.

        Args:
            state: At the end of the last tick that was made.
            given: Input of the tick.
        """


class TunedTick(AbstractTick):
    """Hardware in the loop: tune zeta, simulate to the tick's end, drive at the simulated speed.

    Args:
        physics: The loop, made ready.
    """

    def __init__(self, physics: LoopPhysics):
        self._physics = physics

    @property
    def loop(self) -> LoopSetUp:
        return self._physics.loop

    @property
    def ticks(self) -> int:
        return self._physics.ticks

    @property
    def driven(self) -> bool:
        return True

    def begin(self, start: Start) -> LoopState:
        return begin(self._physics, start)

    def with_readings(self, readings: ReadingLimits) -> "TunedTick":
        return TunedTick(self._physics.with_readings(readings))

    def precompile(self, start: Start) -> None:
        """Step a little beforehand, so that the first tick takes no longer than any other."""
        self._physics.precompile(start)

    def step(self, state: LoopState, given: TickInput) -> tuple[LoopState, TickOutput]:
        return step_tick(self._physics, state, given)


class FreeTick(AbstractTick):
    """The carriage runs free: the profile is driven and recorded, nothing is simulated.

    Args:
        loop: The loop's numbers, its profile among them.
    """

    def __init__(self, loop: LoopSetUp):
        self._loop = loop
        self._omega = profile(loop, 1)

    @property
    def loop(self) -> LoopSetUp:
        return self._loop

    @property
    def ticks(self) -> int:
        return len(self._omega)

    @property
    def driven(self) -> bool:
        return False

    def with_readings(self, readings: ReadingLimits) -> "FreeTick":
        other = copy.copy(self)
        other._loop = msgspec.structs.replace(self._loop, readings=readings)
        return other

    def begin(self, start: Start) -> LoopState:
        return _at_rest(np.zeros(NUMBERS), start, self._loop)

    def step(self, state: LoopState, given: TickInput) -> tuple[LoopState, TickOutput]:
        loop, number = self._loop, state.number + given.skipped
        watch, verdict = _judge(loop, state, given)
        omega = _omega(loop, self._omega, number, state.demand, given.ramping)
        asked = RigCommand(float(omega[-1]), 0.0)
        allowed = limit_command(loop.commands, state.demand, asked, loop.tick)
        demand, held_back = (None, True) if allowed is None else allowed
        still = CompiledStep.compute(state.packed)
        said = TickOutput(
            number, state.demand, still, still, demand, asked, held_back, verdict, False
        )
        packed = state.packed
        after = LoopState(number + 1, packed, watch, demand or state.demand, number, packed)
        return after, said


def begin(physics: LoopPhysics, start: Start) -> LoopState:
    """The loop before its first tick, the wheel at rest."""
    return _at_rest(physics.begin(start), start, physics.loop)


def step_tick(
    physics: LoopPhysics, state: LoopState, given: TickInput
) -> tuple[LoopState, TickOutput]:
    """Judge the reading, tune, simulate to the tick's end, and compute the command to the rig.

    Args:
        physics: The loop, made ready.
        state: At the end of the last tick that was made.
        given: Input of the tick.
    """
    loop, step = physics.loop, physics.step
    packed, number = state.packed, state.number + given.skipped
    # The rig has held the last command over the ticks that were skipped, and so does this.
    held = np.full(step.substeps, state.demand.omega)
    for _ in range(given.skipped):
        packed = step(packed, NO_READING, held)

    watch, verdict = _judge(loop, state, given)
    wanted = _omega(loop, physics.omega, number, state.demand, given.ramping)
    hold, stuck = loop.hold, watch.stuck
    if hold is None:
        zeta_held = False
    else:
        if stuck and not state.watch.stuck:  # what z said since it last changed was no reading
            packed = step.with_tuner_of(packed, state.moved)
        fastest = max(abs(state.demand.omega), abs(float(wanted[-1])))
        zeta_held = stuck or fastest <= hold.standing_omega
    due = number - state.tuned >= loop.tuning_ticks and not (given.ramping or given.old)
    usable = given.reading is not None and verdict is Verdict.USED and due
    sinkage, tuned = NO_READING, state.tuned
    if given.reading is not None and usable and not zeta_held:
        sinkage, tuned = -given.reading.z, number

    before = step.compute(packed)
    # What is simulated is what will be asked for, so a limit on omega comes before the step.
    turning = limit_command(
        loop.commands, state.demand, RigCommand(wanted[-1], state.demand.vx), loop.tick
    )
    if turning is not None and turning[1]:
        wanted = _even_steps(state.demand.omega, turning[0].omega, step.substeps)
    packed = step(packed, sinkage, wanted)
    after = step.compute(packed)
    at_bound = False
    if hold is not None and not hold.min_zeta < after.zeta < hold.max_zeta:
        at_bound = True
        packed = step.with_zeta(packed, min(max(after.zeta, hold.min_zeta), hold.max_zeta))
        after = step.compute(packed)

    asked = RigCommand(float(wanted[-1]), after.vx)
    allowed = limit_command(loop.commands, state.demand, asked, loop.tick)
    demand, held_back = (None, True) if turning is None or allowed is None else allowed
    held_back = held_back or (turning is not None and turning[1])
    changed = after.zeta != before.zeta
    said = TickOutput(
        number,
        state.demand,
        before,
        after,
        demand,
        asked,
        held_back,
        verdict,
        changed,
        (usable and zeta_held) or at_bound,
        at_bound,
    )
    moved = packed if watch.still_since != state.watch.still_since else state.moved
    return LoopState(number + 1, packed, watch, demand or state.demand, tuned, moved), said


def _at_rest(packed: Packed, start: Start, loop: LoopSetUp) -> LoopState:
    watch = ReadingMonitor(0.0, -start.sinkage)
    return LoopState(0, packed, watch, REST, -loop.tuning_ticks, packed)


def _judge(
    loop: LoopSetUp, state: LoopState, given: TickInput
) -> tuple[ReadingMonitor, Verdict | None]:
    if given.reading is None:
        return state.watch, None
    return check_reading(loop.readings, state.watch, given.reading, *state.demand)


def _omega(
    loop: LoopSetUp, table: np.ndarray, number: int, demand: RigCommand, ramping: bool
) -> np.ndarray:
    """Angular velocity at the end of each substep [rad/s]."""
    if not ramping and number < len(table):
        return table[number]
    speed = max(abs(demand.omega) - loop.ramp * loop.tick, 0.0)
    end = math.copysign(speed, demand.omega) if speed else 0.0
    return _even_steps(demand.omega, end, table.shape[1])


def _even_steps(start: float, end: float, substeps: int) -> np.ndarray:
    """The ends of even steps from one number to another; the last is that other, exactly."""
    return np.linspace(start, end, substeps + 1)[1:]
