"""An evaluation told: a table of the gaps, and sentences."""

from rich.markup import escape
from rich.table import Table

from diagnose.evaluation import Evaluation
from identify.result import SHOWN


def sentences(found: Evaluation) -> list[str]:
    """What the numbers rest on."""
    names = ", ".join(each.about.name for each in found.effects)
    if not names:
        return ["The model has no effect: it is the reference model.", *found.notes]
    return [
        f"before: the reference model; after: with {names}. zeta is each run's own, and all else "
        "what its log believes.",
        *found.notes,
    ]


def gap_table(found: Evaluation) -> Table:
    """The gap of every run and of all, before and after."""
    table = Table()
    table.add_column("run")
    table.add_column("zeta", justify="right")
    channels = found.case.channels
    for channel in channels:
        table.add_column(escape(f"{channel} [{SHOWN[channel][0]}]"), justify="right")
    for run, each in enumerate(found.case.candidates):
        cells = found.rmse(run)
        first, last = found.zeta(run)
        table.add_row(
            escape(each.name),
            f"{first:.4f} → {last:.4f}",
            *(_pair(channel, *cells[channel]) if channel in cells else "-" for channel in channels),
        )
    table.add_section()
    gaps = [found.gap[channel] for channel in channels]
    pairs = zip(channels, gaps, strict=True)
    table.add_row("all runs", "", *(_pair(c, gap.before, gap.after) for c, gap in pairs))
    scaled = [f"{SHOWN[c][1] * found.floors[c]:.3f}" for c in channels]
    table.add_row("noise floor", "", *scaled)
    floors = [f"{gap.before / gap.floor:.1f} → {gap.after / gap.floor:.1f}" for gap in gaps]
    table.add_row("in floors", "", *floors)
    return table


def _pair(channel: str, before: float, after: float) -> str:
    scale = SHOWN[channel][1]
    return f"{scale * before:.3f} → {scale * after:.3f}"
