"""Posterior of a fit's values, by Markov chains through the simulation.

R-hat and effective sample sizes are the rank-normalised ones of A. Vehtari et al.: Rank-normalized,
folding, and localization, Bayesian Analysis 16:667, 2021, by ArviZ.
"""

import importlib.util
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from drftjax.common.errors import InputError
from identify.uncertainty.estimate import Estimate
from identify.uncertainty.markov_chains import (
    POSTERIOR_SETTINGS,
    ChainStatistics,
    PosteriorSettings,
    sample_chains,
)
from identify.uncertainty.posterior_density import PosteriorDensity


@dataclass(frozen=True, eq=False)
class ParameterPosterior:
    """Draws of values from their posterior, with intervals.

    Attributes:
        labels: A name for each value.
        parameters: Name of each value's parameter and of its run, None where shared.
        units: Unit of each; "-" for none.
        draws: Values in their units, shape (chains, draws, values).
        statistics: Course of the chains.
        step: Leapfrog step found, in whitened coordinates.
        settings: Numbers of the chains.
        mean, error: Mean and standard deviation, shape (values,).
        low, high: Ends of each value's interval, likewise.
        rhat: R-hat of each, likewise; one where the chains agree.
        effective: Effective samples of each, in the bulk or in the tails, where there are fewer.
    """

    labels: tuple[str, ...]
    parameters: tuple[tuple[str, str | None], ...]
    units: tuple[str, ...]
    draws: np.ndarray
    statistics: ChainStatistics
    step: float
    settings: PosteriorSettings
    mean: np.ndarray
    error: np.ndarray
    low: np.ndarray
    high: np.ndarray
    rhat: np.ndarray
    effective: np.ndarray

    @property
    def divergences(self) -> int:
        """Number of transitions that diverged."""
        return int(self.statistics.diverging.sum())

    def sentences(self) -> list[str]:
        """Return sentences on the chains, and on what they leave in doubt."""
        chains, draws, _ = self.draws.shape
        limits = self.settings
        kind = "adjusted to the standard errors" if limits.adjusted else "of white residuals"
        lines = [
            f"posterior, likelihood {kind}: {chains} chains of {draws} draws, R-hat at most "
            f"{self.rhat.max():.3f}, at least {self.effective.min():.0f} effective samples"
        ]
        apart = ~(self.rhat <= limits.largest_rhat)
        few = ~(self.effective >= limits.min_effective)
        if (apart | few).any():
            named = ", ".join(
                f"{label} (R-hat {rhat:.3f}, {effective:.0f} effective samples)"
                for label, rhat, effective, bad in zip(
                    self.labels, self.rhat, self.effective, apart | few, strict=True
                )
                if bad
            )
            lines.append(
                f"the chains have not settled: {named}; R-hat must be at most "
                f"{limits.largest_rhat:g} and effective samples at least {limits.min_effective:g}: "
                "make more draws (drftjax.PosteriorSettings), or give bounds or a prior"
            )
        if self.divergences:
            lines.append(
                f"{self.divergences} of {chains * draws} transitions diverged: the posterior has a "
                "corner there that the chains may not enter"
            )
        return lines


def require_extra() -> None:
    """Raise InputError where the packages of the extra `posterior` are not installed."""
    needed = {"arviz": "ArviZ", "blackjax": "BlackJAX", "h5netcdf": "h5netcdf"}
    missing = [title for name, title in needed.items() if importlib.util.find_spec(name) is None]
    if missing:
        raise InputError(
            f"a posterior needs {' and '.join(missing)}: pip install 'drftjax[posterior]'"
        )


def import_arviz() -> Any:
    """Return the module arviz; the warning of its import is its developers' affair."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import arviz
    return arviz


def sample_posterior(
    estimate: Estimate,
    settings: PosteriorSettings = POSTERIOR_SETTINGS,
    progress: Callable[[str, int, int], None] | None = None,
) -> ParameterPosterior:
    """Draw the values of a fit from their posterior.

    Args:
        estimate: Of the fit.
        settings: Decision numbers.
        progress: Called with the stage, the number of transitions made and of all in that stage.

    Raises:
        InputError: where the extra is not installed, nothing was fitted, or a value has neither
            information from the runs nor bounds nor a prior.
    """
    require_extra()
    if not len(estimate.flat):
        raise InputError("nothing was fitted that could have a posterior")
    density = PosteriorDensity.of(estimate, settings.adjusted)
    free = np.asarray(density.free)
    centre, covariance = np.asarray(density.centre)[free], np.asarray(density.covariance)
    points, statistics, step = sample_chains(density, centre, covariance, settings, progress)
    filled = np.tile(np.asarray(density.centre), (*points.shape[:2], 1))
    filled[..., free] = points
    draws = estimate.values(filled)[..., free]
    told = [estimate.coordinate_parameters[k] for k in free]
    names = [
        (p.quantity.label, None if run is None else estimate.runs[run].name) for p, run in told
    ]
    return _summarized(
        tuple(estimate.labels[k] for k in free),
        tuple(names),
        tuple(p.quantity.unit for p, _ in told),
        draws,
        statistics,
        step,
        settings,
    )


def _summarized(
    labels: tuple[str, ...],
    parameters: tuple[tuple[str, str | None], ...],
    units: tuple[str, ...],
    draws: np.ndarray,
    statistics: ChainStatistics,
    step: float,
    settings: PosteriorSettings,
) -> ParameterPosterior:
    """Return the posterior with means, intervals and the diagnostics of its chains."""
    arviz = import_arviz()
    columns = np.moveaxis(draws, -1, 0)
    flat = columns.reshape(len(columns), -1)
    tail = (1 - settings.level) / 2
    low, high = np.quantile(flat, (tail, 1 - tail), axis=1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        rhat = np.array([float(arviz.rhat(each)) for each in columns])
        kinds = [
            [float(arviz.ess(each, method=method)) for each in columns]
            for method in ("bulk", "tail")
        ]
    return ParameterPosterior(
        labels,
        parameters,
        units,
        draws,
        statistics,
        step,
        settings,
        flat.mean(axis=1),
        flat.std(axis=1, ddof=1),
        low,
        high,
        rhat,
        np.min(kinds, axis=0),
    )
