"""Tables and files of a designed run."""

import copy
from typing import TYPE_CHECKING

from rich.markup import escape

if TYPE_CHECKING:
    from drftjax.common.rich_text import WholeWordTable
    from identify.design.design import Design
    from identify.design.fisher_information import ParameterInformation
    from identify.design.options import RunOption

# Part of the titles of designed runs, by which they are recognised.
DESIGNED = ", designed for "


def design_table(result: "Design") -> "WholeWordTable":
    """Return a table of all runs: standard error, and factor gained over the given profile."""
    import math

    from drftjax.common.rich_text import WholeWordTable
    from drftjax.runlog.schema import UNITS

    unit = "" if result.unit == "-" else f" [{result.unit}]"
    beside = ", ".join(result.nuisances) or "nothing else unknown"
    title = escape(f"standard error of {result.parameter}{unit}, beside {beside}")
    table = WholeWordTable(title=title)
    table.add_column("run")
    table.add_column("standard error", justify="right")
    table.add_column("of the value", justify="right")
    table.add_column("factor gained", justify="right")
    table.add_column(f"shift by {result.model_error * 1e3:.3g} mm", justify="right")

    def add(name: str, knows: "ParameterInformation") -> None:
        factor = result.given.information.error / knows.error if math.isfinite(knows.error) else 0.0
        shift = knows.shift * result.model_error
        share = f"{knows.relative:.2%}" if math.isfinite(knows.relative) else "-"
        table.add_row(escape(name), f"{knows.error:.3g}", share, f"{factor:.3g}", f"{shift:.3g}")

    units = UNITS["measured"]
    for head, options in (("", [result.given]), ("best: ", [result.best])):
        for each in options:
            add(head + each.name, each.information)
            for channel, more in each.added.items():
                add(f"  with {channel} ({result.noise[channel]:g} {units[channel]})", more)
        table.add_section()
    for group in (result.others, result.found, result.scan):
        for each in group:
            add(each.name, each.information)
        table.add_section()
    return table


def design_document(result: "Design") -> dict:
    """Return the design as plain values, in the layout of the JSON file."""
    import msgspec

    from drftjax import __version__
    from identify.design.design import DESIGN_SCHEMA

    def plain(option: "RunOption") -> dict:
        return {
            "name": option.name,
            **_numbers(option.information),
            "way": option.rim_travel,
            "added": {name: _numbers(each) for name, each in option.added.items()},
            "setup": msgspec.to_builtins(option.setup),
        }

    return {
        "schema": DESIGN_SCHEMA,
        "schema_version": 1,
        "software": f"drftjax {__version__}",
        "parameter": result.parameter,
        "unit": result.unit,
        "nuisances": list(result.nuisances),
        "noise": result.noise,
        "channels": list(result.channels),
        "identifiable": result.identifiable,
        "factor": result.factor,
        "wanted": result.wanted,
        "model_error": result.model_error,
        "speed_needed": result.speed_needed(),
        "speed_needed_with_model_error": result.speed_needed(True),
        "summary": result.summary(),
        "given": plain(result.given),
        "best": plain(result.best),
        "found": [plain(each) for each in result.found],
        "scan": [
            {"peak": peak, **plain(each)}
            for peak, each in zip(result.peaks, result.scan, strict=True)
        ],
        "others": [plain(each) for each in result.others],
    }


def _numbers(knows: "ParameterInformation") -> dict[str, float | str | None]:
    """Information of a run; None where it has none, as JSON has no infinity."""
    import math

    values = {name: getattr(knows, name) for name in ("value", "error", "alone", "share", "effect")}
    values["shift_per_metre"] = knows.shift
    finite = {name: float(v) if math.isfinite(v) else None for name, v in values.items()}
    return {**finite, "imitator": knows.imitator}


def design_toml(result: "Design") -> str:
    """Return the run to make, as the text of a set-up file."""
    import numpy as np

    from drftjax.setups.setup_toml import setup_toml

    setup = copy.deepcopy(result.best.setup)
    built = setup.command.build()
    setup.command.time = np.round(built.time, 3).tolist()
    setup.command.omega = (np.round(np.degrees(built.omega), 3) + 0.0).tolist()
    setup.command.omega_unit = "deg/s"
    setup.title = f"{setup.title}{DESIGNED}{result.parameter}"
    return setup_toml(setup, result.summary().splitlines())
