"""`drft compare`: several fits, or several diagnoses, side by side."""

from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drftjax.commands.options import remove_empty_folders
from drftjax.commands.printing import say
from drftjax.common.errors import InputError

if TYPE_CHECKING:
    from drftjax.common.rich_text import WholeWordTable
    from drftjax.results.compared_files import ComparedResults

app = typer.Typer(add_completion=False, rich_markup_mode=None)


EXAMPLES = """
Examples:

\b
  drft compare out/monday.json out/friday.json
  drft compare out/a/diagnosis.json out/b/diagnosis.json -o out/both.json

Values are held against each other by their errors: chi2/f is chi-square for each degree of freedom,
about 1 where errors account for the scatter; chance is the probability of as much scatter or more.
"""


@app.command(epilog=EXAMPLES)
@remove_empty_folders
def compare(
    results: Annotated[
        list[Path],
        typer.Argument(help="Two or more fits, or diagnoses (JSON).", show_default=False),
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write the comparison here (JSON).")
    ] = None,
) -> None:
    """Hold fits, or diagnoses, against each other: agreement, common runs, and what to record."""
    from rich.console import Console

    from drftjax.common.output_files import replace_file, require_places
    from drftjax.common.structured_files import as_json
    from drftjax.common.text import replace_unprintable
    from drftjax.results.compared_diagnoses import compare_diagnoses
    from drftjax.results.compared_files import read_results
    from drftjax.results.compared_fits import compare_fits

    comparisons = {
        "drft-fit": ("fit", compare_fits),
        "drft-diagnosis": ("diagnosis", compare_diagnoses),
    }
    files = read_results(results, {schema: word for schema, (word, _) in comparisons.items()})
    if output is not None:
        if output.suffix.lower() != ".json":
            raise InputError(f"{output}: the file of --output must end in .json")
        require_places([output], results)
    found = comparisons[files[0].schema][1](files)
    console = Console()
    if found.weights:
        console.print(_weight_table(found))
    if found.quantities:
        console.print(_value_table(found))
    for sentence in [*found.sentences, *found.next_steps]:
        say(replace_unprintable(sentence))
    if output is not None:
        replace_file(output, as_json(found.document()))
        say(f"written: {output}")


def _table(found: "ComparedResults", title: str, first: str, *last: str) -> "WholeWordTable":
    """Table with a column for each file between the first and the last ones."""
    from rich.markup import escape

    from drftjax.common.rich_text import WholeWordTable
    from drftjax.common.text import replace_unprintable

    table = WholeWordTable(title=title, title_justify="left")
    table.add_column(first)
    places = [each.path.parts for each in found.files]
    folders = zip(*(place[:-1] for place in places), strict=False)
    shared = len(list(takewhile(lambda names: len(set(names)) == 1, folders)))
    for place in places:  # without the folder that all lie in, or no row would fit a page
        heading = escape(replace_unprintable("/".join(place[shared:])))
        table.add_column(heading, justify="right")
    for heading in last:
        table.add_column(heading, justify="right")
    return table


def _weight_table(found: "ComparedResults") -> "WholeWordTable":
    from rich.markup import escape

    table = _table(found, "weights of effects", "effect")
    for name, weights in found.weights.items():
        table.add_row(escape(name), *("-" if each is None else f"{each:.2f}" for each in weights))
    return table


def _value_table(found: "ComparedResults") -> "WholeWordTable":
    from rich.markup import escape

    table = _table(found, "values", "parameter", "mean", "chi2/f", "chance")
    for each in found.quantities:
        unit = "" if each.unit == "-" else f" [{each.unit}]"
        cells = ["-" if value is None else str(value) for value in each.values]
        told = each.agreement
        last = ["-", "-", "-"]
        if told is not None:
            last = [
                f"{told.mean:.5g} ± {told.error:.2g}",
                f"{told.chi_square / told.freedom:.2f}",
                f"{told.chance:.2g}",
            ]
        style = "bold" if each.disagrees else None
        table.add_row(escape(f"{each.label}{unit}"), *cells, *last, style=style)
    return table
