"""A series of runs on one rig: a file each, and the sand prepared between them."""

import os
import signal
import subprocess
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
import psutil

from drftjax.common.errors import InputError
from drftjax.common.output_files import require_folder
from drftjax.runlog.recording_lock import part_path, require_free
from hils.clock import MonotonicClock
from hils.control.stop_request import StopReason, StopRequest
from hils.events import Event
from hils.link.port_link import PortLink
from hils.link.ports import open_port
from hils.monitor.observer import with_live_view, without_observer
from hils.monitor.stream_address import StreamAddress
from hils.monitor.tick_stream import open_stream
from hils.procedure.active_runs import ActiveRun, registered
from hils.procedure.operator_prompts import AbstractPrompts, signs_of_life
from hils.procedure.procedure import Procedure, RunReport, run
from hils.realtime import timely
from hils.recording.recorder import Recorder

ENDED_EARLY = 1


INTERRUPTED = 128 + 2


class Series(NamedTuple):
    """Plan of a series of runs: the port, the files, and the preparation between them.

    Attributes:
        port: The rig's port.
        baud: Its baud rate.
        files: A run log for each run.
        between: Shell command that prepares the sand; None to ask the operator.
        fifo: True to ask the system for SCHED_FIFO.
        view: True to show the live view.
        plot: True to draw each run beside its run log, and to write its page.
        stream: Address to which each tick is streamed; None for no stream.
        clearing_time: Time that the command between runs, and all that it has started, may take
            to end when it is interrupted [s].
    """

    port: str
    baud: int
    files: list[Path]
    between: str | None
    fifo: bool
    view: bool = False
    plot: bool = False
    stream: StreamAddress | None = None
    clearing_time: float = 10.0


def file_names(output: Path, runs: int) -> list[Path]:
    """One name for each run: the name itself, or numbered ones. Their folder is made.

    Raises:
        InputError: where one of them is taken or does not end in .h5, or nothing can be written
            there.
    """
    if output.suffix != ".h5":
        raise InputError(f"{output}: a run log's name must end in .h5")
    digits = max(2, len(str(runs)))
    names = [output]
    if runs > 1:
        names = [
            output.with_name(f"{output.stem}-{each:0{digits}d}.h5") for each in range(1, runs + 1)
        ]
    for name in names:
        require_free(name)
    require_folder(output.parent)
    return names


def make_series(procedure: Procedure, series: Series, prompts: AbstractPrompts) -> int:
    """Make the runs, one after the other; the first that does not complete, in which a safety rule
    fired, or after which the rig is not seen to rest, ends them, and so does whoever asks for an
    end, between two runs as well.

    Returns:
        The exit code: 0 where all were completed, nothing was found, the rig rests and nobody asked
        for an end.

    Raises:
        InputError: a run could not be begun, or its file not be finished.
    """
    stop = StopRequest()
    with registered(series.port, series.files) as under_way, stop.on_signals():
        try:
            for number, path in enumerate(series.files):
                if number:
                    _prepare(series, number, prompts, stop)
                if len(series.files) > 1:
                    prompts.say(f"Run {number + 1} of {len(series.files)}: {path}")
                report = make_run(procedure, series, path, prompts, stop, under_way)
                lines = outcome_lines(report, path)
                for line in lines:
                    prompts.say(line)
                if series.plot and _is_run_log(path):
                    for line in (_draw_figure(path), _write_page(path, lines)):
                        prompts.say(line)
                if report.unfinished:
                    raise InputError(report.unfinished)
                request = report.stop_reason or stop.first_reason
                if request is not None:
                    return _exit_code(request)
                if not (report.completed and report.rested) or report.findings:
                    return ENDED_EARLY
                stop.uninterruptible = False
                if stop.first_reason is not None:  # it came just before it would have been raised
                    return _exit_code(stop.first_reason)
        except KeyboardInterrupt:
            if stop.first_reason is None or _exit_code(stop.first_reason) == INTERRUPTED:
                raise
            prompts.say(f"Ended: {stop.reason}.")
            return ENDED_EARLY
    return 0


def _exit_code(request: StopReason) -> int:
    interrupted = request.event is Event.INTERRUPTED and request.arg == signal.SIGINT
    return INTERRUPTED if interrupted else ENDED_EARLY


def make_run(
    procedure: Procedure,
    series: Series,
    path: Path,
    prompts: AbstractPrompts,
    stop: StopRequest,
    under_way: ActiveRun,
) -> RunReport:
    """Open the port, make a run, close everything."""
    with ExitStack() as opened:
        stream = opened.enter_context(open_stream(series.stream, prompts.say))
        # Before the port and before any priority: it must outlive the one and not have the other.
        with signs_of_life("Starting the recorder", prompts.say):
            recorder = Recorder(path)
        opened.callback(recorder.close, "not begun")
        clock = MonotonicClock()
        link = PortLink(open_port(series.port, series.baud), clock)
        opened.callback(link.close)
        rows = recorder if stream is None else stream.rows(recorder)
        seen = without_observer(rows, prompts)
        if series.view:
            seen = opened.enter_context(
                with_live_view(under_way, path, procedure, link, clock, rows, prompts, stop)
            )

        def before_motion() -> None:
            seen.begin()
            granted = opened.enter_context(timely(series.fifo))
            seen.prompts.say(f"Timing: {', '.join(granted)}.")

        return run(procedure, link, clock, seen.rows, seen.prompts, stop, before_motion)


def _prepare(series: Series, number: int, prompts: AbstractPrompts, stop: StopRequest) -> None:
    if series.between is None:
        prompts.confirm("Prepare the sand and bring the wheel back to its start")
        return
    prompts.say(f"Preparing the sand: {series.between}")
    made = {**os.environ, "DRFT_RUNS_MADE": str(number)}
    # An interrupt in the midst of its start would leave it running, known to nobody.
    stop.uninterruptible = True
    with subprocess.Popen(series.between, shell=True, env=made) as shell:
        try:
            stop.uninterruptible = False
            if stop.first_reason is not None:
                raise KeyboardInterrupt
            code = shell.wait()
        except BaseException:
            _end_process_tree(shell.pid, series.clearing_time)
            raise
    if code:
        raise InputError(
            f"the command between runs, {series.between!r}, left with code {code}; "
            f"{number} of {len(series.files)} runs are made"
        )


def _end_process_tree(pid: int, clearing_time: float) -> None:
    """End a process and all that it has started: what prepares the sand may be moving."""
    with suppress(psutil.NoSuchProcess):
        every = _suspend_all(psutil.Process(pid))
        for each in every:
            with suppress(psutil.NoSuchProcess):
                each.terminate()
                each.resume()
        try:
            psutil.wait_procs(every, timeout=clearing_time)
        finally:
            for each in every:
                with suppress(psutil.NoSuchProcess):
                    each.kill()


def _suspend_all(first: psutil.Process) -> list[psutil.Process]:
    """A process and all that it has started, suspended, so that none of them starts another."""
    held: list[psutil.Process] = []
    while new := [p for p in (first, *first.children(recursive=True)) if p not in held]:
        for each in new:
            with suppress(psutil.NoSuchProcess):
                each.suspend()
        held += new
    return held


def _is_run_log(path: Path) -> bool:
    """True where it is the run's log; beside its recording it is another file, put there since."""
    return path.exists() and not part_path(path).exists()


def _draw_figure(path: Path) -> str:
    """Draw the run; a sentence that says where, or why not."""
    from drftjax.common.figures import save_figure
    from drftjax.runlog.hdf5.api import read_run
    from hils.run_figure import plot_hils

    picture = path.with_suffix(".png")
    if picture.exists():
        return f"No picture was drawn: {picture} is already there."
    try:
        save_figure(plot_hils(read_run(path)), picture)
    except (InputError, OSError) as error:
        return f"No picture was drawn: {error}."
    return f"Picture: {picture}"


def _write_page(path: Path, outcome: list[str]) -> str:
    """Write the run's report page; a sentence that says where, or why not."""
    from drftjax.common.output_files import put_new_file
    from drftjax.runlog.hdf5.api import read_run
    from hils.run_page import run_page

    page = path.with_suffix(".html")
    if page.exists():
        return f"No page was written: {page} is already there."
    try:
        text = run_page(read_run(path), path.name, outcome)
        if text is None:
            return "No page was written: nothing was simulated beside this run."
        put_new_file(page, text.encode())
    except (InputError, OSError) as error:
        return f"No page was written: {error}."
    return f"Page: {page}"


def outcome_lines(report: RunReport, path: Path) -> list[str]:
    """A run's report in a few lines."""
    lines = [f"Ended early: {report.reason}."]
    if report.completed:
        lines = ["Completed, but not all was well:" if report.findings else "Completed."]
    reason = "" if report.completed else report.reason
    lines += [f"- {each}." for each in report.findings if each != reason]
    if report.completed and report.stop_reason is not None:
        lines.append(f"No further run: {report.stop_reason.reason}.")
    if not report.rested:
        lines.append("The rig was not seen to rest: make sure that it does.")
    loop, start = report.loop, report.start
    if loop is not None and start is not None:
        ticks, zeta = loop.statistics, loop.last.packed[1]
        if len(ticks.error):
            rmse, most = np.sqrt((ticks.error**2).mean()), np.abs(ticks.error).max()
            lines.append(
                f"zeta {start.zeta:.4f} to {zeta:.4f}; sinkage, measured minus simulated: "
                f"RMSE {rmse * 1e3:.3f} mm, at most {most * 1e3:.3f} mm."
            )
        lines.append(
            f"{ticks.ticks} ticks, {ticks.overruns} deadlines missed, {ticks.skipped} ticks "
            f"skipped; {ticks.fresh} fresh readings, {ticks.refused} refused; "
            f"{ticks.ticks - ticks.fresh} ticks without a reading."
        )
        if ticks.old:
            lines.append(
                f"{ticks.old} readings answered a command more than five ticks old, and zeta was "
                "held over them: something holds the line's bytes back."
            )
        if len(ticks.work_time):
            work, delay = ticks.work_time * 1e3, ticks.wake_delay * 1e3
            lines.append(
                f"A tick's work: median {np.median(work):.3f} ms, 99.9 % {_high(work):.3f} ms, "
                f"most {work.max():.3f} ms; woken late by {np.median(delay):.3f}, "
                f"{_high(delay):.3f}, {delay.max():.3f} ms."
            )
    quality = report.quality
    causes = ", ".join(f"{count} {cause.value}" for cause, count in quality.drops.items())
    lines.append(
        f"Link: {quality.sent} frames sent, {quality.received} received, "
        f"{quality.dropped} dropped{f' ({causes})' if causes else ''}, "
        f"{quality.replaced} commands replaced by newer ones."
    )
    if _is_run_log(path):
        lines.append(f"Run log: {path}")
    elif loop is not None and not loop.statistics.fresh:
        lines.append("No run log: no reading came during the profile.")
    return lines


def _high(values: np.ndarray) -> float:
    return float(np.percentile(values, 99.9))
