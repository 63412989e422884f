"""What a live view is told of a run, and what it draws of that: in virtual time."""

import functools
import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from rich.text import Text

from drftjax.setups.setup import CommandSetUp, IntegratorSetUp, SetUp, WheelSetUp
from drftjax.tuning.registry import TunerSetUp
from hils.control.limits import CommandLimits
from hils.control.loop_config import LoopSetUp
from hils.control.stop_request import EMERGENCY_SIGNAL, STOP_SIGNAL, StopRequest
from hils.events import Phase
from hils.monitor.dashboard import Dashboard, DashboardSettings, Point, plot
from hils.monitor.observer import RunInfo, RunObserver, with_live_view, without_observer
from hils.monitor.status import INTERVAL, WHOLE, RunStatus, StatusReader
from hils.monitor.view_process import StopKey
from hils.procedure.active_runs import ActiveRun
from hils.procedure.operator_prompts import AbstractPrompts
from hils.procedure.procedure import Procedure, run
from hils.recording.sinks import InMemorySink
from hils.rig_sim.config import VirtualSetUp
from hils.rig_sim.in_process import QUICK, soft_rig
from hils.rig_sim.sensors import Instruments
from hils.run_figure import plot_hils, sinkage_error
from tests.helpers.hils_runs import CLOSE

RADIUS = 0.150
PROFILE = CommandSetUp([0.0, 0.5, 1.5, 2.5, 3.0], [0, 0, 30, 30, 0], omega_unit="deg/s")
TICK = 0.01
# What statics says of this rig, to the last digit; a reading scatters by 22 um, and the wheel still
# settles by a hundredth of a millimetre [m].
STANDS, SETTLES = 0.0162, 1e-4
# A reading more or less in the second that is looked back on.
ONE = 1.5 * TICK


class Told(AbstractPrompts):
    """Keeps what it is told."""

    def __init__(self):
        self.lines: list[str] = []

    def say(self, text: str) -> None:
        self.lines.append(text)

    def say_if_free(self, text: str) -> None:
        self.lines.append(text)

    def confirm(self, text: str, meanwhile: Callable[[], None] = lambda: None) -> None:
        self.lines.append(text)

    def accept(self, doubt: str) -> bool:
        self.lines.append(doubt)
        return False

    def enter_phase(self, phase: Phase, lasts: float = math.nan) -> None:
        pass

    def show_sinkage(self, sinkage: float) -> None:
        pass


@functools.cache
def looked_on(free: bool = False, x_scale: float = Instruments().x_scale):
    """A run, the scenes that were told of it with their times, and the prompts behind the view."""
    setup = SetUp(
        command=PROFILE,
        wheel=WheelSetUp(plate_size=8e-3),
        integrator=IntegratorSetUp(step=2e-3),
    )
    loop = LoopSetUp(
        setup=setup, commands=CommandLimits(2.0, 0.3), tuner=TunerSetUp("step"), tick=TICK
    )
    scales = Instruments(x_scale=x_scale)
    soft = soft_rig(setup=VirtualSetUp(physics=QUICK, instruments=scales))
    kept, told, scenes, stop = InMemorySink(), Told(), [], StopRequest()
    observer = RunObserver(
        RunInfo("a run", "/dev/rig", "run.h5", 3.0, RADIUS),
        lambda scene: scenes.append((soft.clock.now(), scene)),
        soft.clock,
        soft.link.quality,
        stop,
    )
    run(
        Procedure(loop=loop, free=free, countdown=0.4),
        soft.link,
        soft.clock,
        observer.rows(kept),
        observer.prompts(told),
        stop,
        observer.begin,
    )
    return kept, scenes, told, observer


def test_phases_come_in_order():
    phases = [scene.phase for _, scene in looked_on()[1]]
    order = list(dict.fromkeys(phases))
    assert order == [
        Phase.CHECKING,
        Phase.SETTLING,
        Phase.COUNTDOWN,
        Phase.RUNNING,
        Phase.STOPPING,
        Phase.CLOSING,
    ], order


def test_loop_tells_ten_scenes_a_second_and_not_more():
    times = [time for time, scene in looked_on()[1] if scene.phase is Phase.RUNNING]
    gaps = np.diff(times)
    assert gaps.min() > INTERVAL - TICK / 2
    # The first tick that is so much later.
    assert gaps.max() < INTERVAL + 1.5 * TICK


def test_scenes_say_what_is_recorded():
    kept, scenes, _, _ = looked_on()
    log = kept.run()
    assert log.online is not None
    assert log.measured.z is not None
    running = [scene for _, scene in scenes if scene.phase is Phase.RUNNING and scene.time > 0.5]
    for scene in running:
        row = int(np.searchsorted(log.command.time, scene.time - TICK / 2))
        assert scene.omega == log.command.omega[row]
        assert scene.vx == log.command.vx[row]
        # The tick before has been recorded whole.
        tick = np.searchsorted(log.online.time, scene.time - 2.5 * TICK)
        assert scene.zeta == log.online.zeta[tick]
        assert scene.simulated == -log.online.z_sim[tick]
        assert -scene.real in log.measured.z
    assert running[-1].received == pytest.approx(1 / TICK, rel=ONE)
    assert {scene.dropped for scene in running} == {0}


def test_slip_is_of_the_commands_and_unknown_at_rest():
    scenes = [scene for _, scene in looked_on()[1] if scene.phase is Phase.RUNNING]
    assert all(scene.slip is None for scene in scenes if scene.time < 0.4)
    turning = [scene for scene in scenes if 1.0 < scene.time < 2.4]
    for scene in turning:
        assert scene.slip == pytest.approx(1 - scene.vx / (RADIUS * scene.omega))
    assert 0 < turning[-1].slip < 1


def test_measured_sinkage_is_shown_while_the_wheel_settles_and_the_countdown_goes_on():
    scenes = looked_on()[1]
    settling = [scene for _, scene in scenes if scene.phase is Phase.SETTLING]
    assert len(settling) > 15
    assert settling[-1].real == pytest.approx(STANDS, abs=SETTLES)
    counting = [(when, scene) for when, scene in scenes if scene.phase is Phase.COUNTDOWN]
    assert counting[-1][1].real == pytest.approx(STANDS, abs=SETTLES)
    first = counting[0][0]
    for when, scene in counting:
        assert scene.time == pytest.approx(when - first - 0.4)


def test_measured_sinkage_is_shown_where_x_is_not_measured():
    kept, scenes, _, _ = looked_on(x_scale=0.0)
    assert -scenes[-1][1].real in kept.run().measured.z


def test_free_run_shows_the_measured_sinkage_alone():
    kept, scenes, _, _ = looked_on(free=True)
    scenes = [scene for _, scene in scenes if scene.phase is Phase.RUNNING]
    assert -scenes[-1].real in kept.run().measured.z
    assert {(scene.simulated, scene.zeta, scene.slip) for scene in scenes} == {(None, None, None)}


def test_questions_come_before_the_view_and_what_is_told_meanwhile_is_told_later():
    _, scenes, told, observer = looked_on()
    questions = [line for line in told.lines if not line.startswith("Compiling")]
    assert [line.split()[0] for line in questions] == ["Hold", "Let"]
    later = observer.end()
    assert later[0].startswith("Armed")
    assert scenes[-1][1].words == later[-3:]


def test_view_tells_the_length_of_the_profile_and_the_run_log_of_this_run(monkeypatch, tmp_path):
    scenes: list[RunStatus] = []

    class Shown:
        def __init__(self, run):
            self.show, self.close = scenes.append, lambda: None

    monkeypatch.setattr("hils.monitor.observer.LiveView", Shown)
    setup = SetUp(command=CommandSetUp([2.0, 3.0, 5.0], [0.0, 0.5, 0.0]))
    procedure = Procedure(loop=LoopSetUp(setup=setup, commands=CommandLimits(2.0, 0.3)))
    soft, whole = soft_rig(), ActiveRun(1, "", "/dev/rig", "run-01.h5 to run-09.h5")
    given = procedure, soft.link, soft.clock, InMemorySink(), Told(), StopRequest()
    with with_live_view(whole, tmp_path / "run-03.h5", *given) as seen:
        seen.begin()
    assert scenes[0].duration == 3.0
    assert scenes[0].output.endswith("run-03.h5")


def test_without_a_view_rows_and_words_go_where_they_went():
    rows, told = InMemorySink(), Told()
    seen = without_observer(rows, told)
    assert (seen.rows, seen.prompts) == (rows, told)


# Scenes over a pipe -------------------------------------------------------------------------------


def test_scenes_survive_any_cutting_of_the_bytes():
    sent = [RunStatus(phase=Phase.RUNNING, time=each / 7, words=["é…"]) for each in range(20)]
    data = b"".join(scene.line() for scene in sent) + b"no scene\n" + sent[0].line()
    for size in (1, 7, 1000):
        scenes = StatusReader()
        pieces = (data[start : start + size] for start in range(0, len(data), size))
        assert [scene for piece in pieces for scene in scenes.feed(piece)] == [*sent, sent[0]]


def test_no_scene_is_longer_than_a_pipe_takes_whole():
    long = RunStatus(title="\x01" * 3000, words=["ab" * 3000])
    assert len(long.line()) <= WHOLE
    assert StatusReader().feed(long.line())[0].phase is Phase.CHECKING


# The picture --------------------------------------------------------------------------------------


def drawn(dashboard: Dashboard, width: int, height: int) -> list[str]:
    """The picture as lines of text, as rich draws it into such a window."""
    console = Console(width=width, height=height, force_terminal=True, legacy_windows=False)
    with console.capture() as capture:
        console.print(dashboard, end="")
    return capture.get().split("\n")


def picture(now: float = 10.0, keys: bool = True, **changes) -> Dashboard:
    dashboard = Dashboard(keys, lambda: now)
    for each in range(100):
        time = each * INTERVAL
        dashboard.add(
            RunStatus(
                phase=Phase.RUNNING,
                time=time,
                duration=24.0,
                real=0.016 + 1e-3 * math.sin(time),
                simulated=0.0155,
                zeta=0.7823,
                slip=0.123,
                latest=2.5e-3,
                missed=3,
                words=["Armed. The wheel settles."],
                **changes,
            ),
            time,
        )
    return dashboard


def text(lines: list[str]) -> str:
    return Text.from_ansi("\n".join(lines)).plain


def test_picture_says_the_numbers_and_the_keys():
    said = text(drawn(picture(), 100, 30))
    for each in ("RUNNING", "H_sim 15.50 mm", "zeta 0.7823", "slip 0.123", "late at most 2.50 ms"):
        assert each in said
    assert "deadlines missed 3" in said
    assert "press S or SPACE" in said
    assert "EMERGENCY STOP" in said
    assert "said nothing" not in said


def test_picture_says_that_news_stopped_and_that_keys_cannot_be_read():
    said = text(drawn(picture(now=15.0, keys=False), 100, 30))
    assert "has said nothing for 5 s" in said
    assert "drft hils stop" in said


def test_silence_and_plot_are_shown_by_the_numbers_that_are_set():
    status, late = RunStatus(phase=Phase.RUNNING, time=1.0, real=0.016), lambda: 15.0
    for settings, plotted in [
        (DashboardSettings(silent_time=20.0), True),
        (DashboardSettings(silent_time=20.0, min_plot=40, max_plot=40), False),
    ]:
        dashboard = Dashboard(keys=True, clock=late, settings=settings)
        dashboard.add(status, 10.0)
        words = text(drawn(dashboard, 100, 30))
        assert "said nothing" not in words
        assert ("sinkage [mm]" in words) == plotted


@pytest.mark.parametrize("width", [20, 40, 79, 200])
@pytest.mark.parametrize("height", [4, 8, 13, 24, 70])
def test_picture_fits_any_window_and_keeps_the_stop_key(width, height):
    lines = drawn(picture(stopping=""), width, height)
    assert len(lines) <= height
    assert max(map(len, text(lines).split("\n"))) <= width
    assert "STOP" in text(lines)


def test_deeper_is_drawn_lower_and_later_further_right():
    points = [Point(each * INTERVAL, 0.010 + each * 1e-4, math.nan) for each in range(60)]
    lines = [line.plain for line in plot(points, 38, 5)]
    dots = [[place for place, each in enumerate(line[8:]) if "⠀" < each <= "⣿"] for line in lines]
    assert len(lines) == 5
    assert all(dots)
    assert dots == sorted(dots)
    assert float(lines[0].split()[0]) < float(lines[-1].split()[0])


def test_hostile_words_give_the_terminal_no_orders():
    scenes, stop = [], StopRequest()
    clock = soft_rig(setup=VirtualSetUp(physics=QUICK)).clock
    quality = soft_rig(setup=VirtualSetUp(physics=QUICK)).link.quality
    observer = RunObserver(
        RunInfo("\x1b[2J", "p", "o", 3.0, 0.1), scenes.append, clock, quality, stop
    )
    observer.begin()
    observer.on_message("\x1b]0;title\x07 and\nmore")
    dashboard = Dashboard(keys=True, clock=lambda: 0.0)
    dashboard.add(scenes[-1], 0.0)
    escapes = re.findall("\x1b[^m]{0,12}.", "".join(drawn(dashboard, 100, 30)))
    assert all(re.match("\x1b\\[[0-9;]*m", each) for each in escapes)


# Keys ---------------------------------------------------------------------------------------------


def test_keys():
    for typed in (b"s", b"S", b" ", b"q"):
        assert StopKey().press(typed) == [STOP_SIGNAL]
    assert StopKey().press(b"e") == [EMERGENCY_SIGNAL]
    assert StopKey().press(b"xyz\n\x1b[A\x1bOS\x1b[15~\x1b[1;5E") == []


def test_stop_that_was_asked_for_can_become_an_emergency_but_not_by_the_same_key():
    key = StopKey()
    assert key.press(b"ss") + key.press(b" ") == [STOP_SIGNAL]
    assert key.press(b"e") == [EMERGENCY_SIGNAL]


# The picture at the end ---------------------------------------------------------------------------


def test_figure_has_sinkage_error_zeta_slip_and_lateness(tmp_path):
    log = looked_on()[0].run()
    figure = plot_hils(log)
    sinkage, error, *others = [axes.get_ylabel() for axes in figure.axes]
    assert (sinkage, error) == ("sinkage [mm],\ndownward", "sim - real [mm],\ndownward")
    assert others == ["zeta [-]", "slip, commanded [-]", "lateness [ms]"]
    real, simulated = figure.axes[0].get_lines()
    np.testing.assert_allclose(real.get_ydata(), -log.measured.z * 1e3)
    np.testing.assert_allclose(simulated.get_ydata(), -log.online.z_sim * 1e3)
    figure.savefig(Path(tmp_path) / "run.png")


def test_sinkage_error_is_measured_minus_simulated():
    log = looked_on()[0].run()
    error = sinkage_error(log)
    assert 0 < np.sqrt((error**2).mean()) < CLOSE
    row = 150
    within = log.measured.time >= log.online.time[0]
    expected = -log.measured.z[within][row] + np.interp(
        log.measured.time[within][row], log.online.time, log.online.z_sim
    )
    assert error[row] == pytest.approx(expected)


def test_free_run_is_drawn_as_any_run():
    figure = plot_hils(looked_on(free=True)[0].run())
    assert "sinkage [mm],\ndownward" in [axes.get_ylabel() for axes in figure.axes]
