"""Frames that must not count, each with one thing wrong."""

import struct
import zlib
from collections.abc import Callable

from cobs import cobs

from hils.conformance.probe import HOLD, Probe
from hils.link.messages import (
    DELIMITER,
    U32,
    Arm,
    EmergencyStop,
    Frame,
    Message,
    StateReport,
    encode,
)

Damage = Callable[[Probe], list[bytes]]


def wrong_checksum(probe: Probe) -> list[bytes]:
    """ARM and CMD with one bit of the CRC flipped, and ARM with one of its clock."""
    frames = [_framed(_body(probe, message), checksum_error=1 << 9) for message in (Arm(), HOLD)]
    body = _body(probe, Arm())
    right = zlib.crc32(body)
    body[8] ^= 1
    return [*frames, _framed(body, checksum_error=right ^ zlib.crc32(body))]


def wrong_version(probe: Probe) -> list[bytes]:
    """ARM of the versions 0 and 2."""
    return [_changed(probe, Arm(), 0, value) for value in (0, 2)]


def wrong_type(probe: Probe) -> list[bytes]:
    """Types that there are not, and a STATE, which only a rig sends."""
    unknown = [_changed(probe, Arm(), 1, value) for value in (0, 10, 255)]
    state = StateReport(probe.ack.state, 0, probe.ack.boot_id)
    return [*unknown, _framed(_body(probe, state))]


def wrong_length(probe: Probe) -> list[bytes]:
    """ARM with a byte too many, CMD with one too few and ESTOP without its reason."""
    longer, shorter = _body(probe, Arm()) + b"\x01", _body(probe, HOLD)[:-1]
    return [_framed(longer), _framed(shorter), _framed(_body(probe, EmergencyStop(1))[:-2])]


def old_number(probe: Probe) -> list[bytes]:
    """ARM with the last sequence number, one before it, and one 2^31 after it."""
    seqs = (probe.seq, (probe.seq - 1) & U32, (probe.seq + (1 << 31)) & U32)
    return [encode(Frame(Arm(), probe.session, seq, 0)) for seq in seqs]


def broken_stuffing(probe: Probe) -> list[bytes]:
    """Packets whose COBS leads past their end, and a frame cut off in its middle."""
    frame = encode(probe.next_frame(Arm()))
    beyond = DELIMITER + bytes([0xFF]) + frame[2:-1] + DELIMITER
    return [beyond, frame[: len(frame) // 2], b"\x00\x05\x01\x00"]


def overlong_packet(probe: Probe) -> list[bytes]:
    """Noise without a delimiter, longer than any buffer, then an ARM behind it without one."""
    return [b"\x55" * 2000 + encode(probe.next_frame(Arm()))[1:]]


def _body(probe: Probe, message: Message) -> bytearray:
    """Header and payload of the next frame."""
    return bytearray(cobs.decode(encode(probe.next_frame(message))[1:-1])[:-4])


def _changed(probe: Probe, message: Message, place: int, value: int) -> bytes:
    body = _body(probe, message)
    body[place] = value
    return _framed(body)


def _framed(body: bytearray, checksum_error: int = 0) -> bytes:
    checksum = struct.pack("<I", zlib.crc32(body) ^ checksum_error)
    return DELIMITER + cobs.encode(bytes(body) + checksum) + DELIMITER
