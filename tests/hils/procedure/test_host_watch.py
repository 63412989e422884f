"""The host's share in an early end: a pause between commands, and sleep; and a rig's clock."""

import itertools

import numpy as np
import pytest

import hils.clock
from drftjax.common.figures import save_figure
from hils.clock import time_suspended
from hils.control.stop_request import StopReason
from hils.events import Event
from hils.procedure import host_watch
from hils.rig_sim.faults import Fault, LostFrames, Window
from hils.run_figure import count_ticks, plot_hils
from hils.series import outcome_lines
from tests.helpers.fault_matrix import WATCHDOG, struck
from tests.helpers.hils_runs import BEFORE, START, TICK, LoggedLink, make
from tests.helpers.replayable_run import record_run

# Sums of the virtual clock's grains [s].
CLOCK = 1e-6
# The clock of a link's arrivals is read once a millisecond [s].
GRAIN = 2e-3
LATE = 0.2


def sleeping(monkeypatch, seconds: float) -> None:
    """Let this computer have slept for so long between the first look and the second."""
    clocks = itertools.chain([7.0], itertools.repeat(7.0 + seconds))
    monkeypatch.setattr(host_watch, "time_suspended", lambda: next(clocks))


# A pause between commands -------------------------------------------------------------------------


def test_a_watchdog_stop_names_the_hosts_pause_and_a_remedy():
    made = make(at=2.0, late=LATE)
    head, _, share = made.report.reason.partition("; ")
    assert head == "the rig went SAFE, reason 1 (watchdog: no valid command in time)"
    # The last command came a tick before the one that was late.
    assert share.startswith(f"this computer sent no command for {TICK + LATE:.2f} s (the rig's")
    assert "watchdog is 0.05 s): close other programs, or allow SCHED_FIFO" in share
    assert made.rows.end_reason == made.report.reason


def test_a_watchdog_stop_without_a_pause_blames_the_line():
    lost = Fault(LostFrames(towards="rig", rate=1.0), Window("motion", 0.5))
    reason = struck((lost,)).report.reason
    assert f"0.02 s apart at most (the rig's watchdog is {WATCHDOG:g} s): the line" in reason


def test_an_end_that_was_asked_for_is_not_explained():
    def ask(stop, link):
        stop.ask(StopReason("stopped by the operator", Event.STOP_ASKED))

    assert make(cue=ask, at=1.0).report.reason == "stopped by the operator"


def test_a_completed_run_is_just_completed():
    made = make()
    assert made.report.reason == "completed"
    assert made.report.completed
    assert not made.events(Event.HOST_SLEPT)
    assert not made.events(Event.RIG_CLOCK_JUMPED)


# Sleep --------------------------------------------------------------------------------------------


def test_time_asleep_is_what_the_clock_since_the_boot_is_ahead(monkeypatch):
    clocks = {hils.clock.time.CLOCK_BOOTTIME: 112.5, hils.clock.time.CLOCK_MONOTONIC: 100.0}
    monkeypatch.setattr("hils.clock.time.clock_gettime", clocks.__getitem__)
    assert time_suspended() == 12.5


def test_time_asleep_is_none_where_the_system_has_no_such_clock(monkeypatch):
    monkeypatch.delattr("hils.clock.time.CLOCK_BOOTTIME")
    assert time_suspended() == 0.0


def test_sleep_that_let_the_watchdog_bite_is_the_reason(monkeypatch):
    sleeping(monkeypatch, 12.3)
    made = make(at=2.0, late=LATE)
    assert "; this computer slept for 12.3 s meanwhile" in made.report.reason
    assert made.events(Event.HOST_SLEPT) == pytest.approx([12.3])


def test_sleep_that_did_no_harm_is_an_event(monkeypatch):
    sleeping(monkeypatch, 12.3)
    made = make()
    assert made.report.reason == "completed"
    assert made.events(Event.HOST_SLEPT) == pytest.approx([12.3])


def test_two_clocks_read_one_after_the_other_are_no_sleep(monkeypatch):
    sleeping(monkeypatch, 0.05)
    assert not make().events(Event.HOST_SLEPT)


# A rig's clock ------------------------------------------------------------------------------------


class Resetting(LoggedLink):
    """A rig whose clock is set by so much in the midst of the profile [us]."""

    jump_us = -3_000_000

    def newest(self):
        arrival = super().newest()
        if arrival is None or arrival.time < START + BEFORE + 2.0:
            return arrival
        t_us = (arrival.frame.t_us + self.jump_us) % 2**32
        return arrival._replace(frame=arrival.frame._replace(t_us=t_us))


class Leaping(Resetting):
    jump_us = 600_000


class Drifting(Resetting):
    jump_us = 400_000


@pytest.mark.parametrize("link", [Resetting, Leaping])
def test_a_clock_of_the_rig_that_jumps_is_an_event_with_the_jump(link):
    made = make(link=link)
    assert made.report.completed
    (jump,) = made.events(Event.RIG_CLOCK_JUMPED)
    assert jump == pytest.approx(link.jump_us * 1e-6, abs=GRAIN)
    steps = np.diff([row.rig_time for row in made.rows.ticks])
    strange = steps[np.abs(steps) > 3 * TICK]
    assert strange == pytest.approx([jump + TICK], abs=GRAIN)


def test_a_small_step_of_the_rigs_clock_is_none():
    assert not make(link=Drifting).events(Event.RIG_CLOCK_JUMPED)


class Wrapping(Resetting):
    """The clock on the wire wraps during the run."""

    jump_us = 0

    def newest(self):
        arrival = super(Resetting, self).newest()
        if arrival is None:
            return None
        t_us = (arrival.frame.t_us + 2**32 - 5_000_000) % 2**32
        return arrival._replace(frame=arrival.frame._replace(t_us=t_us))


def test_a_clock_that_wraps_on_the_wire_is_no_jump():
    made = make(link=Wrapping)
    assert not made.events(Event.RIG_CLOCK_JUMPED)
    assert np.diff([row.rig_time for row in made.rows.ticks]).max() < 3 * TICK


# Missing readings ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def lossy(tmp_path_factory):
    """A run with lost frames and skipped ticks."""
    return record_run(tmp_path_factory.mktemp("lossy") / "run.h5", busy_at=(6.5, 7.0))


def test_missing_readings_are_counted_from_the_run_log(lossy):
    counts = count_ticks(lossy)
    # Each fresh reading is a row; so a tick without one is a row of /online more.
    assert counts.without_reading == lossy.online.time.size - lossy.measured.time.size > 0
    numbers = np.rint(lossy.online.time / TICK)
    assert counts.skipped == numbers[-1] + 1 - numbers.size > 0
    assert counts.missed >= counts.skipped


def test_terminal_and_picture_count_alike(tmp_path):
    made = make(at=2.0, late=0.0345)
    statistics, counts = made.report.loop.statistics, count_ticks(made.rows.run())
    assert counts == (
        statistics.ticks,
        statistics.overruns,
        statistics.skipped,
        statistics.ticks - statistics.fresh,
    )
    said = " ".join(outcome_lines(made.report, tmp_path / "run.h5"))
    assert f"; {counts.without_reading} ticks without a reading." in said
    figure = plot_hils(made.rows.run())
    labels = [each.get_text() for each in figure.axes[-1].get_legend().get_texts()]
    assert f"without a reading ({counts.without_reading} of {counts.ticks} ticks)" in labels
    assert f"over the deadline ({counts.missed} in {counts.ticks} ticks)" in labels
    save_figure(figure, tmp_path / "run.png")
