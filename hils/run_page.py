"""Report page of a run in the loop: its outcome, and its curves to zoom."""

from collections.abc import Sequence

import numpy as np

from drftjax.report_page.page import render_page
from drftjax.report_page.run_curves import (
    CurveLabels,
    CurvePanel,
    RunCurves,
    RunPanels,
    channel_panel,
)
from drftjax.runlog.record import RunLog
from hils.run_figure import commanded_slip, readings_in_the_loop


def run_page(run: RunLog, name: str, outcome: Sequence[str]) -> str | None:
    """The report as one HTML page that refers to no other file.

    Args:
        run: The run.
        name: Of its run log.
        outcome: Its end, in lines as a terminal shows them.

    Returns:
        None for a run without a simulation beside it, as with the carriage free.
    """
    online, z = run.online, run.measured.z
    within = readings_in_the_loop(run)
    if online is None or z is None or not within.any():
        return None
    time = run.measured.time[within]
    error = np.interp(time, online.time, online.z_sim) - z[within]
    panels = [channel_panel("z", "mm", 1e3, z[within], None, error)]
    panels.append(CurvePanel("zeta", "-", None, None, np.interp(time, online.time, online.zeta)))
    slip = commanded_slip(run)
    if slip is not None:
        commanded = np.interp(time, run.command.time, slip)
        panels.append(CurvePanel("slip, commanded", "-", None, None, commanded))
    first, *others = outcome
    return render_page(
        "hils",
        "run.html",
        RunCurves([RunPanels(name, time, panels)], CurveLabels("HILS (real)", after="HILS (sim)")),
        title=run.title,
        first=first,
        others=others,
        name=name,
    )
