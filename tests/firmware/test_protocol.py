"""The reference firmware in C, beside this project's own rig and codec, in explicit time."""

import random
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from hils.link.framing import Receiver
from hils.link.messages import (
    DELIMITER,
    FROM_RIG,
    U32,
    Arm,
    Bye,
    Drive,
    EmergencyStop,
    Frame,
    Hello,
    HelloAck,
    Measurement,
    RigState,
    StateReport,
    Stop,
    decode,
    encode,
)
from hils.rig_sim.firmware import RigIdentity, RigProtocol
from tests.helpers.c_firmware import FIRMWARE, TESTS, WARNINGS, CFirmware, compile_c
from tests.helpers.frame_fuzzer import random_message, spoilt

# Set-points in 32 and in 64 bits, summed over a few thousand steps of a ramp.
ROUNDING = 1e-4
# A command lapses within a step of 1 ms at 5 rad/s2: the one ramps up to then, the other down. A
# ramp of these hosts sees no more than five lapses.
STEPS = 5 * 2 * 5.0 * 1e-3 + ROUNDING
# The clock of the other rig runs so much faster that no due time of its own is a rounding late.
STRETCH = 1.0 + 1e-9
ME = RigIdentity(boot_id=77, z_scale=2.0**-17, omega_max=2.0, vx_max=0.25)
GO = Drive(1.0, 0.125, True, 1000)
STATE_OF_THE_SCALES = (-1760, 3, 0.5)  # as python_bench.c has them


def test_it_compiles_as_c99_without_a_warning(tmp_path):
    compile_c(tmp_path / "rig", *WARNINGS, *FIRMWARE.glob("*.c"))


def test_the_protocol_needs_nothing_but_string_h():
    text = "".join((FIRMWARE / name).read_text() for name in ("rig_protocol.c", "rig_protocol.h"))
    includes = set(re.findall(r"#include\s+(\S+)", text))
    assert includes == {'"rig_protocol.h"', "<stddef.h>", "<stdint.h>", "<string.h>"}


class Desk:
    """A host's hands on the firmware."""

    def __init__(self, start: float = 0.0):
        self.rig, self.now, self.seq = CFirmware(ME, start=start), start, 0

    def say(self, message, session: int = 5) -> list:
        self.seq += 1
        return self.heard(self.rig.advance(self.now, encode(Frame(message, session, self.seq, 0))))

    def pause(self, duration: float) -> list:
        self.now += duration
        return self.heard(self.rig.advance(self.now, b""))

    def heard(self, data: bytes, session: int = 5) -> list:
        receiver = Receiver(FROM_RIG)
        receiver.expect(session)
        return [frame.message for frame in receiver.feed(data)]

    def running(self) -> "Desk":
        self.say(Hello(10_000, 50))
        self.say(Arm())
        for _ in range(50):
            self.say(GO)
            self.pause(0.01)
        assert self.rig.state is RigState.RUNNING
        return self


def test_its_frames_are_those_of_this_projects_codec():
    desk = Desk()
    data = desk.rig.advance(0.0, encode(Frame(Hello(10_000, 50), 5, 1, 0)))
    for message in (Arm(), GO, EmergencyStop(3)):
        desk.seq += 2
        data += desk.rig.advance(0.001, encode(Frame(message, 5, desk.seq, 0)))
    data += desk.rig.press(9, 0.002)
    packets = [packet for packet in data.split(DELIMITER) if packet]
    frames = [decode(packet) for packet in packets]
    assert all(isinstance(frame, Frame) for frame in frames), frames
    assert [encode(frame) for frame in frames if isinstance(frame, Frame)] == [
        DELIMITER + packet + DELIMITER for packet in packets
    ]
    kinds = {type(frame.message) for frame in frames if isinstance(frame, Frame)}
    assert kinds == {HelloAck, StateReport, Measurement, EmergencyStop}


def host_frames(source: random.Random, count: int) -> list[tuple[float, bytes]]:
    """Frames of a host that is often sound, with pauses [s] of whole milliseconds before each."""
    session, seq, made = 5, source.randrange(1 << 31), []
    plain = (Arm(), Arm(), Stop(), Bye(), EmergencyStop(2))
    for _ in range(count):
        seq = (seq + source.choice((1, 1, 1, 1, 1, 2, 0, -1))) & U32
        message = source.choice(
            (
                Hello(source.choice((0, 1000, 10_000, 40_000, 1 << 31)), source.randrange(1 << 16)),
                *(Drive(source.uniform(-2.2, 2.2), 0.1, bool(source.getrandbits(1)), 60),) * 8,
                source.choice(plain),
                source.choice(plain),
                random_message(source),
            )
        )
        if isinstance(message, Hello) and source.random() < 0.5:
            session = source.randrange(1, 4)
        stranger = source.random() < 0.03
        data = encode(Frame(message, 99 if stranger else session, seq, 0))
        if source.random() < 0.2:
            data = spoilt(source, data, made[-1][1] if made else data) + DELIMITER
        made.append((source.choice((0.001, 0.005, 0.01, 0.01, 0.02, 0.1)), data))
    return made


@pytest.mark.parametrize("seed", range(6))
def test_it_answers_as_the_virtual_rigs_firmware_does(seed):
    ours, theirs = CFirmware(ME, stands=True), RigProtocol(ME)
    tick, states = 0, set()
    for pause, data in host_frames(random.Random(seed), 1500):
        said, expected = b"", b""
        theirs.measure(*STATE_OF_THE_SCALES)
        for _ in range(round(pause * 1000)):
            tick += 1
            said += ours.advance(tick * 1e-3, b"")
            expected += theirs.advance(tick * 1e-3 * STRETCH, b"")
        assert ours.demand == pytest.approx(theirs.demand[:2], abs=STEPS)
        said += ours.advance(tick * 1e-3, data)
        expected += theirs.advance(tick * 1e-3 * STRETCH, data)
        assert untimed(said) == untimed(expected), (tick, decode(data[1:-1]))
        assert ours.state is theirs.state
        states.add(ours.state)
    assert ours.drops == theirs.drops
    assert {RigState.IDLE, RigState.ARMED, RigState.RUNNING, RigState.SAFE} <= states


def untimed(data: bytes) -> list[tuple]:
    """The frames but for their clocks, which differ by the step of this firmware's polls."""
    frames = [decode(packet) for packet in data.split(DELIMITER) if packet]
    return [frame[:3] if isinstance(frame, Frame) else frame for frame in frames]


def test_its_own_stop_is_told_five_times_and_latches():
    desk = Desk().running()
    said = desk.heard(desk.rig.press(100, desk.now))
    assert [type(each) for each in said] == [EmergencyStop, StateReport]
    assert desk.rig.demand == (0.0, 0.0)
    assert desk.rig.emergency_stops == 1
    times = [at for at in range(1, 400) if stops(desk.pause(0.001))]
    assert times == [50, 100, 150, 200]
    desk.say(Arm())
    assert desk.rig.state is RigState.SAFE


def test_the_hosts_answer_ends_the_repetition_of_its_stop():
    desk = Desk().running()
    desk.rig.press(100, desk.now)
    desk.pause(0.06)
    desk.say(EmergencyStop(100))
    assert not stops(desk.pause(1.0))


def stops(heard: list) -> bool:
    return any(isinstance(each, EmergencyStop) for each in heard)


def test_a_fault_of_its_own_is_left_by_nothing_that_a_host_says():
    desk = Desk().running()
    desk.heard(desk.rig.fail(101, 4, desk.now))
    for message in (Hello(10_000, 50), Arm(), GO, Bye(), Hello(10_000, 50), Arm(), GO):
        heard = desk.say(message)
        assert desk.rig.state is RigState.FAULT
    assert heard[-1].fault == 4
    assert desk.rig.demand == (0.0, 0.0)


@pytest.mark.parametrize("before", [0.2, 0.51, 0.53])
def test_the_watchdog_holds_over_the_wrap_of_the_clock(before):
    desk = Desk(start=2**32 / 1e6 - before).running()
    desk.say(GO)
    desk.pause(0.049)
    assert desk.rig.state is RigState.RUNNING
    desk.pause(0.002)
    assert desk.rig.state is RigState.SAFE


def test_a_loop_that_was_held_up_does_not_make_the_drive_jump():
    # 5 rad/s2 for at most the 20 ms that a late poll counts as.
    desk = Desk()
    desk.say(Hello(1_000_000, 5000))
    desk.say(Arm())
    desk.say(Drive(2.0, 0.0, False, 60_000))
    library, now = desk.rig._library, CFirmware._us(desk.now + 1.0)
    library.bench_late(desk.rig._bench, now)
    assert desk.rig.demand[0] == pytest.approx(0.1, abs=ROUNDING)


def test_random_frames_break_no_invariant(tmp_path):
    sanitizers = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    empty = tmp_path / "empty.c"
    empty.write_text("int main(void) { return 0; }\n")
    if shutil.which("cc") and _fails(*sanitizers, empty, "-o", tmp_path / "empty"):
        pytest.skip("the C compiler of this computer has no address and undefined sanitizers")
    harness = compile_c(
        *(tmp_path / "fuzz", *WARNINGS[:3], *sanitizers, "-O1", f"-I{FIRMWARE}"),
        *(FIRMWARE / "rig_protocol.c", TESTS / "fuzz.c", "-lm"),
    )
    answer = subprocess.run([harness, "500000", "7"], capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout.startswith("500000 frames")


def _fails(*arguments: str | Path) -> bool:
    made = subprocess.run(["cc", *map(str, arguments)], capture_output=True, check=False)
    return made.returncode != 0
