"""What fails around a run - link, recorder, program, terminal - still brings the rig to rest."""

import math

import pytest

from drftjax.common.errors import InputError
from hils.clock import VirtualClock
from hils.control.stop_request import StopRequest
from hils.events import Phase
from hils.link.link import InProcessLink
from hils.link.messages import Bye, RigState
from hils.procedure.operator_prompts import UnattendedPrompts
from hils.procedure.procedure import Procedure, run
from hils.recording.sinks import InMemorySink
from hils.rig_sim.config import VirtualSetUp
from hils.rig_sim.in_process import QUICK, rig_physics, soft_rig
from hils.rig_sim.rig import VirtualRig
from tests.helpers.hils_runs import START, LoggedLink, loop_setup, make, resting


def test_lost_link_closes_the_file_and_says_so():
    class Torn(InMemorySink):
        """Lets the link break in the middle of the profile."""

        link: InProcessLink

        def command(self, time, omega, vx=None):
            super().command(time, omega, vx)
            if time > 2.0:
                self.link.close()

    rows = Torn()
    soft = soft_rig()
    rows.link = soft.link
    report = run(
        Procedure(loop=loop_setup(), countdown=0.3),
        soft.link,
        soft.clock,
        rows,
        UnattendedPrompts(quiet=True),
        StopRequest(),
    )
    assert report.reason.startswith("link lost: ")
    assert not report.rested
    assert rows.end_reason == report.reason


def test_dead_recorder_brings_the_rig_to_rest():
    class Dies(InMemorySink):
        dead = False

        @property
        def alive(self) -> bool:
            return not self.dead

        @property
        def reason(self) -> str | None:
            return "ended unasked" if self.dead else None

        def command(self, time, omega, vx=None):
            super().command(time, omega, vx)
            self.dead = time > 2.0

    made = make(rows=Dies())
    assert made.report.reason == "the recorder ended unasked"
    assert made.report.rested
    assert made.rows.commands[-1][1] == 0.0
    assert resting(made)


def test_fault_of_the_program_still_stops_the_rig():
    class Breaks(InMemorySink):
        def online(self, row):
            if row.time > 2.0:
                raise ZeroDivisionError("of a bug")
            super().online(row)

    rows, soft = Breaks(), soft_rig()
    with pytest.raises(InputError, match="fault of this program, ZeroDivisionError: of a bug"):
        run(
            Procedure(loop=loop_setup(), countdown=0.3),
            soft.link,
            soft.clock,
            rows,
            UnattendedPrompts(quiet=True),
            StopRequest(),
        )
    assert rows.end_reason == "failed: ZeroDivisionError: of a bug"
    soft.clock.sleep_until(soft.clock.now() + 1.0)
    assert soft.rig.motion.omega == 0.0
    assert soft.rig.state in (RigState.IDLE, RigState.SAFE)


def test_nothing_that_is_told_can_prevent_the_stop():
    class Speechless(UnattendedPrompts):
        def enter_phase(self, phase, lasts=math.nan):
            if phase is Phase.STOPPING:
                raise OSError("the terminal is gone")

    setup, clock = VirtualSetUp(physics=QUICK), VirtualClock(START)
    rig = VirtualRig(setup, rig_physics(setup), None, 0, 0, 0.0, START)
    link, given = LoggedLink(rig, clock), Procedure(loop=loop_setup(), countdown=0.3)
    with pytest.raises(InputError, match="OSError: the terminal is gone"):
        run(given, link, clock, InMemorySink(), Speechless(quiet=True), StopRequest())
    assert isinstance(link.said[-1][1], Bye)
    assert rig.state is RigState.IDLE
