"""A diagnosis told: in sentences and tables for a terminal, and as files for a folder."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from rich.markup import escape
from rich.table import Table

from diagnose.checks.outlier_runs import REPEATS_DIFFER
from diagnose.gap.gap import Gap
from diagnose.localization import localization as location
from diagnose.report.figures import as_source, at_a_glance, residuals, unknown_signal, weights
from diagnose.report.model_writer import MARK, estimate_in_words, model_toml
from diagnose.result import Diagnosis
from diagnose.selection.model_weights import NONE, UNKNOWN, percent
from drftjax import __version__
from drftjax.common.output_files import make_folder, replace_file
from drftjax.common.structured_files import as_json
from drftjax.common.text import replace_unprintable
from drftjax.effects.catalogue import reported_names
from drftjax.effects.correction import VARIABLES
from drftjax.recorded.observation import SHOWN
from drftjax.recorded.repeats import group_by_condition
from drftjax.setups.generated_files import replace_own_setup

# So many noise floors off, a run is plainly not followed.
PLAIN = 3.0


# Weights under this are not told.
TOLD = 0.01


def in_words(found: Diagnosis) -> list[Table | str]:
    """Everything that was found, as it is read from top to bottom."""
    return [verdict(found), gap_table(found), *paragraphs(found)]


def verdict(found: Diagnosis) -> str:
    """What was found, in one sentence."""
    weight = certainty_in_words(found)
    alone = len(found.dataset.runs) == 1
    runs = "this run" if alone else "these runs"
    if found.verdict == (NONE,):
        if missed := _missed_by_far(found):
            tell = "tells" if alone else "tell"
            return (
                f"The reference model misses {runs} by {missed}, but {runs} {tell} too little of "
                "why: no effect outweighs chance by enough to be named (weight of none "
                f"{percent(weight)})."
            )
        if any(REPEATS_DIFFER in note for note in found.notes):
            return (
                "No effect shows beyond what repeats of one command differ by, which is far more "
                f"than instruments make (weight of none {percent(weight)}): these runs can say "
                "nothing of the model until that is found."
            )
        follows = "its own zeta the model follows it" if alone else "a zeta each it follows them"
        if weight < 0.5:
            return (
                f"Nothing shows in {runs} that could not be chance: with {follows}. Yet an effect "
                f"too faint to be named is likelier than none (weight of none {percent(weight)})."
            )
        return (
            f"Nothing beyond the reference model shows in {runs} (weight {percent(weight)}): with "
            f"{follows}."
        )
    if found.verdict == (UNKNOWN,):
        return (
            f"Something makes {runs} differ from the reference model (weight {percent(weight)}), "
            "but no effect that is known here explains it."
        )
    effects = " and ".join(f"{name} ({found.meaning(name)})" for name in found.verdict)
    if alone:
        return (
            f"This run looks like {effects}, with weight {percent(weight)}; one run alone "
            "describes and does not prove."
        )
    return f"These runs show {effects}, with weight {percent(weight)}."


def _missed_by_far(found: Diagnosis) -> str:
    """In which channels the reference model lies plainly off, and by how much; empty for none."""
    floors = {channel: gap.before / gap.floor for channel, gap in found.gap.items() if gap.floor}
    return " and ".join(
        f"{size:.0f} noise floors in {channel}" for channel, size in floors.items() if size >= PLAIN
    )


def certainty_in_words(found: Diagnosis) -> float:
    """Weight of the verdict, or of the least sure part of it."""
    return min(found.weights.get(name, 0.0) for name in found.verdict)


def paragraphs(found: Diagnosis) -> list[str]:
    """All else that was found, in sentences."""
    others = [w for w in found.weights.items() if w[1] >= TOLD]
    told_weights = ", ".join(f"{name} {percent(weight)}" for name, weight in others)
    lines = [f"weights: {told_weights}"]
    lines += group_sentences(found)
    lines += gap_sentences(found)
    if found.verdict != (NONE,):
        lines.append(location.localization_sentence(found.localization))
    lines += parameter_sentences(found)
    lines += [f"note: {note}" for note in found.notes]
    lines += next_sentences(found)
    return lines


def group_sentences(found: Diagnosis) -> list[str]:
    """What these runs cannot tell apart."""
    sentences = []
    for group in found.groups:
        first, others = group[0], " or ".join(map(_worded, group[1:]))
        alone = len(found.dataset.runs) == 1
        runs, rule = ("this run", "rules") if alone else ("these runs", "rule")
        if others and first == NONE:
            sentences.append(f"What {runs} {rule} out least: {others}.")
        elif others:
            sentences.append(f"{runs.capitalize()} cannot tell {_worded(first)} from {others}.")
    return sentences


def _worded(name: str) -> str:
    return {NONE: "the reference model", UNKNOWN: "something that is not known here"}.get(
        name, name
    )


def shrinkage_in_words(gap: Gap) -> str:
    """How far a gap shrinks; with the interval, where there are conditions to draw from."""
    if not gap.is_reducible:
        return "at the floor"
    if gap.interval is None:
        return f"{gap.shrinkage:.0%}"
    low, high = gap.interval
    return f"{gap.shrinkage:.0%} ({low:.0%} to {high:.0%})"


def gap_sentences(found: Diagnosis) -> list[str]:
    """On what the gap was measured, and how far it shrinks."""
    if found.verdict == (NONE,):
        return []
    if found.verdict == (UNKNOWN,):
        return [_stand_in_sentence(found)]
    least = " and ".join(found.verdict)
    shares = _shrunk_by(found)
    on = _measured_on(found, "its curve was" if found.correction else "the effect's numbers were")
    if not shares:
        return [f"There is no gap above the noise floor that {least} could shrink."]
    return [
        f"With {least} the gap above the noise floor shrinks by {shares}, {on}.",
        *step_sentences(found),
    ]


def _stand_in_sentence(found: Diagnosis) -> str:
    """What stands for an effect that is not known, and how far the gap shrinks with it."""
    if not found.selected.effects:
        return "Nothing tried in its place shrinks the gap; model.toml holds the reference model."
    if found.correction is not None:
        effect, on = found.correction.effect, _measured_on(found, "its curve was")
        what = f"a correction of {effect.stage} over {effect.variable}, fitted to these runs"
    else:
        on = _measured_on(found, "the effect's numbers were")
        what = f"{' and '.join(reported_names(found.chosen.names))}, the likeliest of what is known"
    shares = _shrunk_by(found) or "little in any one channel"
    return (
        f"Offered in its place: {what}. With it the gap above the noise floor shrinks by {shares}, "
        f"{on}; model.toml holds it."
    )


def step_sentences(found: Diagnosis) -> list[str]:
    """How far the gap shrinks as effects are added one by one, where there are several."""
    if not found.stepwise:
        return []
    steps = [f"{each.effects[-1]} {_shrunk_by(found, each.gap)}" for each in found.stepwise]
    return [f"Added one by one, each fitted anew: {'; then '.join(steps)}."]


def _shrunk_by(found: Diagnosis, gaps: Mapping[str, Gap] | None = None) -> str:
    gaps = found.gap if gaps is None else gaps
    return ", ".join(
        f"{channel} {shrinkage_in_words(gap)}" for channel, gap in gaps.items() if gap.is_reducible
    )


def _measured_on(found: Diagnosis, what: str) -> str:
    if len(group_by_condition(found.dataset.runs)) > 1:
        return f"on runs left out while {what} found"
    return f"on the very runs that {what} found on, which flatters it"


def parameter_sentences(found: Diagnosis) -> list[str]:
    """The effects' numbers with errors and units."""
    head = ""
    if found.verdict == (UNKNOWN,) and found.parameters:
        head = "the likeliest effect that is known, which does not explain the runs: "
    return [
        f"{head}{name}: "
        + ", ".join(f"{key} = {estimate_in_words(each)}" for key, each in numbers.items())
        for name, numbers in found.parameters.items()
    ]


def next_sentences(found: Diagnosis) -> list[str]:
    """What to run next, so that what cannot be told apart can be."""
    advice = dict[str, Any](found.next_run)
    if not advice:
        return []
    first, *others = (" with ".join(map(_worded, each.split("+"))) for each in advice["tells"])
    second = " and from ".join(others)
    ways = []
    for key, words in (("run", "run {run}"), ("channel", "record {channel} on {run}")):
        way = advice.get(key)
        if isinstance(way, dict):
            ways.append(
                f"{words.format(**way)}, where {way['channel']} differs by "
                f"{way['difference']:.3g} {way['unit']} ({way['floors']:.1f} noise floors)"
            )
    if not ways:
        return [f"No variation of these runs would tell {first} from {second}."]
    return [f"To tell {first} from {second}: {'; or '.join(ways)}."]


# Tables -------------------------------------------------------------------------------------------


def gap_rows(found: Diagnosis) -> list[tuple[str, ...]]:
    """By channel: unit, before, after, floor, both in floors, shrinkage and its interval."""
    rows = []
    for channel, gap in found.gap.items():
        unit, scale = SHOWN[channel]
        rows.append(
            (
                f"{channel} [{unit}]",
                f"{gap.before * scale:.3f}",
                f"{gap.after * scale:.3f}",
                f"{gap.floor * scale:.3f}",
                f"{gap.before / gap.floor:.1f} → {gap.after / gap.floor:.1f}",
                shrinkage_in_words(gap) if found.selected.effects else "-",
            )
        )
    return rows


GAP_COLUMNS = ("gap", "before", "after", "noise floor", "in floors", "shrinkage (90 %)")


def gap_table(found: Diagnosis) -> Table:
    """The gap before and after, against the noise floor."""
    table = Table()
    for name in GAP_COLUMNS:
        table.add_column(name, justify="left" if name == "gap" else "right")
    for row in gap_rows(found):
        table.add_row(*map(escape, row))
    return table


def run_rows(found: Diagnosis) -> list[tuple[str, ...]]:
    """By run: name, title, duration, zeta, and the gap before and after by channel."""
    rows = []
    for number, each in enumerate(found.dataset.runs):
        zeta = float(each.setup.terrain.zeta) * np.exp(found.selected.matches[number].log_zeta)  # pyright: ignore
        cells = [
            _rms_pair(
                found.residual_before[number][place], found.selected.after[number][place], channel
            )
            for place, channel in enumerate(found.dataset.channels)
        ]
        time = found.dataset.time(number)
        duration = f"{len(time) * found.dataset.sample_interval(number):.1f}"
        rows.append(
            (each.name, replace_unprintable(each.setup.title), duration, f"{zeta:.4f}", *cells)
        )
    return rows


def _rms_pair(before: np.ndarray, after: np.ndarray, channel: str) -> str:
    _, scale = SHOWN[channel]
    if not np.isfinite(before).any():
        return "not recorded"
    first, last = (scale * float(np.sqrt(np.nanmean(np.square(v)))) for v in (before, after))
    return f"{first:.3f} → {last:.3f}"


def run_columns(found: Diagnosis) -> tuple[str, ...]:
    channels = (f"{c} [{SHOWN[c][0]}]" for c in found.dataset.channels)
    return ("run", "title", "compared [s]", "zeta", *channels)


# Files --------------------------------------------------------------------------------------------


def page(found: Diagnosis) -> str:
    """The report: one page that needs nothing else."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("diagnose.report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("report.html").render(
        version=__version__,
        names=[each.name for each in found.dataset.runs],
        verdict=verdict(found),
        sentences=[
            *group_sentences(found),
            *gap_sentences(found),
            *(
                [location.localization_sentence(found.localization)]
                if found.verdict != (NONE,)
                else []
            ),
        ],
        glance=as_source(at_a_glance(found)),
        weights=as_source(weights(found)),
        residuals=as_source(residuals(found)),
        gap_columns=GAP_COLUMNS,
        gap_rows=gap_rows(found),
        added="the effect" if found.correction is None else "the correction",
        run_columns=run_columns(found),
        run_rows=run_rows(found),
        where=found.localization,
        parameters=_parameter_rows(found),
        unknown=found.verdict == (UNKNOWN,),
        signal=_signal(found),
        next=next_sentences(found),
        notes=found.notes,
    )


def _signal(found: Diagnosis) -> dict[str, Any] | None:
    """What an effect that nobody has written looks like, for the page."""
    if found.unknown_effect is None:
        return None
    offered = found.correction
    rows = []
    if offered is not None:
        knots, values = (np.asarray(v) for v in (offered.effect.knots, offered.effect.values()))
        rows = [(f"{a:.4g}", f"{b:.4g}") for a, b in zip(knots, values, strict=True)]
    return {
        "sentences": found.unknown_effect.sentences(offered is not None),
        "figure": as_source(unknown_signal(found, found.unknown_effect)),
        "correction": offered,
        "variable_unit": "" if offered is None else VARIABLES[offered.effect.variable],
        "rows": rows,
    }


def _parameter_rows(found: Diagnosis) -> list[Sequence[str]]:
    return [
        (name, found.meaning(name), key, estimate_in_words(each))
        for name, numbers in found.parameters.items()
        for key, each in numbers.items()
    ]


def write(found: Diagnosis, folder: Path) -> list[Path]:
    """Write diagnosis.json, model.toml and report.html.

    Raises:
        InputError: where one cannot be written, or would replace a set-up that somebody wrote.
    """
    document, model, report = (
        folder / name for name in ("diagnosis.json", "model.toml", "report.html")
    )
    numbers, setup, shown = as_json(found.document()), model_toml(found), page(found)
    make_folder(folder)
    # First, as it may be refused: all three stay as they were then.
    replace_own_setup(model, setup, MARK)
    replace_file(document, numbers)
    replace_file(report, shown.encode())
    return [document, model, report]
