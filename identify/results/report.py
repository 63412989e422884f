"""The report page of a fit."""

from drftjax.common.rich_text import table_cells
from drftjax.recorded.observation import SHOWN
from drftjax.report_page.page import render_page
from drftjax.report_page.run_curves import CurveLabels, RunCurves, RunPanels, channel_panel
from identify.results.result import FitResult
from identify.results.values import RunFit


def page(result: FitResult, stem: str) -> str:
    """The report as one HTML page that refers to no other file.

    Args:
        result: The fit.
        stem: Name of its other files, without their endings.
    """
    profiles = [each.table() for each in result.profiles]
    curves = RunCurves(
        [_panels(result, run) for run in result.runs],
        CurveLabels(before="before the fit", after="fitted"),
    )
    return render_page(
        "identify.results",
        "fit.html",
        curves,
        count=len(result.runs),
        answer=answer(result),
        misfit=misfit_sentence(result),
        # The shared values stand in the answer.
        sentences=result.sentences()[len(result.shared) :],
        table=table_cells(result.table()),
        intervals=[table_cells(each) for each in (*profiles, *result.interval_tables())],
        stem=stem,
    )


def answer(result: FitResult) -> str:
    """The shared values and the end of the fit, in one or two sentences."""
    count = len(result.runs)
    runs = "one run" if count == 1 else f"{count} runs"
    values = ", ".join(map(str, result.shared.values()))
    found = f"Fitted to {runs}: {values}." if values else f"Fitted to {runs}, each on its own."
    ends = [run.status for run in result.runs]
    counted = ", ".join(f"{ends.count(end)} {end}" for end in dict.fromkeys(ends))
    return f"{found} Status: {result.status}" + f" (runs: {counted})" * (len(set(ends)) > 1) + "."


def misfit_sentence(result: FitResult) -> str:
    """RMS of simulated less recorded over all runs, before and after, by channel."""
    before, after = result.rmse(False), result.rmse()
    parts = (
        f"{channel} {before[channel] * scale:.3f} → {after[channel] * scale:.3f} {unit}"
        for channel in result.channels
        for unit, scale in [SHOWN[channel]]
    )
    return f"RMS of simulated less recorded over all runs: {', '.join(parts)}."


def _panels(result: FitResult, run: RunFit) -> RunPanels:
    """Panels of one run, sinkage first: it is what the sand's model is about."""
    panels = [
        channel_panel(
            channel,
            *SHOWN[channel],
            recorded=run.recorded[number],
            before=run.before[number] - run.recorded[number],
            after=run.after[number] - run.recorded[number],
            floor=result.floors.get(channel),
        )
        for number, channel in enumerate(run.channels)
    ]
    panels.sort(key=lambda panel: not panel.downward)
    return RunPanels(run.name, run.time, panels)
