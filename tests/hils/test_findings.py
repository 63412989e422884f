"""A run in which a safety rule fired says so everywhere: report, picture, run log, live view."""

from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from drftjax.runlog.summary import show
from drftjax.setups.setup import CommandSetUp, IntegratorSetUp, SetUp, WheelSetUp
from hils.clock import VirtualClock
from hils.control.limits import CommandLimits
from hils.control.loop_config import LoopSetUp
from hils.control.stop_request import StopRequest
from hils.events import Event, TickFlag
from hils.link.link import LinkQuality
from hils.monitor.observer import RunInfo, RunObserver
from hils.procedure.operator_prompts import UnattendedPrompts
from hils.procedure.procedure import Procedure, run
from hils.recording.sinks import InMemorySink
from hils.rig_sim.config import PhysicsSetUp, VirtualSetUp
from hils.rig_sim.in_process import soft_rig
from hils.run_figure import plot_hils
from hils.series import outcome_lines
from tests.helpers.fault_matrix import FAULTS, Cell, cell

QUIET = LinkQuality(0.0, 0, 0, 0, 0, 0, 0.0, {}, None, None)


@pytest.fixture(scope="module")
def stuck() -> Cell:
    return cell(FAULTS["stuck scale"][0], "steady")


def test_the_report_and_the_picture_say_so(stuck):
    assert stuck.report is not None
    first, second, *_ = outcome_lines(stuck.report, Path("run.h5"))
    assert first == "Completed, but not all was well:"
    assert second.startswith("- z did not change while the wheel turned, from ")
    title = plot_hils(stuck.rows.run()).get_suptitle()
    assert title.endswith("not all was well: sensor stuck")
    sound = cell(None)
    assert sound.report is not None
    assert outcome_lines(sound.report, Path("run.h5"))[0] == "Completed."
    assert "not all" not in plot_hils(sound.rows.run()).get_suptitle()


def test_the_run_log_lists_its_events_and_its_held_ticks(stuck):
    log = stuck.rows.run()
    console = Console(width=100)
    with console.capture() as shown:
        console.print(show("run.h5", log))
    assert " s: sensor_stuck (" in shown.get()
    assert " s: armed" in shown.get()
    assert log.online is not None
    flags = log.online.flags
    # z stands still for 0.3 s, and is stuck after 0.2 s of it: five ticks of 20 ms.
    stood = (flags & TickFlag.STUCK) != 0
    assert 4 <= stood.sum() <= 7
    fresh = (flags & TickFlag.FRESH) != 0
    assert (flags[stood & fresh] & TickFlag.HELD).mean() > 0.7  # the flag is of the tick before


def test_the_live_view_says_so():
    shown = []
    about = RunInfo("title", "port", "run.h5", 3.0, 0.15)
    observer = RunObserver(about, shown.append, VirtualClock(), lambda: QUIET, StopRequest())
    rows = observer.rows(InMemorySink())
    observer.begin()
    rows.event(1.0, Event.RUNAWAY, 10.0)
    assert shown[-1].words == ["runaway (10)"]


def test_beside_a_wheel_that_stands_for_a_minute_zeta_does_not_move():
    """A scale that drifts by 0.6 mm in that time would let eq. 7 step thousands of times."""
    setup = SetUp(
        command=CommandSetUp([0, 60, 60.5, 62], [0, 0, 30, 30], omega_unit="deg/s"),
        wheel=WheelSetUp(plate_size=0.01),
        integrator=IntegratorSetUp(step=0.01),
    )
    loop = LoopSetUp(setup=setup, commands=CommandLimits(2.0, 0.3), tick=0.05)
    drift = {"name": "sinkage_drift", "rate": -1e-5}
    rig = VirtualSetUp(effects=[drift], physics=PhysicsSetUp(step=2.5e-3, plate_size=0.01))
    soft, rows = soft_rig(rig, grain=2e-3), InMemorySink()
    prompts = UnattendedPrompts(quiet=True)
    report = run(
        Procedure(loop=loop, countdown=0.1), soft.link, soft.clock, rows, prompts, StopRequest()
    )
    assert report.completed, report.reason
    online = rows.run().online
    assert online is not None
    stands = online.time < 60.0
    assert np.ptp(online.zeta[stands]) == 0
    assert np.ptp(online.zeta) > 0.01
