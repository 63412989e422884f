"""Tables of a cross-check."""

from typing import TYPE_CHECKING

from rich.markup import escape

if TYPE_CHECKING:
    from drftjax.common.rich_text import WholeWordTable
    from identify.crosscheck.comparison import Comparison
    from identify.crosscheck.crosscheck import CrossCheck
    from identify.crosscheck.replays import TunerSetting

MM = 1e3


# Tables -------------------------------------------------------------------------------------------


def tables(result: "CrossCheck") -> "list[WholeWordTable]":
    """Tables of a cross-check: both zetas of each run, ticks, sweep, and the truth if known."""
    made = [_beside(result), _ticks(result)]
    if any(run.truth is not None for run in result.runs):
        made.append(_truth(result))
    if any(run.sweep for run in result.runs):
        made.append(_sweep(result))
    return made


def _table(title: str, *columns: str) -> "WholeWordTable":
    from drftjax.common.rich_text import WholeWordTable

    table = WholeWordTable(title=title, title_justify="left")
    first, *numbers = columns
    table.add_column(escape(first))
    for name in numbers:
        # Units below, and only names of runs fold: all columns are whole in 80 characters.
        table.add_column(escape(name.replace(" [", "\n[")), justify="right")
    return table


def _number(value: float | None, places: int) -> str:
    return "-" if value is None else f"{value:.{places}f}"


def _likeness(each: "Comparison") -> list[str]:
    return [
        _number(each.difference, 4),
        _number(each.lag, 2),
        _number(each.ripple, 4),
        _number(each.ripple_frequency, 2),
    ]


def _beside(result: "CrossCheck") -> "WholeWordTable":
    table = _table(
        "online tuner beside offline zeta(t)",
        *("run", "tuner", "difference", "lag [s]", "ripple", "at [Hz]"),
        *("z by it [mm]", "offline [mm]"),
    )
    for run in result.runs:
        z = [_number(run.rmse[which]["z"] * MM, 3) for which in ("tuner", "offline")]
        table.add_row(escape(run.name), "replayed", *_likeness(run.tuner), *z)
        if run.online is not None:
            table.add_row(escape(run.name), "logged", *_likeness(run.online), "-", z[1])
    return table


def _ticks(result: "CrossCheck") -> "WholeWordTable":
    limit = result.setting.zeta_step / result.setting.tick
    table = _table(
        f"ticks of {result.setting.tick * MM:g} ms; slew limit {limit:.3g} /s",
        *("run", "up [%]", "down [%]", "idle [%]", "slew limit [%]", "dead band [%]"),
    )
    for run in result.runs:
        each = run.tuner
        shares = (each.up, each.down, each.idle, each.slew_limit, each.dead_band)
        table.add_row(escape(run.name), *(f"{100 * share:.1f}" for share in shares))
    return table


def _truth(result: "CrossCheck") -> "WholeWordTable":
    table = _table("against the true zeta(t), RMS", "run", "tuner", "offline", "closer")
    for run in result.runs:
        far = (run.tuner.from_truth, run.offline_from_truth)
        table.add_row(escape(run.name), *(_number(value, 5) for value in far), run.closer or "-")
    return table


def _sweep(result: "CrossCheck") -> "WholeWordTable":
    import numpy as np

    table = _table(
        "one factor at a time, mean over the runs",
        *("varied", "difference", "lag [s]", "ripple", "slew limit [%]", "dead band [%]"),
    )
    groups: dict[str, list[Comparison]] = {}
    for run in result.runs:
        for row in run.sweep:
            groups.setdefault(_varied(row.setting, result.setting), []).append(row.comparison)
    for number, (varied, found) in enumerate(groups.items()):
        lags = [each.lag for each in found if each.lag is not None]
        table.add_row(
            varied,
            f"{np.mean([each.difference for each in found]):.4f}",
            f"{np.mean(lags):.2f}" if lags else "-",
            f"{np.mean([each.ripple for each in found]):.4f}",
            f"{100 * np.mean([each.slew_limit for each in found]):.1f}",
            f"{100 * np.mean([each.dead_band for each in found]):.1f}",
            end_section=number in (0, 4, 8),
        )
    return table


def _varied(setting: "TunerSetting", base: "TunerSetting") -> str:
    """Numbers in which a setting differs from the one asked for."""
    if setting.tick != base.tick:
        return f"tick {setting.tick * MM:g} ms"
    if setting.zeta_step != base.zeta_step:
        return f"zeta step {setting.zeta_step:g}"
    if setting.tolerance != base.tolerance:
        return f"tolerance {setting.tolerance * MM:g} mm"
    return "as asked"
