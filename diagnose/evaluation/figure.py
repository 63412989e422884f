"""Figure of an evaluation: runs beside the reference model and the model with effects."""

from typing import Final

from matplotlib.figure import Figure

from diagnose.evaluation.result import Evaluation
from drftjax.recorded.observation import SHOWN
from drftjax.results.comparison_figure import ComparedChannel, comparison_figure

MOST_RUNS: Final = 12
"""Runs that are drawn, at most."""


def evaluation_figure(found: Evaluation) -> Figure:
    """Recorded and simulated channels of each run (the first twelve), above their residuals."""
    dataset = found.dataset
    runs = dataset.runs[:MOST_RUNS]
    compared = []
    for run, each in enumerate(runs):
        recorded, gaps = dataset.recording(run), found.rmse(run)
        for place, channel in enumerate(dataset.channels):
            if channel not in gaps:
                continue
            simulated = {"reference model": found.before[run].residual[place]}
            if found.effects:
                simulated["with the effects"] = found.after[run].residual[place]
            unit, scale = SHOWN[channel]
            before, after = (scale * gap for gap in gaps[channel])
            title = f"{each.name}  RMSE {before:.3f} → {after:.3f} {unit}"
            compared.append(
                ComparedChannel(
                    title,
                    channel,
                    dataset.logged_time(run),
                    recorded[place],
                    {name: recorded[place] + residual for name, residual in simulated.items()},
                    found.floors[channel],
                )
            )
    more = f" ({len(runs)} shown)" if len(runs) < len(dataset.runs) else ""
    effects = ", ".join(each.about.name for each in found.effects) or "no effect"
    return comparison_figure(compared, f"evaluation of {len(dataset.runs)} runs{more}  {effects}")
