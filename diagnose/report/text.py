"""A diagnosis in words: sentences and tables for a terminal, and the files of its folder."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from rich.markup import escape

from diagnose.checks.outlier_runs import REPEATS_DIFFER
from diagnose.gap.gap import Gap
from diagnose.localization.localization import localization_sentence
from diagnose.report.budget_text import (
    budget_table,
    effect_sentences,
    one_zeta_sentence,
    remainder_sentence,
    zeta_sentence,
)
from diagnose.report.model_writer import estimate_in_words
from diagnose.result import Diagnosis
from diagnose.selection.model_weights import NONE, UNKNOWN, percent
from drftjax.common.rich_text import WholeWordTable
from drftjax.common.structured_files import as_json
from drftjax.common.text import replace_unprintable
from drftjax.effects.catalogue import reported_names
from drftjax.recorded.observation import SHOWN
from drftjax.recorded.repeats import group_by_condition
from drftjax.results.advice import NextRunAdvice, worded


@dataclass(frozen=True)
class ReportSettings:
    """Thresholds of the sentences.

    Attributes:
        min_floors: The reference model misses the runs by far where the gap of a channel is so many
            noise floors [-].
        sure_weight: Of three effects and more the smallest weight is told where it is below this
            [-].
        min_weight: Smaller weights are left out of the list of weights [-].
        most_of_gap: Runs are named that hold this share of the gap [-].
        max_named_runs: Of these, so many at most.
        min_concentration: They are named where they hold so many times more of the gap than of the
            time [-].
    """

    min_floors: float = 3.0
    sure_weight: float = 0.9
    min_weight: float = 0.01
    most_of_gap: float = 0.6
    max_named_runs: int = 3
    min_concentration: float = 1.5


DEFAULT_REPORT = ReportSettings()


def in_words(
    found: Diagnosis, settings: ReportSettings = DEFAULT_REPORT
) -> list[WholeWordTable | str]:
    """The whole diagnosis as sentences and tables, from top to bottom."""
    return [
        verdict(found, settings),
        budget_table(found),
        gap_table(found),
        *paragraphs(found, settings),
    ]


def verdict(found: Diagnosis, settings: ReportSettings = DEFAULT_REPORT) -> str:
    """The verdict in one or two sentences."""
    weight = certainty_in_words(found)
    alone = len(found.dataset.runs) == 1
    runs = "this run" if alone else "these runs"
    if found.verdict == (NONE,):
        if missed := _large_gaps(found, settings.min_floors):
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
    if len(found.verdict) > 2:
        told = f"These runs show {len(found.verdict)} effects at once: {_listed(found.verdict)}"
        if weight < settings.sure_weight:
            told += f", the least sure of them with weight {percent(weight)}"
        return f"{told}."
    effects = " and ".join(f"{name} ({found.meaning(name)})" for name in found.verdict)
    if alone:
        return (
            f"This run looks like {effects}, with weight {percent(weight)}; one run alone "
            "describes and does not prove."
        )
    return f"These runs show {effects}, with weight {percent(weight)}."


def _listed(names: Sequence[str]) -> str:
    """Names with commas between, and "and" before the last."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _large_gaps(found: Diagnosis, min_floors: float) -> str:
    """Channels whose gap is large, with its size; empty for none."""
    floors = {channel: gap.before / gap.floor for channel, gap in found.gap.items() if gap.floor}
    return " and ".join(
        f"{size:.0f} noise floors in {channel}"
        for channel, size in floors.items()
        if size >= min_floors
    )


def certainty_in_words(found: Diagnosis) -> float:
    """Weight of the verdict; of two effects, the smaller one [-]."""
    return min(found.weights.get(name, 0.0) for name in found.verdict)


def paragraphs(found: Diagnosis, settings: ReportSettings = DEFAULT_REPORT) -> list[str]:
    """The rest of the diagnosis, in sentences."""
    weighty = [each for each in found.weights.items() if each[1] >= settings.min_weight]
    lines = [*drive_sentences(found), *effect_sentences(found), remainder_sentence(found)]
    lines += group_sentences(found)
    lines += gap_sentences(found)
    lines.append(one_zeta_sentence(found))
    if found.verdict != (NONE,):
        lines.append(run_sentence(found))
        lines.append(localization_sentence(found.localization))
    if found.verdict == (UNKNOWN,):
        lines += parameter_sentences(found)
    lines.append("weights: " + ", ".join(f"{name} {percent(weight)}" for name, weight in weighty))
    lines = [each for each in lines if each]
    lines += [f"note: {note}" for note in (*found.notes, zeta_sentence(found)) if note]
    lines += next_sentences(found)
    return lines


def drive_sentences(found: Diagnosis) -> list[str]:
    """Error of the drive by the wheel's measured speed, in sentences; empty without one."""
    return [] if found.drive is None else found.drive.sentences()


def group_sentences(found: Diagnosis) -> list[str]:
    """Effects that these runs cannot tell apart, in sentences."""
    sentences = []
    for group in found.groups:
        first, others = group[0], " or ".join(map(worded, group[1:]))
        alone = len(found.dataset.runs) == 1
        runs, rule = ("this run", "rules") if alone else ("these runs", "rule")
        if others and first == NONE:
            sentences.append(f"What {runs} {rule} out least: {others}.")
        elif others:
            sentences.append(f"{runs.capitalize()} cannot tell {worded(first)} from {others}.")
    return sentences


def shrinkage_in_words(gap: Gap) -> str:
    """Shrinkage of a gap, with its interval where there is one."""
    if not gap.is_reducible:
        return "at the floor"
    if gap.interval is None:
        return f"{gap.shrinkage:.0%}"
    low, high = gap.interval
    return f"{gap.shrinkage:.0%} ({low:.0%} to {high:.0%})"


def run_sentence(found: Diagnosis, settings: ReportSettings = DEFAULT_REPORT) -> str:
    """The runs that hold most of the gap; empty where it is spread."""
    runs = sorted((e for e in found.localization if e.axis == "run"), key=lambda each: -each.share)
    if len(runs) < 2:
        return ""
    named, total = [], 0.0
    for each in runs[: settings.max_named_runs]:
        named.append(f"{each.label} ({each.share:.0%})")
        total += each.share
        if total >= settings.most_of_gap:
            time = sum(e.time for e in runs[: len(named)])
            if total < settings.min_concentration * time:
                return ""
            return f"{total:.0%} of the gap is in {' and '.join(named)}."
    return ""


def gap_sentences(found: Diagnosis) -> list[str]:
    """Shrinkage of the gap, and the runs on which it was measured, in sentences."""
    if found.verdict == (NONE,):
        return []
    if found.verdict == (UNKNOWN,):
        return [_substitute_sentence(found)]
    effects = _listed(found.verdict)
    shares = _shrunk_by(found)
    on = _measured_on(found, "its curve was" if found.correction else "the effect's numbers were")
    if not shares:
        return [f"There is no gap above the noise floor that {effects} could shrink."]
    return [
        f"With {effects} the gap above the noise floor shrinks by {shares}, {on}.",
        *step_sentences(found),
    ]


def _substitute_sentence(found: Diagnosis) -> str:
    """The model offered in place of an unknown effect, and how far the gap shrinks with it."""
    if not found.selected.effects:
        return "Nothing tried in its place shrinks the gap; model.toml holds the reference model."
    if found.correction is not None:
        effect, on = found.correction.effect, _measured_on(found, "its curve was")
        what = f"a correction of {effect.stage} over {effect.variable}, fitted to these runs"
    else:
        on = _measured_on(found, "the effect's numbers were")
        what = f"{_listed(reported_names(found.chosen.names))}, the likeliest of what is known"
    shares = _shrunk_by(found) or "little in any one channel"
    return (
        f"Offered in its place: {what}. With it the gap above the noise floor shrinks by {shares}, "
        f"{on}; model.toml holds it."
    )


def step_sentences(found: Diagnosis) -> list[str]:
    """Shrinkage as two effects are added one by one; empty without two."""
    if not found.stepwise:
        return []
    steps = [f"{each.effects[-1]} {_shrunk_by(found, each.gap)}" for each in found.stepwise]
    return [f"Added one by one, each fitted again: {'; then '.join(steps)}."]


def _shrunk_by(found: Diagnosis, gaps: Mapping[str, Gap] | None = None) -> str:
    """Shrinkage of every reducible gap."""
    gaps = found.gap if gaps is None else gaps
    return ", ".join(
        f"{channel} {shrinkage_in_words(gap)}" for channel, gap in gaps.items() if gap.is_reducible
    )


def _measured_on(found: Diagnosis, what: str) -> str:
    """Runs on which the shrinkage was measured; `what` ends in a verb."""
    if len(group_by_condition(found.dataset.runs)) > 1:
        return f"on held-out runs while {what} found"
    return f"on the same runs that {what} found on, which overstates it"


def parameter_sentences(found: Diagnosis) -> list[str]:
    """Numbers of the effects with standard errors and units, in sentences."""
    head = ""
    if found.verdict == (UNKNOWN,) and found.parameters:
        head = "the likeliest effect that is known, which does not explain the runs: "
    return [
        f"{head}{name}: "
        + ", ".join(f"{key} = {estimate_in_words(each)}" for key, each in numbers.items())
        for name, numbers in found.parameters.items()
    ]


def next_sentences(found: Diagnosis) -> list[str]:
    """The run or channel that would tell the hypotheses apart, in one sentence."""
    # By way of the file's layout: its numbers may be NumPy's.
    advice = msgspec.json.decode(as_json(dict(found.next_run)), type=NextRunAdvice)
    return advice.sentences()


# Tables -------------------------------------------------------------------------------------------


def gap_rows(found: Diagnosis) -> list[tuple[str, ...]]:
    """Rows of the table of gaps: channel, before, after, floor, both in floors, shrinkage."""
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


def gap_table(found: Diagnosis) -> WholeWordTable:
    """Table of the gap before and after, against the noise floor."""
    table = WholeWordTable()
    for name in GAP_COLUMNS:
        table.add_column(name, justify="left" if name == "gap" else "right")
    for row in gap_rows(found):
        table.add_row(*map(escape, row))
    return table


def run_rows(found: Diagnosis) -> list[tuple[str, ...]]:
    """Rows of the table of runs: name, title, duration, zeta, gap before and after by channel."""
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
    """Headings of the table of runs."""
    channels = (f"{c} [{SHOWN[c][0]}]" for c in found.dataset.channels)
    return ("run", "title", "compared [s]", "zeta", *channels)
