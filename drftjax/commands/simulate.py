"""`drft simulate`: make a run log from a set-up file or from a recorded run."""

from pathlib import Path
from typing import Annotated

import typer

from drftjax.commands.options import (
    PlotFile,
    draw_picture,
    remove_empty_folders,
    require_picture,
)
from drftjax.commands.printing import say
from drftjax.common.errors import InputError

app = typer.Typer(add_completion=False, rich_markup_mode=None)


EXAMPLES = """
Examples:

  drft simulate data/paper.toml -o out/paper.h5 --plot out/paper.png

  drft simulate --like run.h5 --zeta 0.8 -o out/again.h5

  drft simulate --from out/fit.json --run run_a -o out/fitted.h5
"""


@app.command(epilog=EXAMPLES)
@remove_empty_folders
def simulate(
    setup: Annotated[
        Path | None, typer.Argument(help="A set-up file (TOML or JSON).", show_default=False)
    ] = None,
    like: Annotated[
        Path | None,
        typer.Option(help="A run log: the same set-up, commands and sampling times."),
    ] = None,
    source: Annotated[
        Path | None,
        typer.Option(
            "--from",
            help="A fit's result (JSON or HDF5): its fitted model; or a set-up file (TOML).",
        ),
    ] = None,
    run: Annotated[
        str | None, typer.Option(help="With --from: which run of the fit, by name.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write a run log here.")
    ] = None,
    plot: PlotFile = None,
    zeta: Annotated[float | None, typer.Option(help="Scaling factor, over the set-up's.")] = None,
    inertial: Annotated[
        float | None, typer.Option("--lambda", help="Inertial coefficient, over the set-up's.")
    ] = None,
    step: Annotated[float | None, typer.Option(help="Integrator step [s].")] = None,
    rate: Annotated[float, typer.Option(help="Rows a second in the output [Hz].")] = 100.0,
) -> None:
    """Simulate a run of a wheel on sand and write it as a run log."""
    from drftjax.common.jax_config import configure_jax

    configure_jax()
    from drftjax.common.output_files import require_places
    from drftjax.runlog.check import require_no_recording
    from drftjax.runlog.files import HDF5_ENDINGS
    from drftjax.runlog.hdf5.api import write_run
    from drftjax.runlog.plausibility import plausibility_warnings
    from drftjax.setups import fitted_model as saved
    from drftjax.setups import setup as setups
    from drftjax.setups.from_run import setup_like
    from drftjax.setups.simulated_run import simulated_run, summary

    given = [each for each in (setup, like, source) if each is not None]
    if len(given) != 1:
        raise InputError(
            f"{len(given) or 'no'} sources were given; name one set-up file, --like RUN or "
            "--from RESULT"
        )
    if not 0 < rate <= 1e5:
        raise InputError(f"--rate is {rate:g} Hz, must be above 0 and at most 100000 Hz")
    if run is not None and source is None:
        raise InputError("--run goes with --from, to name one run of a fit")
    if output is not None and output.suffix not in HDF5_ENDINGS:
        raise InputError(f"{output}: a run log's name must end in {', '.join(HDF5_ENDINGS)}")
    require_picture(plot, given)
    if output is not None:
        require_places([output], given)
        require_no_recording(output)
    sampled = None
    if setup is not None:
        chosen = setups.read_setup(setup)
    elif like is not None:
        chosen, recorded = setup_like(like)
        sampled = recorded.measured.time
    else:
        assert source is not None
        chosen = saved.read_model(source, run)
    if zeta is not None:
        chosen.terrain.zeta = zeta
    if inertial is not None:
        chosen.terrain.put_number("inertial_coefficient", inertial)
    if step is not None:
        chosen.integrator.step = step
    log = simulated_run(chosen, interval=1 / rate, at=sampled)

    say(summary(log))
    if log.notes:
        say(log.notes)
    time = log.measured.time
    if sampled is None and len(time) > 1 and abs((time[1] - time[0]) * rate - 1) > 1e-6:
        true = 1 / (time[1] - time[0])
        say(f"note: rows come at {true:.4g} Hz, at whole steps", error=True)
    for doubt in plausibility_warnings(log):
        say(f"note: {doubt}", error=True)
    if output is not None:
        write_run(output, log)
        say(f"run log written to {output}")
    if plot is not None:
        from drftjax.runlog.figure import plot_run

        draw_picture(plot_run(log), plot)
