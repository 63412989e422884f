"""Results of the experiment, as tables in Markdown."""

from collections.abc import Iterable, Mapping

import numpy as np

from hils.experiment.experiment import PAPER_DRFT, PAPER_HILS, PAPER_RMSE, ExperimentResult, HilsRun
from hils.experiment.spectrum import order

MM = 1e3


def markdown_report(result: ExperimentResult, ticks: Mapping[float, HilsRun]) -> str:
    """Every table.

    Args:
        result: The experiment made.
        ticks: A run at each tick [s]; may be empty.
    """
    parts = [runs_table(result), trajectory_table(result), lines_table(result)]
    if ticks:
        parts.append(ticks_table(ticks))
    return "\n\n".join(parts) + "\n"


def runs_table(result: ExperimentResult) -> str:
    """One row for each HILS run."""
    rows = [
        (
            str(number),
            f"{MM * each.start.sinkage:.2f}",
            f"{each.start.zeta:.4f}",
            f"{each.zeta[-1]:.4f}",
            f"{MM * each.rmse:.3f}",
            f"{MM * np.abs(each.error).max():.3f}",
        )
        for number, each in enumerate(result.hils, start=1)
    ]
    close = sum(each.rmse < PAPER_RMSE for each in result.hils)
    head = ("run", "H at rest, mm", "ζ(0)", "ζ at the end", "RMSE of z, mm", "largest, mm")
    said = f"RMSE of z between HILS (sim) and HILS (real) under {MM * PAPER_RMSE:g} mm: "
    return f"{markdown_table(head, rows)}\n\n{said}{close} of {len(rows)}."


def trajectory_table(result: ExperimentResult) -> str:
    """Distances of the mean trajectories from the mean free one."""
    paper = {"HILS (sim)": PAPER_HILS, "DRFT": PAPER_DRFT}
    rows = [
        (
            name,
            *(f"{MM * value:.2f}" for value in found),
            f"{MM * paper[name]:.1f}" if name in paper else "-",
        )
        for name, found in result.distances().items()
    ]
    head = ("mean of", "in the plane, mm", "z(t), mm", "x(t), mm", "z(x), mm", "the paper's, mm")
    scatter = f"Free runs differ from each other by {MM * result.scatter():.2f} mm in z (sd)."
    return f"{markdown_table(head, rows)}\n\n{scatter}"


def lines_table(result: ExperimentResult) -> str:
    """The three strongest lines of each spectrum at the steady speed."""
    _, top = result.steady_stretch()
    rows = []
    for name, found in result.spectra().items():
        unit = (1.0, "") if name == "zeta" else (1e6, " µm")
        lines = [
            f"{line.frequency:.2f} Hz ({order(line.frequency, top):.1f}): "
            f"{unit[0] * line.amplitude:.3g}{unit[1]}"
            for line in found.lines()
        ]
        rows.append((name, *lines, *["-"] * (3 - len(lines))))
    return markdown_table(("of", "strongest line (order)", "second", "third"), rows)


def ticks_table(ticks: Mapping[float, HilsRun]) -> str:
    """RMSE by the tick."""
    rows = []
    for tick, each in ticks.items():
        rows.append(
            (
                f"{MM * tick:g}",
                f"{MM * each.rmse:.3f}",
                f"{MM * np.abs(each.error).max():.3f}",
                f"{each.zeta[-1]:.3f}",
            )
        )
    return markdown_table(("tick, ms", "RMSE of z, mm", "largest, mm", "ζ at the end"), rows)


def markdown_table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A table in Markdown."""
    head = tuple(head)
    lines = [head, ("---",) * len(head), *map(tuple, rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
