"""Noise models of residuals, by name: white, and first-order autoregressive.

A new model is a class here that implements `AbstractNoise`, and one line in `NOISE_MODELS`.
"""

from typing import ClassVar, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from drftjax.common.errors import InputError
from identify.solver.abstract_noise import AbstractNoise
from identify.solver.whitening import lag_one_correlation


class White(AbstractNoise):
    """Independent samples. The correlation that residuals have only widens standard errors."""

    name: ClassVar[str] = "white"

    def for_channels(self, count: int) -> Self:
        return self

    def fit(self, residual: np.ndarray, counts: np.ndarray, gaps: np.ndarray) -> Self:
        return self

    def whiten(
        self, residual: Float[Array, "channels samples"], gaps: Float[Array, "channels samples"]
    ) -> Float[Array, "channels samples"]:
        return residual

    def inflation(self, residual: np.ndarray, counts: np.ndarray, gaps: np.ndarray) -> float:
        return autoregressive_inflation(residual, counts, gaps)

    def sample(
        self,
        random: np.random.Generator,
        draws: int,
        residual: np.ndarray,
        counts: np.ndarray,
        gaps: np.ndarray,
    ) -> np.ndarray:
        return sample_autoregressive(
            random, draws, lag_one_correlation(residual, counts, gaps), gaps
        )


class Autoregressive(AbstractNoise):
    r"""First-order autoregressive: $e_i = \rho^{k_i} e_{i-1} + \sqrt{1 - \rho^{2 k_i}}\,\eta_i$.

    $k_i$ is the gap before sample i in usual intervals and $\eta$ is white. The whitened residual
    is $(e_i - \rho^{k_i} e_{i-1}) / \sqrt{1 - \rho^{2 k_i}}$.

    Attributes:
        correlation: $\rho$ of each channel [-], shape (channels,).
        largest: Largest $\rho$ that is whitened by [-]. A residual that is correlated more strongly
            is an error of the model and not noise; whitening by more would remove the slow part of
            the residual, which is what a fit is made on.
    """

    name: ClassVar[str] = "autoregressive"
    correlation: float | Float[Array, " channels"] = 0.0
    largest: float = eqx.field(static=True, default=0.95)

    def for_channels(self, count: int) -> Self:
        return self._with(np.zeros(count))

    def fit(self, residual: np.ndarray, counts: np.ndarray, gaps: np.ndarray) -> Self:
        runs, channels, _ = residual.shape
        weights = counts.sum(axis=2)
        each = np.array(
            [
                [
                    lag_one_correlation(residual[r, c], counts[r, c], gaps[r])
                    for c in range(channels)
                ]
                for r in range(runs)
            ]
        )
        pooled = (each * weights).sum(axis=0) / np.maximum(weights.sum(axis=0), 1)
        return self._with(np.minimum(pooled, self.largest))

    def coefficients(
        self, gaps: Float[Array, "channels samples"]
    ) -> Float[Array, "channels samples"]:
        r"""Return $\rho^k$, the share of the last sample's noise that is left after k intervals."""
        rho = jnp.asarray(self.correlation)[..., None]
        return jnp.where(jnp.isfinite(gaps), rho**gaps, 0)

    def whiten(
        self, residual: Float[Array, "channels samples"], gaps: Float[Array, "channels samples"]
    ) -> Float[Array, "channels samples"]:
        before = jnp.pad(residual[:, :-1], ((0, 0), (1, 0)))
        share = self.coefficients(gaps)
        return jnp.where(share > 0, (residual - share * before) / jnp.sqrt(1 - share**2), residual)

    def inflation(self, residual: np.ndarray, counts: np.ndarray, gaps: np.ndarray) -> float:
        return autoregressive_inflation(residual, counts, gaps)

    def sample(
        self,
        random: np.random.Generator,
        draws: int,
        residual: np.ndarray,
        counts: np.ndarray,
        gaps: np.ndarray,
    ) -> np.ndarray:
        return sample_autoregressive(
            random, draws, lag_one_correlation(residual, counts, gaps), gaps
        )

    def _with(self, correlation: np.ndarray) -> Self:
        return eqx.tree_at(lambda n: n.correlation, self, jnp.asarray(correlation))


NOISE_MODELS: dict[str, type[AbstractNoise]] = {each.name: each for each in (White, Autoregressive)}


def noise_model(name: str) -> AbstractNoise:
    """Return the noise model of this name.

    Raises:
        InputError: for an unknown name.
    """
    if name not in NOISE_MODELS:
        raise InputError(f"there is no noise model {name!r}; give one of {', '.join(NOISE_MODELS)}")
    return NOISE_MODELS[name]()


def autoregressive_inflation(
    residual: Float[np.ndarray, " samples"],
    counts: Bool[np.ndarray, " samples"],
    gaps: Float[np.ndarray, " samples"],
) -> float:
    r"""Return $(1 + \rho) / (1 - \rho)$, by which correlated samples widen a mean's variance."""
    rho = lag_one_correlation(residual, counts, gaps)
    return (1 + rho) / (1 - rho)


def sample_autoregressive(
    random: np.random.Generator, draws: int, correlation: float, gaps: Float[np.ndarray, " samples"]
) -> Float[np.ndarray, "draws samples"]:
    """Draw first-order autoregressive noise of unit variance, samples `gaps` intervals apart."""
    fresh = random.standard_normal((draws, len(gaps)))
    noise = np.empty_like(fresh)
    noise[:, 0] = fresh[:, 0]
    for sample, share in enumerate(correlation ** gaps[1:], start=1):
        noise[:, sample] = share * noise[:, sample - 1] + np.sqrt(1 - share**2) * fresh[:, sample]
    return noise
