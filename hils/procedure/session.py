"""The host's side of a session: HELLO, ARM, ESTOP and BYE, each under absolute deadlines."""

import math
import secrets
from collections.abc import Callable
from dataclasses import dataclass

from drftjax.common.errors import InputError
from hils.clock import AbstractClock
from hils.link.link import AbstractLink, Arrival, LinkQuality
from hils.link.messages import (
    READY,
    SCHEMA,
    Arm,
    Bye,
    Drive,
    EmergencyStop,
    Hello,
    HelloAck,
    Message,
    RigState,
    StateReport,
    Stop,
    is_newer,
    reason_in_words,
)
from hils.link.timing import watchdog_us

STOPPED = (RigState.SAFE, RigState.FAULT)


@dataclass(frozen=True)
class SessionSettings:
    """Deadlines of a session, and the rigs that it takes.

    Attributes:
        tries: Times that a message is sent before its answer counts as missing; five by
            docs/reference/wire.md.
        interval: From one try to the next [s]; 50 ms by docs/reference/wire.md.
        max_scale: Metres a count over which a rig's scale cannot be right.
    """

    tries: int = 5
    interval: float = 0.05
    max_scale: float = 1.0


DEFAULT_SESSION = SessionSettings()


class RigStopped(InputError):
    """The rig ended the run by itself; the message says in which words."""


def draw_session_number() -> int:
    """Draw a session number at random, never zero: a rig that knows no session may send zero."""
    return 1 + secrets.randbelow(0xFFFF)


class Session:
    """One host's conversation with the rig at the end of a link.

    Args:
        link: To the rig.
        clock: Of the deadlines.
        number: Draws a session number for each HELLO.
        settings: Deadlines, and the rigs that are taken.
    """

    def __init__(
        self,
        link: AbstractLink,
        clock: AbstractClock,
        number: Callable[[], int] = draw_session_number,
        settings: SessionSettings = DEFAULT_SESSION,
    ):
        self._link, self._clock, self._number, self._settings = link, clock, number, settings
        self._hello: Hello | None = None
        self._ack: HelloAck | None = None
        self._armed_by: Arrival | None = None
        self._last_state: StateReport | None = None
        self._rig_stop: EmergencyStop | None = None
        self._answer_time = 0.0

    def connect(self, hello: Hello, patience: float = 0.0) -> HelloAck:
        """Open a session: HELLO up to five times, 50 ms apart (docs/reference/wire.md).

        All tries have one session number, so that an answer counts however late it comes.

        Args:
            hello: The first message of the session.
            patience: Time [s] over which the five tries are made again, for a rig that restarts
                when its port is opened, or answers late.

        Returns:
            Identity, scales and limits of the rig.

        Raises:
            InputError: nothing answers, or what answers cannot be driven safely.
            LinkLost: the line broke.
        """
        self._rig_stop = self._armed_by = None
        begun, before = self._clock.now(), self._link.quality()
        number, answer = self._number(), None
        while answer is None:
            self._link.begin(number)  # again: a rig that restarts counts its frames from 0
            answer = self._ask(hello, _is_hello_ack)
            if answer is None and self._clock.now() >= begun + patience:
                raise InputError(self._no_answer(before))
        assert isinstance(answer.frame.message, HelloAck)
        self._hello, self._ack = hello, answer.frame.message
        self._answer_time = answer.time - begun
        _require_usable(self._link.name, hello, self._ack, self._settings.max_scale)
        return self._ack

    @property
    def late_answer(self) -> str:
        """Sentence on an answer to HELLO that came after the first five tries; else empty."""
        if self._answer_time <= self._settings.tries * self._settings.interval:
            return ""
        return f"the rig on {self._link.name} answered HELLO after {self._answer_time:.1f} s"

    def arm(self, hold: Drive) -> None:
        """Make the rig ready to move: ARM until it says that it is, with commands behind.

        A rig may count its watchdog from ARM on, so `hold` is sent each tick while its answer is
        on the way; the caller goes on sending commands as soon as this returns. A rig that is
        SAFE, which by then it may be for want of commands, gets one more HELLO.

        Args:
            hold: The command at rest.

        Raises:
            InputError: the rig does not get ready, or made an emergency stop since HELLO.
            LinkLost: the line broke.
        """
        hello, ack = self._require_open()
        for again in (False, True):
            self.require_no_rig_stop()
            if again:
                self._reconnect(hello, ack)
            self._last_state = None
            self._armed_by = self._ask(Arm(), _is_ready, hold, hello.tick_us * 1e-6)
            self.require_no_rig_stop()
            if self._armed_by is not None:
                return
            if self._last_state is None or self._last_state.state is RigState.FAULT:
                break
        self._require_same_boot(ack)
        raise InputError(self._not_armed(ack))

    def require_no_rig_stop(self) -> None:
        """Refuse to go on with a rig that made an emergency stop of its own since HELLO.

        It is answered by one of the same reason. A HELLO would let the rig move again, so this is
        to be called before a new session.

        Raises:
            InputError: the rig made one.
            LinkLost: the line broke.
        """
        _, ack = self._require_open()
        self._reports()
        if self._rig_stop is None:
            return
        halted, self._armed_by = self._rig_stop, None
        self.emergency_stop(halted.reason)
        if self._last_state is not None and self._last_state.state is RigState.FAULT:
            raise InputError(self._not_armed(ack))
        raise InputError(
            f"the rig on {self._link.name} made an emergency stop, "
            f"{reason_in_words(ack.rig_id, halted.reason)}: release it and start again"
        )

    @property
    def rig_stop(self) -> EmergencyStop | None:
        """The last emergency stop that came while this waited for an answer, since HELLO."""
        return self._rig_stop

    def check(self) -> list[Arrival]:
        """Take the reports of the rig since the last call; once armed, refuse if it is no longer.

        An emergency stop of the rig's own is answered by one of the same reason.

        Raises:
            RigStopped: the rig stopped, left its ready state, failed or was reset.
            LinkLost: the line broke.
        """
        _, ack = self._require_open()
        reports = self._link.reports()
        foreign = self._link.quality().foreign_state
        heard = [each.frame.message for each in reports]
        if foreign is not None:
            heard.append(foreign)
        for message in heard:
            if isinstance(message, HelloAck | StateReport) and message.boot_id != ack.boot_id:
                raise RigStopped(f"the rig on {self._link.name} was reset during the run")
            if isinstance(message, EmergencyStop):
                self._link.send(message)
                raise RigStopped(
                    f"the rig on {self._link.name} made an emergency stop, "
                    f"{reason_in_words(ack.rig_id, message.reason)}"
                )
        newest = self._link.newest()
        for each in reports if newest is None else [*reports, newest]:
            self._require_ready(each, ack.rig_id)
        return reports

    def stop(self) -> None:
        """Ask the rig to ramp to rest and stay armed; not repeated, so the caller goes on with
        commands at rest."""
        self._link.send(Stop())

    def emergency_stop(self, reason: int) -> bool:
        """Ask the rig to rest at once, up to five times, 50 ms apart.

        Returns:
            True where the rig answered that it is SAFE; else its watchdog has to make it so.
        """
        return self._ask(EmergencyStop(reason), _is_stopped) is not None

    def require_not_reset(self) -> None:
        """Refuse a rig that was reset since HELLO, where it sends nothing any more before ARM.

        It is sent BYE, which a rig that knows no session answers with its boot number.

        Raises:
            InputError: it was reset.
            LinkLost: the line broke.
        """
        _, ack = self._require_open()
        self.bye()
        self._require_same_boot(ack)

    def bye(self) -> None:
        """End the session, and give the rig a moment to take it in."""
        now = self._clock.now()
        self._link.send(Bye())
        self._wait_for_answer(
            lambda each: isinstance(each.frame.message, StateReport),
            now,
            now + self._settings.interval,
        )
        self._armed_by = None

    def _reconnect(self, hello: Hello, ack: HelloAck) -> None:
        if self.connect(hello).boot_id != ack.boot_id:
            raise RigStopped(f"the rig on {self._link.name} was reset before it was armed")
        # Its words from before this HELLO have come before its answer.
        self._rig_stop = self._rig_stop or self._link.quality().foreign_stop
        self.require_no_rig_stop()

    def _require_same_boot(self, ack: HelloAck) -> None:
        foreign = self._link.quality().foreign_state
        if foreign is not None and foreign.boot_id != ack.boot_id:
            raise InputError(
                f"the rig on {self._link.name} was reset before it was armed: start again"
            )

    def _require_open(self) -> tuple[Hello, HelloAck]:
        if self._hello is None or self._ack is None:
            raise InputError(f"no session is open with the rig on {self._link.name}")
        return self._hello, self._ack

    def _require_ready(self, arrival: Arrival, rig_id: int) -> None:
        state = _state(arrival)
        if self._armed_by is None or state is None or state in READY:
            return
        if not is_newer(arrival.frame.seq, self._armed_by.frame.seq):  # from before it was armed
            return
        message = arrival.frame.message
        reason = (
            f", {reason_in_words(rig_id, message.reason)}"
            if isinstance(message, StateReport)
            else ""
        )
        raise RigStopped(f"the rig on {self._link.name} went {state.name} by itself{reason}")

    def _ask(
        self,
        message: Message,
        answers: Callable[[Arrival], bool],
        hold: Drive | None = None,
        tick: float = math.inf,
    ) -> Arrival | None:
        """Send a message until something answers it, or all tries are over.

        Nothing that came before the first try is an answer, nor a measurement of that instant.
        """
        start = self._clock.now()
        for number in range(1, self._settings.tries + 1):
            self._link.send(message)
            deadline = start + number * self._settings.interval
            while (now := self._clock.now()) < deadline:
                if hold is not None:
                    self._link.send(hold)
                until = min(deadline, now + tick)
                if (answer := self._wait_for_answer(answers, start, until)) is not None:
                    return answer
                if self._rig_stop is not None and isinstance(message, Arm):
                    return None
        return None

    def _wait_for_answer(
        self, answers: Callable[[Arrival], bool], since: float, deadline: float
    ) -> Arrival | None:
        while True:
            for each in self._reports():
                if each.time >= since and answers(each):
                    return each
            newest = self._link.newest()
            if newest is not None and newest.time > since and answers(newest):
                return newest
            if not self._link.wait(deadline):
                return None

    def _reports(self) -> list[Arrival]:
        """Take the reports of the rig since the last call, and keep its state and its stops."""
        reports = self._link.reports()
        for each in reports:
            message = each.frame.message
            if isinstance(message, StateReport):
                self._last_state = message
            if isinstance(message, EmergencyStop):
                self._rig_stop = message
        return reports

    def _no_answer(self, before: LinkQuality) -> str:
        """Sentence for a port at which no rig answers, by the traffic since `before`."""
        tries, interval = self._settings.tries, self._settings.interval * 1e3
        name, after = self._link.name, self._link.quality()
        asked = f"no rig on {name} answers HELLO ({tries} tries, {interval:.0f} ms apart)"
        got = after.bytes_received - before.bytes_received
        if got == 0:
            return (
                f"{asked}, not a byte came back: is the rig on, and is this its port? One that "
                "counts on over sessions drops a host whose clock was set back: switch it off and "
                "on"
            )
        if isinstance(after.foreign_state, HelloAck):
            return f"{asked} in time, but one answers late: an answer to an earlier HELLO came"
        new = {cause: count - before.drops.get(cause, 0) for cause, count in after.drops.items()}
        causes = ", ".join(f"{count} {cause.value}" for cause, count in new.items() if count)
        listed = f" ({causes})" if causes else ""
        return f"{asked}, though {got} bytes came{listed}: is the baud rate the rig's, is it a rig?"

    def _not_armed(self, ack: HelloAck) -> str:
        """Sentence for a rig that did not get ready after ARM."""
        name, state = self._link.name, self._last_state
        if state is None:
            tries, interval = self._settings.tries, self._settings.interval * 1e3
            late = f"; {self.late_answer}" if self.late_answer else ""
            return (
                f"the rig on {name} does not answer ARM ({tries} tries, {interval:.0f} ms apart)"
                f"{late}"
            )
        reason = reason_in_words(ack.rig_id, state.reason)
        return f"the rig on {name} is not armed: it says {state.state.name}, {reason}"


def _state(arrival: Arrival) -> RigState | None:
    return getattr(arrival.frame.message, "state", None)


def _is_hello_ack(arrival: Arrival) -> bool:
    return isinstance(arrival.frame.message, HelloAck)


def _is_ready(arrival: Arrival) -> bool:
    """STATE answers ARM; so does a measurement that already says that the rig is ready."""
    return not isinstance(arrival.frame.message, HelloAck) and _state(arrival) in READY


def _is_stopped(arrival: Arrival) -> bool:
    return isinstance(arrival.frame.message, EmergencyStop) or _state(arrival) in STOPPED


def _require_usable(name: str, hello: Hello, ack: HelloAck, max_scale: float) -> None:
    due_us = watchdog_us(hello.tick_us)
    scales = [ack.z_scale, ack.x_scale]
    limits = [ack.omega_max, ack.vx_max]
    if ack.schema != SCHEMA:
        raise InputError(
            f"the rig on {name} speaks schema 0x{ack.schema:08x}, must be 0x{SCHEMA:08x}"
        )
    if not all(math.isfinite(each) and abs(each) < max_scale for each in scales) or (
        ack.z_scale == 0.0
    ):
        raise InputError(
            f"the rig on {name} says z_scale {ack.z_scale:.4g} and x_scale {ack.x_scale:.4g} m a "
            f"count, must be finite, below {max_scale:g} m, and that of z not zero"
        )
    if not all(math.isfinite(each) and each >= 0.0 for each in limits) or ack.omega_max == 0.0:
        raise InputError(
            f"the rig on {name} says omega_max {ack.omega_max:.4g} rad/s and vx_max "
            f"{ack.vx_max:.4g} m/s, must be finite, the first positive and the second not negative"
        )
    # Less than the rule's, it would bite between two commands; far more, a wheel runs on alone.
    if not due_us // 1000 <= ack.watchdog_ms <= 2 * due_us / 1000:
        raise InputError(
            f"the rig on {name} has a watchdog of {ack.watchdog_ms} ms, must be max(20 ms, "
            f"5 ticks) = {due_us / 1000:g} ms, or up to twice that"
        )
