"""A model with effects against runs that it was not found on."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from diagnose.checks import outlier_runs as odd_runs
from diagnose.dataset import RigDataset
from diagnose.evaluation.result import Evaluation
from diagnose.gap.discretization_error import APART, discretization_errors
from diagnose.gap.gap import Gap, gaps
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

if TYPE_CHECKING:
    pass


def evaluate_model(
    case: RigDataset,
    effects: Sequence[AbstractEffect],
    left_out: Mapping[str, str] | None = None,
    caveats: Sequence[str] = (),
) -> Evaluation:
    """The gap of runs without and with effects whose numbers stay as they are.

    Args:
        case: The runs.
        effects: Added to what each run's set-up says.
        left_out: Why other runs are not among them, by name.
        caveats: What is known to speak against the comparison, in sentences.

    A run whose wheel leaves what the model covers, with or without the effects, is left out.

    Raises:
        InputError: where no run is left.
    """
    with RunPool() as pool:
        return _evaluate(case, effects, left_out or {}, caveats, pool)


def _evaluate(
    case: RigDataset,
    effects: Sequence[AbstractEffect],
    left_out: Mapping[str, str],
    caveats: Sequence[str],
    pool: RunPool,
) -> Evaluation:
    model, coordinates = as_model(effects)
    before = match_runs(case, AugmentedModel(), np.zeros(0), pool)
    after = match_runs(case, model, coordinates, pool) if effects else before
    if lost := _uncovered(case, after, WITH_EFFECTS_NAME) | _uncovered(
        case, before, REFERENCE_NAME
    ):
        kept = [each for run, each in enumerate(case.runs) if run not in lost]
        if not kept:
            raise InputError(f"{lost[min(lost)]}; look at the numbers of the model")
        why = {case.runs[run].name: each for run, each in lost.items()}
        fewer = RigDataset.of(kept, case.settings)
        return _evaluate(fewer, effects, {**left_out, **why}, caveats, pool)
    residuals = residuals_of(before), residuals_of(after)
    own = discretization_errors(case, np.array([each.log_zeta for each in before]), pool)

    def by_zeta(run: int) -> np.ndarray:
        """Along a straight line over one per cent."""
        at, nothing = before[run].log_zeta, np.zeros(0)
        here, there = (
            case.prediction(AugmentedModel(), run, each, nothing) for each in (at, at + APART)
        )
        return (there - here) / APART

    floors, how = noise_floors(case, *residuals, own, by_zeta)
    gap = gaps(case, *residuals, floors)
    doubts = [*caveats, *odd_runs.outliers_among_repeats(case, residuals, own, by_zeta)]
    return Evaluation(case, tuple(effects), before, after, gap, floors, how, doubts, left_out)


def _uncovered(case: RigDataset, runs: Sequence[MatchedRun], model: str) -> dict[int, str]:
    """Runs whose wheel takes off, or sinks deeper than its plates cover, by number, and why."""
    z, found = case.channels.index("z"), {}
    for run, each in enumerate(runs):
        name = case.runs[run].name
        limit = float(case.runs[run].trial.simulator.wheel.cut().sinkage_limit)
        farthest = float(np.abs(each.residual[z] + case.recording(run)[z]).max())
        if not np.isfinite(farthest):
            found[run] = f"{name}: its simulation by {model} diverges"
        elif not farthest < limit:
            found[run] = (
                f"{name}: by {model} its z reaches {1e3 * farthest:.4g} mm, must stay within "
                f"{1e3 * limit:.4g} mm, which the wheel's plates cover"
            )
    return found


def prediction_on(diagnosis: Diagnosis, paths: Sequence[Path]) -> dict[str, Gap]:
    """The gap before and after on other runs of the same rig, by channel.

    Args:
        diagnosis: Whose effects or correction are added, with their numbers as they are.
        paths: The other runs.
    """
    case = RigDataset.of(with_common_origin(prepare_runs(list(paths)), diagnosis.origin))
    with RunPool() as pool:
        before = match_runs(case, AugmentedModel(), np.zeros(0), pool)
        after = match_runs(case, *as_model(diagnosis.selected.effects), pool)
    return gaps(
        case,
        [each.residual for each in before],
        [each.residual for each in after],
        diagnosis.floors,
    )
