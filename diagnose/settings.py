"""Decision numbers of a diagnosis, in one object that `drftjax.diagnose` takes.

    settings = DiagnosisSettings(weights=WeightSettings(log_prior_unknown=0.0))
    found = drftjax.diagnose("data/blind/demo", settings=settings)

Each part documents its numbers, their units and the reason for them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from diagnose.checks.outlier_runs import DEFAULT_OUTLIER_RUNS, OutlierRunSettings
from diagnose.dataset import DEFAULT_DATASET, DatasetSettings
from diagnose.gap.budget import DEFAULT_BUDGET, BudgetSettings
from diagnose.gap.discretization_error import DEFAULT_DISCRETIZATION, DiscretizationSettings
from diagnose.gap.gap import DEFAULT_GAP, GapSettings
from diagnose.gap.selected_effects import DEFAULT_EFFECT_SELECTION, EffectSelectionSettings
from diagnose.gap.standard_errors import DEFAULT_STANDARD_ERROR, StandardErrorSettings
from diagnose.hypotheses.settings import DEFAULT_SCREENING, ScreeningSettings
from diagnose.linear.bed import AbstractBed
from diagnose.linear.linear_fit import LinearFitSettings
from diagnose.localization.settings import DEFAULT_LOCALIZATION, LocalizationSettings
from diagnose.next_runs.discrimination import DEFAULT_NEXT_RUN, NextRunSettings
from diagnose.selection.model_weights import DEFAULT_WEIGHTS, WeightSettings
from diagnose.selection.verdict import DEFAULT_VERDICT, VerdictSettings
from diagnose.unknown.correction_fit import CorrectionStepSettings
from diagnose.unknown.settings import DEFAULT_UNKNOWN_EFFECT, UnknownEffectSettings


@dataclass(frozen=True)
class HeldOutSettings:
    """Number of hypotheses whose prediction of held-out runs is simulated: those that are weighed.

    Attributes:
        max_singles: Leading single effects, two forms of one counting once.
        max_sets: Leading sets of each greater number of effects, likewise.
    """

    max_singles: int = 4
    max_sets: int = 4

    def of_sizes(self, by_size: Sequence[object]) -> list[int]:
        """Number of hypotheses of one effect, of two, and so on."""
        return [self.max_singles, *[self.max_sets] * (len(by_size) - 1)]


DEFAULT_HELD_OUT = HeldOutSettings()


@dataclass(frozen=True)
class DiagnosisSettings:
    """Numbers by which a diagnosis decides, one part for each step.

    Attributes:
        dataset: Preparation of the recorded runs.
        screening: Choice and refinement of hypotheses; its `linear_fit` also holds a model's own
            error, for the weights and the unknown effect.
        held_out: Hypotheses that are weighed.
        weights: Weights of effects, none and unknown.
        verdict: From weights to the verdict.
        standard_error: Errors of the numbers of effects.
        discretization: Comparison with finer plates, for the noise floor.
        gap: Intervals of the gap.
        budget: Intervals of the budget.
        selection: Rule by which effects are worth adding.
        localization: Shares of the gap.
        outlier_runs: Runs that do not go with the others.
        next_run: Runs that may be proposed.
        unknown_effect: Disturbances and corrections of an unlisted mechanism.
    """

    dataset: DatasetSettings = DEFAULT_DATASET
    screening: ScreeningSettings = DEFAULT_SCREENING
    held_out: HeldOutSettings = DEFAULT_HELD_OUT
    weights: WeightSettings = DEFAULT_WEIGHTS
    verdict: VerdictSettings = DEFAULT_VERDICT
    standard_error: StandardErrorSettings = DEFAULT_STANDARD_ERROR
    discretization: DiscretizationSettings = DEFAULT_DISCRETIZATION
    gap: GapSettings = DEFAULT_GAP
    budget: BudgetSettings = DEFAULT_BUDGET
    selection: EffectSelectionSettings = DEFAULT_EFFECT_SELECTION
    localization: LocalizationSettings = DEFAULT_LOCALIZATION
    outlier_runs: OutlierRunSettings = DEFAULT_OUTLIER_RUNS
    next_run: NextRunSettings = DEFAULT_NEXT_RUN
    unknown_effect: UnknownEffectSettings = DEFAULT_UNKNOWN_EFFECT

    def with_bed(self, bed: AbstractBed) -> "DiagnosisSettings":
        """The same with another rule for the zetas of the runs; see `diagnose.linear.bed`."""
        weights = replace(self.screening.linear_fit, bed=bed)
        return replace(self, screening=replace(self.screening, linear_fit=weights))

    @property
    def linear_fit(self) -> LinearFitSettings:
        """Weights of linear fits and of the log score."""
        return self.screening.linear_fit

    @property
    def correction_steps(self) -> CorrectionStepSettings:
        """Settings of the steps that a correction goes through."""
        return CorrectionStepSettings(
            self.localization,
            self.linear_fit,
            self.screening.refinement,
            self.weights,
            self.gap,
            self.selection,
        )


DEFAULT_SETTINGS = DiagnosisSettings()
