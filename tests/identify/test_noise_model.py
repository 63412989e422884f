"""Noise models: whitening, the widening of errors, draws, and their names."""

import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.common.errors import InputError
from identify.uncertainty.noise_model import NOISE_MODELS, Autoregressive, White, noise_model

RHO = 0.8

# Five standard errors of a correlation, a variance or a mean of this many samples.
SAMPLES = 20_000
FIVE = 5 / np.sqrt(SAMPLES)

# Rounding of a few additions.
ROUNDING = 1e-12


@pytest.fixture(scope="module")
def drawn() -> np.ndarray:
    """Autoregressive noise of three channels in one run, drawn by the model itself."""
    random, gaps = np.random.default_rng(3), np.ones(SAMPLES)
    # The draws take their correlation from a residual: one that repeats itself RHO of the time.
    shape = np.cumsum(np.where(random.random(SAMPLES) < (1 - RHO) / 2, 1, 0)) % 2 * 2.0 - 1.0
    counts = np.ones(SAMPLES, bool)
    return Autoregressive().sample(random, 3, shape, counts, gaps)[None]


def everything(residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.ones(residual.shape, bool), np.ones((len(residual), residual.shape[-1]))


def test_draws_scatter_by_one_and_follow_one_another(drawn):
    assert drawn.std(axis=-1) == pytest.approx(1.0, abs=3 * FIVE)  # nine samples count as one
    noise = Autoregressive().fit(drawn, *everything(drawn))
    assert np.asarray(noise.correlation) == pytest.approx(RHO, abs=FIVE)


def test_whitened_draws_no_longer_follow_one_another(drawn):
    noise = Autoregressive().fit(drawn, *everything(drawn))
    gaps = jnp.ones(drawn[0].shape).at[:, 0].set(jnp.inf)
    white = np.asarray(noise.whiten(jnp.asarray(drawn[0]), gaps))[None]
    left = np.asarray(Autoregressive().fit(white, *everything(white)).correlation)
    assert left.max() < FIVE
    assert white.std(axis=-1) == pytest.approx(1.0, abs=FIVE)


def test_a_model_of_white_noise_changes_no_residual(drawn):
    noise = White().fit(drawn, *everything(drawn))
    residual = jnp.asarray(drawn[0])
    assert noise.whiten(residual, jnp.ones(residual.shape)) is residual
    unfitted = Autoregressive().for_channels(3)
    after = np.asarray(unfitted.whiten(residual, jnp.ones(residual.shape)))
    assert after == pytest.approx(drawn[0], abs=ROUNDING)


def test_correlated_samples_count_as_one_by_either_model(drawn):
    counts, gaps = everything(drawn)
    for noise in (White(), Autoregressive()):
        widened = noise.inflation(drawn[0, 0], counts[0, 0], gaps[0])
        # d ln((1 + r) / (1 - r)) / dr = 2 / (1 - r^2)
        expected = (1 + RHO) / (1 - RHO)
        assert widened == pytest.approx(expected, rel=2 / (1 - RHO**2) * FIVE)


def test_a_residual_that_is_a_model_error_is_whitened_by_no_more_than_the_largest_correlation():
    drift = np.linspace(-1.0, 1.0, 500)[None, None]
    assert Autoregressive().fit(drift, *everything(drift)).correlation == 0.95
    wider = Autoregressive(largest=0.99).fit(drift, *everything(drift))
    assert wider.correlation == pytest.approx(0.99)


def test_models_go_by_their_names():
    assert {name: type(noise_model(name)) for name in NOISE_MODELS} == {
        "white": White,
        "autoregressive": Autoregressive,
    }
    with pytest.raises(InputError, match="give one of white, autoregressive"):
        noise_model("pink")
