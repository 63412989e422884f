"""A comparison in words: sentences and a table for a terminal, and the files of its folder."""

from pathlib import Path

from rich.markup import escape

from diagnose.change.figures import difference_figure
from diagnose.change.hypothesis import ZETA
from diagnose.change.result import ChangeDiagnosis
from diagnose.report.figures import as_source
from diagnose.report.model_writer import estimate_in_words
from diagnose.selection.model_weights import NONE, UNKNOWN, percent
from drftjax.common.output_files import make_folder, replace_file
from drftjax.common.rich_text import WholeWordTable
from drftjax.common.structured_files import as_json
from drftjax.common.text import value_with_error
from drftjax.recorded.observation import SHOWN
from drftjax.report_page.page import render_page

# Smaller weights are left out of the list of weights [-].
MIN_WEIGHT = 0.01

# Without a change, an unexplained share of so many times the noise's is reported [-]: five times
# its RMS. Noise counts for 2 % at least: a fiftieth of a difference is left by any law.
MIN_UNEXPLAINED = 25.0
MIN_NOISE_SHARE = 0.02

BUDGET_COLUMNS = ("difference", "RMS", "the change", "zeta's scatter", "unexplained", "noise")


def in_words(found: ChangeDiagnosis) -> list[WholeWordTable | str]:
    """The whole comparison as sentences and a table, from top to bottom."""
    return [first_sentence(found), budget_table(found), *paragraphs(found)]


def first_sentence(found: ChangeDiagnosis) -> str:
    """The verdict with its size: nothing, something unknown, or a change by its name."""
    name = found.verdict[0]
    weight = percent(found.weights.get(name, 0.0))
    if name == NONE and (left := _unexplained(found)):
        return (
            f"Now differs from before by {left} that zeta's scatter does not explain, but these "
            f"runs are too few to tell it from chance (weight of no change {weight})."
        )
    if name == NONE:
        return (
            f"Nothing changed that these runs can show (weight {weight}): now differs from before "
            "by no more than the sand does from run to run."
        )
    if name == UNKNOWN:
        return (
            f"Something changed (weight {weight}), but no effect that is known here, nor the "
            "sand's strength, makes the runs of now differ from those before in this way."
        )
    size = size_in_words(found)
    return f"Changed since before: {name} ({found.meaning(name)}): {size}, with weight {weight}."


def _unexplained(found: ChangeDiagnosis) -> str:
    """RMS of what no change leaves in the channels where it is large, in words; empty for none."""
    large = [
        (each.channel, each.rms * max(each.remainder, 0.0) ** 0.5)
        for each in found.budget
        if each.remainder > MIN_UNEXPLAINED * max(each.noise, MIN_NOISE_SHARE)
    ]
    return " and ".join(
        f"{scale * rms:.2g} {unit} of {channel}"
        for channel, rms, unit, scale in ((c, rms, *SHOWN[c]) for c, rms in large)
    )


def size_in_words(found: ChangeDiagnosis) -> str:
    """Numbers of the change with standard errors and units."""
    if found.chosen.zeta_changes:
        change = found.parameters[ZETA]["change"]
        return f"zeta by {value_with_error(100 * change.value, 100 * change.error)} %"
    numbers = next(iter(found.parameters.values()))
    words = ", ".join(f"{key} = {estimate_in_words(each)}" for key, each in numbers.items())
    weaker = ", weaker now than before" if found.chosen.side == "before" else ""
    return f"{words}{weaker}"


def paragraphs(found: ChangeDiagnosis) -> list[str]:
    """The rest of the comparison, in sentences."""
    weighty = [each for each in found.weights.items() if each[1] >= MIN_WEIGHT]
    lines = ["weights: " + ", ".join(f"{name} {percent(weight)}" for name, weight in weighty)]
    first, *others = found.groups[0]
    if others:
        lines.append(f"These runs cannot tell {first} from {' or '.join(others)}.")
    if found.verdict == (UNKNOWN,):
        lines.append(f"The likeliest that is known: {found.chosen.name}, {size_in_words(found)}.")
    lines += [relabelling_sentence(found)]
    return [*lines, *(f"note: {each}" for each in found.notes)]


def relabelling_sentence(found: ChangeDiagnosis) -> str:
    """The test without a model of noise, in one sentence."""
    test = found.relabelling
    return (
        f"Without any model of noise: in {test.p:.1%} of {test.orders} ways to label these runs "
        f"before and now they differ as much as they do (p = {test.p:.3f}; so few runs give "
        f"{test.least_p:.3f} at least)."
    )


def budget_rows(found: ChangeDiagnosis) -> list[tuple[str, ...]]:
    """Rows of the table of the difference: channel, RMS, and the four shares of its square."""
    rows = []
    for each in found.budget:
        unit, scale = SHOWN[each.channel]
        shares = (each.change, each.zeta_scatter, each.remainder, each.noise)
        cells = (f"{100 * share + 0.0:.1f} %" for share in shares)
        rows.append((f"{each.channel} [{unit}]", f"{scale * each.rms:.3f}", *cells))
    return rows


def budget_table(found: ChangeDiagnosis) -> WholeWordTable:
    """Table of the difference between now and before, and what makes it up."""
    table = WholeWordTable()
    for name in BUDGET_COLUMNS:
        table.add_column(name, justify="left" if name == BUDGET_COLUMNS[0] else "right")
    for row in budget_rows(found):
        table.add_row(*map(escape, row))
    return table


# Files --------------------------------------------------------------------------------------------


def page(found: ChangeDiagnosis) -> str:
    """The report as one HTML page that refers to no other file."""
    return render_page(
        "diagnose.report",
        "change.html",
        verdict=first_sentence(found),
        sentences=paragraphs(found),
        columns=BUDGET_COLUMNS,
        rows=budget_rows(found),
        conditions=found.conditions,
        figure=as_source(difference_figure(found)),
        parameters=[
            (name, found.meaning(name), key, estimate_in_words(each))
            for name, numbers in found.parameters.items()
            for key, each in numbers.items()
        ],
    )


def write(found: ChangeDiagnosis, folder: Path) -> list[Path]:
    """Write diagnosis.json and report.html.

    Raises:
        InputError: where one cannot be written.
    """
    document, report = folder / "diagnosis.json", folder / "report.html"
    numbers, shown = as_json(found.document()), page(found)
    make_folder(folder)
    replace_file(document, numbers)
    replace_file(report, shown.encode())
    return [document, report]
