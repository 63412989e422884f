"""Weights of sets of effects, by what they leave of the runs."""

import numpy as np
import pytest

from diagnose.hypotheses.refinement import HeldOutCondition
from diagnose.selection.model_weights import (
    UNKNOWN,
    LeftByRun,
    ScoredHypothesis,
    WeightSettings,
    weights,
)

# Sums of a few doubles.
ROUNDING = 1e-12


def left(*powers: float) -> LeftByRun:
    """What is left of as many runs in one block, with one zeta [m^2]."""
    return LeftByRun(np.array(powers)[:, None], np.zeros(len(powers)))


def test_weights_follow_what_is_left():
    blocks = (("z", "slow"),)
    settings = WeightSettings(
        log_prior_none=0.0,
        parameter_cost=0.0,
        model_error_factor=0.0,
        formula_error_share=0.0,
        slow_worth=2.0,
        log_prior_unknown=-50.0,
    )

    def ratio(unseen: float, fitted: float) -> float:
        judged = [
            ScoredHypothesis((), 0, left(4e-8)),
            ScoredHypothesis(("drawbar",), 1, left(fitted), left(unseen)),
        ]
        found = weights(judged, blocks, np.array([1.0]), np.array([0.0]), settings)
        return found[("drawbar",)] / found[("none",)]

    # Half of a worth of 2 by the logarithm of a quarter: four to one.
    assert ratio(1e-8, 1e-8) == pytest.approx(4.0, rel=ROUNDING)
    # Fitted to a quarter, predicted no better than nothing: the geometric mean of four and one.
    assert ratio(4e-8, 1e-8) == pytest.approx(4.0 ** (1 - settings.held_out_share), rel=ROUNDING)


def test_a_remainder_takes_a_part_of_a_sets_weight_and_adds_nothing():
    """Half a gap explained is no more credible for what something unknown does with the rest."""
    blocks, count, noise = (("z", "slow"),), np.array([400.0]), np.array([0.0])

    def of(remaining: float, odds: float) -> dict:
        judged = [
            ScoredHypothesis((), 0, left(1e-6)),
            ScoredHypothesis(("drawbar",), 1, left(remaining)),
        ]
        return weights(judged, blocks, count, noise, WeightSettings(max_remainder_odds=odds))

    for remaining in (2.5e-7, 1e-8, 4e-10):
        none, most = of(remaining, -50.0), of(remaining, 3.0)
        both = most[("drawbar",)] + most[("drawbar", UNKNOWN)]
        assert both == pytest.approx(none[("drawbar",)], rel=1e-9, abs=1e-12)
    # Half of a gap: what is left is sure to be there, and the effect is not believed.
    half = of(2.5e-7, 3.0)
    assert half[("drawbar", UNKNOWN)] > 10 * half[("drawbar",)]
    assert half[(UNKNOWN,)] > 0.99
    # All of it: no remainder.
    whole = of(4e-10, 3.0)
    assert whole[("drawbar",)] > 0.9


# Three runs, of which the last alone tells the effect's number: the others miss it.
FITTED, MISSED = left(1e-10, 1e-10, 1e-10), left(1e-10, 1e-10, 1e-6)


def odds_of_missed_over_fitted(cost: float) -> float:
    """Odds of an effect whose last condition is missed by the others, over one that all foretell.

    Args:
        cost: What it costs the others to take the number of all runs [-].
    """
    settings = WeightSettings(max_remainder_odds=-50.0)
    conditions = [HeldOutCondition((run,), np.zeros(1), cost * (run == 2)) for run in range(3)]

    def odds(held_out: LeftByRun) -> float:
        drawbar = ScoredHypothesis(("drawbar",), 1, FITTED, held_out, conditions=conditions)
        judged = [ScoredHypothesis((), 0, left(1e-6, 1e-6, 1e-6)), drawbar]
        found = weights(judged, (("z", "slow"),), np.array([400.0]), np.array([0.0]), settings)
        return found[("drawbar",)] / found[("none",)]

    return odds(MISSED) / odds(FITTED)


def test_a_condition_counts_by_the_numbers_of_all_where_the_others_know_little():
    share = np.exp(-WeightSettings().held_out_share * 2.0)
    assert odds_of_missed_over_fitted(cost=2.0) == pytest.approx(share, rel=1e-9)


def test_a_condition_that_the_others_know_better_counts_by_their_prediction():
    missed = odds_of_missed_over_fitted(cost=200.0)
    assert missed < 0.1
    # However much more it would cost.
    assert odds_of_missed_over_fitted(cost=np.inf) == pytest.approx(missed, rel=1e-9)
