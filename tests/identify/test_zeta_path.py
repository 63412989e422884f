"""Offline zeta(t): a known path comes back within its errors, and a standstill says nothing."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lfilter

from drftjax.common.errors import InputError
from drftjax.physics.terrain import KnotZeta
from drftjax.recorded.batch import make_batch
from drftjax.recorded.observation import sampling_intervals, white_noise
from drftjax.recorded.prepared_run import PreparedRun, prepare_run
from drftjax.setups.setup import IntegratorSetUp
from identify.zeta_path.evidence import (
    AR1Noise,
    InstrumentFloor,
    LaggedProducts,
    LinearizedPath,
)
from identify.zeta_path.path import SEGMENTS, ZetaPath, cardinal_splines, segment_ends
from identify.zeta_path.simulate import predict_path
from identify.zeta_path.smoother import zeta_paths
from tests.helpers.synthetic_runs import DEEPER
from tests.studies.crosscheck import NOISE, RATE, known_run, known_setup

# Coarse plates: the program is tested, not their error. With coarser ones and at longer steps the
# misfit grows rough, by the corners that plates pass as they begin to lead.
PLATE_SIZE, STEP = 5e-3, 1e-3
TIME, OMEGA = (0.0, 0.5, 2.0, 4.0, 5.5, 6.0), (0.0, 0.0, 45.0, 45.0, 0.0, 0.0)
# A stretch about the fourth knot, which a recording lost [s].
LOST = (2.0, 3.5)
LATE_TIME, LATE_OMEGA = (0.0, 3.0, 4.0, 5.0, 5.9, 6.0), (0.0, 0.0, 30.0, 30.0, 0.0, 0.0)
KNOTS = np.linspace(0.0, 5.5, 7)
FINE = np.linspace(0.0, 5.5, 111)
SPACING = 5.5 / 6
RUNS = 4
# Steps have corners, where plates begin to lead, and derivatives jump there: differences over so
# small a change cross none. What is left is what is taken off where a step's balance all but folds
# (`drftjax.physics.implicit.LARGEST_GROWTH`), less than 1 % at this step.
DIFFERENCES = 1e-2
# Rise of the bed [-]; and what zeta at knots, the plates' ripple between them, may leave of z.
RISE, FEW_FLOORS = 0.012, 5 * NOISE
# Root mean squares of 275 samples scatter by 1 / sqrt(2 * 275) of themselves, 4 %, and of the 140
# that a thinned run has by 6 %: five times that.
MISFIT, SPREAD = 0.25, 0.3
# 46 samples a knot of 20 um, where sinkage changes by 25 mm a zeta, tell a knot to 1.2e-4; twice.
TOLD = 3e-4
# A few roundings of doubles up to ten.
ROUNDING = 1e-13
# The inverse of a covariance whose eigenvalues are two orders apart.
INVERSE = 1e-12
# Second differences over a millisecond, where third derivatives are of order ten; of a curve with a
# bend at its end they would be a thousand times as large.
UNBENT = 1e-7
# Two-sided 90 % of a normal distribution, in standard errors.
BAND = 1.645


def path_of(number: int):
    values = 0.75 + 0.05 * np.sin(0.9 * KNOTS + number) + 0.01 * (number % 3)
    return lambda t: np.exp(cardinal_splines(KNOTS, t) @ np.log(values))


def made(name: str, path, seed: int, time=TIME, omega=OMEGA, effects=(), step=STEP) -> PreparedRun:
    setup = known_setup(name, path, FINE, time, omega, PLATE_SIZE)
    setup.integrator = IntegratorSetUp(step=step)
    setup.start.sinkage *= DEEPER
    setup.effects = [*effects]
    run = known_run(setup, np.random.default_rng(seed))
    each = prepare_run(name, run, step=step)
    each.setup.wheel.plate_size = PLATE_SIZE
    return dataclasses.replace(each, trial=each.setup.trial(5 * step))


def without(each: PreparedRun, start: float, end: float) -> PreparedRun:
    """The run without the samples of some time [s], and without every seventh other."""
    seen = each.observation
    kept = (seen.time < start) | (seen.time > end)
    kept &= np.arange(len(seen.time)) % 7 > 0
    short = dataclasses.replace(
        seen, time=seen.time[kept], values=seen.values[:, kept], counts=seen.counts[kept]
    )
    return dataclasses.replace(each, name="lossy", observation=short)


@pytest.fixture(scope="module")
def candidates() -> list[PreparedRun]:
    runs = [made(f"run {number}", path_of(number), number) for number in range(RUNS)]
    late = made("stands long", lambda t: 0.74 + 0 * t, RUNS, LATE_TIME, LATE_OMEGA)
    return [*runs, late]


@pytest.fixture(scope="module")
def paths(candidates) -> list[ZetaPath]:
    return zeta_paths(candidates, SPACING)


# A known path -----------------------------------------------------------------------------------


def test_known_path_lies_within_its_band(paths):
    """Of 28 knots over 4 runs, nine in ten; fewer than 22 would be chance once in 100 times."""
    inside = [
        np.abs(each.value - path_of(number)(each.time)) <= BAND * each.error
        for number, each in enumerate(paths[:RUNS])
    ]
    assert np.concatenate(inside).sum() >= 22
    # And the band is no wide one.
    assert np.median([each.error[2:5] for each in paths[:RUNS]]) < TOLD


def test_where_samples_were_lost_the_path_is_known_less_well():
    """At half the step, where what a knot bears on does not change with the corners on its way."""
    run = made("run 0", path_of(0), 0, step=STEP / 2)
    whole, lossy = zeta_paths([run, without(run, *LOST)], SPACING)
    assert np.abs(lossy.value - path_of(0)(lossy.time)).max() < 4 * lossy.error.max()
    middle = int(np.argmin(np.abs(lossy.time - np.mean(LOST))))
    assert lossy.error[middle] > 1.5 * whole.error[middle]
    # Elsewhere one in seven is lost, and an error of one in fourteen more is due; the knot beside
    # bears on it too, and is told far less well. In the gap it is three times as large.
    assert lossy.error[-2] == pytest.approx(whole.error[-2], rel=0.4)
    assert all(spread == pytest.approx(NOISE, rel=SPREAD) for spread, _ in lossy.noise.values())


def test_between_knots_the_path_is_a_curve(paths):
    """Straight lines from knot to knot would cut the waves' corners by several times as much."""
    inside = FINE[(KNOTS[2] < FINE) & (KNOTS[4] > FINE)]
    curve, lines = [], []
    for number, each in enumerate(paths[:RUNS]):
        truth = path_of(number)
        curve.append(each.at(inside) - truth(inside))
        lines.append(np.interp(inside, KNOTS, truth(KNOTS)) - truth(inside))
    assert np.std(curve) < np.std(lines) / 2


def test_spline_is_exact_at_its_knots_and_straight_beyond():
    grid = np.array([0.0, 1.0, 2.5, 3.0, 4.0])
    values = np.array([1.0, 3.0, -2.0, 0.5, 4.0])
    ends = segment_ends(grid)
    np.testing.assert_allclose(ends[::SEGMENTS], grid, rtol=0, atol=ROUNDING)
    curve = cardinal_splines(grid, ends) @ values
    np.testing.assert_allclose(curve[::SEGMENTS], values, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(
        cardinal_splines(grid, np.array([-3.0, 9.0])) @ values, values[[0, -1]]
    )
    # Natural: no bend at the ends; and a straight line stays one.
    small = np.array([0.0, 1e-3, 2e-3])
    assert np.diff(cardinal_splines(grid, small) @ values, 2) == pytest.approx(0.0, abs=UNBENT)
    straight = cardinal_splines(grid, ends) @ (2 - 3 * grid)
    np.testing.assert_allclose(straight, 2 - 3 * ends, rtol=0, atol=ROUNDING)


def test_fit_comes_down_to_the_noise(paths):
    for each in paths[:RUNS]:
        assert each.converged
        assert each.rmse["z"] == pytest.approx(NOISE, rel=MISFIT)
        assert each.rmse["x"] == pytest.approx(NOISE, rel=MISFIT)
        assert all(spread == pytest.approx(NOISE, rel=SPREAD) for spread, _ in each.noise.values())


def test_a_wheel_that_speeds_up_is_not_noise(candidates):
    """At 25 Hz its readings' second differences are twice the noise's."""
    seen = candidates[0].observation
    sparse = dataclasses.replace(
        seen, time=seen.time[::2], values=seen.values[:, ::2], counts=seen.counts[::2]
    )
    assert white_noise(sparse.values[sparse.channels.index("x")]) > 2 * NOISE
    (path,) = zeta_paths([dataclasses.replace(candidates[0], observation=sparse)], SPACING)
    assert all(spread == pytest.approx(NOISE, rel=SPREAD) for spread, _ in path.noise.values())


def test_fitted_setup_and_trial_are_the_path(paths):
    each = paths[0]
    zeta = each.trial.simulator.terrain.zeta
    assert isinstance(zeta, KnotZeta)
    np.testing.assert_allclose(zeta.value, each.at(np.asarray(zeta.time)), rtol=ROUNDING)
    np.testing.assert_array_equal(zeta.value, each.setup.terrain.zeta.value)
    np.testing.assert_array_equal(zeta.time, each.setup.terrain.zeta.time)
    np.testing.assert_allclose(each.at(each.time), each.value)


def test_standstill_tells_nothing_of_zeta(paths):
    path = paths[-1]
    standing, moving = path.time < 2.0, (path.time > 3.5) & (path.time < 5.5)
    np.testing.assert_allclose(path.value[moving], 0.74, rtol=0, atol=TOLD)
    assert path.error[moving].max() < TOLD
    assert path.identified[moving].all()
    assert not path.identified[standing].any()
    # Not even the first digit.
    assert path.error[standing].min() > 0.5


# A zeta that moves a lot --------------------------------------------------------------------------

MECHANISMS = {
    "slope": {"name": "surface_slope", "slope": RISE},
    "falling slope": {"name": "surface_slope", "slope": -RISE},
    "loosening": {"name": "loosening", "loss": 0.3, "decay": 1.0},
    "patch": {"name": "terrain_variation", "excess": -0.2, "centre": 0.25, "width": 0.1},
}


@pytest.fixture(scope="module")
def moved() -> dict[str, ZetaPath]:
    """Runs on sand of 0.75 with a mechanism that the model leaves to zeta."""
    runs = [
        made(name, lambda t: 0.75 + 0 * t, number, effects=[effect])
        for number, (name, effect) in enumerate(MECHANISMS.items())
    ]
    return dict(zip(MECHANISMS, zeta_paths(runs, SPACING / 2), strict=True))


def test_path_makes_up_for_whatever_moves_the_sinkage(moved):
    for name, each in moved.items():
        assert each.converged, name
        assert each.rmse["z"] < FEW_FLOORS, name
        spread, correlation = each.noise["z"]
        assert spread < FEW_FLOORS, name
        assert correlation <= np.exp(-np.pi / (SPACING / 2) / RATE) + INVERSE, name


def test_rising_bed_is_met_by_ever_harder_sand_at_the_cost_of_travel(moved):
    path, fallen = moved["slope"], moved["falling slope"]
    # At 25 mm of sinkage a zeta, the last 5 mm of rise ask for 0.2 more, and less as zeta grows.
    assert path.value[path.identified][-2] > 0.9
    assert fallen.value[fallen.identified][-2] < 0.68
    # No zeta(t) meets both: what it does to slip is summed up, and told as what it is.
    assert path.rmse["x"] > 20 * path.rmse["z"]
    said = path.contradiction()
    assert said is not None
    assert said.startswith("slope: a zeta(t) that matches the sinkage to 0.0")
    # It lasts for as long as the run: seconds, of 20 ms each.
    assert path.noise["x"][1] > 0.99


def test_sand_that_changes_is_told_by_travel_too(moved):
    for name in ("loosening", "patch"):
        assert moved[name].rmse["x"] < 2 * NOISE
        assert moved[name].contradiction() is None


# Derivatives and algebra --------------------------------------------------------------------------


def test_derivative_by_the_knots_is_exact(candidates):
    each = candidates[1]
    values, ends = path_of(1)(KNOTS), segment_ends(KNOTS)
    curve = jnp.asarray(cardinal_splines(KNOTS, ends))
    lines = KnotZeta(ends, path_of(1)(ends))
    trial = eqx.tree_at(lambda t: t.simulator.terrain.zeta, each.trial, lines)
    batch = make_batch([trial], [each.observation])
    observed = jax.tree.map(lambda leaf: leaf[0], batch.observed)
    at = jnp.concatenate([jnp.log(jnp.asarray(values)), jnp.zeros(2)])

    @jax.jit
    def simulated(coordinates):
        return predict_path(trial, observed, batch.channels, curve, coordinates)

    # A curve of the moving part alone: a standing wheel sinks into weaker sand, but does not rise
    # in stronger sand, so its differences are not its derivative.
    standing = curve[(ends < TIME[1] + ends[1]) | (ends >= TIME[-2])]
    _, size, kinds = np.linalg.svd(standing)
    moving = kinds[np.sum(size > 1e-9) :]
    assert len(moving) == 3
    along = jnp.zeros(len(at)).at[: len(KNOTS)].set(moving.sum(axis=0))
    _, forward = jax.jit(lambda a, d: jax.jvp(simulated, (a,), (d,)))(at, along)
    small = 1e-8
    differences = (simulated(at + small * along) - simulated(at - small * along)) / (2 * small)
    counts = (observed.weight > 0).astype(float)
    far = counts * (forward - differences)
    assert jnp.sqrt(jnp.sum(far**2) / jnp.sum((counts * forward) ** 2)) < DIFFERENCES


@pytest.mark.parametrize("lost", [[], [0, 7, 20, 21, 22, 39], [*range(3, 30)]])
def test_whitening_is_the_inverse_covariance_whatever_was_lost(lost):
    random = np.random.default_rng(0)
    place = np.delete(np.arange(40), lost)
    columns, noise = random.standard_normal((len(place), 3)), AR1Noise(0.3, 0.8)
    covariance = 0.3**2 * 0.8 ** np.abs(np.subtract.outer(place, place))
    products = LaggedProducts.of(columns, sampling_intervals(0.01 * place))
    dense = columns.T @ np.linalg.solve(covariance, columns)
    np.testing.assert_allclose(products.whitened_gram(noise), dense, rtol=INVERSE)
    assert products.log_determinant(noise) == pytest.approx(
        np.linalg.slogdet(covariance)[1], rel=INVERSE
    )


def test_noise_is_found_among_the_samples_that_are_left():
    random = np.random.default_rng(1)
    fresh = 0.3 * np.sqrt(1 - 0.9**2) * random.standard_normal(20000)
    place = np.flatnonzero(random.random(20000) < 0.5)
    data = lfilter([1.0], [1.0, -0.9], fresh)[place]
    products = LaggedProducts.of(data[:, None], sampling_intervals(0.01 * place))
    found = products.most_probable_noise(
        np.ones(1), np.zeros((0, 0)), InstrumentFloor(1e-6, 0.9999)
    )
    # Five standard deviations of a correlation told by 5,000 pairs, and of the spread.
    assert found.correlation == pytest.approx(0.9, abs=5 * np.sqrt((1 - 0.9**2) / 5000))
    assert found.spread == pytest.approx(0.3, rel=5 * np.sqrt(19 / 2 / 20000))


def test_noise_lasts_no_longer_than_its_instrument_allows():
    time = np.linspace(0.0, 1.0, 500)
    products = LaggedProducts.of((1e-3 * time)[:, None], sampling_intervals(time))
    residual, nothing = np.ones(1), np.zeros((0, 0))
    assert (
        products.most_probable_noise(residual, nothing, InstrumentFloor(1e-6, 0.9999)).correlation
        == 0.9999
    )
    short = products.most_probable_noise(residual, nothing, InstrumentFloor(1e-6, 0.9))
    assert short.correlation == 0.9
    # A slow drift cannot hide in it: the spread that would have to hold it is its own size.
    assert short.spread > 0.1e-3


def test_evidence_is_largest_near_the_weight_that_made_the_path():
    random = np.random.default_rng(2)
    knots, weight = 40, 1e3
    found = []
    for _ in range(8):
        bends = random.standard_normal(knots - 2) / np.sqrt(weight)
        drawn = np.cumsum(np.cumsum(np.r_[0, 0, bends]))
        seen = np.repeat(np.eye(knots), 10, axis=0)
        data = seen @ drawn + 0.02 * random.standard_normal(len(seen))
        products = [LaggedProducts.of(np.c_[seen, data], sampling_intervals(np.arange(len(data))))]
        path = LinearizedPath(products, knots, 0.0)
        best = max(
            path.settings.weight_grid,
            key=lambda w, p=path: p.posterior(w, [AR1Noise(0.02, 0.0)]).evidence,
        )
        found.append(np.log10(best))
    # 38 bends tell a weight to sqrt(2 / 38) / ln 10, a tenth of a decade, and eight paths to 0.035;
    # but the weights that are tried lie half a decade apart.
    assert np.mean(found) == pytest.approx(3.0, abs=0.25)


# Refusals -----------------------------------------------------------------------------------------


def test_a_path_that_cannot_be_fitted_is_refused(candidates):
    with pytest.raises(InputError, match="knot spacing is 0 s, must be positive"):
        zeta_paths(candidates[:1], 0.0)
    with pytest.raises(InputError, match=r"run 0: has \d+ samples to compare, too few for"):
        zeta_paths(candidates[:1], 0.01)
