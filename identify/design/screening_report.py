"""Table, figure and file of a global sensitivity."""

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from drftjax.common.rich_text import WholeWordTable
    from identify.design.number_ranges import NumberRange
    from identify.design.screening import GlobalSensitivity

SCREENING_SCHEMA = "drft-screening"

# Numbers in the table of a terminal; the figure and the file have all.
TABLE_ROWS = 20

# Smallest change in the figure, in noise: a hundred times less than can be seen of one reading.
SMALLEST_SHOWN = 1e-2

# Change in the table below which it is a rounding or nothing, in noise.
SMALLEST_TOLD = 1e-3


def screening_table(result: "GlobalSensitivity") -> "WholeWordTable":
    """Return the numbers of largest effect with their ranges and changes by channel."""
    from drftjax.common.rich_text import WholeWordTable

    table = WholeWordTable(
        title="largest changes across the range, in noise: mean ± 95 % interval (spread)",
        caption="spread: by the other numbers' values and the place in the range",
    )
    table.add_column("number")
    table.add_column("range")
    for channel in result.channels:
        table.add_column(f"{channel} ({_noise(result, channel)})", justify="right")
    effects = result.effects
    for index in result.order[:TABLE_ROWS]:
        cells = [
            _change(*(float(each[index, place]) for each in statistics))
            for place in range(len(result.channels))
            for statistics in [(effects.mean_size, effects.interval, effects.spread)]
        ]
        each = result.ranges[index]
        table.add_row(each.quantity.label, range_text(each), *cells)
    return table


def _change(size: float, interval: float, spread: float) -> str:
    if not math.isfinite(size):
        return "-"
    if size < SMALLEST_TOLD:
        return "0" if size == 0 else f"< {SMALLEST_TOLD:g}"
    return f"{_digits(size, 3)} ± {_digits(interval, 2)} ({_digits(spread, 2)})"


def _digits(value: float, digits: int) -> str:
    """A number of so many digits without an exponent; one that rounds to nothing is 0."""
    import numpy as np

    if value < SMALLEST_TOLD:
        return "0"
    return np.format_float_positional(value, precision=digits, fractional=False, trim="-")


def range_text(each: "NumberRange") -> str:
    """A range with its unit, such as "0 to 0.1 s"."""
    unit = "" if each.quantity.unit == "-" else f" {each.quantity.unit}"
    return f"{each.low:.4g} to {each.high:.4g}{unit}"


def _noise(result: "GlobalSensitivity", channel: str) -> str:
    """Noise of a channel in the unit of reports, such as "0.02 mm"."""
    from drftjax.recorded.observation import SHOWN

    unit, factor = SHOWN[channel]
    return f"{result.noise[channel] * factor:.3g} {unit}"


def plot_screening(result: "GlobalSensitivity") -> "Figure":
    """Plot the change that each number makes, in noise, a panel for each channel."""
    from matplotlib.figure import Figure

    count = len(result.ranges)
    figure = Figure(
        figsize=(4.0 + 2.6 * len(result.channels), 1.6 + 0.17 * count), layout="constrained"
    )
    panels = figure.subplots(1, len(result.channels), sharey=True, squeeze=False)[0]
    for place, (axes, channel) in enumerate(zip(panels, result.channels, strict=True)):
        _draw_channel(axes, result, place)
        axes.set_title(f"{channel}: noise {_noise(result, channel)}", fontsize=9)
        axes.set_xlabel("change across the range, in noise [-]", fontsize=8)
    first = panels[0]
    names = [
        f"{each.quantity.label}   {range_text(each)}"
        for each in (result.ranges[index] for index in result.order)
    ]
    first.set_yticks(range(count), names, fontsize=7)
    first.set_ylim(count - 0.4, -0.6)
    handles, labels = first.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=7)
    figure.suptitle(f"{result.title}: which numbers can matter", fontsize=10, parse_math=False)
    return figure


def _draw_channel(axes: "Axes", result: "GlobalSensitivity", place: int) -> None:
    import numpy as np

    order = result.order
    effects = result.effects
    size, interval, spread = (
        np.nan_to_num(each[order, place])
        for each in (effects.mean_size, effects.interval, effects.spread)
    )
    rows = np.arange(len(order))
    axes.set_xscale("log")
    matters = size + interval >= 1
    for chosen, colour, name in (
        (matters, "C0", "mean change that reaches the noise"),
        (~matters, "0.75", "mean change below the noise"),
    ):
        width = np.maximum(size - SMALLEST_SHOWN, 0)[chosen]
        axes.barh(rows[chosen], width, left=SMALLEST_SHOWN, color=colour, height=0.7, label=name)
    seen = size + interval > SMALLEST_SHOWN
    low = np.minimum(interval, np.maximum(size - SMALLEST_SHOWN, 0))
    axes.errorbar(
        size[seen],
        rows[seen],
        xerr=[low[seen], interval[seen]],
        fmt="none",
        ecolor="0.2",
        elinewidth=0.8,
        label="95 % interval",
    )
    some = spread > SMALLEST_SHOWN
    label = "spread by the other numbers"
    axes.plot(spread[some], rows[some], "o", mfc="none", mec="C1", ms=3, label=label)
    axes.axvline(1, color="C3", lw=1, label="noise of one reading")
    most = max(10.0, float((size + interval).max(initial=0)), float(spread.max(initial=0)))
    axes.set_xlim(SMALLEST_SHOWN, 2 * most)
    axes.grid(axis="x", color="0.9", lw=0.5)
    axes.set_axisbelow(True)
    axes.tick_params(axis="x", labelsize=8)


def screening_document(result: "GlobalSensitivity") -> dict:
    """Return the global sensitivity as plain values, in the layout of the JSON file."""
    from drftjax import __version__

    def finite(value: float) -> float | None:
        return float(value) if math.isfinite(value) else None

    effects = result.effects
    relevant, undetermined = set(result.relevant), set(result.undetermined)

    def plain(index: int) -> dict:
        each = result.ranges[index]
        changes = {
            channel: {
                "mean_size": finite(effects.mean_size[index, place]),
                "interval": finite(effects.interval[index, place]),
                "spread": finite(effects.spread[index, place]),
            }
            for place, channel in enumerate(result.channels)
        }
        return {
            "name": each.quantity.label,
            "unit": each.quantity.unit,
            "value": each.value,
            "low": each.low,
            "high": each.high,
            "matters": None if index in undetermined else index in relevant,
            "effects_counted": int(effects.counted[index]),
            "changes": changes,
        }

    return {
        "schema": SCREENING_SCHEMA,
        "schema_version": 1,
        "software": f"drftjax {__version__}",
        "title": result.title,
        "method": "Morris elementary effects",
        "trajectories": result.settings.trajectories,
        "levels": result.settings.levels,
        "seed": result.seed,
        "simulations": effects.simulations,
        "failed": effects.failed,
        "channels": list(result.channels),
        "noise": result.noise,
        "summary": result.summary(),
        "numbers": [plain(index) for index in result.order],
        "excluded": result.excluded,
    }
