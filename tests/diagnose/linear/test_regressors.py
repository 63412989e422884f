"""Gram matrices of columns beside all regressors, against those of all columns together."""

import numpy as np

from diagnose.dataset import match_initial_zeta
from diagnose.linear.linearized_runs import linearize_runs
from diagnose.linear.regressors import Regressors
from drftjax.effects.catalogue import effect_class
from tests.helpers.rig_datasets import dataset_with

# One with a shape, and one without.
EFFECTS = ("drawbar", "loosening")
GIVEN = 3


def test_products_beside_all_regressors_are_those_of_all_columns_together(pool):
    dataset = dataset_with({"name": "drawbar", "force": 5.0})
    linearized = linearize_runs(dataset, match_initial_zeta(dataset, pool), pool)
    regressors = Regressors.of(dataset, linearized, [*map(effect_class, EFFECTS)], pool)
    numbers = np.random.default_rng(3)
    columns = [numbers.standard_normal((*each.shape[:2], GIVEN)) for each in regressors.columns]
    residual = [numbers.standard_normal(each.shape) for each in regressors.residual]
    log_zeta = numbers.standard_normal(len(residual))
    together = [
        np.concatenate([given, every[:, :, 1:]], axis=2)
        for given, every in zip(columns, regressors.columns, strict=True)
    ]
    expected = regressors.gram_matrices_of(together, residual, log_zeta, pool)
    found = regressors.gram_matrices_beside_all(columns, residual, log_zeta, pool)
    assert found.blocks == expected.blocks
    np.testing.assert_array_equal(found.sample_count, expected.sample_count)
    np.testing.assert_array_equal(found.log_zeta, expected.log_zeta)
    # Products are summed in another order: a rounding of the columns' own sizes.
    size = np.sqrt(np.diagonal(expected.gram, axis1=2, axis2=3))
    bound = 1e-12 * size[..., :, None] * size[..., None, :]
    assert (np.abs(found.gram - expected.gram) <= bound).all()
