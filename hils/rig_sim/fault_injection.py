"""Faults at work in one run: which hold now, with their random numbers and what they remember."""

import math

import numpy as np

from hils.rig_sim.faults import (
    Counts,
    CreepingClock,
    DemandFault,
    Disconnect,
    DriveFault,
    End,
    Fault,
    FaultScript,
    Occasion,
    Reset,
    ScaleJump,
    SlowLine,
    StuckScale,
    WireFault,
)
from hils.rig_sim.firmware import MotorDemand
from hils.rig_sim.sensors import RandomStream
from hils.rig_sim.serial_line import DelayedPacket


class FaultInjector:
    """A script of faults over the life of one rig, in explicit time.

    Each fault draws from numbers of its own, so that one more fault leaves the others' chances
    as they were.
    """

    def __init__(self, script: FaultScript):
        script.check()
        self._faults = script.faults
        self._randoms = [
            np.random.default_rng([script.seed, RandomStream.FAULT, number])
            for number in range(len(script.faults))
        ]
        self._occasions: dict[str, float] = {}
        self._begun: dict[int, Counts] = {}
        # What holds, and between which times: it changes only at an edge.
        self._held: list[tuple[int, Fault]] = []
        self._held_from, self._held_until = math.inf, -math.inf

    def mark(self, occasion: Occasion, now: float) -> None:
        """An occasion has come; only its first time counts."""
        if occasion not in self._occasions:
            self._occasions[occasion] = now
            self._held_until = -math.inf

    @property
    def occasions(self) -> dict[str, float]:
        """Time of each occasion, when it came first [s]."""
        return dict(self._occasions)

    def next_edge(self, now: float) -> float:
        """Time at which a fault next begins or ends [s]; infinite where none will."""
        self._holding(now)
        return self._held_until

    def packets(self, frames: list[bytes], towards: End, now: float) -> list[DelayedPacket]:
        """Packets that come of frames that set out now towards one end."""
        packets = [DelayedPacket(now, frame) for frame in frames]
        for number, fault in self._holding(now):
            what = fault.what
            if isinstance(what, WireFault) and what.towards in (towards, "both"):
                random = self._randoms[number]
                packets = [after for each in packets for after in what.strike(each, random)]
        return packets

    def counts(self, counts: Counts, now: float) -> Counts:
        """Counts that the scales give instead."""
        for number, fault in self._holding(now):
            if isinstance(fault.what, StuckScale | ScaleJump):
                begun = self._begun.setdefault(number, counts)
                counts = fault.what.read(counts, begun, self._randoms[number])
        return counts

    def demand(self, demand: MotorDemand, now: float) -> MotorDemand:
        """Demand that the drive follows instead."""
        for _, fault in self._holding(now):
            if isinstance(fault.what, DemandFault):
                demand = fault.what.drive(demand)
        return demand

    def line_baud(self, now: float) -> float | None:
        """Bits a second that the line carries instead; None where it is sound."""
        return min(
            (f.what.baud for _, f in self._holding(now) if isinstance(f.what, SlowLine)),
            default=None,
        )

    def clock_error(self, now: float) -> float:
        """Time that the rig's clock is ahead by creeping [s]."""
        error = 0.0
        for fault in self._faults:
            if isinstance(fault.what, CreepingClock):
                begin, end = fault.when.edges(self._occasions)
                error += fault.what.skew * max(0.0, min(now, end) - begin)
        return error

    def drive_fault(self, now: float) -> int:
        """Number of the fault that the drive reports; zero where it reports none."""
        codes = [f.what.code for _, f in self._holding(now) if isinstance(f.what, DriveFault)]
        return codes[0] if codes else 0

    def is_unplugged(self, now: float) -> bool:
        """Return True while the plug is out."""
        return any(isinstance(fault.what, Disconnect) for _, fault in self._holding(now))

    def is_powerless(self, now: float) -> bool:
        """Return True while the firmware is down for a reset."""
        return any(isinstance(fault.what, Reset) for _, fault in self._holding(now))

    def _holding(self, now: float) -> list[tuple[int, Fault]]:
        if not self._held_from <= now < self._held_until:
            self._held = [
                (number, fault)
                for number, fault in enumerate(self._faults)
                if fault.when.holds(self._occasions, now)
            ]
            edges = (edge for fault in self._faults for edge in fault.when.edges(self._occasions))
            self._held_from = now
            self._held_until = min((edge for edge in edges if edge > now), default=math.inf)
        return self._held
