"""Least squares in shared numbers and each run's own, which only that run's rows depend on.

The normal equations have the shape of an arrow: a block for each run along the diagonal, and the
shared numbers beside all of them. Each run's own numbers are eliminated from its rows (a Schur
complement), the few shared ones are solved for, and the own ones follow. So the cost grows with the
number of runs, not with its cube (G. H. Golub, V. Pereyra, SIAM J. Numer. Anal. 10:413, 1973).
"""

from typing import Any

import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
from jaxtyping import Array, Float

# A shared direction is determined where eliminating the runs' own numbers leaves more of its
# information than so many rounding errors.
ROUNDING_MARGIN = 100.0


class ArrowQR(lx.AbstractLinearSolver):
    """Solver of damped least squares of full rank, by QR of each run's rows, then of the shared.

    The unknowns are (shared, own) of shapes (shared,) and (runs, own). An operator's values are
    ((rows, shared prior, own prior), (shared damping, own damping)): rows of shape (runs, channels,
    samples), of which each depends on its run's own numbers, and numbers that depend on one
    coordinate each.
    """

    def init(self, operator: lx.AbstractLinearOperator, options: dict[str, Any]):
        (blocks, *priors), damping = columns(operator.mv, operator.in_structure())
        return blocks, tuple(zip(priors, damping, strict=True))

    def compute(self, state, vector, options: dict[str, Any]):
        blocks, ((shared_prior, shared_damping), (own_prior, own_damping)) = state
        (right, right_shared, right_own), (zero_shared, zero_own) = vector
        runs, number = len(right), len(shared_prior)
        rows = blocks.reshape(runs, -1, blocks.shape[-1])
        beside, inner = rows[..., :number], rows[..., number:]
        eliminated = inner.shape[-1]
        diagonal = jax.vmap(jnp.diag)
        inner = jnp.concatenate([inner, diagonal(own_prior), diagonal(own_damping)], axis=1)
        right = jnp.concatenate([right.reshape(runs, -1), right_own, zero_own], axis=1)
        beside = jnp.pad(beside, ((0, 0), (0, 2 * eliminated), (0, 0)))
        q, triangle = jnp.linalg.qr(inner)
        along, along_right = jnp.einsum("rmo,rms->ros", q, beside), _along(q, right)
        beside = beside - jnp.einsum("rmo,ros->rms", q, along)
        right = right - jnp.einsum("rmo,ro->rm", q, along_right)
        tall = jnp.concatenate(
            [jnp.concatenate(beside), jnp.diag(shared_prior), jnp.diag(shared_damping)]
        )
        q_shared, triangle_shared = jnp.linalg.qr(tall)
        whole = jnp.concatenate([right.ravel(), right_shared, zero_shared])
        shared = _solve(triangle_shared, q_shared.T @ whole)
        left = along_right - jnp.einsum("ros,s->ro", along, shared)
        return (shared, jax.vmap(_solve)(triangle, left)), lx.RESULTS.successful, {}

    def transpose(self, state, options: dict[str, Any]):
        raise NotImplementedError("rows of runs are solved for, their transpose never is")

    def conj(self, state, options: dict[str, Any]):
        return state, options

    def assume_full_rank(self) -> bool:
        return True


def _solve(triangle: Float[Array, "n n"], right: Float[Array, " n"]) -> Array:
    return jax.scipy.linalg.solve_triangular(triangle, right) if len(right) else right


def _along(q: Float[Array, "runs rows own"], right: Float[Array, "runs rows"]) -> Array:
    return jnp.einsum("rmo,rm->ro", q, right)


def columns(derivative, structure):
    """Return what a derivative of this form consists of, by a few directions of all runs at once.

    Args:
        derivative: Linear function of (shared, own), as for `ArrowQR`; its first value may stand in
            a tree of others.
        structure: Shapes of (shared, own).

    Returns:
        Its values' tree: the columns of the rows, shape (runs, channels, samples, shared + own), in
        place of the rows, and the slope by its own coordinate in place of each other number.
    """
    shared, own = (jnp.zeros(each.shape, each.dtype) for each in structure)
    runs, number = own.shape
    units = [
        *((unit, jnp.zeros_like(own)) for unit in jnp.eye(len(shared))),
        *((jnp.zeros_like(shared), jnp.tile(unit, (runs, 1))) for unit in jnp.eye(number)),
    ]
    # Each of the others depends on one coordinate, so a single sweep gives every slope.
    sweeps, tree = jax.tree.flatten(derivative((jnp.ones_like(shared), jnp.ones_like(own))))
    found = [jax.tree.leaves(derivative(unit))[0] for unit in units]
    return jax.tree.unflatten(tree, [jnp.stack(found, axis=-1), *sweeps[1:]])


def gauss_newton_step(
    blocks: np.ndarray,
    residual: np.ndarray,
    prior: np.ndarray,
    prior_slope: np.ndarray,
    shared: int,
) -> tuple[float, np.ndarray]:
    """Return the fall of the sum of squares that an undamped step promises, and the step.

    Directions that nothing determines are not moved along.

    Args:
        blocks: Derivatives of each run's rows, shape (runs, channels, samples, shared + own).
        residual: The rows, shape (runs, channels, samples).
        prior: Priors' residuals: of shared coordinates, then of each run's own.
        prior_slope: Their derivatives, each by its own coordinate, likewise.
        shared: Number of shared coordinates.

    Returns:
        The fall, and the step of all coordinates, shape (all,).
    """
    runs, own = len(blocks), blocks.shape[-1] - shared
    rows = blocks.reshape(runs, -1, shared + own)
    information = np.einsum("rmp,rmq->rpq", rows, rows)
    slope = np.einsum("rmp,rm->rp", rows, residual.reshape(runs, -1))
    at = np.arange(shared, shared + own)
    information[:, at, at] += (prior_slope[shared:] ** 2).reshape(runs, own)
    slope[:, shared:] += (prior_slope[shared:] * prior[shared:]).reshape(runs, own)
    inner, beside = information[:, shared:, shared:], information[:, shared:, :shared]
    inverse = np.linalg.pinv(inner, hermitian=True) if own else inner
    removed = np.einsum("rij,rjs->ris", inverse, beside)
    whole = information[:, :shared, :shared].sum(axis=0) + np.diag(prior_slope[:shared] ** 2)
    left = whole - np.einsum("ris,rit->st", beside, removed)
    shared_slope = slope[:, :shared].sum(axis=0) + prior_slope[:shared] * prior[:shared]
    against = shared_slope - np.einsum("ris,ri->s", removed, slope[:, shared:])
    size = np.sqrt(np.where(np.diag(whole) > 0, np.diag(whole), 1.0))
    cut = ROUNDING_MARGIN * np.finfo(float).eps * max(shared, 1)
    values, vectors = np.linalg.eigh(left / np.outer(size, size))
    values = np.divide(1.0, values, out=np.zeros_like(values), where=values > cut)
    move = -vectors @ (values * (vectors.T @ (against / size))) / size
    own_move = -np.einsum("rij,rj->ri", inverse, slope[:, shared:]) - removed @ move
    fall = -shared_slope @ move - np.sum(slope[:, shared:] * own_move)
    return float(fall), np.concatenate([move, own_move.ravel()])
