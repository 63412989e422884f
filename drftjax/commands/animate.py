"""`drft animate`: a film of a recorded wheel that turns and sinks."""

from pathlib import Path
from typing import Annotated

import typer

from drftjax.commands.options import remove_empty_folders
from drftjax.common.errors import InputError

app = typer.Typer(add_completion=False, rich_markup_mode=None)


EXAMPLES = """
Examples:

\b
  drft animate data/runs/medium.h5 -o out/wheel.gif
  drft animate run.h5 --speed 4 -o out/wheel.mp4     needs ffmpeg

The wheel's plates are coloured by the force of the sand on each: that of the reference model at
the recorded place and speed, by the set-up in the run log. Beside it runs the sinkage over time.
"""

SLOWEST, FASTEST = 0.01, 1000.0


@app.command(epilog=EXAMPLES)
@remove_empty_folders
def animate(
    run: Annotated[Path, typer.Argument(help="A run log.", show_default=False)],
    output: Annotated[Path, typer.Option("-o", "--output", help="Write the film here (GIF, MP4).")],
    speed: Annotated[float, typer.Option(help="Of the film, in times of real time.")] = 1.0,
) -> None:
    """Make a film of a recorded wheel that turns and sinks in the sand."""
    from rich.console import Console

    from drftjax.common.jax_config import configure_jax

    if not SLOWEST <= speed <= FASTEST:
        raise InputError(f"--speed is {speed:g}, must be {SLOWEST:g} to {FASTEST:g}")
    configure_jax()
    from drftjax.animation.film import WheelFilm
    from drftjax.animation.film_file import check_film_name, write_film
    from drftjax.animation.wheel_motion import DEFAULT_FILM, plate_forces, wheel_motion
    from drftjax.commands.progress import progress_line
    from drftjax.common.output_files import require_places
    from drftjax.runlog.check import read_run_guarded

    check_film_name(output)
    require_places([output], [run])
    console = Console()
    with progress_line(console, "reading the run") as show:
        log = read_run_guarded(run)
        try:
            motion = wheel_motion(log, speed)
        except InputError as problem:
            raise InputError(f"{run}: {problem}") from None
        show("computing the forces on the plates")
        forces, reason = None, ""
        try:
            forces = plate_forces(log, motion)
        except InputError as problem:
            reason = f"the plates have no colour: {problem}"
        try:
            film = WheelFilm(log, motion, forces)
        except InputError as problem:
            raise InputError(f"{run}: {problem}") from None

        def frames():
            for number, picture in enumerate(film.frames(DEFAULT_FILM.dots_per_inch), start=1):
                show(f"frame {number} of {len(film)}")
                yield picture

        write_film(frames(), DEFAULT_FILM.frame_time, output)
    if reason:
        console.print(reason, style="yellow", markup=False, soft_wrap=True)
    console.print(f"film of {len(film)} frames written to {output}", markup=False, soft_wrap=True)


if __name__ == "__main__":
    app()
