"""Evaluation of a model with effects on runs that it was not fitted to."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from diagnose.checks.outlier_runs import (
    DEFAULT_OUTLIER_RUNS,
    OutlierRunSettings,
    outliers_among_repeats,
)
from diagnose.dataset import RigDataset, in_short_steps, without_step_errors
from diagnose.evaluation.result import Evaluation
from diagnose.gap.discretization_error import (
    changes_with_finer_plates,
    discretization_errors,
    zeta_response,
)
from diagnose.gap.gap import DEFAULT_GAP, Gap, GapSettings, gaps
from diagnose.gap.noise_floor import noise_floors
from diagnose.gap.selected_effects import as_model
from diagnose.gap.zeta_matching import (
    REFERENCE_NAME,
    WITH_EFFECTS_NAME,
    MatchedRun,
    match_runs,
    residuals_of,
)
from diagnose.model.augmented_model import AugmentedModel
from diagnose.result import Diagnosis
from diagnose.rig_runs import with_common_origin
from diagnose.run_pool import RunPool
from drftjax.common.errors import InputError
from drftjax.effects.base import AbstractEffect
from drftjax.recorded.prepared_run import prepare_runs


def evaluate_model(
    dataset: RigDataset,
    effects: Sequence[AbstractEffect],
    skipped: Mapping[str, str] | None = None,
    caveats: Sequence[str] = (),
    *,
    gap_settings: GapSettings = DEFAULT_GAP,
    outlier_settings: OutlierRunSettings = DEFAULT_OUTLIER_RUNS,
) -> Evaluation:
    """Gap of runs without and with effects whose numbers stay as they are.

    A run whose wheel leaves the range that the model covers, with or without the effects, is left
    out.

    Args:
        dataset: The runs.
        effects: Added to those of each run's set-up.
        skipped: Reasons why other runs are not among them, by name.
        caveats: Reasons known to weaken the comparison, in sentences.
        gap_settings: Numbers of a gap.
        outlier_settings: Rule by which repeats disagree.

    Raises:
        InputError: where no run is left.
    """
    with RunPool() as pool:
        dataset = without_step_errors(in_short_steps(dataset), pool)
        dataset, before, after, lost = _match_covered(dataset, effects, pool)
        log_zeta = np.array([each.log_zeta for each in before])
        own = discretization_errors(dataset, changes_with_finer_plates(dataset, log_zeta, pool))
    residuals = residuals_of(before), residuals_of(after)

    def response(run: int) -> np.ndarray:
        return zeta_response(dataset, run, before[run].log_zeta)

    floors, floor_source = noise_floors(dataset, *residuals, own, response)
    return Evaluation(
        dataset=dataset,
        effects=tuple(effects),
        before=before,
        after=after,
        gap=gaps(dataset, *residuals, floors, gap_settings),
        floors=floors,
        floor_source=floor_source,
        caveats=[
            *caveats,
            *outliers_among_repeats(dataset, residuals, own, response, outlier_settings),
        ],
        skipped={**(skipped or {}), **lost},
    )


def _match_covered(
    dataset: RigDataset, effects: Sequence[AbstractEffect], pool: RunPool
) -> tuple[RigDataset, list[MatchedRun], list[MatchedRun], dict[str, str]]:
    """The runs that both models cover, matched without and with effects, and why others are not.

    Raises:
        InputError: where no run is left.
    """
    model, coordinates = as_model(effects)
    skipped: dict[str, str] = {}
    while True:
        before = match_runs(dataset, AugmentedModel(), np.zeros(0), pool)
        after = match_runs(dataset, model, coordinates, pool) if effects else before
        lost = _uncovered(dataset, after, WITH_EFFECTS_NAME)
        lost |= _uncovered(dataset, before, REFERENCE_NAME)
        if not lost:
            return dataset, before, after, skipped
        kept = [each for run, each in enumerate(dataset.runs) if run not in lost]
        if not kept:
            raise InputError(f"{lost[min(lost)]}; look at the numbers of the model")
        skipped |= {dataset.runs[run].name: each for run, each in lost.items()}
        dataset = RigDataset.of(kept, dataset.settings)


def _uncovered(dataset: RigDataset, runs: Sequence[MatchedRun], model: str) -> dict[int, str]:
    """Reason, by index, of runs whose wheel takes off or sinks deeper than its plates cover."""
    z, found = dataset.channels.index("z"), {}
    for run, each in enumerate(runs):
        name = dataset.runs[run].name
        limit = float(dataset.runs[run].trial.simulator.wheel.cut().sinkage_limit)
        farthest = float(np.abs(each.residual[z] + dataset.recording(run)[z]).max())
        if not np.isfinite(farthest):
            found[run] = f"{name}: its simulation by {model} diverges"
        elif not farthest < limit:
            found[run] = (
                f"{name}: by {model} its z reaches {1e3 * farthest:.4g} mm, must stay within "
                f"{1e3 * limit:.4g} mm, which the wheel's plates cover"
            )
    return found


def prediction_on(diagnosis: Diagnosis, paths: Sequence[Path]) -> dict[str, Gap]:
    """Gap before and after on other runs of the same rig, by channel.

    Args:
        diagnosis: Its effects or correction are added, with their numbers as they are.
        paths: Run logs of the other runs.
    """
    dataset = RigDataset.of(with_common_origin(prepare_runs(list(paths)), diagnosis.origin))
    with RunPool() as pool:
        dataset = without_step_errors(in_short_steps(dataset), pool)
        before = match_runs(dataset, AugmentedModel(), np.zeros(0), pool)
        after = match_runs(dataset, *as_model(diagnosis.selected.effects), pool)
    return gaps(dataset, residuals_of(before), residuals_of(after), diagnosis.floors)
