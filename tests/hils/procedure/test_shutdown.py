"""A rig at the end of its run: told to rest, and believed to rest only where it is seen to."""

import math
import struct

import pytest

from hils.control.safety import DEFAULT_SAFETY
from hils.control.stop_request import StopReason, StopRequest
from hils.events import Event
from hils.link.messages import Bye, Drive, EmergencyStop, RigState, Stop
from hils.procedure.shutdown import DEFAULT_SHUTDOWN, Shutdown, ShutdownSettings
from hils.recording.event_log import EventLog
from hils.recording.sinks import InMemorySink
from hils.rig_sim.firmware import RigIdentity, RigProtocol
from tests.helpers.protocol_variants import HELLO, HOLD, OtherRig, Table

RAMP = 2.0
# Of another's firmware: x in steps of 0.1 mm.
WITH_X = (0x44524654, 9, 7, 1e-5, 1e-4, 2.0, 0.1, 50, 0)


class Turning(RigProtocol):
    """Our own firmware; its wheel turns as it is asked to."""

    def __init__(self):
        super().__init__(RigIdentity(boot_id=5))
        self.states = []

    def advance(self, now: float, data: bytes) -> bytes:
        self.measure(0, 0, self.demand.omega)
        out = super().advance(now, data)
        self.states.append(self.state)
        return out


class Rolling(OtherRig):
    """The carriage rolls on at 0.1 m/s for a while, whatever it is told; its wheel stands."""

    stands_from = math.inf

    def measure(self, now: float, seq: int) -> None:
        x = round(1000 * min(now, self.stands_from))
        self.told = now
        self.say(5, struct.pack("<IiifHH", seq, -1760, x, 0.0, self.state, 0))


class Resting(Table):
    """A rig that is armed, with what the host says to it from here on."""

    def __init__(self, rig):
        super().__init__(rig)
        self.ack, self.stop = self.session.connect(HELLO), StopRequest()
        self.session.arm(HOLD)
        self.said, send = [], self.link.send
        self.link.send = lambda message: (self.said.append(message), send(message))[1]
        self.rows = InMemorySink()
        self.log = EventLog(self.rows, self.clock)
        self.log.begin(0.0)

    def bring_to_rest(self, settings: ShutdownSettings = DEFAULT_SHUTDOWN) -> bool:
        given = self.session, self.link, self.clock, self.ack, self.stop, self.log
        return Shutdown(*given, HOLD, 0.01, RAMP, settings).bring_to_rest()

    @property
    def logged(self) -> list:
        return [(code, arg) for _, code, arg in self.rows.events]


def test_commands_at_rest_keep_the_watchdog_quiet_while_the_wheel_ramps_down():
    table = Resting(Turning())
    table.drive(1.0, omega=1.0)
    table.said.clear()
    # The firmware takes four times its watchdog to ramp down.
    assert table.bring_to_rest()
    assert RigState.SAFE not in table.rig.states
    assert isinstance(table.said[0], Stop)
    assert table.said[-1] == Bye()
    assert not any(isinstance(each, EmergencyStop) for each in table.said)
    assert {each for each in table.said if isinstance(each, Drive)} == {HOLD}


@pytest.mark.parametrize("ways", [{}, {"runs_at_arm": True}])
def test_a_wheel_that_stands_is_seen_to_rest(ways):
    table = Resting(OtherRig(**ways))
    assert table.bring_to_rest()
    assert not any(isinstance(each, EmergencyStop) for each in table.said)


def test_a_wheel_that_turns_on_is_not_believed_to_rest_though_the_rig_says_that_it_is_safe():
    table = Resting(OtherRig(omega=0.5))
    assert not table.bring_to_rest()
    assert table.rig.state == 0  # it took ESTOP and BYE, and turns
    # The emergency stop goes out as soon as it is seen not to slow down.
    seen = {code: (time, arg) for time, code, arg in table.rows.events}
    time, omega = seen[Event.NOT_SLOWING]
    assert time < 2 * DEFAULT_SAFETY.slowing_time
    assert omega == 0.5


def test_a_wheel_rests_by_the_speed_that_is_set():
    table = Resting(OtherRig(omega=0.5))
    assert table.bring_to_rest(ShutdownSettings(max_omega=0.6))
    assert table.clock.now() < DEFAULT_SHUTDOWN.longest_stop


def test_a_rig_that_falls_silent_is_not_believed_to_rest():
    table = Resting(OtherRig(omega=0.5))
    table.drive(0.1)
    table.rig.state = 3
    table.rig.measure(table.clock.now(), 0)
    table.clock.sleep_until(table.clock.now() + 0.01)
    table.rig.say = lambda *_: None
    assert not table.bring_to_rest()
    assert table.said[-1] == Bye()


def test_a_wheel_that_is_not_measured_rests_no_sooner_than_it_can():
    table = Resting(OtherRig(omega=math.nan))
    began = table.clock.now()
    assert table.bring_to_rest()
    assert table.clock.now() - began >= RAMP


def test_a_carriage_that_rolls_on_does_not_rest():
    assert not Resting(Rolling(greeting=WITH_X)).bring_to_rest()
    table = Resting(Rolling(greeting=WITH_X, stands_from=1.0))
    assert table.bring_to_rest()
    assert table.clock.now() > 1.0


def test_an_emergency_stop_asked_for_meanwhile_goes_out_at_once():
    table = Resting(OtherRig(omega=0.5))
    table.stop.ask(StopReason("asked", Event.STOP_ASKED), emergency=True)
    table.bring_to_rest()
    assert table.said[0] == EmergencyStop(1)


# What the rig does by itself meanwhile ------------------------------------------------------------


class Failing(OtherRig):
    """Its drive fails at the first STOP, and it says so in each measurement."""

    fault = 0

    def hear(self, content: bytes, now: float) -> None:
        super().hear(content, now)
        if content[1] == 6:
            self.state, self.fault = 4, 7

    def measure(self, now: float, seq: int) -> None:
        self.told = now
        payload = struct.pack("<IiifHH", seq, -1760, 0, self.omega, self.state, self.fault)
        self.say(5, payload)


def test_a_fault_that_the_rig_reports_is_logged_once_and_asks_for_no_further_run():
    table = Resting(Failing())
    assert table.bring_to_rest()
    assert table.logged == [(Event.RIG_STATE, RigState.FAULT), (Event.RIG_FAULT, 7)]
    assert table.stop.first_reason.reason == "the rig reports fault 7"
    assert not table.stop.emergency


def test_a_rig_that_goes_safe_is_logged_and_may_run_again():
    class Safe(Failing):
        def measure(self, now, seq):
            self.state, self.fault = 3 if self.fault else self.state, 0
            super().measure(now, seq)

    table = Resting(Safe())
    assert table.bring_to_rest()
    assert table.logged == [(Event.RIG_STATE, RigState.SAFE)]
    assert table.stop.first_reason is None


def test_what_ended_the_run_is_not_logged_again():
    table = Resting(Failing())
    table.log.note(Event.RIG_FAULT, 7)
    assert table.bring_to_rest()
    assert table.logged == [(Event.RIG_FAULT, 7), (Event.RIG_STATE, RigState.FAULT)]


class Parting(OtherRig):
    """It makes an emergency stop of its own while it takes leave, or answers one by one."""

    at, reason = 9, 12

    def hear(self, content: bytes, now: float) -> None:
        if content[1] == self.at:
            self.say(7, struct.pack("<H", self.reason))
        super().hear(content, now)


def test_an_emergency_stop_at_the_farewell_is_answered_logged_and_asks_for_no_further_run():
    table = Resting(Parting())
    assert table.bring_to_rest()
    assert table.logged == [(Event.EMERGENCY_STOP, 12)]
    assert table.stop.first_reason.reason.startswith("the rig made an emergency stop, reason 12")
    assert table.said[-2:] == [Bye(), EmergencyStop(12)]


def test_an_emergency_stop_that_answers_the_hosts_is_not_the_rigs_own():
    table = Resting(Parting(at=7, reason=1))
    table.stop.ask(StopReason("asked", Event.EMERGENCY_STOP, 10.0), emergency=True)
    table.bring_to_rest()
    assert table.logged == [(Event.EMERGENCY_STOP, 10.0)]


def test_a_second_wish_is_logged_as_the_emergency_stop_that_it_is():
    table = Resting(OtherRig(omega=0.5))
    table.stop.ask(StopReason("asked", Event.STOP_ASKED, 12.0))
    table.stop.ask(StopReason("asked", Event.STOP_ASKED, 12.0))
    table.bring_to_rest()
    assert table.logged == [(Event.STOP_ASKED, 12.0), (Event.EMERGENCY_STOP, 12.0)]
