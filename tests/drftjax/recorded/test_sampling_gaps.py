"""Samples that a recording lost: a residual carries less of itself over a gap."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lfilter

from drftjax.recorded.batch import make_batch
from drftjax.recorded.observation import Observation
from identify.solver.problem import sample_gaps
from identify.solver.whitening import Whitening
from identify.uncertainty.noise_model import Autoregressive, White
from tests.helpers.synthetic_runs import coarse, recorded, setup_of

PROFILE = ([0.0, 0.3, 1.3, 2.5], [0.0, 0.0, 0.9, 0.9])
RHO = 0.9
SAMPLES = 20000
# Of means and spreads that are told by many draws, too.
FIVE = 5
# Five standard deviations of a lag-one correlation where half of the samples are kept, and a
# quarter has its neighbour: 5 sqrt((1 - RHO^2) / (SAMPLES / 4)) < 0.031.
TOLD = 0.031


def autoregressive(seed: int) -> np.ndarray:
    fresh = np.sqrt(1 - RHO**2) * np.random.default_rng(seed).standard_normal(SAMPLES)
    return lfilter([1.0], [1.0, -RHO], fresh)


def observation(time: np.ndarray) -> Observation:
    nothing = np.zeros((1, len(time)))
    return Observation(time, ("z",), nothing, np.ones(1), np.ones(len(time), bool))


def test_the_mean_speed_is_the_way_from_first_to_last_over_their_time():
    time, compared = np.array([1.0, 1.5, 3.0]), np.ones(3, bool)
    x = np.array([[0.1, 0.9, 0.5]])
    assert Observation(time, ("x",), x, np.ones(1), compared).mean_speed == pytest.approx(0.2)
    assert observation(time).mean_speed == 0.0
    assert Observation(time[:1], ("x",), x[:, :1], np.ones(1), compared[:1]).mean_speed == 0.0


def test_intervals_count_what_was_lost_and_not_what_came_a_little_late():
    time = np.array([0.0, 0.010, 0.0203, 0.030, 0.040, 0.080, 0.0897, 0.1])
    assert observation(time).intervals.tolist() == [np.inf, 1, 1, 1, 1, 4, 1, 1]
    assert observation(np.array([0.5])).intervals.tolist() == [np.inf]


def test_correlation_is_that_of_neighbours_whatever_was_lost_between_others():
    kept = np.random.default_rng(1).random(SAMPLES) < 0.5
    residual = autoregressive(0)[kept][None, None]
    intervals = observation(0.01 * np.flatnonzero(kept)).intervals[None]
    assert set(intervals[0]) > {1.0, 2.0, 3.0}
    counts = np.ones(residual.shape, bool)
    (found,) = Autoregressive().fit(residual, counts, intervals).correlation
    assert found == pytest.approx(RHO, abs=TOLD)
    (side_by_side,) = Autoregressive().fit(residual, counts, np.ones(intervals.shape)).correlation
    assert side_by_side < RHO - 2 * TOLD


def test_whitened_residuals_scatter_by_one_on_both_sides_of_gaps():
    run = coarse("run", recorded(setup_of(PROFILE), rate=100.0, noise=0.0))
    kept = np.random.default_rng(2).random(len(run.observation.time)) < 0.6
    short = dataclasses.replace(
        run.observation,
        time=run.observation.time[kept],
        values=run.observation.values[:, kept],
        counts=run.observation.counts[kept],
    )
    batch = make_batch([run.trial], [short], jax.device_count())
    noise = Autoregressive(jnp.full(2, RHO))
    gaps = jax.vmap(sample_gaps)(batch.observed)
    share = np.asarray(jax.vmap(noise.coefficients)(gaps))[0]
    length = len(short.time)
    usual = short.intervals
    expected = np.where(short.counts, RHO**usual, 0)
    assert share[:, :length] == pytest.approx(np.stack([expected] * 2))
    assert not share[:, length:].any()

    # Of noise that carries RHO a sample on, what is left after each sample's share scatters by 1.
    draws = np.stack([autoregressive(seed)[: len(kept)][kept] for seed in range(3, 203)])
    after = (draws[:, 1:] - expected[1:] * draws[:, :-1]) / np.sqrt(1 - expected[1:] ** 2)
    late = (usual[1:] > 1) & short.counts[1:]
    assert late.sum() > 20
    assert after[:, late].std() == pytest.approx(1.0, abs=FIVE / np.sqrt(2 * late.sum() * 200))
    assert after[:, late].mean() == pytest.approx(0.0, abs=FIVE / np.sqrt(late.sum() * 200))


def test_samples_beside_a_gap_widen_no_error():
    residual = np.ones((1, 1, 60))
    residual[..., 30:] = -1.0
    counts, phase = np.ones(residual.shape, bool), np.zeros((1, 60), int)
    offset, intervals = np.zeros(residual.shape), np.ones((1, 60))
    close = Whitening.of(residual, counts, offset, phase, intervals, White()).scale
    apart = Whitening.of(residual, counts, offset, phase, 7 * intervals, White()).scale
    assert np.all(apart == 1.0)
    # One change in 60 samples: they carry 0.97 of themselves on, and count sqrt(0.03 / 1.97) each.
    assert np.all(close < 0.2)
