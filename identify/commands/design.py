"""`drft design`: a set-up in, the run to make next out, or the numbers that can matter."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drftjax.commands.options import (
    PlotFile,
    draw_picture,
    is_on_command_line,
    refuse_options,
    remove_empty_folders,
    require_picture,
)
from drftjax.commands.printing import say_next, say_on
from drftjax.common.errors import InputError
from drftjax.common.output_files import files_of, stem_of
from identify.design.report import DESIGNED, design_document, design_table, design_toml

if TYPE_CHECKING:
    from drftjax.results.provenance import Provenance
    from identify.design.design import Design

app = typer.Typer(add_completion=False, rich_markup_mode=None)


EXAMPLES = """
Examples:

\b
  drft design data/paper.toml --parameter lambda --max-speed 300 -o out/design
  drft design --like run.h5 --nuisance zeta --nuisance rig.damping_x \\
      --loads 150 220
  drft simulate out/design.toml -o out/design.h5

The result is out/design.toml (the run to make), out/design.json and out/design.png.

\b
  drft design data/paper.toml --screen -o out/screen
  drft design --like run.h5 --screen --range zeta=0.6..0.9

Elementary effects (Morris 1991; SALib) of zeta, lambda, sand, rig, start and all effects: the
change that each makes in each channel across its range, in the noise of that channel. The result is
out/screen.json and out/screen.png.
"""

# Options of a search for the next run, and of a screening.
OF_SEARCH = (
    "parameter",
    "nuisance",
    "max_speed",
    "max_acceleration",
    "duration",
    "max_travel",
    "loads",
    "wanted",
    "model_error",
    "steps",
)


OF_SCREENING = ("range", "trajectories", "seed")


@app.command(epilog=EXAMPLES)
@remove_empty_folders
def design(
    context: typer.Context,
    setup: Annotated[
        Path | None, typer.Argument(help="A set-up file (TOML or JSON).", show_default=False)
    ] = None,
    like: Annotated[Path | None, typer.Option(help="A run log instead: its set-up.")] = None,
    parameter: Annotated[str, typer.Option(help="The parameter to identify.")] = "lambda",
    nuisance: Annotated[
        list[str] | None,
        typer.Option(help="What the same run must also identify. [default: zeta, lambda]"),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Stem of the result files.")
    ] = None,
    picture: PlotFile = None,
    max_speed: Annotated[float, typer.Option(help="Largest speed [deg/s].")] = 300.0,
    max_acceleration: Annotated[
        float, typer.Option(help="Largest angular acceleration [deg/s2].")
    ] = 50.0,
    duration: Annotated[
        float | None, typer.Option(help="Of the run [s]. [default: the given profile's]")
    ] = None,
    max_travel: Annotated[
        float | None, typer.Option(help="Largest travel of the rim [m]. [default: any]")
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
        list[str] | None,
        typer.Option(
            help="A channel that is recorded. [default: x, z; with --screen all that are compared]"
        ),
    ] = None,
    wanted: Annotated[
        float, typer.Option(help="Standard error that counts as identified [% of the value].")
    ] = 10.0,
    model_error: Annotated[
        float, typer.Option(help="Error of the model itself in x and z, RMS [mm].")
    ] = 0.05,
    steps: Annotated[int, typer.Option(help="Steps of each descent.", min=1, max=100)] = 3,
    screen: Annotated[
        bool,
        typer.Option("--screen", help="Say instead which numbers can matter on this rig at all."),
    ] = False,
    range: Annotated[
        list[str] | None,
        typer.Option(
            "--range",
            metavar="NAME=LOW..HIGH",
            help="Range of a number that is screened, in SI units. [default: docs/guide/design.md]",
        ),
    ] = None,
    trajectories: Annotated[
        int, typer.Option(help="Of --screen; each is a run for every number.", min=2, max=100)
    ] = 10,
    seed: Annotated[
        int, typer.Option(help="Of the trajectories of --screen.", min=0, max=2**32 - 1)
    ] = 0,
) -> None:
    """Say which run to make next, so that a parameter becomes identifiable."""
    import math
    import os

    from rich.console import Console

    from drftjax.common.jax_config import configure_jax

    if (setup is None) == (like is None):
        both = "" if setup is None else ", not both"
        raise InputError(f"name one set-up file, or --like RUN{both}")
    if screen:
        refuse_options(context, OF_SEARCH, "--screen searches for no run")
    else:
        refuse_options(context, OF_SCREENING, "without --screen no numbers are screened")
    require_picture(picture, [each for each in (setup, like) if each is not None])
    configure_jax(devices=os.cpu_count())
    noise = {"x": noise_x * 1e-6, "z": noise_z * 1e-6}
    noise |= {"fx": noise_fx, "fz": noise_fz, "torque": noise_torque}
    if screen:
        from identify.commands.design_screen import screen_setup
        from identify.design.elementary_effects import MorrisSettings

        given = [each for each in noise if is_on_command_line(context, f"noise_{each}")]
        screen_setup(
            setup,
            like,
            ranges=range or [],
            channels=channel or [],
            noise=noise,
            noise_given=given,
            settings=MorrisSettings(trajectories),
            seed=seed,
            output=output,
            picture=picture,
        )
        return
    from drftjax.commands.progress import progress_line
    from drftjax.common.output_files import require_places
    from drftjax.results.provenance import command_provenance
    from drftjax.setups.from_run import setup_like
    from drftjax.setups.generated_files import require_own_setup
    from drftjax.setups.setup import read_setup
    from identify.design.design import design as design_run
    from identify.design.fisher_information import InstrumentNoise
    from identify.design.limits import Limits
    from identify.design.search import DesignSettings

    if output is not None:
        names = result_files(output)
        require_places(names, [each for each in (setup, like) if each is not None])
        require_own_setup(names[0], DESIGNED)
    made = command_provenance("design", [setup, like])
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
    console = Console()
    with progress_line(console, "compiling") as show:
        result = design_run(
            chosen,
            parameter,
            nuisances=nuisance or None,
            limits=limits,
            instrument=InstrumentNoise(noise, tuple(channel or ("x", "z"))),
            search=DesignSettings(steps=steps),
            wanted=wanted / 100,
            model_error=model_error * 1e-3,
            progress=show,
        )
    if result.identifiable:
        console.print(design_table(result))
    for line in result.summary().splitlines():
        say_on(console, line)
    if output is not None and result.identifiable:
        written = _write(result, output, made)
        say_on(console, f"written: {', '.join(map(str, written))}")
        say_next("simulate", written[0], "-o", written[0].with_suffix(".h5"))
    if picture is not None and result.identifiable:
        from identify.design.figures import plot_design

        draw_picture(plot_design(result), picture)


def result_files(output: Path) -> list[Path]:
    """The run to make, the numbers and the figure, by the stem that was asked for."""
    endings = (".toml", ".json", ".png")
    return files_of(stem_of(output, endings), endings)


def _write(result: "Design", output: Path, provenance: "Provenance") -> list[Path]:
    from drftjax.common.figures import save_figure
    from drftjax.common.output_files import make_folder, replace_file
    from drftjax.common.structured_files import as_json
    from drftjax.setups.generated_files import replace_own_setup
    from identify.design.figures import plot_design

    names = result_files(output)
    make_folder(output.parent)
    replace_own_setup(names[0], design_toml(result), DESIGNED)
    replace_file(
        names[1], as_json({**design_document(result), "provenance": provenance.document()})
    )
    save_figure(plot_design(result), names[2])
    return names
