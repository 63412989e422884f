"""`drft design`: a set-up in, the run to make next out."""

import copy
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drftjax.commands.folders import leaves_no_empty_folder
from drftjax.errors import InputError
from identify.stem import files_of, stem_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.table import Table

    from identify.design import Design
    from identify.information import Knowledge
    from identify.judge import Option

# What the titles of designed runs hold.
DESIGNED = ", designed for "

app = typer.Typer(add_completion=False, rich_markup_mode=None)

EXAMPLES = """
Examples:

\b
  drft design data/paper.toml --parameter lambda --max-speed 300 -o out/design
  drft design --like run.h5 --nuisance zeta --nuisance rig.damping_x \\
      --loads 150 220
  drft simulate out/design.toml -o out/design.h5

The result is out/design.toml (the run to make), out/design.json and out/design.png.
"""


@app.command(epilog=EXAMPLES)
@leaves_no_empty_folder
def design(
    setup: Annotated[
        Path | None, typer.Argument(help="A set-up file (TOML or JSON).", show_default=False)
    ] = None,
    like: Annotated[Path | None, typer.Option(help="A run log instead: its set-up.")] = None,
    parameter: Annotated[str, typer.Option(help="The parameter to identify.")] = "lambda",
    nuisance: Annotated[
        list[str] | None,
        typer.Option(help="What the same run must also tell. [default: zeta, lambda]"),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Stem of the result files.")
    ] = None,
    max_speed: Annotated[float, typer.Option(help="Largest speed [deg/s].")] = 300.0,
    max_acceleration: Annotated[
        float, typer.Option(help="Largest angular acceleration [deg/s2].")
    ] = 50.0,
    duration: Annotated[
        float | None, typer.Option(help="Of the run [s]. [default: the given profile's]")
    ] = None,
    max_travel: Annotated[
        float | None, typer.Option(help="Longest way of the rim [m]. [default: any]")
    ] = None,
    loads: Annotated[
        tuple[float, float] | None,
        typer.Option(help="Lowest and highest load that may be put on the wheel [N]."),
    ] = None,
    noise_x: Annotated[float, typer.Option(help="White noise of x [um].")] = 50.0,
    noise_z: Annotated[float, typer.Option(help="White noise of z [um].")] = 20.0,
    noise_fx: Annotated[float, typer.Option(help="White noise of fx [N].")] = 0.5,
    noise_fz: Annotated[float, typer.Option(help="White noise of fz [N].")] = 0.5,
    noise_torque: Annotated[float, typer.Option(help="White noise of torque [N m].")] = 0.05,
    channel: Annotated[
        list[str] | None, typer.Option(help="A channel that is recorded. [default: x, z]")
    ] = None,
    wanted: Annotated[
        float, typer.Option(help="Standard error that counts as identified [% of the value].")
    ] = 10.0,
    model_error: Annotated[
        float, typer.Option(help="Error of the model itself in x and z, RMS [mm].")
    ] = 0.05,
    steps: Annotated[int, typer.Option(help="Steps of each descent.", min=1, max=100)] = 3,
) -> None:
    """Say which run to make next, so that a parameter becomes identifiable."""
    import math
    import os

    from rich.console import Console

    from drftjax.commands.runtime import configure_jax

    if (setup is None) == (like is None):
        both = "" if setup is None else ", not both"
        raise InputError(f"name one set-up file, or --like RUN{both}")
    configure_jax(devices=os.cpu_count())
    from drftjax.like import setup_like
    from drftjax.own_setup import require_own_setup
    from drftjax.runlog.replace import require_places
    from drftjax.setup import read_setup
    from identify.design import design as design_run
    from identify.information import Instrument
    from identify.limits import Limits
    from identify.profile_search import Search

    if output is not None:
        names = result_files(output)
        require_places(names, [each for each in (setup, like) if each is not None])
        require_own_setup(names[0], DESIGNED)
    if setup is not None:
        chosen = read_setup(setup)
    else:
        assert like is not None
        chosen, _ = setup_like(like)
    time = chosen.command.time
    limits = Limits(
        math.radians(max_speed),
        math.radians(max_acceleration),
        time[-1] - time[0] if duration is None else duration,
        loads,
        math.inf if max_travel is None else max_travel,
    )
    noise = {"x": noise_x * 1e-6, "z": noise_z * 1e-6}
    noise |= {"fx": noise_fx, "fz": noise_fz, "torque": noise_torque}
    console = Console()
    with console.status("compiling") as status:
        result = design_run(
            chosen,
            parameter,
            nuisances=nuisance or None,
            limits=limits,
            instrument=Instrument(noise, tuple(channel or ("x", "z"))),
            search=Search(steps=steps),
            wanted=wanted / 100,
            model_error=model_error * 1e-3,
            progress=status.update,
        )
    if result.seen:
        console.print(design_table(result))
    console.print(result.summary(), soft_wrap=True)
    if output is not None and result.seen:
        written = _write(result, output)
        console.print(f"written: {', '.join(map(str, written))}", soft_wrap=True)


def result_files(output: Path) -> list[Path]:
    """The run to make, the numbers and the figure, by the stem that was asked for."""
    endings = (".toml", ".json", ".png")
    return files_of(stem_of(output, endings), endings)


def _write(result: "Design", output: Path) -> list[Path]:
    from drftjax.figures import save_figure
    from drftjax.own_setup import replace_own_setup
    from drftjax.runlog.replace import make_folder, replace_file
    from drftjax.structfile import as_json

    names = result_files(output)
    make_folder(output.parent)
    replace_own_setup(names[0], design_toml(result), DESIGNED)
    replace_file(names[1], as_json(design_document(result)))
    save_figure(plot_design(result), names[2])
    return names


def plot_design(result: "Design") -> "Figure":
    """The given and the best profile, and the standard error over peak speeds."""
    import numpy as np
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 3.6), layout="constrained")
    profile, scan = figure.subplots(1, 2)
    for each, name, colour in ((result.now, "given", "0.4"), (result.best, "best", "C0")):
        command = each.setup.command.build()
        label = f"{name}: ±{each.knows.error:.2g}"
        profile.plot(command.time, np.degrees(command.omega), ".-", color=colour, label=label)
    profile.set_xlabel("time [s]")
    profile.set_ylabel("angular velocity [deg/s]")
    profile.legend(title=f"standard error of {result.parameter}", fontsize=8)
    peaks = np.degrees(result.peaks)
    errors = np.array([each.knows.error for each in result.scan])
    shifts = np.array([result.shift(each) for each in result.scan])
    scan.loglog(peaks, errors, "o-", label="standard error, white noise")
    label = f"shift by a model error of {result.model_error * 1e3:.3g} mm"
    scan.loglog(peaks, shifts, "s--", label=label)
    value = abs(result.now.knows.value)
    if value:
        label = f"{result.wanted:.0%} of the value"
        scan.axhline(result.wanted * value, color="0.5", lw=0.8, ls=":", label=label)
    scan.set_xticks(peaks, [f"{each:.0f}" for each in peaks])
    scan.minorticks_off()
    scan.set_xlabel("peak speed of a trapezoid [deg/s]")
    scan.set_ylabel(f"error of {result.parameter} [{result.unit}]")
    scan.legend(fontsize=8)
    return figure


def design_table(result: "Design") -> "Table":
    """Every run judged, its standard error and the factor gained over the given profile."""
    import math

    from rich.table import Table

    from drftjax.runlog.layout import UNITS

    unit = "" if result.unit == "-" else f" [{result.unit}]"
    beside = ", ".join(result.nuisances) or "nothing else unknown"
    table = Table(title=f"standard error of {result.parameter}{unit}, beside {beside}")
    table.add_column("run")
    table.add_column("standard error", justify="right")
    table.add_column("of the value", justify="right")
    table.add_column("factor gained", justify="right")
    table.add_column(f"shift by {result.model_error * 1e3:.3g} mm", justify="right")

    def add(name: str, knows: "Knowledge") -> None:
        factor = result.now.knows.error / knows.error if math.isfinite(knows.error) else 0.0
        shift = knows.shift * result.model_error
        share = f"{knows.relative:.2%}" if math.isfinite(knows.relative) else "-"
        table.add_row(name, f"{knows.error:.3g}", share, f"{factor:.3g}", f"{shift:.3g}")

    units = UNITS["measured"]
    for head, options in (("", [result.now]), ("best: ", [result.best])):
        for each in options:
            add(head + each.name, each.knows)
            for channel, more in each.added.items():
                add(f"  with {channel} ({result.noise[channel]:g} {units[channel]})", more)
        table.add_section()
    for group in (result.others, result.found, result.scan):
        for each in group:
            add(each.name, each.knows)
        table.add_section()
    return table


def design_document(result: "Design") -> dict:
    """The design as plain values, in the layout of the JSON file."""
    import msgspec

    from drftjax import __version__
    from identify.design import DESIGN_SCHEMA

    def plain(option: "Option") -> dict:
        return {
            "name": option.name,
            **_numbers(option.knows),
            "way": option.way,
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
        "identifiable": result.seen,
        "factor": result.factor,
        "wanted": result.wanted,
        "model_error": result.model_error,
        "speed_needed": result.speed_needed(),
        "speed_needed_with_model_error": result.speed_needed(True),
        "summary": result.summary(),
        "given": plain(result.now),
        "best": plain(result.best),
        "found": [plain(each) for each in result.found],
        "scan": [
            {"peak": peak, **plain(each)}
            for peak, each in zip(result.peaks, result.scan, strict=True)
        ],
        "others": [plain(each) for each in result.others],
    }


def _numbers(knows: "Knowledge") -> dict[str, float | str | None]:
    """What a run tells; None where it tells nothing, as JSON has no infinity."""
    import math

    values = {name: getattr(knows, name) for name in ("value", "error", "alone", "share", "effect")}
    values["shift_per_metre"] = knows.shift
    finite = {name: float(v) if math.isfinite(v) else None for name, v in values.items()}
    return {**finite, "imitator": knows.imitator}


def design_toml(result: "Design") -> str:
    """The run to make, as a set-up file."""
    import numpy as np

    from drftjax.setup_toml import setup_toml

    setup = copy.deepcopy(result.best.setup)
    built = setup.command.build()
    setup.command.time = np.round(built.time, 3).tolist()
    setup.command.omega = (np.round(np.degrees(built.omega), 3) + 0.0).tolist()
    setup.command.omega_unit = "deg/s"
    setup.title = f"{setup.title}{DESIGNED}{result.parameter}"
    return setup_toml(setup, result.summary().splitlines())
