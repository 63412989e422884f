"""The wire between host and rig, version 1: messages to bytes and back, without any state.

    frame = 0x00 | COBS( header | payload | CRC-32 ) | 0x00

Numbers are little-endian; the CRC is zlib's, over header and payload; the header is version u8,
type u8, session u16, sequence number u32 and the sender's clock u32 [us], which wraps. The page
`docs/reference/wire.md` says what each message means.
"""

import enum
import math
import struct
import zlib
from collections.abc import Callable
from typing import Any, Generic, NamedTuple, TypeVar

import msgspec
from cobs import cobs

from drftjax.common.errors import InputError

VERSION = 1


SCHEMA = 0x44524654


DELIMITER = b"\x00"


BITS_PER_BYTE = 10  # start bit, eight data bits, stop bit


U16, U32 = 0xFFFF, 0xFFFF_FFFF


_HEADER = struct.Struct("<BBHII")


_CHECKSUM = struct.Struct("<I")


# COBS adds one byte to anything shorter than 254 bytes, and there are two delimiters.
_FRAMING = _HEADER.size + _CHECKSUM.size + 1 + 2


# rig_id of the virtual rig, so that a host can tell it from a real one: "VIRT".
VIRTUAL_RIG = 0x56495254


class RigState(enum.IntEnum):
    """State of the rig; SAFE is latched (docs/reference/wire.md)."""

    IDLE = 0
    ARMED = 1
    RUNNING = 2
    SAFE = 3
    FAULT = 4


READY = (RigState.ARMED, RigState.RUNNING)


"""States in which a rig follows commands."""


class Drop(enum.Enum):
    """Cause for which something received does not count; the value is its wording for a person."""

    OVERLONG = "longer than any frame"
    COBS = "no COBS"
    SHORT = "shorter than a header"
    CRC = "wrong checksum"
    VERSION = "another version"
    TYPE = "unknown type"
    LENGTH = "wrong length for its type"
    CONTENT = "unknown state"
    DIRECTION = "not for this end"
    SESSION = "another session"
    ORDER = "not newer"


class Hello(msgspec.Struct, frozen=True):
    """Host to rig: open a session. Times are the control period [us] and the watchdog [ms]."""

    tick_us: int
    watchdog_ms: int
    flags: int = 0
    schema: int = SCHEMA


class HelloAck(msgspec.Struct, frozen=True):
    """Rig to host: who answers, and its limits.

    Attributes:
        rig_id: Which rig this is.
        boot_id: Another one after each reset.
        z_scale, x_scale: Metres a count.
        omega_max: Largest angular velocity [rad/s].
        vx_max: Largest carriage speed [m/s].
        watchdog_ms: Time without a command after which the rig goes SAFE [ms].
        state: Of the rig.
        schema: Which table of messages it speaks.
    """

    rig_id: int
    boot_id: int
    z_scale: float
    x_scale: float
    omega_max: float
    vx_max: float
    watchdog_ms: int
    state: RigState
    schema: int = SCHEMA


class Arm(msgspec.Struct, frozen=True):
    """Host to rig: commands may move it from here on."""


class Drive(msgspec.Struct, frozen=True):
    """Host to rig, CMD: what to do until the next one.

    Attributes:
        omega: Angular velocity, positive driving forward [rad/s].
        vx: Carriage speed [m/s], where it is driven.
        driven: Whether the carriage is driven at vx; else it runs free.
        valid_ms: How long the command may be held without a newer one [ms].
    """

    omega: float
    vx: float
    driven: bool
    valid_ms: int


class Measurement(msgspec.Struct, frozen=True):
    """Rig to host, MEAS.

    Attributes:
        ack_seq: Sequence number of the newest command that the rig received.
        z: Height, up positive [counts], zero at power-up.
        x: Position, forward positive [counts].
        omega: Angular velocity as measured [rad/s]; a rig that does not measure it may send NaN.
        state: Of the rig.
        fault: Zero where there is none.
    """

    ack_seq: int
    z: int
    x: int
    omega: float
    state: RigState
    fault: int


class Stop(msgspec.Struct, frozen=True):
    """Host to rig: ramp to rest and stay armed."""


class EmergencyStop(msgspec.Struct, frozen=True):
    """Either way: rest at once, latched."""

    reason: int


class StateReport(msgspec.Struct, frozen=True):
    """Rig to host, STATE: the answer to ARM and ESTOP, and what changed of itself."""

    state: RigState
    reason: int
    boot_id: int


class Bye(msgspec.Struct, frozen=True):
    """Host to rig: the session ends."""


Message = Hello | HelloAck | Arm | Drive | Measurement | Stop | EmergencyStop | StateReport | Bye


FROM_HOST = (Hello, Arm, Drive, Stop, EmergencyStop, Bye)


FROM_RIG = (HelloAck, Measurement, EmergencyStop, StateReport)


class Frame(NamedTuple):
    """A message as it stands on the wire.

    Attributes:
        message: What is said.
        session: Number of the session it belongs to.
        seq: Sequence number, one count over all messages of a sender.
        t_us: The sender's clock [us], modulo 2^32.
    """

    message: Message
    session: int
    seq: int
    t_us: int


M = TypeVar("M")


class _Layout(NamedTuple, Generic[M]):
    """A message type's payload."""

    number: int
    name: str
    packing: struct.Struct
    fields: Callable[[M], tuple]
    message: Callable[..., M]


_LAYOUTS: dict[type, _Layout[Any]] = {
    Hello: _Layout(
        1,
        "HELLO",
        struct.Struct("<IIHH"),
        lambda m: (m.schema, m.tick_us, m.watchdog_ms, m.flags),
        lambda schema, tick_us, watchdog_ms, flags: Hello(tick_us, watchdog_ms, flags, schema),
    ),
    HelloAck: _Layout(
        2,
        "HELLO_ACK",
        struct.Struct("<IIIffffHH"),
        lambda m: (
            *(m.schema, m.rig_id, m.boot_id, m.z_scale, m.x_scale),
            *(m.omega_max, m.vx_max, m.watchdog_ms, m.state),
        ),
        lambda schema, *rest: HelloAck(*rest[:-1], state=RigState(rest[-1]), schema=schema),
    ),
    Arm: _Layout(3, "ARM", struct.Struct("<"), lambda m: (), Arm),
    Drive: _Layout(
        4,
        "CMD",
        struct.Struct("<ffHH"),
        lambda m: (m.omega, m.vx, int(m.driven), m.valid_ms),
        # The other flags mean nothing in this version.
        lambda omega, vx, flags, valid_ms: Drive(omega, vx, bool(flags & 1), valid_ms),
    ),
    Measurement: _Layout(
        5,
        "MEAS",
        struct.Struct("<IiifHH"),
        lambda m: (m.ack_seq, m.z, m.x, m.omega, m.state, m.fault),
        lambda ack_seq, z, x, omega, state, fault: Measurement(
            ack_seq, z, x, omega, RigState(state), fault
        ),
    ),
    Stop: _Layout(6, "STOP", struct.Struct("<"), lambda m: (), Stop),
    EmergencyStop: _Layout(7, "ESTOP", struct.Struct("<H"), lambda m: (m.reason,), EmergencyStop),
    StateReport: _Layout(
        8,
        "STATE",
        struct.Struct("<HHI"),
        lambda m: (m.state, m.reason, m.boot_id),
        lambda state, reason, boot_id: StateReport(RigState(state), reason, boot_id),
    ),
    Bye: _Layout(9, "BYE", struct.Struct("<"), lambda m: (), Bye),
}


_BY_NUMBER = {layout.number: layout for layout in _LAYOUTS.values()}


def message_name(kind: type) -> str:
    """A message type's name in the table of `docs/reference/wire.md`."""
    return _LAYOUTS[kind].name


def wire_bytes(kind: type) -> int:
    """Length [bytes] of a frame of this message type on the wire, delimiters included."""
    return _LAYOUTS[kind].packing.size + _FRAMING


LONGEST_PACKET = max(map(wire_bytes, _LAYOUTS)) - 2


def encode(frame: Frame) -> bytes:
    """The frame's bytes, both delimiters included.

    Raises:
        InputError: a number does not fit its field.
    """
    layout = _LAYOUTS[type(frame.message)]
    try:
        body = _HEADER.pack(VERSION, layout.number, *frame[1:]) + layout.packing.pack(
            *layout.fields(frame.message)
        )
    except (struct.error, OverflowError):
        sent = f"{layout.name} {frame.message} cannot be sent"
        raise InputError(f"{sent}: a number in it does not fit its field") from None
    return DELIMITER + cobs.encode(body + _CHECKSUM.pack(zlib.crc32(body))) + DELIMITER


def decode(packet: bytes) -> Frame | Drop:
    """The frame between two delimiters, or why it does not count.

    Session and sequence number are the receiver's to judge: `hils.link.framing`.
    """
    if len(packet) > LONGEST_PACKET:
        return Drop.OVERLONG
    try:
        content = cobs.decode(packet)
    except cobs.DecodeError:
        return Drop.COBS
    if len(content) < _HEADER.size + _CHECKSUM.size:
        return Drop.SHORT
    body = content[: -_CHECKSUM.size]
    if _CHECKSUM.unpack_from(content, len(body)) != (zlib.crc32(body),):
        return Drop.CRC
    version, number, session, seq, t_us = _HEADER.unpack_from(body)
    if version != VERSION:
        return Drop.VERSION
    layout = _BY_NUMBER.get(number)
    if layout is None:
        return Drop.TYPE
    if len(body) != _HEADER.size + layout.packing.size:
        return Drop.LENGTH
    try:
        message = layout.message(*layout.packing.unpack_from(body, _HEADER.size))
    except ValueError:  # a state that is not in the table
        return Drop.CONTENT
    return Frame(message, session, seq, t_us)


def is_newer(new: int, last: int) -> bool:
    """Return True where a sequence number comes after another, over the wrap at 2^32."""
    return 0 < (new - last) & U32 < 1 << 31


def clock_us(seconds: float) -> int:
    """A clock's reading [s] as a header's t_us."""
    return math.floor(seconds * 1e6) & U32


# Reasons of an emergency stop, as the rig is told.
EMERGENCY, NOT_RESTED = 1, 2


class Reason(enum.IntEnum):
    """Reasons for a change of state of this project's rigs; other rigs have their own numbers."""

    NONE = 0
    WATCHDOG = 1
    ANOTHER_SESSION = 2
    HELLO_WHILE_ARMED = 3
    HOST_STOPPED = 4
    COMMAND_REFUSED = 5
    HELLO_NEEDED = 6
    HELLO_REFUSED = 7
    BYE = 8
    SENSOR = 9
    DRIVE = 10


REASON_MEANINGS = {
    Reason.NONE: "none given",
    Reason.WATCHDOG: "watchdog: no valid command in time",
    Reason.ANOTHER_SESSION: "a frame of another session",
    Reason.HELLO_WHILE_ARMED: "HELLO while it was armed",
    Reason.HOST_STOPPED: "stopped by the host",
    Reason.COMMAND_REFUSED: "a command beyond its limits",
    Reason.HELLO_NEEDED: "ARM without a HELLO before it",
    Reason.HELLO_REFUSED: "a HELLO whose tick cannot be",
    Reason.BYE: "BYE",
    Reason.SENSOR: "a sensor failed",
    Reason.DRIVE: "the drive failed",
}


def reason_in_words(rig_id: int, reason: int) -> str:
    """A rig's reason, in words where they are known: other rigs have numbers of their own."""
    if rig_id != VIRTUAL_RIG:
        return f"reason {reason} (see its firmware)"
    words = {int(each): said for each, said in REASON_MEANINGS.items()}.get(reason, "unknown")
    return f"reason {reason} ({words})"
