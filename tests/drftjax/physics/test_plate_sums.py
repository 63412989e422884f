"""Sums in one pass, and their derivatives, beside those of jax.numpy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.physics.plate_sums import sums_over_plates

# Sums of a few numbers of about one, in another order.
ROUNDING = 1e-13

COLUMNS = tuple(jnp.asarray(each) for each in np.random.default_rng(0).normal(size=(3, 7)))


def squares(sums):
    """A function of three numbers with a derivative by each, and a second one."""

    def of(factor, columns):
        first, second, third = sums(tuple(factor * column for column in columns))
        return first * second + third**2

    return of


def plain(columns):
    return tuple(column.sum(-1) for column in columns)


def same(transformed):
    ours, theirs = (transformed(squares(each)) for each in (sums_over_plates, plain))
    for found, expected in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        np.testing.assert_allclose(found, expected, rtol=ROUNDING, atol=ROUNDING)


def test_sums_are_those_of_the_columns():
    same(lambda of: of(2.0, COLUMNS))


def test_forward_and_reverse_derivatives():
    same(lambda of: jax.grad(of, (0, 1))(2.0, COLUMNS))
    same(lambda of: jax.jacfwd(of, (0, 1))(2.0, COLUMNS))
    same(lambda of: jax.hessian(of)(2.0, COLUMNS))


@pytest.mark.parametrize("axis", [0, 1])
def test_batches_of_some_columns(axis):
    many = jnp.stack([COLUMNS[0], 3 * COLUMNS[0]], axis)

    def over(of):
        return jax.vmap(lambda one: of(2.0, (one, *COLUMNS[1:])), in_axes=axis)(many)

    same(over)
    same(lambda of: jax.vmap(jax.grad(of), (0, None))(jnp.arange(3.0), COLUMNS))


def test_derivative_by_one_column_alone():
    def alone(of):
        return jax.linearize(lambda one: of(2.0, (one, *COLUMNS[1:])), COLUMNS[0])[1](COLUMNS[1])

    same(alone)
    same(lambda of: jax.grad(lambda one: of(2.0, (one, *COLUMNS[1:])))(COLUMNS[0]))
