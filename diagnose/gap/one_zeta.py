"""The gap with one zeta for the bed: each condition at the zeta that the others predict.

A zeta of its own lets each run match its mean sinkage, whatever makes it sink. Where the bed was
prepared alike, what another zeta makes up for is part of the gap: the held-out condition is
simulated at the mean zeta of the others, and chance there is also what zeta scatters by.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.gap.cross_validation import HeldOutPrediction
from diagnose.gap.gap import DEFAULT_GAP, Gap, GapSettings, gaps
from diagnose.linear.regressors import Regressors
from diagnose.run_pool import RunPool
from drftjax.effects.catalogue import reported_name
from drftjax.recorded.repeats import group_by_condition


def predicted_zetas(log_zeta: np.ndarray, groups: Sequence[Sequence[int]]) -> np.ndarray:
    """Mean log zeta of the runs of all other conditions, for each run.

    Args:
        log_zeta: Of each run, over one reference for all [-], shape (runs,).
        groups: Runs of each condition, by index.

    Returns:
        Shape (runs,); with one condition, the mean of all its runs.
    """
    found = np.full(len(log_zeta), float(np.mean(log_zeta)))
    for group in groups:
        others = np.setdiff1d(np.arange(len(log_zeta)), group)
        if others.size:
            found[list(group)] = log_zeta[others].mean()
    return found


def predicted_residuals(
    regressors: Regressors, prediction: HeldOutPrediction, pool: RunPool
) -> list[np.ndarray]:
    """Residual of each run at the predicted zeta [m, N, N m], shape (channels, samples).

    Where a run cannot be simulated there, its response to zeta is taken as linear.

    Args:
        regressors: Of the dataset.
        prediction: Held-out runs.
        pool: Threads.
    """
    dataset, hypothesis = prediction.dataset, prediction.hypothesis
    zetas = prediction.log_zeta + regressors.log_reference_zeta
    groups = group_by_condition(dataset.runs)
    predicted = predicted_zetas(zetas, groups) - regressors.log_reference_zeta

    def of(run: int) -> np.ndarray:
        at = prediction.coordinates[run]
        simulated = dataset.prediction(hypothesis.model, run, predicted[run], at)
        found = simulated - dataset.recording(run)
        if np.isfinite(found[~np.isnan(dataset.recording(run))]).all():
            return found
        apart = predicted[run] - prediction.log_zeta[run]
        return prediction.residual[run] + apart * hypothesis.by_zeta(run)

    return dataset.map(pool, of)


def one_zeta_gaps(
    regressors: Regressors,
    before: HeldOutPrediction,
    after: HeldOutPrediction,
    floors: Mapping[str, float],
    pool: RunPool,
    settings: GapSettings = DEFAULT_GAP,
) -> dict[str, Gap]:
    """Gap in every channel with one zeta for the bed.

    Args:
        regressors: Of the dataset.
        before, after: Held-out runs by the reference model and by the chosen hypothesis.
        floors: Noise floor of each channel with each run's own zeta [m, N, N m].
        pool: Threads.
        settings: Numbers of a gap.
    """
    dataset = regressors.dataset
    scatter = regressors.settings.bed.scatter
    by_zeta = after.hypothesis.by_zeta
    wider = {}
    for index, channel in enumerate(dataset.channels):
        response = np.concatenate([by_zeta(run)[index] for run in dataset.run_numbers])
        # The predicted zeta is a mean of others: its own scatter is small beside the run's.
        wider[channel] = float(np.hypot(floors[channel], scatter * _rms(response)))
    first, last = (predicted_residuals(regressors, each, pool) for each in (before, after))
    return gaps(dataset, first, last, wider, settings)


@dataclass(frozen=True)
class ZetaShare:
    """Share of an effect's response that another zeta would make up for.

    Attributes:
        own: With a zeta for each run [-].
        bed: With one zeta for all [-].
    """

    own: float
    bed: float


def zeta_shares(regressors: Regressors) -> dict[str, ZetaShare]:
    """Share of each effect that another zeta would make up for, from products that exist already.

    Of an effect with shapes, those count that zeta makes up for least.

    Args:
        regressors: The runs.
    """
    found: dict[str, ZetaShare] = {}
    weighed = regressors.gram_matrices.weighed(regressors.settings)
    for variant in regressors.variants:
        name = reported_name(variant.effect.about.name)
        share = _made_up(weighed, variant.columns)
        known = found.get(name, share)
        found[name] = ZetaShare(min(known.own, share.own), min(known.bed, share.bed))
    return found


def _made_up(gram: np.ndarray, columns: Sequence[int]) -> ZetaShare:
    """The same of some columns, by the runs' weighed gram matrices, shape (runs, n, n)."""
    own = np.maximum(gram[:, 0, 0], 1e-300)
    power = shared = each = 0.0
    for column in columns:
        cross = gram[:, 0, 1 + column]
        power += float(gram[:, 1 + column, 1 + column].sum())
        each += float((cross**2 / own).sum())
        shared += float(cross.sum() ** 2 / own.sum())
    return ZetaShare(each / power, shared / power) if power > 0 else ZetaShare(1.0, 1.0)


def _rms(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else 0.0
