"""`drft effects`: list, explain and draw the mechanisms beyond the reference model."""

from pathlib import Path
from typing import Annotated

import typer

from drftjax.commands.options import complete_effect, draw_picture, require_picture
from drftjax.commands.printing import say
from drftjax.common.errors import InputError

app = typer.Typer(add_completion=False, rich_markup_mode=None)


EXAMPLES = """
Examples:

  drft effects

  drft effects loosening --plot out/loosening.png

  drft effects --plot out/effects.png
"""


@app.command(epilog=EXAMPLES)
def effects(
    name: Annotated[
        str | None,
        typer.Argument(
            help="An effect, to show in full.", show_default=False, autocompletion=complete_effect
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            help="Draw what it does to the paper's run (PNG, PDF, SVG); without a name, what each "
            "of them does."
        ),
    ] = None,
    markdown: Annotated[
        bool, typer.Option("--markdown", help="The list as a table in Markdown.")
    ] = False,
) -> None:
    """Effects that a set-up may have beyond the reference model, and what they do."""
    if markdown and name is not None:
        raise InputError(f"--markdown is a list of all effects; leave out {name!r} or --markdown")
    from drftjax.common.jax_config import configure_jax

    configure_jax()
    from drftjax.effects import correction
    from drftjax.effects import listing as table
    from drftjax.effects.catalogue import effect_class

    require_picture(plot, [])
    if name == correction.NAME:
        if plot is not None:
            raise InputError("a correction is what its set-up file says; there is nothing to draw")
        say(table.correction_details())
        return
    chosen = None if name is None else effect_class(name)
    if chosen is not None:
        say(table.effect_details(chosen))
    elif markdown:
        typer.echo(table.effect_markdown())
    elif plot is None:
        from rich.console import Console

        console = Console(highlight=False)
        console.print(table.effect_table())
        say(f"\n{table.BESIDES}")
    if plot is not None:
        from drftjax.simulation import effect_gallery as portrait

        everything = [each for _, those in table.by_stage() for each in those]
        figure = (
            portrait.draw_gallery(everything) if chosen is None else portrait.draw_effect(chosen)
        )
        draw_picture(figure, plot)
