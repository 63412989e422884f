"""Table and file of a global sensitivity."""

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from drftjax.common.rich_text import WholeWordTable
    from identify.design.number_ranges import NumberRange
    from identify.design.screening import GlobalSensitivity

SCREENING_SCHEMA = "drft-screening"

# Numbers in the table of a terminal; the figure and the file have all.
TABLE_ROWS = 20

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
        table.add_column(f"{channel} ({noise_text(result, channel)})", justify="right")
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


def noise_text(result: "GlobalSensitivity", channel: str) -> str:
    """Noise of a channel in the unit of reports, such as "0.02 mm"."""
    from drftjax.recorded.observation import SHOWN

    unit, factor = SHOWN[channel]
    return f"{result.noise[channel] * factor:.3g} {unit}"


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
