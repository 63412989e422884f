"""Diagnosis: verdict, gaps, numbers of the effects; summary, figure and files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import jax
import numpy as np

from diagnose.dataset import RigDataset
from diagnose.gap.gap import Gap
from diagnose.gap.selected_effects import SelectedEffects
from diagnose.gap.stepwise import NestedModel
from diagnose.hypotheses.hypothesis import Hypothesis
from diagnose.hypotheses.screening import ScreeningResult
from diagnose.localization.shares import GapShare
from diagnose.unknown.correction_fit import Correction, UnknownEffect
from drftjax.common.rich_text import summary_html, summary_text
from drftjax.effects.catalogue import effect_class

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCHEMA = "drft-diagnosis"


@dataclass(frozen=True)
class ParameterEstimate:
    """A fitted number of an effect.

    Attributes:
        value, error: The number and its standard error, in `unit`.
        unit: "-" for none.
    """

    value: float
    error: float
    unit: str


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis:
    """What was found.

    Attributes:
        verdict: Effects that explain the runs, or ("none",), or ("unknown",).
        weights: Weight of each effect, of none and of unknown.
        groups: Names that these runs cannot tell apart, the likeliest first.
        added: What shrinks the gap, as model.toml holds it: the verdict's effects, or a curve that
            is one of another form than the list's. Where the verdict is unknown, the likeliest
            effect known or a correction, if either helps.
        steps: The same as two effects are added one by one; empty where there are not two.
        parameters: Numbers of the effects added, by effect and field; none of a correction.
        notes: What else must be known, in sentences.
        next_run: What would tell the group apart; empty where nothing need be.
        found: The search behind it.
        chosen: The hypothesis that the verdict stands for: the reference model for none, the
            likeliest effect known for unknown.
        before: By run, simulated less recorded by the reference model with the zeta that meets the
            run's mean sinkage, shape (channels, samples).
        floors: Noise floor of each channel [m, N, N m].
        where: Shares of the gap by axis.
        unwritten: What an effect that explains the runs looks like, where no form of the list does.
    """

    verdict: tuple[str, ...]
    weights: Mapping[str, float]
    groups: Sequence[Sequence[str]]
    selected: SelectedEffects
    parameters: Mapping[str, Mapping[str, ParameterEstimate]]
    notes: Sequence[str]
    next_run: Mapping[str, object]
    screening: ScreeningResult
    chosen: Hypothesis
    residual_before: list[np.ndarray]
    floors: Mapping[str, float]
    localization: Sequence[GapShare] = field(default_factory=list)
    unknown_effect: UnknownEffect | None = None
    stepwise: Sequence[NestedModel] = field(default_factory=list)

    @property
    def dataset(self) -> RigDataset:
        return self.screening.regressors.dataset

    @property
    def origin(self) -> float | None:
        """Recorded x that the effects' x = 0 stands for [m]; None where x is as recorded."""
        return self.dataset.runs[0].setup.start.origin

    @property
    def gap(self) -> Mapping[str, Gap]:
        """Before, and after with what is added, on runs left out, by channel."""
        return self.selected.gap

    @property
    def correction(self) -> Correction | None:
        """The curve that is added in the place of an effect that nobody has written."""
        tried = None if self.unknown_effect is None else self.unknown_effect.tried
        return tried if tried is not None and tried.added is self.selected else None

    def meaning(self, name: str) -> str:
        """What an effect of the verdict does; it may be of the user's own and in no catalogue."""
        given = {each.effect.about.name: each.effect for each in self.screening.regressors.variants}
        return (given.get(name) or effect_class(name)).about.meaning

    def summary(self, width: int = 110) -> str:
        """Verdict, gaps and all else in words, as text so many columns wide."""
        from diagnose.report.text import in_words

        return summary_text(in_words(self), width)

    def __repr__(self) -> str:
        return f"<Diagnosis of {len(self.dataset.runs)} runs: {', '.join(self.verdict)}>"

    def _repr_html_(self) -> str:
        from diagnose.report.text import in_words

        return summary_html(in_words(self))

    def plot(self) -> "Figure":
        """The gap before and after against the noise floor, and where it lies."""
        from diagnose.report.figures import at_a_glance

        return at_a_glance(self)

    def write(self, folder: str | Path) -> list[Path]:
        """Write diagnosis.json, model.toml and report.html, as `drft diagnose -o` does.

        Raises:
            InputError: where one cannot be written.
        """
        from diagnose.report.text import write

        with jax.enable_x64(True):
            return write(self, Path(folder))

    def document(self) -> dict:
        """The diagnosis as plain values, in the layout of diagnosis.json."""
        return {
            "schema": SCHEMA,
            "schema_version": 1,
            "verdict": list(self.verdict),
            "weights": dict(self.weights),
            "groups": [list(group) for group in self.groups],
            "gap": {channel: gap.document() for channel, gap in self.gap.items()},
            "steps": [each.document() for each in self.stepwise],
            "where": [
                {
                    "axis": each.axis,
                    "label": each.label,
                    "share": each.share,
                    "interval": list(each.interval),
                }
                for each in self.localization
            ],
            "parameters": {
                name: {
                    number: {"value": n.value, "error": n.error, "unit": n.unit}
                    for number, n in fields.items()
                }
                for name, fields in self.parameters.items()
            },
            "correction": None if self.correction is None else self.correction.document(),
            "next_run": dict(self.next_run),
            "notes": list(self.notes),
        }
