"""Frames damaged at random, fed to both ends of the link."""

import math
import random
from collections import Counter
from dataclasses import dataclass, field

from hils.link.framing import FrameSplitter, Receiver
from hils.link.messages import (
    FROM_RIG,
    LONGEST_PACKET,
    U32,
    Arm,
    Bye,
    Drive,
    EmergencyStop,
    Frame,
    Hello,
    HelloAck,
    Measurement,
    Message,
    RigState,
    StateReport,
    Stop,
    decode,
    encode,
)
from hils.rig_sim.firmware import RigIdentity, RigProtocol

SESSION = 0x0101
POOL = 200  # intact frames that a batch is made from
CHUNK = 700  # longest piece that is fed at once [bytes]


def random_message(random: random.Random) -> Message:
    """Random message, with any values that its fields can hold."""

    def bits(count: int) -> int:
        return random.getrandbits(count)

    def real() -> float:
        return random.choice((0.0, random.uniform(-2.0, 2.0), random.uniform(-1e38, 1e38)))

    state = RigState(random.randrange(5))
    counts = [random.randrange(-(1 << 31), 1 << 31) for _ in range(2)]
    return random.choice(
        (
            Hello(bits(32), bits(16), bits(16), bits(32)),
            HelloAck(bits(32), bits(32), real(), real(), real(), real(), bits(16), state),
            Arm(),
            Drive(real(), real(), bool(bits(1)), bits(16)),
            Drive(random.uniform(-2.0, 2.0), 0.0, False, bits(16)),
            Measurement(bits(32), *counts, real(), state, bits(16)),
            Stop(),
            EmergencyStop(bits(16)),
            StateReport(state, bits(16), bits(32)),
            Bye(),
        )
    )


def spoilt(random: random.Random, frame: bytes, other: bytes) -> bytes:
    """Frame after one random damage or several."""
    data = bytearray(frame)
    for _ in range(random.choice((1, 1, 1, 2, 5))):
        place = random.randrange(len(data) or 1)
        match random.randrange(9):
            case 0 if data:
                data[place] ^= 1 << random.randrange(8)
            case 1 if data:
                data[place] = random.getrandbits(8)
            case 2:
                del data[place : place + random.randrange(1, 5)]
            case 3:
                data[place:place] = random.randbytes(random.randrange(1, 5))
            case 4:
                del data[place:]
            case 5:  # the end of another frame behind the start of this one
                data[place:] = other[random.randrange(len(other)) :]
            case 6:
                data[place:place] = data[: random.randrange(len(data) + 1)]
            case 7:
                piece = data[place : place + 8]
                random.shuffle(piece)
                data[place : place + 8] = piece
            case _:
                data = bytearray(random.randbytes(random.randrange(2 * LONGEST_PACKET)))
    return bytes(data)


@dataclass
class Tally:
    """Counts of the outcomes of damaged frames.

    Attributes:
        spoilt: How many there were; one in ten more is left as it is, between them.
        counted: Frames that the host took, all of them as they had been sent.
        obeyed: How often the rig moved by one.
        drops: The rest, by cause.
    """

    spoilt: int = 0
    counted: int = 0
    obeyed: int = 0
    drops: Counter = field(default_factory=Counter)


def judge_batch(seed: int, count: int, tally: Tally) -> None:
    """Spoil so many frames and feed them to a decoder, a host's receiver and a rig.

    Raises:
        AssertionError: a frame that nobody sent was taken, one went uncounted, or the rig was
            asked for more than its limits.
    """
    source = random.Random(seed)
    messages = [random_message(source) for _ in range(POOL)]
    frames = [
        encode(Frame(each, source.choice((SESSION, SESSION, source.getrandbits(16))), seq, 0))
        for seq, each in enumerate(messages)
    ]
    stream = b"".join(
        spoilt(source, source.choice(frames), source.choice(frames))
        + (source.choice(frames) if source.random() < 0.1 else b"")
        for _ in range(count)
    )
    sent = set(frames)
    packets = [packet for packet in stream.split(b"\0") if packet]
    for packet in packets:
        found = decode(packet)
        assert not isinstance(found, Frame) or encode(found) in sent, packet.hex(" ")
    tally.spoilt += count
    _feed_host(source, stream, sent, len(packets), tally)
    _feed_rig(source, stream, tally)


def _pieces(source: random.Random, stream: bytes) -> list[bytes]:
    pieces, place = [], 0
    while place < len(stream):
        length = source.randrange(1, CHUNK)
        pieces.append(stream[place : place + length])
        place += length
    return pieces


def _feed_host(
    source: random.Random, stream: bytes, sent: set[bytes], packets: int, tally: Tally
) -> None:
    receiver = Receiver(FROM_RIG)
    for piece in _pieces(source, stream):
        receiver.expect(SESSION)
        for frame in receiver.feed(piece):
            assert encode(frame) in sent
            assert frame.session == SESSION
            assert isinstance(frame.message, FROM_RIG)
    dropped = sum(receiver.drops.values())
    # What stands behind the last delimiter is still awaited.
    assert 0 <= packets - receiver.accepted - dropped <= 1
    tally.counted += receiver.accepted
    tally.drops.update(receiver.drops)


def _feed_rig(source: random.Random, stream: bytes, tally: Tally) -> None:
    rig, splitter, now = RigProtocol(RigIdentity(boot_id=1)), FrameSplitter(), 0.0
    # Another session and back, so that the rig is armed and takes any sequence number after zero.
    ready = b"".join(
        encode(Frame(*each, 0))
        for each in (
            (Hello(10_000, 50), 7, 0),
            (Hello(10_000, 50), SESSION, U32),
            (Arm(), SESSION, 0),
        )
    )
    for piece in _pieces(source, stream):
        rig.advance(now, ready)
        now += 1e-3
        out = rig.advance(now, piece)
        tally.obeyed += rig.state is RigState.RUNNING
        assert all(isinstance(decode(packet), Frame) for packet in splitter.packets(out))
        assert math.isfinite(rig.demand.omega)
        assert abs(rig.demand.omega) <= 2.0
        assert abs(rig.demand.vx) <= 0.3000001
