"""The wire: each message's exact bytes, what is dropped and why, and nothing corrupt gets in."""

import math
import struct
import zlib

import pytest
from cobs import cobs

from drftjax.common.errors import InputError
from hils.link.framing import FrameSplitter, Receiver
from hils.link.messages import (
    FROM_HOST,
    FROM_RIG,
    LONGEST_PACKET,
    Arm,
    Bye,
    Drive,
    Drop,
    EmergencyStop,
    Frame,
    Hello,
    HelloAck,
    Measurement,
    RigState,
    StateReport,
    Stop,
    clock_us,
    decode,
    encode,
    is_newer,
    message_name,
    wire_bytes,
)
from hils.link.timing import require_baud, watchdog_ms, watchdog_us
from tests.helpers.frame_fuzzer import Tally, judge_batch

SESSION, SEQ, TIME = 0x1234, 0x01020304, 0x0A0B0C0D
HEADER = "34 12 04 03 02 01 0d 0c 0b 0a"
BOOT = 0xDEADBEEF

# Every message with that header, as it stands on the wire; numbers that 32 bits hold exactly.
FRAMES = {
    Hello(10_000, 50): (f"00 13 01 01 {HEADER} 54 46 52 44 10 27 01 02 32 01 01 05 34 d6 f3 2e 00"),
    HelloAck(7, BOOT, 2.0**-17, 2.0**-13, 2.0, 0.25, 50, RigState.IDLE): (
        f"00 12 01 02 {HEADER} 54 46 52 44 07 01 01 05 ef be ad de 01 01 02 37 01 01 02 39 01 01 "
        "02 40 01 04 80 3e 32 01 01 05 e9 20 d5 05 00"
    ),
    Arm(): f"00 11 01 03 {HEADER} 04 29 e7 a7 00",
    Drive(0.5, 0.0625, True, 50): (
        f"00 0d 01 04 {HEADER} 01 01 02 3f 01 04 80 3d 01 02 32 05 39 79 05 45 00"
    ),
    Measurement(258, -17600, 1169, 0.5, RigState.RUNNING, 0): (
        f"00 0f 01 05 {HEADER} 02 01 01 07 40 bb ff ff 91 04 01 01 01 01 03 3f 02 01 01 05 "
        "77 81 a7 20 00"
    ),
    Stop(): f"00 11 01 06 {HEADER} 46 85 b0 d6 00",
    EmergencyStop(3): f"00 0e 01 07 {HEADER} 03 05 25 d1 93 8c 00",
    StateReport(RigState.SAFE, 1, BOOT): (
        f"00 0e 01 08 {HEADER} 03 02 01 09 ef be ad de 09 35 31 a6 00"
    ),
    Bye(): f"00 11 01 09 {HEADER} 80 71 48 45 00",
}
messages = pytest.mark.parametrize("message", FRAMES, ids=lambda each: message_name(type(each)))


def framed(body: bytes) -> bytes:
    """A frame of these bytes, written apart from the code under test."""
    return b"\0" + cobs.encode(body + struct.pack("<I", zlib.crc32(body))) + b"\0"


def header(version=1, kind=3, session=SESSION, seq=SEQ) -> bytes:
    return struct.pack("<BBHII", version, kind, session, seq, TIME)


def sent(message, seq=1, session=SESSION) -> bytes:
    return encode(Frame(message, session, seq, 0))


def host() -> Receiver:
    receiver = Receiver(FROM_RIG)
    receiver.expect(SESSION)
    return receiver


STATE = StateReport(RigState.IDLE, 0, BOOT)


# Bytes -------------------------------------------------------------------------------------------


@messages
def test_each_message_has_its_exact_bytes(message):
    assert encode(Frame(message, SESSION, SEQ, TIME)).hex(" ") == FRAMES[message]


@messages
def test_each_message_is_read_from_its_exact_bytes(message):
    packet = bytes.fromhex(FRAMES[message])[1:-1]
    assert decode(packet) == Frame(message, SESSION, SEQ, TIME)


@messages
def test_a_frame_is_as_long_as_it_is_said_to_be(message):
    assert wire_bytes(type(message)) == len(bytes.fromhex(FRAMES[message]))


def test_a_measurement_takes_39_bytes_and_a_command_31():
    assert (wire_bytes(Measurement), wire_bytes(Drive)) == (39, 31)


def test_a_frame_is_what_the_page_says():
    body = header(kind=4) + struct.pack("<ffHH", 0.5, -0.25, 1, 100)
    assert encode(Frame(Drive(0.5, -0.25, True, 100), SESSION, SEQ, TIME)) == framed(body)


def test_a_clock_wraps():
    assert clock_us(2**32 * 1e-6 + 5e-6) == 5
    assert clock_us(1.5e-6) == 1


@pytest.mark.parametrize(
    "message",
    [
        Drive(1e39, 0.0, False, 50),
        Drive(0.0, 0.0, False, 70_000),
        Drive(0.0, 0.0, False, -1),
        Hello(2**32, 50),
        EmergencyStop(65_536),
    ],
)
def test_a_number_that_does_not_fit_is_refused(message):
    with pytest.raises(InputError, match="cannot be sent"):
        sent(message)


def test_flags_without_a_meaning_are_read_past():
    body = header(kind=4) + struct.pack("<ffHH", 0.5, 0.0, 0xFFFE, 100)
    frame = decode(framed(body)[1:-1])
    assert isinstance(frame, Frame)
    assert frame.message == Drive(0.5, 0.0, False, 100)


def test_a_rig_without_a_wheel_sensor_may_say_so():
    frame = decode(sent(Measurement(0, 0, 0, math.nan, RigState.IDLE, 0))[1:-1])
    assert isinstance(frame, Frame)
    assert isinstance(frame.message, Measurement)
    assert math.isnan(frame.message.omega)


# What does not count -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("packet", "cause"),
    [
        (bytes(range(1, LONGEST_PACKET + 2)), Drop.OVERLONG),
        (b"\x09\x01", Drop.COBS),
        (framed(b"short")[1:-1], Drop.SHORT),
        (cobs.encode(header() + b"abcd"), Drop.CRC),
        (framed(header(version=2))[1:-1], Drop.VERSION),
        (framed(header(kind=0))[1:-1], Drop.TYPE),
        (framed(header(kind=10))[1:-1], Drop.TYPE),
        (framed(header(kind=3) + b"\1")[1:-1], Drop.LENGTH),
        (framed(header(kind=7) + b"\1")[1:-1], Drop.LENGTH),
        (framed(header(kind=8) + struct.pack("<HHI", 5, 0, BOOT))[1:-1], Drop.CONTENT),
    ],
)
def test_what_is_no_frame_has_a_cause(packet, cause):
    assert decode(packet) is cause
    receiver = host()
    assert receiver.feed(b"\0" + packet + b"\0") == []
    assert receiver.drops == {cause: 1}


def test_the_checksum_is_looked_at_before_what_it_protects():
    assert decode(cobs.encode(header(version=2) + b"\1\2\3\4")) is Drop.CRC


@pytest.mark.parametrize("message", [Hello(10_000, 50), Arm(), Drive(0, 0, False, 5), Bye()])
def test_an_echo_of_the_host_itself_does_not_count(message):
    receiver = host()
    assert receiver.feed(sent(message, seq=900)) == []
    assert receiver.drops == {Drop.DIRECTION: 1}
    assert len(receiver.feed(sent(STATE, seq=1))) == 1


def test_an_echo_of_its_own_emergency_stop_is_no_answer():
    """And does not set the count to the host's numbers, or all that the rig says would be old."""
    receiver = host()
    own = Frame(EmergencyStop(3), SESSION, 9_000_000, 5)
    receiver.note_sent(own)
    assert receiver.feed(encode(own)) == []
    assert receiver.drops == {Drop.DIRECTION: 1}
    assert receiver.foreign_stop is None
    assert len(receiver.feed(sent(STATE, seq=1))) == 1
    # The rig's own answer, which may say the same, counts.
    assert len(receiver.feed(sent(EmergencyStop(3), seq=2))) == 1


def test_no_frame_counts_before_a_session_is_expected():
    receiver = Receiver(FROM_RIG)
    assert receiver.feed(sent(STATE, session=0)) == []
    assert receiver.drops == {Drop.SESSION: 1}


def test_another_session_does_not_count_but_a_reset_rig_is_noticed():
    receiver = host()
    assert receiver.feed(sent(STATE, session=SESSION + 1)) == []
    assert receiver.drops == {Drop.SESSION: 1}
    assert receiver.foreign_state == STATE
    receiver.expect(SESSION + 1)
    assert receiver.foreign_state is None


@pytest.mark.parametrize(
    ("new", "last", "counts"),
    [
        (1, 0, True),
        (0, 0, False),
        (0, 1, False),
        (0, 2**32 - 1, True),
        (5, 2**32 - 5, True),
        (2**31 - 1, 0, True),
        (2**31, 0, False),
        (2**31 + 7, 8, True),
    ],
)
def test_newer_holds_over_the_wrap(new, last, counts):
    assert is_newer(new, last) is counts
    receiver = host()
    assert len(receiver.feed(sent(STATE, last) + sent(STATE, new))) == 1 + counts
    assert receiver.drops == ({} if counts else {Drop.ORDER: 1})


def test_duplicates_and_late_frames_do_not_count():
    receiver = host()
    one, two, three = (sent(STATE, seq) for seq in (1, 2, 3))
    assert [each.seq for each in receiver.feed(one + three + two + three)] == [1, 3]
    assert receiver.drops == {Drop.ORDER: 2}


def test_a_new_session_starts_at_any_number():
    receiver = host()
    receiver.feed(sent(STATE, 5000))
    receiver.expect(77)
    assert len(receiver.feed(sent(STATE, 3, session=77))) == 1


# The stream --------------------------------------------------------------------------------------


@pytest.mark.parametrize("cut", [1, 2, 7, 26, 1000])
def test_frames_come_whole_however_the_bytes_are_cut(cut):
    stream = b"".join(sent(STATE, seq) for seq in range(1, 30))
    receiver = host()
    frames = [
        frame
        for start in range(0, len(stream), cut)
        for frame in receiver.feed(stream[start : start + cut])
    ]
    assert [each.seq for each in frames] == list(range(1, 30))


@pytest.mark.parametrize(
    "stream",
    [
        sent(STATE, 1)[1:] + sent(STATE, 2)[1:],  # delimiters behind only
        sent(STATE, 1) + sent(STATE, 2)[1:],  # one between two
        b"\0\0\0" + sent(STATE, 1) + b"\0\0" + sent(STATE, 2) + b"\0\0\0",
    ],
)
def test_delimiters_may_be_shared_or_many(stream):
    receiver = host()
    assert [each.seq for each in receiver.feed(stream)] == [1, 2]
    assert receiver.drops == {}


def test_a_frame_after_noise_counts():
    receiver = host()
    frames = receiver.feed(b"boot v1.3\r\nready\r\n" + sent(STATE, 1))
    assert len(frames) == 1
    assert sum(receiver.drops.values()) == 1


def test_babble_without_end_is_counted_once_and_kept_nowhere():
    splitter = FrameSplitter()
    for _ in range(200):
        assert splitter.packets(b"\xff" * 1000) == []
    assert splitter.overlong == 1
    assert len(vars(splitter)["_rest"]) <= LONGEST_PACKET
    assert splitter.packets(b"tail\0") == []
    assert splitter.packets(b"good\0") == [b"good"]


def test_the_rig_takes_only_what_a_host_says():
    receiver = Receiver(FROM_HOST)
    receiver.expect(SESSION)
    assert receiver.feed(sent(STATE)) == []
    assert len(receiver.feed(sent(EmergencyStop(1), 2))) == 1


# What the line carries ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("baud", "tick"), [(115_200, 0.01), (115_200, 390 / 115_200), (460_800, 1e-3), (921_600, 1e-3)]
)
def test_a_line_carries_what_fits_it(baud, tick):
    require_baud(baud, tick)


def test_a_tick_that_the_line_cannot_carry_is_refused_with_the_arithmetic():
    with pytest.raises(InputError, match=r"39 bytes .* 10 bits a byte .*390 / 115200 = 3.385 ms"):
        require_baud(115_200, 1e-3)


@pytest.mark.parametrize(("baud", "tick"), [(0, 0.01), (115_200, 0.0), (115_200, math.nan)])
def test_a_line_or_tick_that_cannot_be_is_refused(baud, tick):
    with pytest.raises(InputError, match="must"):
        require_baud(baud, tick)


@pytest.mark.parametrize(
    ("tick_us", "ms"), [(1, 20), (1000, 20), (4000, 20), (4001, 21), (10_000, 50), (500_000, 2500)]
)
def test_watchdog_is_20_ms_or_five_ticks(tick_us, ms):
    assert watchdog_ms(tick_us) == ms
    assert 0 <= ms * 1000 - watchdog_us(tick_us) < 1000


# Damage ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_no_spoilt_frame_is_taken(seed):
    tally = Tally()
    judge_batch(1_000_000 + seed, 20_000, tally)
    assert tally.spoilt == 20_000
    assert tally.counted > 100  # what was left as it was does count
    assert tally.obeyed > 10
    assert {Drop.CRC, Drop.COBS, Drop.OVERLONG, Drop.SHORT} <= set(tally.drops)


@messages
def test_no_single_flipped_bit_passes(message):
    data = bytearray.fromhex(FRAMES[message])
    for bit in range(8, 8 * (len(data) - 1)):
        data[bit // 8] ^= 1 << bit % 8
        frame = Receiver(FROM_RIG + FROM_HOST)
        frame.expect(SESSION)
        assert frame.feed(bytes(data)) == []
        data[bit // 8] ^= 1 << bit % 8
