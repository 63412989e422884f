"""What a diagnosis says of a gap, and what other runs show of it, go by one rule."""

import numpy as np
import pytest

from diagnose.dataset import RigDataset, match_initial_zeta
from diagnose.gap.cross_validation import at_mean_sinkage, predict_held_out
from diagnose.gap.zeta_matching import match_runs, residuals_of
from diagnose.hypotheses.hypothesis import linear_start
from diagnose.hypotheses.refinement import refine
from diagnose.linear.linear_fit import LinearFitSettings
from diagnose.linear.linearized_runs import linearize_runs
from diagnose.linear.regressors import Regressors
from diagnose.model.augmented_model import AugmentedModel
from tests.helpers.rig_datasets import WITH_REST, dataset_with

# Secant steps end where 2e-5 of zeta is left: about half a micrometre of half a millimetre.
AGREE = 2e-3


@pytest.fixture(scope="module")
def drifting() -> RigDataset:
    """Runs whose z reads over a millimetre too high on the mean, where 5 % of zeta would be."""
    return dataset_with({"name": "sinkage_drift", "rate": 5e-4}, settings=WITH_REST)


def rms(residual: list[np.ndarray]) -> np.ndarray:
    return np.sqrt(np.mean(np.concatenate(residual, axis=1) ** 2, axis=1))


@pytest.mark.parametrize("level_worth", [1.0, 0.0])
def test_the_gap_is_that_which_an_evaluation_of_the_same_runs_finds(drifting, pool, level_worth):
    linearized = linearize_runs(drifting, match_initial_zeta(drifting, pool), pool)
    weights = LinearFitSettings(level_worth=level_worth)
    regressors = Regressors.of(drifting, linearized, (), pool, weights)
    none = refine(regressors, linear_start(regressors, []), 3, pool)
    held_out = predict_held_out(regressors, none, pool)
    met = residuals_of(at_mean_sinkage(held_out, pool))
    alone = [each.residual for each in match_runs(drifting, AugmentedModel(), np.zeros(0), pool)]
    assert rms(met) == pytest.approx(rms(alone), rel=AGREE)
    if level_worth:
        return
    # Without levels the zeta that suits all channels best gives z up for x.
    x, z = (drifting.channels.index(channel) for channel in "xz")
    # And by far: x has more samples to say so, and less noise.
    assert rms(met)[z] < 0.5 * rms(none.residual)[z]
    assert rms(met)[x] > 3 * rms(none.residual)[x]
