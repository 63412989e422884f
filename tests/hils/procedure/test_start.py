"""What comes before the first command: a wheel in the air, and a rig that stopped by itself."""

import math
import re
import struct

import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.runlog.hdf5.api import survey_run, write_run
from hils.clock import VirtualClock
from hils.control.loop_config import Start
from hils.control.measurements import ResponseSettings
from hils.control.stop_request import StopRequest
from hils.link.messages import Arm, Bye, Drive, EmergencyStop, Hello, RigState
from hils.procedure.initial_state import StartLimits, within_limits, zeta_doubt
from hils.procedure.operator_prompts import POLL_INTERVAL, UnattendedPrompts
from hils.procedure.procedure import Procedure, ProcedureSettings, run
from hils.procedure.settling import SettlingSettings
from hils.recording.sinks import InMemorySink
from hils.rig_sim.in_process import soft_rig
from tests.helpers.hils_runs import START, Cue, LoggedLink, loop_setup
from tests.helpers.protocol_variants import Buttons, OtherRig


class InTheAir(OtherRig):
    """Its wheel hangs so far over where it was zeroed [m]."""

    over = 0.0
    turns_as_commanded = True
    greeting = (0x44524654, 9, 7, 1e-5, 1e-4, 2.0, 0.1, 50, 0)

    def measure(self, now, seq):
        self.told, z = now, round(self.over / 1e-5) if now > START + 0.55 else 0
        self.say(5, struct.pack("<IiifHH", seq, z, 0, self.omega, self.state, 0))


@pytest.mark.parametrize("over", [0.0, 0.03])
def test_wheel_in_the_air_is_driven_and_recorded_where_nothing_is_simulated(over, tmp_path):
    told, clock, rows = [], VirtualClock(START), InMemorySink()

    class Listener(UnattendedPrompts):
        def say(self, text):
            told.append(text)

        say_if_free = say

    given = Procedure(loop=loop_setup(), countdown=0.3, free=True)
    link = LoggedLink(InTheAir(over=over), clock)
    report = run(given, link, clock, rows, Listener(quiet=True), StopRequest())
    assert report.completed
    assert report.rested
    assert "At rest in the air; start in 0.3 s" in told
    assert max(m.omega for _, m in link.said if isinstance(m, Drive)) == pytest.approx(
        np.radians(30)
    )
    log = rows.run()
    assert log.setup.scaling_factor_initial is None
    assert log.setup.sinkage_static is None
    write_run(tmp_path / "air.h5", log)
    # A wheel that was zeroed on the sand and lifted is no run on sand, and a check says so. In the
    # air it turns and goes nowhere, which is worth a note.
    found = survey_run(tmp_path / "air.h5")[1]
    assert [each.where for each in found] == [*(["/measured/z"] if over else []), "/measured/x"]


@pytest.mark.parametrize(
    ("free", "over", "said"),
    [
        (False, 0.0, "-0.00 mm deep, must lie between 0.5"),
        (True, 0.06, "-60.00 mm deep, must lie between -50"),
    ],
)
def test_wheel_in_the_air_is_refused_where_it_is_simulated_or_too_high(free, over, said):
    clock, given = VirtualClock(START), Procedure(loop=loop_setup(), countdown=0.3, free=free)
    link = LoggedLink(InTheAir(over=over), clock)
    with pytest.raises(InputError, match=f"rests {said}"):
        run(given, link, clock, InMemorySink(), UnattendedPrompts(quiet=True), StopRequest())
    assert not any(isinstance(m, Drive) and m.omega for _, m in link.said)


@pytest.mark.parametrize(
    ("zeta", "said"),
    [
        (0.9, None),
        (2.5, "the set-up says 0.75: the rig's z_scale, the sign of z"),
        (25.0, "the set-up says 0.75 and sand has 0.05 to 20: the rig's z_scale, the sign of z"),
        (-0.5, "the set-up says 0.75 and sand has 0.05 to 20"),
    ],
)
def test_a_doubtful_zeta_is_asked_about_and_kept_within_what_sand_has(zeta, said):
    loop = loop_setup()
    loop.setup.terrain.zeta = 0.75
    start = Start(0.01, zeta)
    doubt = zeta_doubt(loop, start)
    assert (doubt is None) == (said is None)
    assert doubt is None or f"10.00 mm gives zeta(0) {zeta:.3g}, {said}" in doubt.sentence
    assert within_limits(start).zeta == min(max(zeta, 0.05), 20.0)


class Pressing(UnattendedPrompts):
    """An operator who presses the rig's own emergency stop while asked for something else."""

    def __init__(self, rig: Buttons, clock: VirtualClock, question: str):
        super().__init__(quiet=True)
        self._rig, self._clock, self._question = rig, clock, question

    def confirm(self, text, meanwhile=None):
        if self._question in text:
            self._rig.press(12, self._clock.now())
            self._clock.sleep_until(self._clock.now() + 10.0)


@pytest.mark.parametrize("question", ["Hold the wheel", "Let the wheel down", "none: held"])
def test_rigs_own_emergency_stop_before_arm_is_answered_and_nothing_is_armed(question):
    clock, rig = VirtualClock(START), Buttons()
    link, rows = LoggedLink(rig, clock), InMemorySink()
    Cue(clock, START + 0.2 if "none" in question else math.inf, lambda: rig.press(12, clock.now()))
    given = Procedure(loop=loop_setup(), countdown=0.3)
    with pytest.raises(InputError, match=r"stop, reason 12 .*: release it and start"):
        run(given, link, clock, rows, Pressing(rig, clock, question), StopRequest())
    assert [message for _, message in link.said[1:]] == [EmergencyStop(12), Bye()]
    assert rig.protocol.state is RigState.SAFE
    assert "emergency stop" in rows.end_reason


class Resetting(UnattendedPrompts):
    """The rig is reset at one of the questions."""

    def __init__(self, rig: Buttons, clock: VirtualClock, question: str):
        super().__init__(quiet=True)
        self._rig, self._clock, self._question = rig, clock, question

    def confirm(self, text, meanwhile=None):
        if self._question in text:
            self._rig.reset(self._clock.now())
            self._clock.sleep_until(self._clock.now() + 1.0)


@pytest.mark.parametrize("question", ["Hold the wheel", "Let the wheel down"])
def test_rig_that_is_reset_at_a_question_is_refused_as_such(question):
    clock, rig = VirtualClock(START), Buttons()
    link, rows = LoggedLink(rig, clock), InMemorySink()
    given = Procedure(loop=loop_setup(), countdown=0.3)
    said = "the rig on the virtual rig was reset before it was armed: start again$"
    with pytest.raises(InputError, match=said):
        run(given, link, clock, rows, Resetting(rig, clock, question), StopRequest())
    assert not any(isinstance(m, Drive) and m.omega for _, m in link.said)
    assert rig.protocol.state in (RigState.IDLE, RigState.SAFE)


def test_a_file_that_cannot_be_recorded_any_more_after_the_questions_is_refused():
    class Filling(InMemorySink):
        asked = 0

        def require_room(self, head):
            self.asked += 1
            if self.asked > 1:
                raise InputError("the disk is full")

    soft = soft_rig()
    with pytest.raises(InputError, match="the disk is full"):
        run(
            Procedure(loop=loop_setup(), countdown=0.3),
            soft.link,
            soft.clock,
            Filling(),
            UnattendedPrompts(quiet=True),
            StopRequest(),
        )
    assert "arm" not in soft.rig.occasions


class Waiting(UnattendedPrompts):
    """An operator who never presses Enter, at a rig whose own emergency stop is pressed."""

    def __init__(self, rig: Buttons, clock: VirtualClock):
        super().__init__(quiet=True)
        self._rig, self._clock = rig, clock

    def confirm(self, text, meanwhile=None):
        assert meanwhile is not None
        self._rig.press(12, self._clock.now())
        for _ in range(20):
            self._clock.sleep_until(self._clock.now() + POLL_INTERVAL)
            meanwhile()
        raise AssertionError("nobody looked at the rig while the question was open")


def test_rigs_own_emergency_stop_ends_an_open_question():
    clock, rig = VirtualClock(START), Buttons()
    link, rows = LoggedLink(rig, clock), InMemorySink()
    given = Procedure(loop=loop_setup(), countdown=0.3)
    with pytest.raises(InputError, match=r"stop, reason 12 .*: release it and start"):
        run(given, link, clock, rows, Waiting(rig, clock), StopRequest())
    assert [message for _, message in link.said[1:]] == [EmergencyStop(12), Bye()]


def test_rig_that_hello_finds_armed_is_told_of_and_driven():
    told = []

    class Listener(UnattendedPrompts):
        def say(self, text):
            told.append(text)

    soft, given = soft_rig(), Procedure(loop=loop_setup(), countdown=0.3)
    soft.link.begin(7)
    for message in (Hello(10_000, 50), Arm()):  # another host's, that has left
        soft.link.send(message)
    run(given, soft.link, soft.clock, rows := InMemorySink(), Listener(quiet=True), StopRequest())
    assert rows.end_reason == "completed"
    assert told[0] == "The rig was SAFE before this run; ARM lets it move again."


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        (ProcedureSettings(start=StartLimits(min_sinkage=0.02)), "must lie between 20 and"),
        (ProcedureSettings(settling=SettlingSettings(longest_time=0.5)), "to rest in 0.5 s"),
    ],
)
def test_a_start_is_refused_by_the_numbers_that_are_set(settings, sentence):
    soft = soft_rig()
    given = Procedure(loop=loop_setup(), countdown=0.3, settings=settings)
    with pytest.raises(InputError, match=re.escape(sentence)):
        run(given, soft.link, soft.clock, InMemorySink(), UnattendedPrompts(True), StopRequest())


def test_patience_with_a_silent_rig_can_be_set():
    patient = ResponseSettings(silent_time=1.0, stale_time=0.2)
    assert patient.longest_silence(0.01) == 1.0
    assert patient.longest_silence(1.0) == 5.0
    assert patient.stale_age(0.01) == 0.2
