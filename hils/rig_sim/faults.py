"""Faults that a virtual rig can be told to have, and when: what a TOML file of faults holds.

    seed = 7

    [[fault]]
    what = {kind = "lost_frames", rate = 0.3, towards = "rig"}
    when = {after = "motion", start = 1.0, duration = 2.0}

Each fault is a pure function of what passes it and of random numbers: a wire's turns one packet
into those that come instead, a reading's one set of counts into another, a drive's one demand into
another. docs/reference/hils-faults.md lists the kinds.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal, NamedTuple, get_args

import msgspec
import numpy as np

from drftjax.common.arrays import require_between
from drftjax.common.errors import InputError
from drftjax.common.structured_files import read_document, to_structure
from hils.link.messages import DELIMITER
from hils.rig_sim.firmware import MotorDemand
from hils.rig_sim.serial_line import DelayedPacket

End = Literal["host", "rig", "both"]


Channel = Literal["z", "x", "both"]


Occasion = Literal["power", "hello", "arm", "motion", "stop"]


# A delay beyond this is a slip of units [s].
LONGEST_DELAY = 10.0


INT32 = 2**31 - 1


class Counts(NamedTuple):
    """A set of readings: the scales' counts, and the wheel's angular velocity [rad/s]."""

    z: int
    x: int
    omega: float


class _FaultKindBase(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind"):
    """A kind of fault; `kind` names it in a file.

    Of a wire's fault, rate is the share of frames or bytes that it strikes, and towards the end at
    which they would arrive.
    """


class LostFrames(_FaultKindBase, frozen=True, tag="lost_frames"):
    """Whole frames vanish."""

    rate: float = 1.0
    towards: End = "both"

    def strike(self, packet: DelayedPacket, random: np.random.Generator) -> list[DelayedPacket]:
        return [] if random.random() < self.rate else [packet]


class DamagedFrames(_FaultKindBase, frozen=True, tag="damaged_frames"):
    """One bit of a frame, between its delimiters, is flipped."""

    rate: float = 1.0
    towards: End = "both"

    def strike(self, packet: DelayedPacket, random: np.random.Generator) -> list[DelayedPacket]:
        if random.random() >= self.rate or len(packet.data) < 3:
            return [packet]
        struck = bytearray(packet.data)
        struck[random.integers(1, len(struck) - 1)] ^= 1 << int(random.integers(8))
        return [replace(packet, data=bytes(struck))]


class DuplicatedFrames(_FaultKindBase, frozen=True, tag="duplicated_frames"):
    """Frames come twice."""

    rate: float = 1.0
    towards: End = "both"

    def strike(self, packet: DelayedPacket, random: np.random.Generator) -> list[DelayedPacket]:
        return [packet] * (2 if random.random() < self.rate else 1)


class ReorderedFrames(_FaultKindBase, frozen=True, tag="reordered_frames"):
    """Frames are overtaken by those behind them; delay: how late they come [s]."""

    rate: float = 1.0
    towards: End = "both"
    delay: float = 0.03

    def strike(self, packet: DelayedPacket, random: np.random.Generator) -> list[DelayedPacket]:
        if random.random() >= self.rate:
            return [packet]
        return [replace(packet, due=packet.due + self.delay, in_order=False)]


class DelayedFrames(_FaultKindBase, frozen=True, tag="delayed_frames"):
    """Frames come late, and all behind them with them; delay: how late [s]."""

    rate: float = 1.0
    towards: End = "both"
    delay: float = 0.03

    def strike(self, packet: DelayedPacket, random: np.random.Generator) -> list[DelayedPacket]:
        late = self.delay * (random.random() < self.rate)
        return [replace(packet, due=packet.due + late)]


class LostBytes(_FaultKindBase, frozen=True, tag="lost_bytes"):
    """Single bytes vanish."""

    rate: float = 1.0
    towards: End = "both"

    def strike(self, packet: DelayedPacket, random: np.random.Generator) -> list[DelayedPacket]:
        kept = random.random(len(packet.data)) >= self.rate
        return [replace(packet, data=bytes(np.frombuffer(packet.data, np.uint8)[kept]))]


class FlippedBytes(_FaultKindBase, frozen=True, tag="flipped_bytes"):
    """One bit of single bytes is flipped."""

    rate: float = 1.0
    towards: End = "both"

    def strike(self, packet: DelayedPacket, random: np.random.Generator) -> list[DelayedPacket]:
        count = len(packet.data)
        struck = random.random(count) < self.rate
        bits = np.left_shift(1, random.integers(0, 8, count)).astype(np.uint8)
        data = np.frombuffer(packet.data, np.uint8) ^ np.where(struck, bits, 0).astype(np.uint8)
        return [replace(packet, data=data.tobytes())]


class DuplicatedBytes(_FaultKindBase, frozen=True, tag="duplicated_bytes"):
    """Single bytes come twice."""

    rate: float = 1.0
    towards: End = "both"

    def strike(self, packet: DelayedPacket, random: np.random.Generator) -> list[DelayedPacket]:
        times = 1 + (random.random(len(packet.data)) < self.rate)
        return [
            replace(packet, data=np.repeat(np.frombuffer(packet.data, np.uint8), times).tobytes())
        ]


class ReorderedBytes(_FaultKindBase, frozen=True, tag="reordered_bytes"):
    """Single bytes change places with the next one."""

    rate: float = 1.0
    towards: End = "both"

    def strike(self, packet: DelayedPacket, random: np.random.Generator) -> list[DelayedPacket]:
        data = bytearray(packet.data)
        for place in np.flatnonzero(random.random(max(len(data) - 1, 0)) < self.rate).tolist():
            data[place], data[place + 1] = data[place + 1], data[place]
        return [replace(packet, data=bytes(data))]


class DelayedBytes(_FaultKindBase, frozen=True, tag="delayed_bytes"):
    """A gap opens within a frame; rate: share of the frames; delay: how long [s]."""

    rate: float = 1.0
    towards: End = "both"
    delay: float = 0.03

    def strike(self, packet: DelayedPacket, random: np.random.Generator) -> list[DelayedPacket]:
        if random.random() >= self.rate or len(packet.data) < 2:
            return [packet]
        cut = int(random.integers(1, len(packet.data)))
        late = replace(packet, due=packet.due + self.delay, data=packet.data[cut:])
        return [replace(packet, data=packet.data[:cut]), late]


class StuckScale(_FaultKindBase, frozen=True, tag="stuck"):
    """A scale stands still at what it read when the fault began."""

    channel: Channel = "z"

    def read(self, counts: Counts, begun: Counts, random: np.random.Generator) -> Counts:
        return _with(counts, self.channel, begun.z, begun.x)


class ScaleJump(_FaultKindBase, frozen=True, tag="absurd"):
    """A scale jumps; rate: share of the readings; counts: how far, to either side."""

    channel: Channel = "z"
    rate: float = 1.0
    counts: int = INT32

    def read(self, counts: Counts, begun: Counts, random: np.random.Generator) -> Counts:
        away = self.counts * int(random.choice((-1, 1))) * int(random.random() < self.rate)
        return _with(counts, self.channel, counts.z + away, counts.x + away)


class SaturatedDrive(_FaultKindBase, frozen=True, tag="saturated"):
    """The wheel's drive gives no more than this angular velocity [rad/s]."""

    omega: float = 0.1

    def drive(self, demand: MotorDemand) -> MotorDemand:
        held = math.copysign(min(abs(demand.omega), self.omega), demand.omega)
        return demand._replace(omega=held)


class Runaway(_FaultKindBase, frozen=True, tag="runaway"):
    """The wheel turns at this angular velocity, whatever is demanded [rad/s]."""

    omega: float = 1.5

    def drive(self, demand: MotorDemand) -> MotorDemand:
        return demand._replace(omega=self.omega)


class ReversedDrive(_FaultKindBase, frozen=True, tag="reversed_drive"):
    """The wheel turns the other way round."""

    def drive(self, demand: MotorDemand) -> MotorDemand:
        return demand._replace(omega=-demand.omega)


class ReversedCarriage(_FaultKindBase, frozen=True, tag="reversed_carriage"):
    """The carriage is driven the other way."""

    def drive(self, demand: MotorDemand) -> MotorDemand:
        return demand._replace(vx=-demand.vx)


class SlowLine(_FaultKindBase, frozen=True, tag="slow_line"):
    """The line carries only so many bits a second, both ways, and what waits comes ever later."""

    baud: float = 9600.0


class CreepingClock(_FaultKindBase, frozen=True, tag="creeping_clock"):
    """The rig's clock runs faster by this share [-]; slower where it is negative."""

    skew: float = 0.01


class DriveFault(_FaultKindBase, frozen=True, tag="drive_fault"):
    """The drive reports a fault of this number and stands still."""

    code: int = 1


class Disconnect(_FaultKindBase, frozen=True, tag="disconnect"):
    """The plug is out for the fault's duration."""


class Reset(_FaultKindBase, frozen=True, tag="reset"):
    """The firmware starts again: the drive has no power for the fault's duration."""


WireFault = (
    LostFrames
    | DamagedFrames
    | DuplicatedFrames
    | ReorderedFrames
    | DelayedFrames
    | LostBytes
    | FlippedBytes
    | DuplicatedBytes
    | ReorderedBytes
    | DelayedBytes
)


ReadingFault = StuckScale | ScaleJump


DemandFault = SaturatedDrive | Runaway | ReversedDrive | ReversedCarriage


DeviceFault = DriveFault | Disconnect | Reset | SlowLine | CreepingClock


FaultKind = WireFault | ReadingFault | DemandFault | DeviceFault


KINDS = tuple(msgspec.inspect.type_info(each).tag for each in get_args(FaultKind))  # pyright: ignore[reportAttributeAccessIssue]


class Window(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Time window in which a fault acts, in seconds of the host's clock.

    Attributes:
        after: Occasion that the start counts from, at its first time: the rig's power-up, the first
            HELLO, the first ARM, the first motion of the wheel, or the first STOP.
        start: From then on [s].
        duration: How long [s]; to the end where none is given.
    """

    after: Occasion = "power"
    start: float = 0.0
    duration: float = math.inf

    def edges(self, occasions: Mapping[str, float]) -> tuple[float, float]:
        """Begin and end of the window [s]; infinite while its occasion has not come."""
        begun = occasions.get(self.after, math.inf) + self.start
        return begun, begun + self.duration

    def holds(self, occasions: Mapping[str, float], now: float) -> bool:
        begun, ended = self.edges(occasions)
        return begun <= now < ended


class Fault(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One fault: what, and when."""

    what: FaultKind
    when: Window = Window()


class FaultScript(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """All faults of a rig, and the seed of their chances."""

    faults: tuple[Fault, ...] = msgspec.field(default=(), name="fault")
    seed: int = 0

    def check(self) -> None:
        """Refuse what cannot be.

        Raises:
            InputError: says which fault, what was given and what must hold.
        """
        for number, fault in enumerate(self.faults, start=1):
            _check(fault, f"fault {number}")


def read_faults(path: str | Path) -> FaultScript:
    """A TOML or JSON file of faults.

    Raises:
        InputError: names the file, the entry and what must hold.
    """
    path = Path(path)
    document = read_document(path)
    if document and not document.keys() & {"fault", "seed"}:
        given = ", ".join(map(repr, document))
        raise InputError(f"{path}: holds {given}; a file of faults holds seed and [[fault]]")
    entries = document.get("fault", [])
    for number, entry in enumerate(entries if isinstance(entries, list) else [], start=1):
        what = entry.get("what") if isinstance(entry, dict) else None
        kind = what.get("kind") if isinstance(what, dict) else None
        if kind is not None and kind not in KINDS:
            raise InputError(
                f"{path}: fault {number} is of kind {kind!r}, must be one of {', '.join(KINDS)}"
            )
    script = to_structure(document, FaultScript, path)
    try:
        script.check()
    except InputError as problem:
        raise InputError(f"{path}: {problem}") from None
    return script


def split_frames(rest: bytes, data: bytes) -> tuple[list[bytes], bytes]:
    """Frames with their delimiters in a stream of bytes, and what is not complete yet.

    Args:
        rest: What was not complete before.
        data: The bytes that follow it.
    """
    *complete, rest = (rest + data).split(DELIMITER)
    return [DELIMITER + each + DELIMITER for each in complete if each], rest


def _with(counts: Counts, channel: Channel, z: int, x: int) -> Counts:
    held = {
        "z": counts.z if channel == "x" else max(-INT32, min(INT32, z)),
        "x": counts.x if channel == "z" else max(-INT32, min(INT32, x)),
    }
    return counts._replace(**held)


def _check(fault: Fault, name: str) -> None:
    what, when = fault.what, fault.when
    require_between(f"{name}: start", when.start, 0.0, 1e6, " s")
    if not when.duration > 0:
        raise InputError(f"{name}: duration is {when.duration:g} s, must be above 0")
    for field, low, high, unit in (
        ("rate", 0.0, 1.0, ""),
        ("delay", 0.0, LONGEST_DELAY, " s"),
        ("omega", -100.0, 100.0, " rad/s"),
        ("baud", 50.0, 1e7, ""),
        ("skew", -0.5, 0.5, ""),
        ("code", 1, 0xFFFF, ""),
        ("counts", 0, INT32, ""),
    ):
        if hasattr(what, field):
            require_between(f"{name}: {field}", getattr(what, field), low, high, unit)
