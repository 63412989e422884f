"""A host that can send any bytes and hears every frame, to try a rig against the wire with."""

import secrets
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass

from drftjax.common.errors import InputError
from hils.clock import AbstractClock
from hils.conformance.received_frame import ReceivedFrame, is_ready, omegas
from hils.link.framing import FrameSplitter
from hils.link.link import LinkLost
from hils.link.messages import (
    DELIMITER,
    FROM_RIG,
    READY,
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
    RigState,
    Stop,
    clock_us,
    decode,
    encode,
)
from hils.link.port_link import first_number
from hils.link.ports import AbstractPort
from hils.link.timing import watchdog_ms


@dataclass(frozen=True)
class ConformanceSettings:
    """Speeds, times and allowances by which a rig is tried.

    Attributes:
        tick_us: Control period that HELLO tells [us]; its watchdog of 100 ms outlasts the pauses
            that an ordinary computer makes.
        long_tick_us: For the rule whose ramp must end within the watchdog, 500 ms [us].
        short_tick_us: For the one rule that needs the shortest watchdog, 20 ms [us].
        command_interval: From one command to the next [s].
        patience: Longest wait for an answer that is due [s]: five intervals of a MEAS.
        tries: Of a message that is repeated; five by docs/reference/wire.md.
        try_interval: From one of them to the next [s]; 50 ms by docs/reference/wire.md.
        rule_tries: Times that a rule is tried before it counts as broken, as a computer may be
            held up.
        allowance: Delay that line and operating system may add to a time [s].
        held_up_time: A longer delay of this program leaves a broken rule without a verdict [s].
        clock_share: Difference of the rig's clock from this computer's that a poor oscillator and
            the jitter of arrivals explain [-].
        omega: Angular velocity of the moving rules [rad/s]; slow enough to be caught by hand, and
            its ramp at 5 rad/s2 outlasts the shortest watchdog.
        vx: Carriage speed of the moving rules [m/s]: 2 cm forth and back.
        turn_time: Length of a turn [s], for a slew limit of 0.6 rad/s2 and faster.
        rest_omega: Measured angular velocity that still counts as rest [rad/s].
        follow_share: Share by which a drive may miss its command [-]: a loose first tuning.
        stall_time: A line that takes nothing for so long is lost [s].
    """

    tick_us: int = 20_000
    long_tick_us: int = 100_000
    short_tick_us: int = 4_000
    command_interval: float = 0.01
    patience: float = 0.1
    tries: int = 5
    try_interval: float = 0.05
    rule_tries: int = 3
    allowance: float = 0.015
    held_up_time: float = 0.01
    clock_share: float = 0.05
    omega: float = 0.3
    vx: float = 0.02
    turn_time: float = 0.8
    rest_omega: float = 0.05
    follow_share: float = 0.3
    stall_time: float = 1.0


DEFAULT_CONFORMANCE = ConformanceSettings()


MEAS_INTERVAL = 0.02  # from one MEAS to the next without a CMD [s], docs/reference/wire.md


HOLD = Drive(0.0, 0.0, False, 1000)
"""Command at rest; it lapses later than any watchdog of these rules."""


class NotPrepared(Exception):
    """The rig could not be brought to where a rule begins; the message says why."""


class RigsOwnStop(InputError):
    """Somebody pressed the rig's own emergency stop; nothing more may be tried."""


class WheelTurns(Exception):
    """The wheel is measured to turn when, or faster than, it may; the message says how fast."""


class Probe:
    """A host under the hands of a test.

    Args:
        port: To the rig.
        clock: Of all times; `port` waits by the same.
        settings: Speeds and times.
        patience: Time [s] for which a rig that restarts when its port opens is asked again.

    Attributes:
        frames: All intact frames of the rig's, in order.
        drops: What else came since the first HELLO_ACK, by cause.
        session: Number of the present session.
        seq: Sequence number of the last frame sent.
        ack: The last HELLO_ACK.
        speed_limit: Measured angular velocity over which `WheelTurns` is raised [rad/s].
        held_up: Longest delay of this program since it was last set to zero [s].
    """

    def __init__(
        self,
        port: AbstractPort,
        clock: AbstractClock,
        settings: ConformanceSettings = DEFAULT_CONFORMANCE,
        patience: float = 0.0,
    ):
        self._port, self._clock, self.settings = port, clock, settings
        self._patience = patience
        self._splitter = FrameSplitter()
        self._sent: deque[bytes] = deque(maxlen=64)  # a line that echoes returns them
        self.frames: list[ReceivedFrame] = []
        self.drops: Counter[Drop] = Counter()
        self.session, self.seq = 0, first_number(time.time())
        self._ack: HelloAck | None = None
        self.speed_limit = 2.0 * settings.rest_omega
        self.held_up = 0.0
        self._has_stopped = False  # an ESTOP may be answered by one

    @property
    def name(self) -> str:
        """Name of the port."""
        return self._port.name

    @property
    def ack(self) -> HelloAck:
        """The last HELLO_ACK."""
        if self._ack is None:
            raise NotPrepared("no HELLO was answered")
        return self._ack

    @property
    def omega(self) -> float:
        """Angular velocity of the moving rules [rad/s], within the rig's limit."""
        return min(self.settings.omega, 0.5 * self.ack.omega_max)

    def now(self) -> float:
        """Time [s]."""
        return self._clock.now()

    # Sending ---------------------------------------------------------------------------------

    def transmit(self, data: bytes) -> None:
        """Send bytes as they are.

        Raises:
            LinkLost: the line takes nothing.
        """
        self._sent.extend(filter(None, data.split(DELIMITER)))
        since = self.now()
        while data:
            count = self._port.write(data)
            data = data[count:]
            since = self.now() if count else since
            if self.now() - since > self.settings.stall_time:
                raise LinkLost(f"{self._port.name} is lost: it takes nothing")
            if data:
                self._port.wait(False, True, self.now() + self.settings.command_interval)

    def next_frame(self, message: Message, session: int | None = None) -> Frame:
        """The next frame of this session, or of another."""
        self.seq = (self.seq + 1) & U32
        session = self.session if session is None else session
        return Frame(message, session, self.seq, clock_us(self.now()))

    def send(self, message: Message, session: int | None = None) -> int:
        """Send a message once; its sequence number."""
        frame = self.next_frame(message, session)
        self._has_stopped = self._has_stopped or isinstance(message, EmergencyStop)
        self.transmit(encode(frame))
        return frame.seq

    # Hearing ---------------------------------------------------------------------------------

    def listen(
        self, duration: float, until: Callable[[ReceivedFrame], bool] | None = None
    ) -> list[ReceivedFrame]:
        """Frames that come in this time [s], or up to the first for which `until` holds.

        Raises:
            WheelTurns: the wheel is measured to turn faster than `speed_limit`.
            RigsOwnStop: the rig made an emergency stop; it is answered.
        """
        begun, deadline = len(self.frames), self.now() + duration
        while True:
            fresh = len(self.frames)
            self._take(self._port.read(4096))
            if until is not None:
                for place, each in enumerate(self.frames[fresh:], start=fresh):
                    if until(each):
                        return self.frames[begun : place + 1]
            if (late := self.now() - deadline) >= 0.0:
                self.held_up = max(self.held_up, late)
                return self.frames[begun:]
            self._port.wait(True, False, deadline)

    def stream(
        self, command: Drive, duration: float, interval: float | None = None
    ) -> list[ReceivedFrame]:
        """Send a command again and again for this time [s]; the frames that come meanwhile."""
        begun, start = len(self.frames), self.now()
        interval = interval or self.settings.command_interval
        for number in range(1, round(duration / interval) + 1):
            self.send(command)
            self.listen(start + number * interval - self.now())
        return self.frames[begun:]

    # Sessions --------------------------------------------------------------------------------

    def connect(self, tick_us: int | None = None, asked_ms: int | None = None) -> HelloAck:
        """Open a new session, by HELLO up to five times.

        Args:
            tick_us: Control period to tell [us].
            asked_ms: Watchdog to ask for [ms]; the rule's where not given.

        Raises:
            NotPrepared: nothing answers.
        """
        tick_us = tick_us or self.settings.tick_us
        hello = Hello(tick_us, watchdog_ms(tick_us) if asked_ms is None else asked_ms)
        until, self._has_stopped = self.now() + self._patience, False
        while True:
            self.session = 1 + (self.session + secrets.randbelow(0xFFFE)) % 0xFFFF
            for _ in range(self.settings.tries):
                if (ack := self.ask(hello)) is not None:
                    self._patience = 0.0
                    return ack
            if self.now() >= until:
                tries, interval = self.settings.tries, self.settings.try_interval * 1e3
                raise NotPrepared(f"HELLO is not answered ({tries} tries, {interval:.0f} ms apart)")

    def ask(self, hello: Hello) -> HelloAck | None:
        """Send HELLO once in the present session; its answer, where one comes."""
        self.send(hello)
        heard = self.listen(self.settings.try_interval, self._is_ack)
        if not heard or not isinstance(heard[-1].message, HelloAck):
            return None
        self._ack = heard[-1].message
        return self._ack

    def make_idle(self) -> HelloAck:
        """Open a session with a rig that is at rest and not ready; SAFE where HELLO leaves it so.

        Raises:
            NotPrepared: it is ready, or in FAULT.
        """
        for number in range(self.settings.tries):
            if number:
                self.listen(self.settings.patience)  # it may still ramp to rest
            if self.connect().state is RigState.IDLE:
                break
        ack = self.ack
        if ack.state is RigState.FAULT:
            raise NotPrepared("the rig says FAULT, which only power-up ends")
        if ack.state in READY:
            raise NotPrepared(f"after HELLO the rig says {ack.state.name}")
        return ack

    def make_ready(self, tick_us: int | None = None) -> None:
        """Arm the rig, with a command at rest behind.

        Raises:
            NotPrepared: it does not get ready.
        """
        self.make_idle()
        if tick_us is not None:
            self.connect(tick_us)
        for _ in range(self.settings.tries):
            self.send(Arm())
            self.send(HOLD)
            heard = self.listen(self.settings.try_interval, is_ready)
            if heard and is_ready(heard[-1]):
                return
        raise NotPrepared("ARM does not make it ready")

    def make_turn(self, tick_us: int | None = None) -> None:
        """Arm the rig and let the wheel turn slowly.

        Raises:
            NotPrepared: it does not get ready, or is not measured to turn.
        """
        self.make_ready(tick_us)
        interval = self.settings.command_interval
        interval = interval if tick_us is None else min(interval, tick_us * 1e-6)
        heard = self.stream(self.turn(), self.settings.turn_time, interval)
        speed = omegas(heard)[-1:]
        if not speed or not speed[0] > self.settings.rest_omega:
            raise NotPrepared("the wheel is not measured to turn")
        if heard[-1].state not in READY:
            raise NotPrepared(f"it went {heard[-1].state} while commands came")

    def turn(self, sign: float = 1.0) -> Drive:
        """Command of a slow turn, with the carriage free."""
        return Drive(sign * self.omega, 0.0, False, HOLD.valid_ms)

    def leave(self) -> None:
        """Bring the rig to rest, by STOP and if need be by ESTOP, and say BYE."""
        self.speed_limit = float("inf")
        if self._ack is None:
            return
        self.send(Stop())
        heard = self.listen(self.settings.turn_time, self._is_rest)
        if not heard or not self._is_rest(heard[-1]):
            for _ in range(self.settings.tries):
                self.send(EmergencyStop(1))
                self.listen(self.settings.try_interval)
        self.send(Bye())
        self.listen(self.settings.try_interval)

    def _is_ack(self, each: ReceivedFrame) -> bool:
        return isinstance(each.message, HelloAck) and each.frame.session == self.session

    def _is_rest(self, each: ReceivedFrame) -> bool:
        """True for a measurement of a wheel that rests, or whose speed is not measured."""
        return (
            isinstance(each.message, Measurement)
            and each.state is not RigState.RUNNING
            and not abs(each.message.omega) > self.settings.rest_omega
        )

    def _take(self, data: bytes) -> None:
        now = self.now()
        for packet in self._splitter.packets(data):
            if packet in self._sent:
                continue
            found = decode(packet)
            if isinstance(found, Drop):
                if self._ack is not None:
                    self.drops[found] += 1
                continue
            if not isinstance(found.message, FROM_RIG):
                continue
            self.frames.append(ReceivedFrame(found, now))
            if isinstance(found.message, EmergencyStop) and not self._has_stopped:
                self.send(found.message)
                raise RigsOwnStop(
                    f"the rig on {self.name} made an emergency stop, reason "
                    f"{found.message.reason}: release it and start again"
                )
            if (
                isinstance(found.message, Measurement)
                and abs(found.message.omega) > self.speed_limit
            ):
                raise WheelTurns(
                    f"the wheel is measured to turn at {found.message.omega:.3g} rad/s"
                )
