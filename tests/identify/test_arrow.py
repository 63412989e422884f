"""Least squares of shared and own numbers, against NumPy's dense least squares."""

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import pytest

from identify.cluster.chunk import condensed_rows
from identify.solver.arrow import ArrowQR, columns, gauss_newton_step
from identify.solver.problem import normal_equations

# Both are backward stable, and the matrices have condition numbers of some tens.
ROUNDING = 1e-11
RUNS, CHANNELS, SAMPLES = 4, 2, 9
SIZES = [(1, 1), (2, 3), (0, 2), (2, 0)]


def parts(shared: int, own: int, seed: int = 0):
    random = np.random.default_rng(seed)
    blocks = random.standard_normal((RUNS, CHANNELS, SAMPLES, shared + own))
    residual = random.standard_normal((RUNS, CHANNELS, SAMPLES))
    blocks[1], residual[1] = 0, 0  # a run that is padding
    coordinates = shared + RUNS * own
    return blocks, residual, random.standard_normal(coordinates), random.random(coordinates)


class Rows(eqx.Module):
    """Rows, priors and damping along (shared, own) coordinates, as the solver's operator."""

    blocks: jax.Array
    slope: jax.Array
    damping: float

    def __call__(self, step):
        shared, own = step
        number = len(shared)
        spread = jnp.broadcast_to(shared, (len(own), number))
        along = jnp.concatenate([spread, own], axis=1)
        rows = jnp.einsum("rcsp,rp->rcs", self.blocks, along)
        of_shared, of_own = self.slope[:number], self.slope[number:].reshape(own.shape)
        damped = self.damping * shared, self.damping * own
        return (rows, of_shared * shared, of_own * own), damped


@pytest.mark.parametrize(("shared", "own"), SIZES)
def test_damped_step_is_that_of_dense_least_squares(shared, own):
    blocks, residual, prior, slope = parts(shared, own)
    damping = 0.3
    shapes = (
        jax.ShapeDtypeStruct((shared,), float),
        jax.ShapeDtypeStruct((RUNS, own), float),
    )
    operator = lx.FunctionLinearOperator(
        Rows(jnp.asarray(blocks), jnp.asarray(slope), damping), shapes
    )
    right = (
        (
            jnp.asarray(residual),
            jnp.asarray(prior[:shared]),
            jnp.asarray(prior[shared:].reshape(RUNS, own)),
        ),
        (jnp.zeros(shared), jnp.zeros((RUNS, own))),
    )
    found = lx.linear_solve(operator, right, ArrowQR()).value
    dense = np.linalg.lstsq(
        np.asarray(operator.as_matrix()),
        np.concatenate([np.ravel(each) for each in jax.tree.leaves(right)]),
    )[0]
    ours = np.concatenate([np.ravel(each) for each in found])
    np.testing.assert_allclose(ours, dense, rtol=ROUNDING, atol=ROUNDING)


def test_columns_are_what_the_derivative_was_made_of():
    blocks, _, _, slope = parts(2, 3)
    shapes = jnp.zeros(2), jnp.zeros((RUNS, 3))
    (rows, *priors), damping = columns(Rows(jnp.asarray(blocks), jnp.asarray(slope), 0.3), shapes)
    np.testing.assert_array_equal(rows, blocks)
    np.testing.assert_allclose(np.concatenate([np.ravel(p) for p in priors]), slope)
    np.testing.assert_allclose(np.concatenate([np.ravel(d) for d in damping]), 0.3)


@pytest.mark.parametrize(("shared", "own"), SIZES)
def test_whole_step_and_its_fall_are_those_of_the_normal_equations(shared, own):
    blocks, residual, prior, slope = parts(shared, own)
    information, right = normal_equations(blocks, shared, residual)
    information += np.diag(slope**2)
    right += slope * prior
    dense = -np.linalg.lstsq(information, right)[0]
    fall, step = gauss_newton_step(blocks, residual, prior, slope, shared)
    np.testing.assert_allclose(step, dense, rtol=ROUNDING, atol=ROUNDING)
    assert fall == pytest.approx(-right @ dense, rel=ROUNDING)


def test_numbers_that_move_the_runs_alike_are_not_moved_at_random():
    blocks, residual, prior, _ = parts(1, 1)
    blocks[..., 1] = 2 * blocks[..., 0]  # the shared number is seen through each run's own only
    none = np.zeros_like(prior)
    fall, step = gauss_newton_step(blocks, residual, none, none, 1)
    left = residual + np.einsum("rcsp,rp->rcs", blocks, np.c_[np.full(RUNS, step[0]), step[1:]])
    alone = [
        np.linalg.lstsq(b[..., :1].reshape(-1, 1), r.ravel())[1]
        for b, r in zip(blocks, residual, strict=True)
    ]
    best = sum(float(each[0]) for each in alone if len(each))
    assert np.sum(left**2) == pytest.approx(best, rel=ROUNDING)
    assert fall == pytest.approx(np.sum(residual**2) - best, rel=ROUNDING)
    assert np.abs(step).max() < 10


@pytest.mark.parametrize("samples", [SAMPLES, 1])
def test_condensed_rows_have_the_normal_equations_of_all(samples):
    blocks, residual, *_ = parts(2, 1)
    blocks, residual = blocks[:, :, :samples], residual[:, :, :samples]
    few, short = condensed_rows((residual, blocks))
    assert few.shape == (RUNS, 1, 4)
    for ours, whole in zip(
        normal_equations(short, 2, few), normal_equations(blocks, 2, residual), strict=True
    ):
        np.testing.assert_allclose(ours, whole, rtol=ROUNDING, atol=ROUNDING)
    np.testing.assert_allclose(
        np.sum(few**2, axis=(1, 2)), np.sum(residual**2, axis=(1, 2)), rtol=ROUNDING
    )


def test_condensed_rows_say_what_cannot_be_simulated_or_differentiated():
    blocks, residual, *_ = parts(2, 1)
    residual[0, 0, 0], blocks[2, 1, 3, 1] = np.nan, np.inf
    few, short = condensed_rows((residual, blocks))
    assert np.isfinite(few).all(axis=(1, 2)).tolist() == [False, True, True, True]
    assert np.isfinite(short).all(axis=(1, 2, 3)).tolist() == [False, True, False, True]
    assert np.sum(few[2] ** 2) == pytest.approx(np.sum(residual[2] ** 2), rel=ROUNDING)
