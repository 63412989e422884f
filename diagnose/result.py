"""The result of a diagnosis: verdict, gaps, numbers of the effects; summary, figure and files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import jax
import numpy as np

from diagnose.dataset import RigDataset
from diagnose.drive_error import DriveError
from diagnose.gap.budget import Budget
from diagnose.gap.gap import Gap
from diagnose.gap.one_zeta import ZetaShare
from diagnose.gap.selected_effects import SelectedEffects
from diagnose.gap.stepwise import NestedModel
from diagnose.hypotheses.hypothesis import Hypothesis
from diagnose.hypotheses.screening import ScreeningResult
from diagnose.linear.bed import AbstractBed
from diagnose.localization.shares import GapShare
from diagnose.unknown.correction_fit import Correction, UnknownEffect
from drftjax.common.packages import optional_package
from drftjax.common.rich_text import summary_html, summary_text
from drftjax.common.text import value_with_error
from drftjax.effects.catalogue import effect_class, field_metadata, reported_name
from drftjax.recorded.observation import SHOWN
from drftjax.results.provenance import Provenance

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

# Version 2 adds `budget` and `gap_one_zeta`, and `weights` of names that take part in a verdict of
# several effects; every entry of version 1 means what it meant.
SCHEMA, SCHEMA_VERSION = "drft-diagnosis", 2


@dataclass(frozen=True)
class ParameterEstimate:
    """A fitted number of an effect.

    Attributes:
        value, error: The number and its standard error, in `unit`.
        unit: Unit of both; "-" for none.
    """

    value: float
    error: float
    unit: str


def parameter_estimates(
    chosen: Hypothesis, errors: np.ndarray
) -> dict[str, dict[str, ParameterEstimate]]:
    """The numbers of a hypothesis's effects, by effect and field.

    Args:
        chosen: The hypothesis.
        errors: Standard errors of its coordinates, shape (free,).
    """
    found: dict[str, dict[str, ParameterEstimate]] = {}
    for free, at, spread in zip(chosen.model.free, chosen.coordinates, errors, strict=True):
        effect = chosen.model.effects[free.index]
        value = float(free.value(at))
        scale = free.scale if free.scale is not None else value
        fields = found.setdefault(reported_name(effect.about.name), {})
        unit = field_metadata(effect)[free.field]["unit"]
        fields[free.field] = ParameterEstimate(value, float(scale * spread), unit)
    return found


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis:
    """Effects that explain the runs of one rig, and the gap without and with them.

    Attributes:
        verdict: Effects that explain the runs, or ("none",), or ("unknown",).
        weights: Weight of each effect, of none and of unknown [-].
        groups: For each name of the verdict, names that these runs cannot tell from it, the most
            probable first.
        selected: Effects of model.toml: the verdict's, or a correction that is a form of one.
            Where the verdict is unknown, the most probable listed effect or a correction, if either
            helps.
        parameters: Numbers of the selected effects, by effect and field; none of a correction.
        notes: Caveats and reasons, in sentences.
        next_run: Run or channel that would tell the group apart; empty where there is no need.
        screening: All hypotheses that were screened.
        chosen: The hypothesis behind the verdict: the reference model for none, the most probable
            listed effect for unknown.
        residual_before: By run, simulated minus recorded by the reference model at matched zeta
            [m, N, N m], shape (channels, samples).
        floors: Noise floor of each channel [m, N, N m].
        localization: Shares of the gap by axis.
        unknown_effect: The simplest unknown signal, where the verdict is unknown.
        stepwise: The gap as effects are added one by one; empty where there are not two.
        budget: By channel, the gap divided by the verdict's effects, a remainder and chance.
        one_zeta_gap: By channel, the gap with one zeta for the bed, without and with the effects
            behind the verdict, on held-out runs.
        zeta_shares: By effect, the share of it that another zeta would make up for.
        drive: Error of the drive; None where not every run has a measured speed of the wheel.
        provenance: Its inputs, its command line, and what it was made with.
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
    budget: Budget = field(default_factory=dict)
    one_zeta_gap: Mapping[str, Gap] = field(default_factory=dict)
    zeta_shares: Mapping[str, ZetaShare] = field(default_factory=dict)
    drive: DriveError | None = None
    provenance: Provenance | None = None

    @property
    def dataset(self) -> RigDataset:
        """The runs that were diagnosed."""
        return self.screening.regressors.dataset

    @property
    def origin(self) -> float | None:
        """Recorded x of the effects' x = 0 [m]; None where x is as recorded."""
        return self.dataset.runs[0].setup.start.origin

    @property
    def bed(self) -> AbstractBed:
        """Scatter of zeta between the runs, after what repeats say."""
        return self.screening.regressors.settings.bed

    @property
    def gap(self) -> Mapping[str, Gap]:
        """By channel, the gap without and with the selected effects, on held-out runs."""
        return self.selected.gap

    @property
    def correction(self) -> Correction | None:
        """The correction, where it is selected in the place of an unlisted mechanism."""
        tried = None if self.unknown_effect is None else self.unknown_effect.best_correction
        return tried if tried is not None and tried.selection is self.selected else None

    def group_of(self, name: str) -> Sequence[str]:
        """An effect of the verdict with those that it trades places with, itself first."""
        own = reported_name(name)
        return next((each for each in self.groups if each and each[0] == own), [own])

    def meaning(self, name: str) -> str:
        """Meaning of an effect of the verdict, also of one of the user's that no catalogue has."""
        given = {each.effect.about.name: each.effect for each in self.screening.regressors.variants}
        return (given.get(name) or effect_class(name)).about.meaning

    def summary(self, width: int = 110) -> str:
        """Verdict, gaps and reasons in words, as text of `width` columns."""
        from diagnose.report.text import in_words

        return summary_text(in_words(self), width)

    def __repr__(self) -> str:
        named = (
            f"{name} (weight {self.weights[name]:.2f})" if name in self.weights else name
            for name in self.verdict
        )
        numbers = (
            f"{name}.{field} = {value_with_error(n.value, n.error)}"
            + f" {n.unit}" * (n.unit != "-")
            for name, fields in self.parameters.items()
            for field, n in fields.items()
        )
        gaps = (
            f"gap of {channel} {scale * gap.before:.3g} → {scale * gap.after:.3g} {unit}"
            for channel, gap in self.gap.items()
            for unit, scale in [SHOWN[channel]]
        )
        told = ", ".join([*named, *numbers, *gaps])
        return f"<Diagnosis of {len(self.dataset.runs)} runs: {told}>"

    def to_dataframe(self) -> "pandas.DataFrame":
        """Weight of each explanation, and whether it is in the verdict, the heaviest first.

        Raises:
            InputError: pandas is not installed.
        """
        pandas = optional_package("pandas", "to_dataframe")
        rows = [(weight, name in self.verdict) for name, weight in self.weights.items()]
        index = pandas.Index([*self.weights], name="explanation")
        frame = pandas.DataFrame(rows, index, ["weight", "in_verdict"])
        return frame.sort_values("weight", ascending=False, kind="stable")

    def to_xarray(self) -> "xarray.Dataset":
        """Weights, fitted numbers with their errors, and gaps, each along a dimension of its own.

        The gaps and the noise floor are in the units of their channels [m, N, N m].

        Raises:
            InputError: xarray is not installed.
        """
        xarray = optional_package("xarray", "to_xarray")
        numbers = {
            f"{name}.{field}": each
            for name, fields in self.parameters.items()
            for field, each in fields.items()
        }
        gaps = [*self.gap.values()]
        return xarray.Dataset(
            {
                "weight": ("explanation", [*self.weights.values()]),
                "value": ("parameter", [each.value for each in numbers.values()]),
                "error": ("parameter", [each.error for each in numbers.values()]),
                "gap_before": ("channel", [each.before for each in gaps]),
                "gap_after": ("channel", [each.after for each in gaps]),
                "noise_floor": ("channel", [each.floor for each in gaps]),
            },
            {
                "explanation": [*self.weights],
                "parameter": [*numbers],
                "unit": ("parameter", [each.unit for each in numbers.values()]),
                "channel": [*self.gap],
            },
            {"verdict": ", ".join(self.verdict)},
        )

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
        from diagnose.report.page import write

        with jax.enable_x64(True):
            return write(self, Path(folder))

    def document(self) -> dict:
        """The diagnosis as plain values, in the layout of diagnosis.json."""
        return {
            "schema": SCHEMA,
            "schema_version": SCHEMA_VERSION,
            "provenance": None if self.provenance is None else self.provenance.document(),
            "verdict": list(self.verdict),
            "weights": dict(self.weights),
            "groups": [list(group) for group in self.groups],
            "gap": {channel: gap.document() for channel, gap in self.gap.items()},
            "steps": [each.document() for each in self.stepwise],
            "budget": {"channels": {name: each.document() for name, each in self.budget.items()}},
            "gap_one_zeta": {name: gap.document() for name, gap in self.one_zeta_gap.items()},
            "bed": {
                "rule": type(self.bed).__name__,
                "scatter": self.bed.scatter,
                "made_up_by_zeta": {
                    name: {"each_run": each.own, "one_for_all": each.bed}
                    for name, each in self.zeta_shares.items()
                },
            },
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
            "drive": None if self.drive is None else self.drive.document(),
            "correction": None if self.correction is None else self.correction.document(),
            "next_run": dict(self.next_run),
            "notes": list(self.notes),
        }
