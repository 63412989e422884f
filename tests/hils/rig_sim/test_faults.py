"""Scripted faults, and the wire that they act on: pure functions of time, bytes and a seed."""

import math

import numpy as np
import pytest

from drftjax.common.errors import InputError
from hils.rig_sim.fault_injection import FaultInjector
from hils.rig_sim.faults import (
    INT32,
    KINDS,
    Counts,
    DamagedFrames,
    DelayedBytes,
    DelayedFrames,
    Disconnect,
    DriveFault,
    DuplicatedBytes,
    DuplicatedFrames,
    Fault,
    FaultScript,
    FlippedBytes,
    LostBytes,
    LostFrames,
    ReorderedBytes,
    ReorderedFrames,
    SaturatedDrive,
    ScaleJump,
    StuckScale,
    Window,
    read_faults,
    split_frames,
)
from hils.rig_sim.firmware import MotorDemand
from hils.rig_sim.serial_line import LARGEST_BACKLOG, DelayedPacket, SerialLine

FRAME = b"\x00" + bytes(range(1, 38)) + b"\x00"
EACH = [LostFrames, DamagedFrames, DuplicatedFrames, ReorderedFrames, DelayedFrames]
EACH += [LostBytes, FlippedBytes, DuplicatedBytes, ReorderedBytes, DelayedBytes]


def random(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def struck(what, count: int = 1, seed: int = 0) -> list[DelayedPacket]:
    generator = random(seed)
    return [
        after for _ in range(count) for after in what.strike(DelayedPacket(1.0, FRAME), generator)
    ]


@pytest.mark.parametrize("kind", EACH)
def test_fault_of_rate_nought_does_nothing(kind):
    assert b"".join(each.data for each in struck(kind(rate=0.0))) == FRAME
    assert {each.due for each in struck(kind(rate=0.0))} == {1.0}


def test_frames_are_lost_twice_and_late_as_often_as_the_rate_says():
    assert struck(LostFrames()) == []
    # A quarter of 1,000, to one and a half standard deviations of sqrt(1000 * 3 / 16) = 14.
    assert 230 < len(struck(LostFrames(rate=0.75), 1000)) < 270
    assert [each.data for each in struck(DuplicatedFrames())] == [FRAME, FRAME]
    assert struck(DelayedFrames(delay=0.25)) == [DelayedPacket(1.25, FRAME)]
    assert struck(ReorderedFrames(delay=0.25)) == [DelayedPacket(1.25, FRAME, in_order=False)]


def test_damaged_frame_differs_by_one_bit_and_keeps_its_delimiters():
    for seed in range(50):
        (packet,) = struck(DamagedFrames(), seed=seed)
        changed = np.frombuffer(packet.data, np.uint8) ^ np.frombuffer(FRAME, np.uint8)
        assert sum(int(each).bit_count() for each in changed) == 1
        assert (packet.data[0], packet.data[-1]) == (0, 0)


def test_bytes_are_lost_flipped_doubled_and_swapped():
    assert struck(LostBytes())[0].data == b""
    assert struck(DuplicatedBytes())[0].data == bytes(b for b in FRAME for _ in range(2))
    flipped = np.frombuffer(struck(FlippedBytes())[0].data, np.uint8)
    assert all(int(each).bit_count() == 1 for each in flipped ^ np.frombuffer(FRAME, np.uint8))
    assert struck(ReorderedBytes())[0].data == FRAME[1:] + FRAME[:1]
    some = struck(ReorderedBytes(rate=0.2))[0].data
    assert some != FRAME
    assert sorted(some) == sorted(FRAME)


def test_delayed_bytes_open_a_gap_within_the_frame():
    first, second = struck(DelayedBytes(delay=0.25))
    assert first.data + second.data == FRAME
    assert min(len(first.data), len(second.data)) > 0
    assert (first.due, second.due) == (1.0, 1.25)


def test_stuck_scale_keeps_what_it_read_when_the_fault_began():
    run = FaultInjector(FaultScript((Fault(StuckScale("z"), Window(start=1.0, duration=1.0)),)))
    run.mark("power", 10.0)
    assert run.counts(Counts(5, 6, 0.1), 10.5) == (5, 6, 0.1)
    assert run.counts(Counts(7, 8, 0.1), 11.0) == (7, 8, 0.1)
    assert run.counts(Counts(9, 9, 0.2), 11.9) == (7, 9, 0.2)
    assert run.counts(Counts(9, 9, 0.2), 12.0) == (9, 9, 0.2)


def test_absurd_reading_jumps_either_way_and_fits_the_wire():
    generator = random()
    read = {
        ScaleJump("both").read(Counts(5, -5, 0.0), Counts(0, 0, 0.0), generator).z for _ in range(9)
    }
    assert read == {INT32, 5 - INT32}
    once = ScaleJump("x", rate=0.25, counts=100)
    x = [once.read(Counts(0, 0, 0.0), Counts(0, 0, 0.0), generator).x for _ in range(1000)]
    assert 200 < np.count_nonzero(x) < 300
    assert set(x) == {-100, 0, 100}


def test_saturated_drive_keeps_the_sense_of_rotation():
    assert SaturatedDrive(0.2).drive(MotorDemand(-0.5, 0.1, True)) == (-0.2, 0.1, True)
    assert SaturatedDrive(0.2).drive(MotorDemand(0.1, 0.1, True)) == (0.1, 0.1, True)


def test_window_opens_after_the_first_of_its_occasions():
    run = FaultInjector(FaultScript((Fault(Disconnect(), Window("arm", 0.5, 1.0)),)))
    assert run.next_edge(0.0) == math.inf
    run.mark("arm", 3.0)
    run.mark("arm", 9.0)
    assert run.next_edge(3.0) == 3.5
    assert run.next_edge(3.5) == 4.5
    assert [run.is_unplugged(t) for t in (3.4, 3.5, 4.4, 4.5)] == [False, True, True, False]


def test_faults_strike_only_towards_their_end():
    run = FaultInjector(FaultScript((Fault(LostFrames(towards="rig")),)))
    run.mark("power", 0.0)
    assert run.packets([FRAME], "rig", 1.0) == []
    assert run.packets([FRAME], "host", 1.0) == [DelayedPacket(1.0, FRAME)]


def test_a_seed_gives_the_same_faults_and_one_more_fault_leaves_the_others_be():
    def lost(*further: Fault) -> list[int]:
        run = FaultInjector(FaultScript((Fault(LostFrames(rate=0.5)), *further), seed=3))
        run.mark("power", 0.0)
        return [len(run.packets([FRAME], "host", 1.0)) for _ in range(64)]

    assert lost() == lost() == lost(Fault(DriveFault()), Fault(FlippedBytes(rate=0.5)))
    assert 0 < sum(lost()) < 64


def test_frames_are_cut_from_a_stream_at_any_place():
    stream = FRAME + b"\x00\x00" + FRAME + b"\x00junk"
    for cut in range(len(stream)):
        first, rest = split_frames(b"", stream[:cut])
        second, rest = split_frames(rest, stream[cut:])
        assert first + second == [FRAME, FRAME]
        assert rest == b"junk"


def test_line_without_baud_is_instant_and_with_it_takes_ten_bits_a_byte():
    line = SerialLine()
    line.send([DelayedPacket(0.0, FRAME)])
    assert line.take(0.0) == FRAME
    line = SerialLine(baud=115200)
    line.send([DelayedPacket(0.0, FRAME), DelayedPacket(0.0, FRAME)])
    second = 2 * len(FRAME) * 10 / 115200
    assert line.next_event() == pytest.approx(second / 2)
    assert line.take(second / 4) == FRAME[: len(FRAME) // 2]
    assert line.take(second - 1e-6) == (FRAME + FRAME)[len(FRAME) // 2 : -1]
    assert line.take(second) == b"\x00"
    assert line.next_event() == math.inf


@pytest.mark.parametrize("latency", [0.001, 0.016])
def test_adapter_holds_bytes_until_its_timer_rings_or_its_packet_is_full(latency):
    line = SerialLine(latency=latency)
    line.send([DelayedPacket(1.0, b"few")])
    assert line.take(1.0) == b""
    assert line.next_event() == pytest.approx(1.0 + latency)
    line.send([DelayedPacket(1.0 + latency / 2, b"more")])
    assert line.take(1.0 + 0.99 * latency) == b""
    assert line.take(1.0 + latency) == b"fewmore"
    line.send([DelayedPacket(2.0, bytes(100))])
    assert line.take(2.0) == bytes(62)
    assert line.take(2.0 + latency) == bytes(38)


def test_frames_are_overtaken_on_the_line_only_where_told():
    line = SerialLine()
    line.send([DelayedPacket(1.2, b"late"), DelayedPacket(1.0, b"next")])
    assert line.take(1.1) == b""
    assert line.take(1.2) == b"latenext"
    line.send([DelayedPacket(2.2, b"late", in_order=False), DelayedPacket(2.0, b"next")])
    assert line.take(2.1) == b"next"
    assert line.take(2.2) == b"late"


def test_backlog_of_a_line_is_bounded():
    line = SerialLine(baud=9600)
    line.send([DelayedPacket(0.0, bytes(1000)) for _ in range(100)])
    assert line.overflowed == 100 - LARGEST_BACKLOG // 1000
    assert len(line.take(1e6)) == LARGEST_BACKLOG // 1000 * 1000


GOOD = """
seed = 7
[[fault]]
what = {kind = "lost_frames", rate = 0.3, towards = "rig"}
when = {after = "motion", start = 1.0, duration = 2.0}
[[fault]]
what = {kind = "stuck"}
"""


def test_script_is_read_from_a_file(tmp_path):
    path = tmp_path / "faults.toml"
    path.write_text(GOOD)
    assert read_faults(path) == FaultScript(
        (Fault(LostFrames(0.3, "rig"), Window("motion", 1.0, 2.0)), Fault(StuckScale())), seed=7
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[[fault]]\nwhat = {kind = "lost"}', ["fault 1", "'lost'", "lost_frames", KINDS[-1]]),
        ('[[fault]]\nwhat = {kind = "lost_frames", rate = 2}', ["fault 1: rate is 2", "0 and 1"]),
        ('[[fault]]\nwhat = {kind = "stuck", chanel = "z"}', ["'chanel'", "did you mean"]),
        ('[[fault]]\nwhat = {kind = "stuck"}\nwhen = {duration = 0}', ["duration is 0 s"]),
        ('[[fault]]\nwhat = {kind = "stuck"}\nwhen = {after = "lunch"}', ["lunch"]),
        ("[[fault]]\nwhat = {}", ["kind"]),
        ("[[fautl]]", ["'fautl'", "fault"]),
        ("fault = 3", ["fault"]),
        ("title = 'a'\n[rig]\n", ["holds 'title', 'rig'", "holds seed and [[fault]]"]),
    ],
)
def test_wrong_scripts_are_refused_in_one_sentence(tmp_path, text, words):
    path = tmp_path / "faults.toml"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        read_faults(path)
    assert all(word in str(error.value) for word in [str(path), *words]), error.value
    assert "\n" not in str(error.value)
