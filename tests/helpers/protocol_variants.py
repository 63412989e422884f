"""Rigs that implement the wire protocol each in its own way, and a session with one of them.

`OtherRig` is written from the page alone and shares no code with the package: struct, zlib and a
COBS of its own.
"""

import struct
import zlib

from hils.clock import VirtualClock
from hils.link.link import InProcessLink, LinkLost
from hils.link.messages import Drive, Hello
from hils.procedure.session import Session
from hils.rig_sim.firmware import RigIdentity, RigProtocol

HELLO = Hello(10_000, 50)
HOLD = Drive(0.0, 0.0, False, 50)
# Sums of the virtual clock's grains.
ROUNDING = 1e-9


def stuffed(data: bytes) -> bytes:
    """COBS encoding, byte by byte."""
    return b"".join(bytes([len(each) + 1]) + each for each in data.split(b"\0"))


def unstuffed(data: bytes) -> bytes:
    out, place = b"", 0
    while place < len(data):
        out += data[place + 1 : place + data[place]] + b"\0"
        place += data[place]
    return out[:-1]


class OtherRig:
    """Firmware by another hand; each attribute is a way to read the specification, or a fault."""

    leading_delimiter = True
    watchdog_counts_in_idle = False
    restarts_count_at_hello = False
    runs_at_arm = False
    answers_arm = True
    deaf_for = 0.0
    boot_text = b""
    omega = 0.0
    turns_as_commanded = False
    greeting = (0x44524654, 9, 1234, 1e-5, 0.0, 2.0, 0.0, 50, 0)  # HELLO_ACK but its state

    def __init__(self, **ways):
        for way, value in ways.items():
            assert hasattr(self, way)
            setattr(self, way, value)
        self.state, self.session, self.seq, self.boot = 0, 0, 0, self.greeting[2]
        self.greeted, self.commanded, self.told, self.rest = False, 0.0, 0.0, b""
        self.out, self.said = self.boot_text, []
        self.broken = False

    def advance(self, now: float, data: bytes) -> bytes:
        if self.broken:
            raise LinkLost("unplugged")
        counting = self.state in (1, 2) or (self.watchdog_counts_in_idle and self.state == 0)
        if counting and now - self.commanded > 0.05:
            self.state, self.greeted = 3, False
        if now >= self.deaf_for:
            *packets, self.rest = (self.rest + data).split(b"\0")
            for packet in filter(None, packets):
                self.hear(unstuffed(packet), now)
        if self.session and now - self.told >= 0.02:
            self.measure(now, 0)
        out, self.out = self.out, b""
        return out

    def hear(self, content: bytes, now: float) -> None:
        body, (crc,) = content[:-4], struct.unpack("<I", content[-4:])
        version, kind, session, seq, _ = struct.unpack("<BBHII", body[:12])
        assert crc == zlib.crc32(body)
        assert version == 1
        self.said.append(kind)
        if kind == 1:
            self.state = 3 if self.state in (1, 2) else self.state
            self.session, self.greeted, self.commanded = session, True, now
            if self.restarts_count_at_hello:
                self.seq = 0
            self.say(2, struct.pack("<IIIffffHH", *self.greeting[:-1], self.state))
        elif session != self.session:
            return
        elif kind == 3:
            if self.greeted and self.state in (0, 3):
                self.state, self.commanded = 2 if self.runs_at_arm else 1, now
            if self.answers_arm:
                self.report(0)
        elif kind == 4:
            omega, _, _, _ = struct.unpack("<ffHH", body[12:])
            assert self.state != 4 or omega == 0.0
            self.commanded = now
            self.omega = omega if self.turns_as_commanded else self.omega
            self.measure(now, seq)
        elif kind == 7:
            self.state, self.greeted = 3, False
            self.report(1)
        elif kind == 9:
            self.state = 0

    def measure(self, now: float, seq: int) -> None:
        self.told = now
        self.say(5, struct.pack("<IiifHH", seq, -1760, 0, self.omega, self.state, 0))

    def report(self, reason: int) -> None:
        self.say(8, struct.pack("<HHI", self.state, reason, self.boot))

    def say(self, kind: int, payload: bytes) -> None:
        self.seq += 1
        body = struct.pack("<BBHII", 1, kind, self.session, self.seq, 0) + payload
        packet = stuffed(body + struct.pack("<I", zlib.crc32(body))) + b"\0"
        self.out += b"\0" * self.leading_delimiter + packet


class Table:
    """A rig with a virtual clock, a link and a session."""

    def __init__(self, rig):
        self.rig, self.clock = rig, VirtualClock()
        self.link = InProcessLink(rig, self.clock, "port 1")
        self.session = Session(self.link, self.clock)

    def heard(self) -> list:
        """List that collects the messages of the host from here on."""
        said, send = [], self.link.send
        self.link.send = lambda message: (said.append(message), send(message))[1]
        return said

    def ready(self) -> "Table":
        self.session.connect(HELLO)
        self.session.arm(HOLD)
        return self

    def drive(self, duration: float, omega: float = 0.25) -> None:
        for _ in range(round(duration / 0.01)):
            self.session.check()
            self.link.send(Drive(omega, 0.0, False, 50))
            self.clock.sleep_until(self.clock.now() + 0.01)


class Silent:
    """Port without a rig behind it."""

    def __init__(self, babble: bytes = b""):
        self.babble, self.heard = babble, []

    def advance(self, now: float, data: bytes) -> bytes:
        if data:
            self.heard.append(now)
        return self.babble if data else b""


def ours() -> RigProtocol:
    return RigProtocol(RigIdentity(boot_id=5))


class Buttons:
    """Rig with an emergency button and a reset button."""

    def __init__(self):
        self.protocol, self.pressed = RigProtocol(RigIdentity(boot_id=1)), b""

    def advance(self, now: float, data: bytes) -> bytes:
        pressed, self.pressed = self.pressed, b""
        return pressed + self.protocol.advance(now, data)

    def press(self, reason: int, now: float) -> None:
        self.pressed = self.protocol.emergency_stop(reason, now)

    def reset(self, now: float) -> None:
        self.protocol = RigProtocol(RigIdentity(boot_id=2), now)
