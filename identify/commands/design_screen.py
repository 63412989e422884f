"""`drft design --screen`: a set-up or a run in, the numbers that can matter out."""

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from drftjax.commands.options import draw_picture
from drftjax.commands.printing import say_on
from drftjax.commands.progress import progress_line
from drftjax.common.errors import InputError
from drftjax.common.output_files import files_of, require_places, stem_of
from drftjax.recorded.observation import comparable_channels
from drftjax.recorded.prepared_run import prepare_run
from drftjax.results.provenance import Provenance, command_provenance
from drftjax.runlog.record import CHANNELS
from drftjax.setups.from_run import setup_like
from drftjax.setups.setup import SetUp, read_setup
from identify.design.elementary_effects import MorrisSettings, require_extra
from identify.design.fisher_information import InstrumentNoise
from identify.design.screening import GlobalSensitivity, screen
from identify.design.screening_report import screening_document, screening_table


def screen_setup(
    setup: Path | None,
    like: Path | None,
    *,
    ranges: Sequence[str],
    channels: Sequence[str],
    noise: dict[str, float],
    noise_given: Sequence[str],
    settings: MorrisSettings,
    seed: int,
    output: Path | None,
    picture: Path | None = None,
) -> None:
    """Screen the numbers of one set-up or one recorded run, print and write what was found.

    Args:
        setup, like: File of the set-up, or of the run; the other is None.
        ranges: Ranges as NAME=LOW..HIGH.
        channels: Those measured; all that a fit compares where none are given.
        noise: Noise of every channel [m, N, N m].
        noise_given: Channels for which the user gave it: a recorded run has its own for others.
        settings: Numbers of the method.
        seed: Of the trajectories.
        output: Stem of the result files, or None.
        picture: File of a figure, whose name was checked, or None.
    """
    require_extra()
    channels = tuple(dict.fromkeys(channels))
    bounds = parse_ranges(ranges)
    names = [] if output is None else result_files(output)
    require_places(names, [each for each in (setup, like) if each is not None])
    if setup is not None:
        chosen = read_setup(setup)
        usual = comparable_channels(chosen.rig.carriage == "driven")
        instrument = InstrumentNoise(noise, channels or usual)
    else:
        assert like is not None
        chosen, instrument = _as_recorded(like, channels, noise, noise_given)
    console = Console()
    with progress_line(console, "compiling") as show:
        result = screen(
            chosen,
            ranges=bounds,
            instrument=instrument,
            settings=settings,
            seed=seed,
            progress=show,
        )
    console.print(screening_table(result))
    for line in result.summary().splitlines():
        say_on(console, line)
    if names:
        made = command_provenance("design", [setup, like], seed)
        _write(result, names, made)
        say_on(console, f"written: {', '.join(map(str, names))}")
    if picture is not None:
        from identify.design.figures import plot_screening

        draw_picture(plot_screening(result), picture)


def _as_recorded(
    like: Path, channels: Sequence[str], noise: dict[str, float], noise_given: Sequence[str]
) -> tuple[SetUp, InstrumentNoise]:
    """Set-up of a recorded run, its start as recorded, and the noise of its own readings."""
    _, run = setup_like(like)
    prepared = prepare_run(str(like), run, compare=channels or CHANNELS)
    observed = prepared.observation
    own = dict(zip(observed.channels, observed.noise.tolist(), strict=True))
    given = {channel: noise[channel] for channel in noise_given}
    return prepared.setup, InstrumentNoise(noise | own | given, observed.channels)


def parse_ranges(texts: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Ranges by name, from NAME=LOW..HIGH each.

    Raises:
        InputError: names a text of another form, or a name that comes twice.
    """
    found: dict[str, tuple[float, float]] = {}
    for text in texts:
        name, _, ends = text.partition("=")
        low, _, high = ends.partition("..")
        if name in found:
            raise InputError(f"--range gives {name} twice; give it once")
        try:
            found[name] = float(low), float(high)
        except ValueError:
            raise InputError(
                f"--range is {text!r}, must be NAME=LOW..HIGH, such as zeta=0.6..0.9"
            ) from None
    return found


def result_files(output: Path) -> list[Path]:
    """The numbers and the figure, by the stem that was asked for."""
    endings = (".json", ".png")
    return files_of(stem_of(output, endings), endings)


def _write(result: GlobalSensitivity, names: list[Path], made: Provenance) -> None:
    from drftjax.common.figures import save_figure
    from drftjax.common.output_files import make_folder, replace_file
    from drftjax.common.structured_files import as_json
    from identify.design.figures import plot_screening

    make_folder(names[0].parent)
    replace_file(names[0], as_json({**screening_document(result), "provenance": made.document()}))
    save_figure(plot_screening(result), names[1])
