"""Steps of many least-squares problems side by side: optimistix's descents and searches.

`optimistix.LevenbergMarquardt` is its damped Newton descent under its trust region, and
Gauss-Newton its Newton descent, here under its backtracking line search. Both are used by their
parts, on normal equations: whoever holds the problems simulates them between two steps, as many at
once as memory allows, and may put one aside or weight it again, which a closed loop cannot.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

# Share of its own information that is added to each coordinate's, so that what nothing determines
# can be solved for: some thousand rounding errors.
REGULARIZATION = 1e-12


class NormalEquations(NamedTuple):
    """Least-squares problems, each linearised at a place of its own.

    Attributes:
        loss: Half the sum of squares, shape (problems,).
        slope: Its derivative $J^T r$, shape (problems, coordinates).
        information: $J^T J$, shape (problems, coordinates, coordinates).
    """

    loss: Array | np.ndarray
    slope: Array | np.ndarray
    information: Array | np.ndarray


class Descent(eqx.Module):
    """Rule for the next step of each problem, and for which steps count.

    Attributes:
        descent: Direction, and how a step size bears on it.
        search: Which steps count, and the next step size.
        scale: Factor on the sums of squares; of a damped descent, 1 / the first damping, as a share
            of each coordinate's information.
    """

    descent: optx.AbstractDescent
    search: optx.AbstractSearch
    scale: float

    @eqx.filter_jit
    def begin(self, equations: NormalEquations) -> tuple[Array, Any]:
        """First step size of each problem, and the search's state."""

        def one(equations: NormalEquations) -> tuple[Array, Any]:
            info, _ = self._info(equations, jnp.ones_like(equations.slope, bool))
            still = jnp.zeros_like(equations.slope)
            there = optx.FunctionInfo.Eval(info.f)
            state = self.search.init(still, eqx.filter_eval_shape(lambda: info))
            size, _, _, state = self.search.step(
                jnp.asarray(True), still, still, info, there, state
            )
            return size, state

        return jax.vmap(one)(equations)

    @eqx.filter_jit
    def judge(
        self,
        equations: NormalEquations,
        move: Float[np.ndarray | Array, "problems coordinates"],
        end: Float[np.ndarray | Array, " problems"],
        state: Any,
    ) -> tuple[Bool[Array, " problems"], Float[Array, " problems"], Any]:
        """Verdict on moves, by the loss that they end at.

        Args:
            equations: Where the moves began.
            move: The moves.
            end: Half the sum of squares at their ends; not finite where there is none.
            state: The search's.

        Returns:
            True for moves that count, the next step sizes, and the search's state.
        """

        def one(equations: NormalEquations, move: Any, end: Any, state: Any):
            info, scale = self._info(equations, jnp.ones_like(move, bool))
            here, there = jnp.zeros_like(move), optx.FunctionInfo.Eval(self.scale * end)
            size, counts, _, state = self.search.step(
                jnp.asarray(False), here, move * scale, info, there, state
            )
            return counts, size, state

        return jax.vmap(one)(equations, move, end, state)

    @eqx.filter_jit
    def next_move(
        self,
        equations: NormalEquations,
        size: Float[np.ndarray | Array, " problems"],
        free: Bool[np.ndarray | Array, " coordinates"],
        longest: Float[np.ndarray | Array, ""],
    ) -> Float[Array, "problems coordinates"]:
        """Next move of each problem.

        Args:
            equations: Where the move begins.
            size: Step size, as `begin` or `judge` gives it.
            free: False for coordinates that stay.
            longest: Largest move of a coordinate, to which longer steps are shortened; may be
                infinite.
        """

        free = jnp.asarray(free)

        def one(equations: NormalEquations, size: Any) -> Array:
            info, scale = self._info(equations, free)
            still = jnp.zeros_like(scale)
            state = self.descent.init(still, eqx.filter_eval_shape(lambda: info))
            found, _ = self.descent.step(size, self.descent.query(still, info, state))
            found = jnp.where(free, found / scale, 0)
            return found / jnp.maximum(1, jnp.abs(found).max() / longest)

        return jax.vmap(one)(equations, size)

    def _info(
        self, equations: NormalEquations, free: Bool[Array, " coordinates"]
    ) -> tuple[Any, Float[Array, " coordinates"]]:
        """One problem in coordinates of unit information, and the scale of these."""
        loss, slope, information = map(jnp.asarray, equations)
        alone = jnp.diagonal(information)
        scale = jnp.where(free & (alone > 0), jnp.sqrt(jnp.maximum(alone, 0)), 1)
        unit = jnp.eye(len(alone), dtype=alone.dtype)
        both = free[:, None] & free
        scaled = jnp.where(both, information / jnp.outer(scale, scale), unit)
        operator = lx.MatrixLinearOperator(
            self.scale * (scaled + REGULARIZATION * unit), lx.positive_semidefinite_tag
        )
        along = self.scale * jnp.where(free, slope / scale, 0)
        return optx.FunctionInfo.EvalGradHessian(self.scale * loss, along, operator), scale


def levenberg_marquardt(first_damping: float, factor: float) -> Descent:
    """Levenberg-Marquardt steps: any that lowers the sum of squares counts.

    Args:
        first_damping: Damping of the first step, as a share of each coordinate's information.
        factor: Each step that does not count multiplies the damping by this; one that keeps what
            the linearisation promises divides it.
    """
    search = optx.ClassicalTrustRegion(
        low_cutoff=0.0, high_constant=factor, low_constant=1 / factor
    )
    return Descent(optx.DampedNewtonDescent(lx.Cholesky()), search, 1 / first_damping)


def gauss_newton(slope: float) -> Descent:
    """Gauss-Newton steps, halved until they keep a part of what their slope promises.

    Args:
        slope: That part [-].
    """
    search = optx.BacktrackingArmijo(decrease_factor=0.5, slope=slope)
    return Descent(optx.NewtonDescent(linear_solver=lx.Cholesky()), search, 1.0)
