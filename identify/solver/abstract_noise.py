"""Interface of a noise model, as the solver and the statistics of a fit use it."""

import abc
from typing import ClassVar, Self

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float


class AbstractNoise(eqx.Module):
    """A model of the residuals (simulated minus recorded) of each channel, over all runs.

    An instance is a choice of model. `for_channels` and `fit` give instances whose numbers are
    arrays over the channels, first axis first; the solver whitens by these.
    """

    name: ClassVar[str]

    @abc.abstractmethod
    def for_channels(self, count: int) -> Self:
        """Return the model of `count` channels before any residual is known: white."""

    @abc.abstractmethod
    def fit(
        self,
        residual: Float[np.ndarray, "runs channels samples"],
        counts: Bool[np.ndarray, "runs channels samples"],
        gaps: Float[np.ndarray, "runs samples"],
    ) -> Self:
        """Return the model with its numbers estimated from the residuals of all runs.

        Args:
            residual: Simulated minus recorded [m, N, N m].
            counts: True for samples that are compared.
            gaps: Time from the sample before, in usual sampling intervals of the run [-].
        """

    @abc.abstractmethod
    def whiten(
        self, residual: Float[Array, "channels samples"], gaps: Float[Array, "channels samples"]
    ) -> Float[Array, "channels samples"]:
        """Return one run's residuals without their correlation in time, their variance unchanged.

        Args:
            residual: Weighted residuals [-]; zero where nothing is compared.
            gaps: Intervals from the compared sample before [-]; infinite where there is none.
        """

    @abc.abstractmethod
    def inflation(
        self,
        residual: Float[np.ndarray, " samples"],
        counts: Bool[np.ndarray, " samples"],
        gaps: Float[np.ndarray, " samples"],
    ) -> float:
        """Return the number of samples that count as one independent sample [-].

        Args:
            residual: Whitened residuals of one channel of a run; this measures the correlation
                that is still in them.
            counts: True for samples that are compared.
            gaps: Intervals from the sample before [-].
        """

    @abc.abstractmethod
    def sample(
        self,
        random: np.random.Generator,
        draws: int,
        residual: Float[np.ndarray, " samples"],
        counts: Bool[np.ndarray, " samples"],
        gaps: Float[np.ndarray, " samples"],
    ) -> Float[np.ndarray, "draws samples"]:
        """Draw noise of unit variance that is correlated as these whitened residuals are.

        Args:
            random: Source of the draws.
            draws: Number of draws.
            residual, counts, gaps: As for `inflation`.
        """
