"""Safety rules against a rig whose firmware somebody else wrote in C, from the wire's text alone.

In real time over a pseudo-terminal; every rule that this firmware's options can break.
"""

import re
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.setups.setup import CommandSetUp, IntegratorSetUp, SetUp, WheelSetUp
from hils.clock import MonotonicClock
from hils.control.limits import CommandLimits
from hils.control.loop_config import LoopSetUp
from hils.control.stop_request import StopRequest
from hils.events import Event
from hils.link.port_link import PortLink
from hils.link.ports import open_port
from hils.procedure.operator_prompts import UnattendedPrompts
from hils.procedure.procedure import Procedure, ProcedureSettings, RunReport, run
from hils.procedure.settling import SettlingSettings
from hils.realtime import timely
from hils.recording.sinks import InMemorySink
from tests.helpers.other_firmware import build, running

# The wheel turns from 0.1 s on; a fault strikes so long after it has begun to turn [s].
STRIKES = 0.5
# From there to the firmware's hearing of it, on a busy computer [s]: three readings, or half a
# second and three readings, or a second and a tenth; and what other work holds up.
BUSY = 0.6


class Made(NamedTuple):
    report: RunReport | None
    refusal: str
    rows: InMemorySink
    log: str

    @property
    def why(self) -> str:
        """Reason of its end, or why it was refused."""
        return self.report.reason if self.report else self.refusal

    @property
    def events(self) -> set[int]:
        return {code for _, code, _ in self.rows.events}

    def heard(self, word: str) -> float:
        """Time at which the firmware heard or did something first, by its own log [s]."""
        found = re.search(rf"^\s*\[?\s*([\d.]+)\]?\s.*{word}", self.log, re.MULTILINE)
        assert found is not None, self.log
        return float(found[1])


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """Makes a run against the firmware with some options."""
    folder = tmp_path_factory.mktemp("firmware")
    program = build(folder)
    setup = SetUp(
        command=CommandSetUp([0, 0.1, 0.4, 2.5], [0, 0, 30, 30], omega_unit="deg/s"),
        wheel=WheelSetUp(plate_size=0.01),
        integrator=IntegratorSetUp(step=5e-3),
    )
    loop = LoopSetUp(setup=setup, commands=CommandLimits(2.0, 0.3), tick=0.02)
    settings = ProcedureSettings(settling=SettlingSettings(min_time=0.5))
    procedure = Procedure(loop=loop, countdown=0.1, settings=settings)
    count = iter(range(100))

    @cache
    def made(**options: float) -> Made:
        """A run; another one where this computer was so busy that it, not the rig, ended it."""
        for _ in range(5):
            found = once(**options)
            if not re.search(r"no measurement for|is 0\.[23]. s old|this computer", found.why):
                break
        return found

    def once(**options: float) -> Made:
        # Its watchdog is another test's: a busy computer holds a process up for longer.
        options = {"no_wd": 1, **options}
        with running(program, folder / str(next(count)), **options) as firmware, timely():
            clock, rows = MonotonicClock(), InMemorySink()
            link = PortLink(open_port(str(firmware.port), 921600), clock)
            report, refusal = None, ""
            try:
                report = run(procedure, link, clock, rows, UnattendedPrompts(True), StopRequest())
            except InputError as error:
                refusal = str(error)
            finally:
                link.close()
            return Made(report, refusal, rows, firmware.end())

    return made


def test_a_sound_rig_completes_and_nothing_is_found(drive):
    made = drive()
    assert made.report is not None, made.refusal
    assert made.report.completed, made.report.reason
    assert made.report.rested
    assert made.report.findings == ()
    log = made.rows.run()
    # The profile is at its top speed from 0.4 s on; the noise of its omega is 0.002 rad/s.
    top = (log.measured.time > 1.0) & (log.measured.time < 2.4)
    assert np.median(log.measured.omega[top]) == pytest.approx(np.radians(30), abs=0.01)
    assert log.online is not None
    assert set(log.online.rig_state.tolist()) <= {1, 2}


@pytest.mark.parametrize(
    ("options", "event", "said"),
    [  # no event where the run ends before its first tick, as nothing is recorded of it
        ({"spin_at": STRIKES}, Event.RUNAWAY, r"the wheel turns at 10 rad/s, commanded were"),
        ({"omul": 57.3}, Event.RUNAWAY, r"does the rig send deg/s"),
        ({"omul": -1}, Event.RUNAWAY, r"wired the other way round"),
        ({"xmul": -1}, Event.CARRIAGE_DEVIATES, r"the carriage went -.*other way round"),
        ({"xmul": 2}, Event.CARRIAGE_DEVIATES, r"is x_scale right"),
        ({"stuck_at": STRIKES}, Event.STAYS_STUCK, r"the scale is stuck"),
        ({"spin_arm": 1}, None, r"the wheel turns at 1.5 rad/s while it is to"),
        ({"zmul": 4}, None, r"gives zeta\(0\).*z_scale"),
    ],
)
def test_what_the_rig_measures_ends_the_run(drive, options, event, said):
    made = drive(**options)
    assert made.report is not None, made.refusal
    assert not made.report.completed
    assert re.search(said, made.report.reason), made.report.reason
    assert (made.rows.head is None) == (event is None)
    assert event is None or event in made.events


def test_a_runaway_wheel_is_stopped_at_once(drive):
    made = drive(spin_at=STRIKES)
    began, stopped = made.heard("first nonzero omega"), made.heard("ESTOP reason")
    assert stopped - began - STRIKES < 3 * 0.02 + BUSY


def test_zeta_goes_back_to_where_the_scale_was_sound(drive):
    made = drive(stuck_at=STRIKES)
    log = made.rows.run()
    online, z = log.online, log.measured.z
    assert online is not None
    assert z is not None
    frozen = log.measured.time[np.flatnonzero(np.diff(z) != 0)[-1] + 1]
    # zeta moves on every tick while the sand of this firmware is not DRFT's; one tick is allowed.
    after = online.zeta[online.time > frozen + 0.3]
    before = np.interp(frozen, online.time, online.zeta)
    assert np.ptp(after) == 0
    assert abs(after[0] - before) <= 2 * online.zeta_step


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (
            {"spin_boot": 1},
            r"(the wheel turns at 1.5 rad/s|carriage has gone .* mm) while it is to",
        ),
        ({"zsign": -1}, r"the sign of z_scale"),
    ],
)
def test_a_rig_that_is_wrong_before_the_start_is_refused(drive, options, said):
    made = drive(**options)
    assert made.report is None
    assert re.search(said, made.refusal), made.refusal
    assert "first nonzero omega" not in made.log


def test_readings_that_come_too_late_are_refused_before_the_wheel_turns(drive):
    made = drive(delay_ms=400)
    assert re.search(r"newest reading is .* s old|answers? (ARM|HELLO)", made.why), made.why
    assert "first nonzero omega" not in made.log


def test_a_wheel_that_ignores_stop_gets_an_emergency_stop_within_a_second(drive):
    made = drive(ignore_stop=1, spin_at=2.2)
    assert made.heard("ESTOP reason") - made.heard("first nonzero omega") < 2.2 + 1.0 + BUSY
