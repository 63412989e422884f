"""Deviations from a condition's mean, fits of them, and their score, against plain algebra."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import minimize

from diagnose.change.differences.conditions import MatchedCondition
from diagnose.change.differences.fit import CoefficientPrior, fit_differences, score_differences
from diagnose.change.differences.gram import DifferenceGram, Differences
from diagnose.change.differences.settings import DifferenceFitSettings
from diagnose.linear.bed import PreparedBed

# Sums of a few hundred numbers, in another order.
ROUNDING = 1e-10
# A reweighted fit ends where another step gains nothing; a general optimiser where it believes so.
OPTIMUM = 1e-4
SETTINGS = DifferenceFitSettings(iterations=200, linear_error=0.0)


def differences_of(
    times: list[np.ndarray],
    conditions: list[MatchedCondition],
    channels: tuple[str, ...] = ("z",),
) -> Differences:
    """Differences of runs that have these channels at these times."""
    dataset = SimpleNamespace(
        channels=channels, runs=times, run_numbers=range(len(times)), time=lambda run: times[run]
    )
    return Differences.of(dataset, conditions)  # pyright: ignore[reportArgumentType]


def random_runs(seed: int, times: list[np.ndarray]):
    """Columns by two coefficients, by zeta, and residuals, of the size of a rig's [m]."""
    random = np.random.default_rng(seed)
    columns = [1e-3 * random.standard_normal((1, len(t), 2)) for t in times]
    by_zeta = [1e-2 * (1 + random.random((1, len(t)))) for t in times]
    residual = [1e-3 * random.standard_normal((1, len(t))) for t in times]
    return columns, by_zeta, residual


def gram_of(differences, columns, by_zeta, residual) -> DifferenceGram:
    here = SimpleNamespace(map=lambda work, items: [work(each) for each in items])
    return differences.gram(columns, by_zeta, residual, here)


def test_a_pair_has_half_the_square_of_its_difference():
    time = np.arange(0, 4, 0.05)
    differences = differences_of([time, time], [MatchedCondition((0,), (1,))])
    columns, by_zeta, residual = random_runs(1, [time, time])
    found = gram_of(differences, columns, by_zeta, residual)
    split = differences.clocks[0].split.split("z", (residual[1] - residual[0]).T)
    for block, kind in enumerate(("slow", "fast")):
        half = 0.5 * float((split[kind] ** 2).sum())
        assert found.gram[block, -1, -1] == pytest.approx(half, rel=ROUNDING)


def test_what_all_runs_of_a_condition_share_changes_nothing():
    time = np.arange(0, 4, 0.05)
    conditions = [MatchedCondition((0, 1), (2,))]
    differences = differences_of([time] * 3, conditions)
    columns, by_zeta, residual = random_runs(2, [time] * 3)
    shared = 0.05 * np.sin(3 * time)[None]
    plain = gram_of(differences, columns, by_zeta, residual)
    moved = gram_of(differences, columns, by_zeta, [each + shared for each in residual])
    np.testing.assert_allclose(moved.gram, plain.gram, rtol=0, atol=1e-14)
    assert not np.allclose(
        gram_of(differences, columns, by_zeta, [residual[0] + shared, *residual[1:]]).gram,
        plain.gram,
    )


def test_runs_of_other_clocks_are_compared_where_both_were_recorded():
    fine, short = np.arange(0, 4, 0.02), np.arange(0, 3, 0.05)
    differences = differences_of([fine, short], [MatchedCondition((0,), (1,))])
    clock = differences.clocks[0]
    assert clock.time[-1] == short[-1]
    # A straight line is the same on either clock: no difference is left.
    nothing = [np.zeros((1, len(t), 0)) for t in (fine, short)]
    line = [0.01 * t[None] for t in (fine, short)]
    still = [np.zeros((1, len(t))) for t in (fine, short)]
    assert np.abs(gram_of(differences, nothing, still, line).gram).max() < 1e-20


def test_a_fit_is_where_a_general_optimiser_of_its_score_ends():
    time = np.arange(0, 4, 0.05)
    conditions = [MatchedCondition((0,), (1,)), MatchedCondition((2, 3), (4,))]
    differences = differences_of([time] * 5, conditions)
    columns, by_zeta, residual = random_runs(3, [time] * 5)
    columns = [c * float(run in (1, 4)) for run, c in enumerate(columns)]
    matrices = gram_of(differences, columns, by_zeta, residual)
    deviation = np.array([0.01, -0.01, 0.02, 0.0, -0.02])
    width = np.array([0.7, 1.3])
    fit = fit_differences(
        matrices,
        (0, 1),
        deviation,
        differences.centring,
        CoefficientPrior.free(width),
        0.0,
        SETTINGS,
    )

    def loss(changes: np.ndarray) -> float:
        left = [
            (r + c @ changes[:2] + z * changes[2 + run])[0]
            for run, (c, z, r) in enumerate(zip(columns, by_zeta, residual, strict=True))
        ]
        total = 0.0
        for block, kind in enumerate(("slow", "fast")):
            parts = [
                np.array(
                    [clock.split.split("z", left[r][:, None])[kind] for r in clock.condition.runs]
                )
                for clock in differences.clocks
            ]
            square = sum(((each - each.mean(axis=0)) ** 2).sum() for each in parts)
            count = matrices.count[block]
            error = SETTINGS.model_errors(matrices.blocks)[block]
            worth = SETTINGS.worth(matrices.blocks)[block]
            total += 0.5 * worth * count * np.log(square / count + error**2)
        own = differences.centring @ (deviation + changes[2:])
        bed = PreparedBed()
        scatter = (own @ own) / (bed.statements * bed.scatter**2)
        prior = 0.5 * ((changes[:2] / width) ** 2).sum()
        level = deviation + changes[2:] - own
        prior += 0.5 * (level @ level) / SETTINGS.level_width**2
        return total + 0.5 * (bed.statements + 3) * np.log1p(scatter) + prior

    best = minimize(loss, np.r_[fit.coefficients, fit.zeta_change] + 0.01, method="BFGS")
    assert loss(np.r_[fit.coefficients, fit.zeta_change]) == pytest.approx(best.fun, abs=OPTIMUM)


def test_bounds_hold_and_the_others_fit_around_them():
    time = np.arange(0, 4, 0.05)
    differences = differences_of([time] * 2, [MatchedCondition((0,), (1,))])
    columns, by_zeta, residual = random_runs(4, [time] * 2)
    columns[0] *= 0
    matrices = gram_of(differences, columns, by_zeta, residual)
    free = CoefficientPrior.free(np.array([5.0, 5.0]))
    loose = fit_differences(
        matrices, (0, 1), np.zeros(2), differences.centring, free, 0.0, SETTINGS
    )
    bound = CoefficientPrior(
        free.width, free.offset, np.array([loose.coefficients[0] + 0.1, -np.inf]), free.most
    )
    held = fit_differences(
        matrices, (0, 1), np.zeros(2), differences.centring, bound, 0.0, SETTINGS
    )
    assert held.coefficients[0] == pytest.approx(bound.least[0])
    assert held.coefficients[1] != pytest.approx(loose.coefficients[1])
    assert held.score < loose.score


def test_another_law_moves_x_further_for_the_same_sinkage():
    time = np.arange(0, 4, 0.05)
    conditions = [MatchedCondition((run,), (run + 1,)) for run in (0, 2, 4)]
    differences = differences_of([time] * 6, conditions, ("z", "x"))
    random = np.random.default_rng(5)
    of_each = [3e-2 * (1 + random.random((2, 1))) * np.stack([time, time**2]) for _ in range(3)]
    by_zeta = [each for each in of_each for _ in range(2)]
    scatter = 0.01 * np.array([-1, 1, 0.5, -0.5, 0.3, -0.3])
    # The sand moves x by 1.4 times what the model does.
    of_sand = [z * np.array([[1.0], [1.4]]) for z in by_zeta]
    residual = [-z * own for z, own in zip(of_sand, scatter, strict=True)]
    nothing = [np.zeros((2, len(time), 0)) for _ in range(6)]
    matrices = gram_of(differences, nothing, by_zeta, residual)

    centring = differences.centring

    def fit(prior: float, at: np.ndarray | None = None):
        settings = replace(SETTINGS, law_factor_prior=prior)
        free = CoefficientPrior.free(np.zeros(0))
        if at is None:
            return fit_differences(matrices, (), np.zeros(6), centring, free, 0.0, settings)
        moved = [r + z * own for r, z, own in zip(residual, by_zeta, at, strict=True)]
        changed = [(z * own)[:, :, None] for z, own in zip(by_zeta, at, strict=True)]
        there = gram_of(differences, changed, by_zeta, moved)
        return score_differences(there, at, centring, settings)

    wide, held = fit(1.0), fit(1e-6)
    of_x = [channel == "x" for channel, _ in matrices.blocks]
    # The bed's scatter holds zeta back a little, and the factor makes up for it.
    np.testing.assert_allclose(wide.law_factors[of_x], 0.4, atol=0.02)
    assert not wide.law_factors[np.logical_not(of_x)].any()
    assert wide.mean_square[of_x].sum() < 1e-3 * held.mean_square[of_x].sum()
    # A score of residuals that are there finds the same factors as the fit that leads there.
    there = fit(1.0, wide.zeta_change)
    np.testing.assert_allclose(there.law_factors, wide.law_factors, rtol=1e-6)
    assert there.score == pytest.approx(wide.score, rel=1e-9)
    # What the prior asks of them is counted, once for the channel.
    narrow = fit(0.6, wide.zeta_change)
    cost = narrow.zeta_score - there.zeta_score
    asked = (narrow.law_factors[of_x][0] / 0.6) ** 2 - there.law_factors[of_x][0] ** 2
    assert cost == pytest.approx(-0.5 * asked, rel=1e-6)
