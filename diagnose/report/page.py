"""The report page of a diagnosis, and the files of its folder."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from diagnose.localization.localization import localization_sentence
from diagnose.report.budget_text import (
    budget_columns,
    budget_rows,
    effect_sentences,
    one_zeta_sentence,
    remainder_sentence,
    zeta_sentence,
)
from diagnose.report.figures import (
    CHANNEL_NAMES,
    as_source,
    at_a_glance,
    residuals,
    unknown_signal,
    weights,
)
from diagnose.report.model_writer import MODEL_FILE_MARK, estimate_in_words, model_toml
from diagnose.report.text import (
    GAP_COLUMNS,
    drive_sentences,
    gap_rows,
    gap_sentences,
    group_sentences,
    next_sentences,
    run_columns,
    run_rows,
    run_sentence,
    verdict,
)
from diagnose.result import Diagnosis
from diagnose.selection.model_weights import NONE, UNKNOWN
from drftjax.common.output_files import make_folder, replace_file
from drftjax.common.structured_files import as_json
from drftjax.effects.correction import VARIABLES
from drftjax.recorded.observation import SHOWN
from drftjax.report_page.page import render_page
from drftjax.report_page.run_curves import CurveLabels, RunCurves, RunPanels, channel_panel
from drftjax.setups.generated_files import replace_own_setup


@dataclass(frozen=True)
class BudgetBarSettings:
    """Sizes of the bars of the budget.

    Attributes:
        colours: Effects with a colour of their own: as many as a diagnosis names at most. Further
            ones begin again.
    """

    colours: int = 6


DEFAULT_BUDGET_BARS = BudgetBarSettings()

CHANCE_CLASS, UNEXPLAINED_CLASS = "chance", "unexplained"
"""Classes of the style sheet beside those of the effects, part-0, part-1, ..."""


class BarPart(NamedTuple):
    """Part of a bar.

    Attributes:
        label: Name of what makes it.
        style: Class of the style sheet.
        start, width: In percent of the bar [%].
    """

    label: str
    style: str
    start: float
    width: float


class BudgetBar(NamedTuple):
    """Gap of one channel, divided.

    Attributes:
        title: The channel with the size of its gap.
        parts: From left to right.
    """

    title: str
    parts: Sequence[BarPart]


def budget_bars(
    found: Diagnosis, settings: BudgetBarSettings = DEFAULT_BUDGET_BARS
) -> list[BudgetBar]:
    """Bars of each channel's gap, divided into chance, effects and what is unexplained."""
    names = list(dict.fromkeys(name for each in found.budget.values() for name in each.effects))
    bars = []
    for channel, budget in found.budget.items():
        unit, scale = SHOWN[channel]
        sizes = [("chance (noise floor)", CHANCE_CLASS, min(budget.floor, budget.before))]
        for number, name in enumerate(names):
            style = f"part-{number % settings.colours}"
            sizes.append((" or ".join(found.group_of(name)), style, budget.effects[name].size))
        excess = max(budget.before - budget.floor, 0.0)
        sizes.append(("unexplained", UNEXPLAINED_CLASS, budget.remainder * excess))
        parts, start = [], 0.0
        # What makes the gap larger has no width; the others are shares of what all add up to.
        whole = max(sum(max(size, 0.0) for *_, size in sizes), 1e-300)
        for label, style, size in sizes:
            width = 100 * max(size, 0.0) / whole
            parts.append(BarPart(label, style, start, width))
            start += width
        title = f"{CHANNEL_NAMES[channel]}: gap {budget.before * scale:.3g} {unit}"
        bars.append(BudgetBar(title, parts))
    return bars


def recorded_and_simulated(found: Diagnosis) -> RunCurves:
    """Curves of every run: recorded, by the reference model, and with what was found."""
    dataset = found.dataset
    added = bool(found.selected.effects)
    after = found.selected.after if added else None
    runs = []
    for number, run in enumerate(dataset.runs):
        recording, before = dataset.recording(number), found.residual_before[number]
        panels = [
            channel_panel(
                channel,
                *SHOWN[channel],
                recorded=recording[place],
                before=before[place],
                after=None if after is None else after[number][place],
                floor=found.floors[channel],
            )
            for place, channel in enumerate(dataset.channels)
            if np.isfinite(recording[place]).any()
        ]
        # Sinkage first: it is what the sand's model is about.
        panels.sort(key=lambda panel: not panel.downward)
        runs.append(RunPanels(run.name, dataset.logged_time(number), panels))
    return RunCurves(runs, CurveLabels(before="reference model", after=f"with {_added(found)}"))


def _added(found: Diagnosis) -> str:
    """Words for what is added to the reference model."""
    if found.correction is not None:
        return "the correction"
    return "the effects" if len(found.selected.effects) > 1 else "the effect"


def page(found: Diagnosis) -> str:
    """The report as one HTML page that refers to no other file."""
    return render_page(
        "diagnose.report",
        "report.html",
        recorded_and_simulated(found),
        names=[each.name for each in found.dataset.runs],
        verdict=verdict(found),
        bars=budget_bars(found),
        budget_columns=budget_columns(found),
        budget_rows=budget_rows(found),
        effects=[*drive_sentences(found), *effect_sentences(found)],
        sentences=[
            *filter(None, [remainder_sentence(found)]),
            *group_sentences(found),
            *gap_sentences(found),
            *filter(None, [one_zeta_sentence(found), run_sentence(found)]),
            *([localization_sentence(found.localization)] if found.verdict != (NONE,) else []),
        ],
        glance=as_source(at_a_glance(found)),
        weights=as_source(weights(found)),
        residuals=as_source(residuals(found)),
        gap_columns=GAP_COLUMNS,
        gap_rows=gap_rows(found),
        added=_added(found),
        run_columns=run_columns(found),
        run_rows=run_rows(found),
        where=found.localization,
        parameters=_parameter_rows(found),
        unknown=found.verdict == (UNKNOWN,),
        signal=_signal(found),
        next=next_sentences(found),
        notes=[note for note in (*found.notes, zeta_sentence(found)) if note],
    )


def _signal(found: Diagnosis) -> dict[str, Any] | None:
    """The disturbance and the correction, for the page; None where none was sought."""
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
    replace_own_setup(model, setup, MODEL_FILE_MARK)
    replace_file(document, numbers)
    replace_file(report, shown.encode())
    return [document, model, report]
