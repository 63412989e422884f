"""Explanations of a change: nothing, the sand's strength, or one effect in the runs of one side."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from diagnose.change.differences.fit import CoefficientPrior, DifferenceFit, fit_differences
from diagnose.change.differences.gram import DifferenceGram, Differences
from diagnose.change.differences.settings import DEFAULT_DIFFERENCE_FIT, DifferenceFitSettings
from diagnose.hypotheses.hypothesis import column_mixes, mix_columns
from diagnose.linear.linear_fit import WITHOUT_LEVELS, block_names, floor_inflation
from diagnose.linear.regressors import Regressors, ShapeVariant
from diagnose.model.augmented_model import AugmentedModel
from diagnose.run_pool import RunPool
from diagnose.selection.model_weights import NONE
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import field_metadata, reported_name

# Name of the sand's own strength in a verdict.
ZETA = "zeta"

Side = Literal["now", "before"]


@dataclass(frozen=True, eq=False)
class ChangeHypothesis:
    """An explanation with its numbers, and all runs about it.

    Attributes:
        model: The effect; none for no change and for one of zeta.
        side: Runs that the effect acts in. What is stronger `before` has grown weaker.
        zeta_changes: The last coordinate is a change of log zeta that all runs of now share.
        coordinates: The effect's free numbers, or the change of log zeta, shape (free,).
        start: Coordinates about which the prior is centred, shape (free,).
        log_zeta: Log zeta of each run over its set-up's [-], shape (runs,).
        columns: By run, derivatives by the coordinates [m, N, N m], shape (channels, samples,
            free); zero where the effect does not act.
        by_zeta: By run, derivative by its log zeta, shape (channels, samples).
        residual: By run, simulated minus recorded, shape (channels, samples).
        fit: Score and mean squares, by simulation or by a linear fit.
        is_simulated: `fit` is by simulation.
        proposed: Coordinates and log zetas that the linear fit proposes, if not simulated.
    """

    model: AugmentedModel
    side: Side
    zeta_changes: bool
    coordinates: np.ndarray
    start: np.ndarray
    log_zeta: np.ndarray
    columns: list[np.ndarray]
    by_zeta: list[np.ndarray]
    residual: list[np.ndarray]
    fit: DifferenceFit
    is_simulated: bool = False
    proposed: tuple[np.ndarray, np.ndarray] | None = field(default=None)

    @property
    def name(self) -> str:
        """Name in a verdict."""
        if self.zeta_changes:
            return ZETA
        return reported_name(self.model.names[0]) if self.model.effects else NONE

    @property
    def score(self) -> float:
        """Log score; see `diagnose.change.differences.fit`."""
        return self.fit.score

    @property
    def common_zeta(self) -> float:
        """Change of log zeta that all runs of now share [-]."""
        return float(self.coordinates[-1]) if self.zeta_changes else 0.0

    def acts(self, is_now: np.ndarray) -> np.ndarray:
        """True for each run that the effect acts in, shape (runs,)."""
        return is_now if self.side == "now" else ~is_now

    def coordinate_prior(self, settings: DifferenceFitSettings) -> CoefficientPrior:
        """Prior and bounds of a change of the coordinates."""
        if self.zeta_changes:
            width = np.array([settings.zeta_prior])
            return replace(CoefficientPrior.free(width), offset=self.coordinates)
        width, least, most = [], [], []
        for free in self.model.free:
            about = field_metadata(self.model.effects[free.index])[free.field]
            is_shape = free.scale is None
            width.append(settings.shape_prior if is_shape else settings.strength_prior)
            least.append(-np.inf if free.scale is None else about["least"] / free.scale)
            most.append(np.inf if free.scale is None else about["most"] / free.scale)
        at = self.coordinates
        return CoefficientPrior(
            np.array(width), at - self.start, np.array(least) - at, np.array(most) - at
        )


@dataclass(frozen=True, eq=False)
class ChangeProblem:
    """Runs before and now, with their responses to effects about the reference model.

    Attributes:
        differences: The runs.
        regressors: Responses of all runs, as if every effect acted in each.
        law: Effects that the reference model has here, as the runs before follow them.
        settings: Numbers of the fits.
    """

    differences: Differences
    regressors: Regressors
    law: tuple[AbstractEffect, ...]
    settings: DifferenceFitSettings = DEFAULT_DIFFERENCE_FIT

    @classmethod
    def of(
        cls,
        differences: Differences,
        regressors: Regressors,
        law: tuple[AbstractEffect, ...],
        pool: RunPool,
        settings: DifferenceFitSettings = DEFAULT_DIFFERENCE_FIT,
    ) -> "ChangeProblem":
        """The problem at the zetas of the regressors, with what repeats differ by."""
        chance = chance_power(differences, regressors, pool, settings)
        has_repeats = bool(differences.within_sides().clocks)
        differences = replace(differences, chance=chance, has_repeats=has_repeats)
        return cls(differences, regressors, law, settings)

    @property
    def by_zeta(self) -> list[np.ndarray]:
        """By run, derivative by its log zeta, shape (channels, samples)."""
        return [each[:, :, 0] for each in self.regressors.columns]

    def residual_without(self, side: Side | None) -> list[np.ndarray]:
        """By run, residual of the reference model where nothing changed, shape (channels, samples).

        It is at the zeta of the condition's runs that a change of this side left alone; of no side,
        at the mean of all. By a linear response.
        """
        away = self.deviation_from(side, self.regressors.log_zeta)
        parts = zip(self.regressors.residual, self.by_zeta, away, strict=True)
        return [residual - slope * change for residual, slope, change in parts]

    def law_factors(self, here: ChangeHypothesis) -> dict[str, float]:
        """By channel, how much a change does over what it does in the reference model [-]."""
        blocks = block_names(self.differences.dataset.channels)
        factors = zip(blocks, here.fit.law_factors, strict=True)
        return {channel: 1.0 + float(each) for (channel, _), each in factors}

    def deviation(self, here: ChangeHypothesis) -> np.ndarray:
        """Log zeta of each run beyond its condition's and beyond a common change [-]."""
        away = self.deviation_from(self.changed_side(here), here.log_zeta)
        return away - here.common_zeta * self.differences.is_now

    def changed_side(self, here: ChangeHypothesis) -> Side | None:
        """The side that a hypothesis changes; none where nothing changed."""
        return here.side if here.model.effects or here.zeta_changes else None

    def deviation_from(self, side: Side | None, log_zeta: np.ndarray) -> np.ndarray:
        """Log zeta of each run beyond that of its condition's runs which a change left alone [-].

        Args:
            side: The side that changed; none where nothing did.
            log_zeta: Of each run over its set-up's [-], shape (runs,).
        """
        believed = self.regressors.log_reference_zeta
        matched = self.regressors.log_zeta + believed
        healthy = [
            {"now": each.before, "before": each.now, None: each.runs}[side]
            for each in (clock.condition for clock in self.differences.clocks)
        ]
        found = log_zeta + believed
        for clock, runs in zip(self.differences.clocks, healthy, strict=True):
            found[list(clock.condition.runs)] -= matched[list(runs)].mean()
        return found

    def fit(
        self,
        matrices: DifferenceGram,
        columns: Sequence[int],
        deviation: np.ndarray,
        prior: CoefficientPrior,
        error_share: float,
        changed: int | None = None,
        inflation: float = 1.0,
    ) -> DifferenceFit:
        """Fit of some columns of Gram matrices; see `fit_differences`."""
        at = deviation, self.differences.centring, prior, error_share
        return fit_differences(matrices, columns, *at, self.settings, changed, inflation)

    def gram(self, here: ChangeHypothesis, pool: RunPool) -> DifferenceGram:
        """Gram matrices about a hypothesis."""
        return self.differences.gram(here.columns, here.by_zeta, here.residual, pool)

    def gram_with_change(self, here: ChangeHypothesis, pool: RunPool) -> DifferenceGram:
        """The same with one column more: all that the hypothesis changes."""
        both = zip(here.columns, self.change_so_far(here), strict=True)
        columns = [np.concatenate([each, more[:, :, None]], axis=2) for each, more in both]
        return self.differences.gram(columns, here.by_zeta, here.residual, pool)

    def change_so_far(self, here: ChangeHypothesis) -> list[np.ndarray]:
        """By run, all that a hypothesis changes, by zeta's scatter too, shape (channels, samples).

        That is beyond the reference model at the zeta of the condition's runs without an effect.
        """
        without = self.residual_without(self.changed_side(here))
        return [now - then for now, then in zip(here.residual, without, strict=True)]

    def residual_by_law(self, here: ChangeHypothesis) -> list[np.ndarray]:
        """By run, what a hypothesis leaves with the law's factors, shape (channels, samples)."""
        by_channel, channels = self.law_factors(here), self.differences.dataset.channels
        further = np.array([[by_channel[channel] - 1] for channel in channels])
        parts = zip(here.residual, self.change_so_far(here), strict=True)
        return [residual + further * change for residual, change in parts]

    def fit_about(
        self, here: ChangeHypothesis, pool: RunPool, floor_share: float = 0.0
    ) -> DifferenceFit:
        """Linear fit of all coordinates' changes about a hypothesis.

        Args:
            here: The hypothesis.
            pool: Threads.
            floor_share: Every model error is raised to this share of the worst block's RMS in model
                errors [-].
        """
        settings, matrices = self.settings, self.gram_with_change(here, pool)
        share = settings.simulated_error if here.is_simulated else settings.linear_error
        free = range(len(here.coordinates))
        prior = here.coordinate_prior(settings)
        inflation = floor_inflation(
            matrices.blocks, here.fit.mean_square, floor_share, WITHOUT_LEVELS
        )
        at = self.deviation(here), prior, share, len(free), inflation
        return self.fit(matrices, free, *at)

    # The explanations about the reference model ---------------------------------------------------

    def linear_start(
        self, variant: ShapeVariant | None, side: Side, fit: DifferenceFit
    ) -> ChangeHypothesis:
        """Hypothesis at its null, with the step that a linear fit proposes.

        Args:
            variant: The effect; none for no change.
            side: Runs that it acts in.
            fit: Linear fit, its strengths those of an effect in the runs of now.
        """
        reference = self.regressors
        model = AugmentedModel(() if variant is None else (variant.effect,))
        sign = 1.0 if side == "now" else -1.0
        strength = sign * fit.coefficients
        shapes = [] if variant is None else [float(np.log(each)) for each in variant.shapes]
        goal = np.r_[strength, shapes]
        null = np.r_[0 * strength, shapes]
        acts = self.differences.is_now if side == "now" else ~self.differences.is_now
        columns = [
            _columns(reference, variant, strength, run) * float(acts[run])
            for run in reference.dataset.run_numbers
        ]
        proposed = goal, reference.log_zeta + fit.zeta_change
        return ChangeHypothesis(
            model,
            side,
            False,
            null,
            null,
            reference.log_zeta,
            columns,
            self.by_zeta,
            reference.residual,
            fit,
            proposed=proposed,
        )

    def zeta_start(self, fit: DifferenceFit) -> ChangeHypothesis:
        """Hypothesis of a common change of log zeta, at none, with the step of a linear fit."""
        is_now = self.differences.is_now
        columns = [
            each[:, :, None] * float(now) for each, now in zip(self.by_zeta, is_now, strict=True)
        ]
        moved = self.regressors.log_zeta + fit.zeta_change + fit.coefficients[0] * is_now
        return replace(
            self.linear_start(None, "now", replace(fit, coefficients=np.zeros(0))),
            zeta_changes=True,
            coordinates=np.zeros(1),
            start=np.zeros(1),
            columns=columns,
            fit=fit,
            proposed=(fit.coefficients, moved),
        )


def chance_power(
    differences: Differences,
    regressors: Regressors,
    pool: RunPool,
    settings: DifferenceFitSettings = DEFAULT_DIFFERENCE_FIT,
) -> np.ndarray:
    """Mean square that repeats on one side differ by beyond noise and zeta, shape (blocks,).

    Grains that lie otherwise, and whatever else no zeta makes up for. Zero without repeats.

    Args:
        differences: The runs.
        regressors: Responses of all runs, and their residuals.
        pool: Threads.
        settings: Numbers of the fit of zeta.
    """
    sides = differences.within_sides()
    if not sides.clocks:
        return np.zeros(len(regressors.noise_power))
    nothing = [each[:, :, :0] for each in regressors.columns]
    by_zeta = [each[:, :, 0] for each in regressors.columns]
    matrices = sides.gram(nothing, by_zeta, regressors.residual, pool)
    deviation = sides.centring @ (regressors.log_zeta + regressors.log_reference_zeta)
    nowhere = CoefficientPrior.free(np.zeros(0))
    fit = fit_differences(matrices, (), deviation, sides.centring, nowhere, 0.0, settings)
    floor = settings.model_errors(matrices.blocks) ** 2
    return np.maximum(fit.mean_square - regressors.noise_power - floor, 0)


def _columns(
    regressors: Regressors, variant: ShapeVariant | None, strength: np.ndarray, run: int
) -> np.ndarray:
    """One run's derivatives by strengths and shapes, shape (channels, samples, free)."""
    mixes = [] if variant is None else column_mixes(regressors, variant, strength)
    return mix_columns(regressors.columns[run], mixes)[:, :, 1:]
