"""The rig's side of the wire, in explicit time: what a firmware does with bytes and a clock.

Nothing here sleeps or reads a clock, so the same object answers in virtual time and in real time.
It starts IDLE. HELLO opens a session, ARM lets commands move the rig, and SAFE, which the watchdog,
an emergency stop or the end of the session leads to, is left only by a new HELLO and ARM.
"""

import math
import struct
from collections import Counter
from dataclasses import dataclass
from typing import NamedTuple

import msgspec

from hils.link.framing import FrameSplitter
from hils.link.messages import (
    FROM_HOST,
    READY,
    SCHEMA,
    U16,
    U32,
    Arm,
    Bye,
    Drive,
    Drop,
    EmergencyStop,
    Frame,
    Hello,
    HelloAck,
    Measurement,
    Message,
    Reason,
    RigState,
    StateReport,
    Stop,
    clock_us,
    decode,
    encode,
    is_newer,
)
from hils.link.timing import LEAST_WATCHDOG_US, watchdog_ms, watchdog_us


@dataclass(frozen=True)
class FirmwareSettings:
    """Rhythm of the firmware.

    Attributes:
        clock_interval: From one look at its clock to the next, at most [s].
        measurement_interval: From one measurement to the next without a command [s]; 20 ms by
            docs/reference/wire.md.
        stop_tries: Times that an emergency stop is sent until the host answers; five by
            docs/reference/wire.md.
        stop_interval: From one of them to the next [s]; 50 ms by docs/reference/wire.md. Frames
            of another session are answered no more often either.
    """

    clock_interval: float = 0.002
    measurement_interval: float = 0.02
    stop_tries: int = 5
    stop_interval: float = 0.05


DEFAULT_FIRMWARE = FirmwareSettings()


class RigIdentity(msgspec.Struct, frozen=True):
    """Identity, scales and limits of a rig, as HELLO_ACK tells them, and the slew of its demand.

    Attributes:
        boot_id: Another one after each reset.
        rig_id: Which rig this is.
        z_scale, x_scale: Metres a count.
        omega_max: Largest angular velocity [rad/s].
        vx_max: Largest carriage speed [m/s].
        omega_slew: Fastest change of angular velocity [rad/s2].
        vx_slew: Fastest change of carriage speed [m/s2].
    """

    boot_id: int
    rig_id: int = 1
    z_scale: float = 1e-5
    x_scale: float = 1e-4
    omega_max: float = 2.0
    vx_max: float = 0.3
    omega_slew: float = 5.0
    vx_slew: float = 2.0


class MotorDemand(NamedTuple):
    """Set-point of the motors: angular velocity [rad/s], carriage speed [m/s] if driven."""

    omega: float
    vx: float
    driven: bool


class RigProtocol:
    """The rig's state machine.

    Times are the rig's own clock [s]: they never go back, and the same may be told again. What
    happens between two of them (the watchdog, a ramp) happens at its own time.

    Args:
        identity: What HELLO_ACK tells, and the slew limits.
        start: The clock's reading at power-up [s].
        settings: Rhythm.

    Attributes:
        state: IDLE, ARMED, RUNNING, SAFE or FAULT.
        reason: Of its last change.
        demand: Set-point of the motors now.
    """

    def __init__(
        self,
        identity: RigIdentity,
        start: float = 0.0,
        settings: FirmwareSettings = DEFAULT_FIRMWARE,
    ):
        self._identity, self._settings = identity, settings
        self._omega_max, self._vx_max = (
            _as_float32(identity.omega_max),
            _as_float32(identity.vx_max),
        )
        self._splitter = FrameSplitter()
        self._drops: Counter[Drop] = Counter()
        self.state = RigState.IDLE
        self.reason: int = Reason.NONE
        self.demand = self._target = MotorDemand(0.0, 0.0, False)
        self._session: int | None = None
        self._last_heard, self._next_seq = 0, 1
        self._hello_received = False
        self._watchdog = LEAST_WATCHDOG_US * 1e-6
        self._last_command = self._command_expires = math.inf
        self._now = self._measured = start
        self._foreign_answered = -math.inf
        self._ack_seq, self._z, self._x, self._omega, self._fault = 0, 0, 0, 0.0, 0
        self._repeats: list[float] = []
        self._stop_reason = 0
        self._out = b""

    def advance(self, now: float, data: bytes) -> bytes:
        """Advance to this time [s], take these bytes then; return the bytes that have come out."""
        self._advance_to(now)
        for packet in self._splitter.packets(data):
            self._receive(packet)
        out, self._out = self._out, b""
        return out

    @property
    def drops(self) -> dict[Drop, int]:
        """Count of dropped packets, by cause."""
        overlong = Counter({Drop.OVERLONG: self._splitter.overlong})
        return dict(self._drops + overlong)

    def measure(self, z: int, x: int, omega: float) -> None:
        """Take the sensors' readings: height and position [counts], angular velocity [rad/s]."""
        self._z, self._x, self._omega = _counts(z), _counts(x), omega

    def emergency_stop(self, reason: int, now: float) -> bytes:
        """Somebody pressed the rig's own button: rest at once, SAFE, and tell the host."""
        return self._stop_at_once(RigState.SAFE, reason, 0, now)

    def fail(self, reason: int, fault: int, now: float) -> bytes:
        """The rig found a fault of its own: rest at once, FAULT until power-up, tell the host."""
        return self._stop_at_once(RigState.FAULT, reason, fault, now)

    # What happens by itself ------------------------------------------------------------------

    def _advance_to(self, now: float) -> None:
        now = max(now, self._now)
        while self.state in READY:
            starved = self._last_command + self._watchdog
            if min(starved, self._command_expires) > now:
                break
            if self._command_expires < starved:
                self._ramp(self._command_expires)
                self._target, self._command_expires = self._rest(), math.inf
            else:
                self._ramp(starved)
                self._go_safe(Reason.WATCHDOG)
        self._ramp(now)
        while self._repeats and self._repeats[0] <= now:
            self._repeats.pop(0)
            self._send(EmergencyStop(self._stop_reason))
        interval = self._settings.measurement_interval
        if self._session is not None and now >= self._measured + interval:
            # Someone who calls late gets one measurement, not all that were due.
            late = now - self._measured >= 2 * interval
            self._send_measurement(now if late else self._measured + interval)

    def _ramp(self, now: float) -> None:
        elapsed, self._now = max(0.0, now - self._now), max(now, self._now)
        target, limits = self._target, self._identity
        omega = _approach(self.demand.omega, target.omega, limits.omega_slew * elapsed)
        vx = (
            _approach(self.demand.vx, target.vx, limits.vx_slew * elapsed) if target.driven else 0.0
        )
        self.demand = MotorDemand(omega, vx, target.driven)

    def _rest(self) -> MotorDemand:
        return MotorDemand(0.0, 0.0, self._target.driven)

    # What the host says ----------------------------------------------------------------------

    def _receive(self, packet: bytes) -> None:
        frame = decode(packet)
        if isinstance(frame, Drop):
            self._drop(frame)
        elif not isinstance(frame.message, FROM_HOST):
            self._drop(Drop.DIRECTION)
        elif frame.session != self._session:
            if isinstance(frame.message, Hello):
                self._open(frame, frame.message)
            else:
                self._answer_foreign(frame)
        elif not is_newer(frame.seq, self._last_heard):
            self._drop(Drop.ORDER)
        else:
            self._handle(frame)

    def _handle(self, frame: Frame) -> None:
        self._last_heard = frame.seq
        match frame.message:
            case Hello() as hello:
                self._open(frame, hello)
            case Arm():
                self._arm()
            case Drive() as command:
                self._command(command, frame.seq)
            case Stop():
                self._target, self._command_expires = self._rest(), math.inf
                if self.state is RigState.RUNNING:
                    # The watchdog is fed for the time of this ramp.
                    ramp = abs(self.demand.omega) / self._identity.omega_slew
                    self._last_command = self._now + ramp
                    self._set_state(RigState.ARMED, Reason.HOST_STOPPED)
                self._send_state()
            case EmergencyStop():
                self._repeats.clear()
                self._go_safe(Reason.HOST_STOPPED, at_once=True)
            case Bye():
                self._end_session()

    def _open(self, frame: Frame, hello: Hello) -> None:
        was_ready = self.state in READY
        if was_ready:
            self._go_safe(Reason.HELLO_WHILE_ARMED)
        understood = hello.schema == SCHEMA
        possible = hello.tick_us > 0 and watchdog_ms(hello.tick_us) <= U16
        if understood and not possible:
            self._send(StateReport(self.state, Reason.HELLO_REFUSED, self._identity.boot_id), frame)
            return
        if understood:
            if self.state is RigState.SAFE and not was_ready and self.demand.omega == 0.0:
                self._set_state(RigState.IDLE, Reason.NONE)
            self._session, self._last_heard, self._hello_received = frame.session, frame.seq, True
            self._watchdog = watchdog_us(hello.tick_us) * 1e-6
            self._measured, self._ack_seq = self._now, 0
            self._repeats.clear()
        me = self._identity
        self._send(
            HelloAck(
                *(me.rig_id, me.boot_id, me.z_scale, me.x_scale, me.omega_max, me.vx_max),
                watchdog_ms(hello.tick_us) if possible else 0,
                self.state,
            ),
            frame,
        )

    def _arm(self) -> None:
        if self.state in (RigState.IDLE, RigState.SAFE):
            if not self._hello_received:
                self.reason = Reason.HELLO_NEEDED
            elif self.demand.omega == 0.0:  # SAFE is not left before the wheel rests
                self._set_state(RigState.ARMED, Reason.NONE)
                self._target, self._command_expires = self._rest(), math.inf
                self._last_command = self._now
        self._send_state()

    def _command(self, command: Drive, seq: int) -> None:
        self._ack_seq = seq
        if self.state in READY:
            # Written so that NaN fails both.
            if abs(command.omega) <= self._omega_max and abs(command.vx) <= self._vx_max:
                self._target = MotorDemand(
                    command.omega, command.vx if command.driven else 0.0, command.driven
                )
                self._last_command = self._now
                self._command_expires = self._now + command.valid_ms * 1e-3
                if self._target[:2] != (0.0, 0.0):
                    self._set_state(RigState.RUNNING, Reason.NONE)
            else:
                self.reason = Reason.COMMAND_REFUSED
                self._send_state()
        self._send_measurement(self._now)

    def _end_session(self) -> None:
        if self.state in READY:
            self._target = self._rest()
            self._set_state(RigState.IDLE, Reason.BYE)
        self._hello_received = False
        self._repeats.clear()
        self._send_state()
        self._session = None

    def _answer_foreign(self, frame: Frame) -> None:
        self._drop(Drop.SESSION)
        if self.state in READY:
            self._go_safe(Reason.ANOTHER_SESSION, isinstance(frame.message, EmergencyStop))
            self._foreign_answered = -math.inf
        # Told which boot this is, a host sees that the rig was reset under it.
        if self._now - self._foreign_answered >= self._settings.stop_interval:
            self._foreign_answered = self._now
            self._send(
                StateReport(self.state, Reason.ANOTHER_SESSION, self._identity.boot_id), frame
            )

    def _drop(self, cause: Drop) -> None:
        self._drops[cause] += 1

    # What follows from it --------------------------------------------------------------------

    def _set_state(self, state: RigState, reason: int) -> None:
        self.state, self.reason = state, reason

    def _go_safe(self, reason: int, at_once: bool = False) -> None:
        """Latch SAFE: the wheel ramps to rest, or stops at once; the carriage always does."""
        if self.state is not RigState.FAULT:
            self._set_state(RigState.SAFE, reason)
        self._target = self._rest()
        omega = 0.0 if at_once else self.demand.omega
        self.demand = MotorDemand(omega, 0.0, self._target.driven)
        self._hello_received = False
        self._send_state()

    def _stop_at_once(self, state: RigState, reason: int, fault: int, now: float) -> bytes:
        self._advance_to(now)
        self._fault = fault or self._fault
        self._stop_reason = reason
        self._send(EmergencyStop(reason))
        interval, tries = self._settings.stop_interval, self._settings.stop_tries
        self._repeats = [self._now + interval * each for each in range(1, tries)]
        if state is RigState.FAULT:
            self._set_state(state, reason)
        self._go_safe(reason, at_once=True)
        out, self._out = self._out, b""
        return out

    # What the rig says -----------------------------------------------------------------------

    def _send_state(self) -> None:
        self._send(StateReport(self.state, self.reason, self._identity.boot_id))

    def _send_measurement(self, due: float) -> None:
        self._measured = due
        self._send(
            Measurement(self._ack_seq, self._z, self._x, self._omega, self.state, self._fault)
        )

    def _send(self, message: Message, asker: Frame | None = None) -> None:
        session = self._session if asker is None else asker.session
        if session is None:  # nobody has said HELLO yet
            return
        self._out += encode(Frame(message, session, self._next_seq, clock_us(self._now)))
        self._next_seq = (self._next_seq + 1) & U32


def _as_float32(value: float) -> float:
    """The value as its 32-bit field on the wire holds it."""
    return struct.unpack("<f", struct.pack("<f", value))[0]


def _counts(value: int) -> int:
    """A reading that its field can hold; a sensor that is out of range stays at its end."""
    return max(-(1 << 31), min((1 << 31) - 1, value))


def _approach(value: float, target: float, most: float) -> float:
    return value + max(-most, min(most, target - value))
