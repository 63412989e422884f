r"""Implicit Euler in the velocity: a step that stands at rest, with the derivatives of its root.

The sand's force does not depend on how fast a wheel moves but on which way, so at rest it jumps:
whatever holds the wheel, up to what the sand can bear. An explicit step chatters there. Here the
velocity at a step's end is the root of the balance of momentum over the step,

$$\mathbf G(\mathbf v) = M(\mathbf v - \mathbf v_0) - h\,\mathbf F(\mathbf x_0 + h\mathbf v,\,
  \mathbf v) = 0,$$

found by Newton's method with step halving. Quasi-static motion is proportional to the angular
velocity, so the last velocity times the change of angular velocity starts it close by; what the
step before missed by that, per time, is added, but past a fold, where it may lead to another root.

Derivatives by anything that the step depends on follow from the implicit function theorem at the
root, $\partial\mathbf v = -(\partial\mathbf G/\partial\mathbf v)^{-1}\,\partial\mathbf G$: one
linear solve with the last Jacobian, no derivative of the iteration and no second derivative of
the force.

The stress law is not monotone: where a plate begins to lead, the balance of a long step may fold,
and its Jacobian be all but singular, at one step of a thousand. A change of velocity grows there by
more than any that can be seen: plates saturate. So the growth of a derivative is bounded, along
each axis by itself, over all steps since it last shrank, and no product of steps explodes. (A wheel
that falls straight down has such a fold along x, and none along z.)
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from drftjax.physics.plate_sums import sums_over_plates

Pair = Float[Array, "2"]
Matrix = Float[Array, "2 2"]


class AbstractBalance(eqx.Module):
    """Balance of momentum over one step, as a function of the velocity at its end."""

    @property
    @abc.abstractmethod
    def force_count(self) -> int:
        """Number of forces that `of_sums` returns beside the residual."""

    @abc.abstractmethod
    def by_plate(self, velocity: Pair) -> tuple[Float[Array, " plates"], ...]:
        """Columns that are summed over the plates, at a velocity.

        Args:
            velocity: Velocity (x, z) at the end of the step [m/s].
        """

    @abc.abstractmethod
    def of_sums(
        self, velocity: Pair, sums: tuple[Float[Array, ""], ...]
    ) -> tuple[Pair, Float[Array, " forces"]]:
        """Residual G [N s] of the balance at a velocity, and the forces that go into it.

        Args:
            velocity: Velocity (x, z) at the end of the step [m/s].
            sums: Of `by_plate` there.
        """

    def __call__(self, velocity: Pair) -> tuple[Pair, Float[Array, " forces"]]:
        """Residual and forces as of `of_sums`, at a velocity [m/s]."""
        return self.of_sums(velocity, sums_over_plates(self.by_plate(velocity)))

    @abc.abstractmethod
    def solve(self, jacobian: Matrix, residual: Pair) -> Pair:
        """Change of velocity [m/s] that the linearised balance asks for, on the axes that are free.

        Args:
            jacobian: Derivative of the residual by the velocity [kg].
            residual: Residual [N s].
        """

    @abc.abstractmethod
    def growth(self, jacobian: Matrix) -> Pair:
        """Velocity, in units of the masses, that a unit of momentum along each axis makes [-].

        The sizes of its components are added up, so that over several steps none grows by more
        than the product of their largest.

        Args:
            jacobian: Derivative of the residual by the velocity [kg].
        """

    @abc.abstractmethod
    def largest_growth(self) -> Float[Array, ""]:
        """Growth [-] that is believed; along an axis that grows by more, it is scaled to this."""

    @abc.abstractmethod
    def further_guesses(self) -> Float[Array, "guesses 2"]:
        """Velocities [m/s] that the search begins anew from, in turn, where it gets stuck."""

    @abc.abstractmethod
    def speed_scale(self) -> Float[Array, ""]:
        """Speed [m/s] that the tolerance of the search is a share of."""

    @abc.abstractmethod
    def size(self, residual: Pair) -> Float[Array, ""]:
        """Residual as a velocity [m/s], over the axes that are free."""


class NewtonSettings(eqx.Module):
    """Numbers of the search for the root, all without a unit.

    Attributes:
        tolerance: A change of velocity, as a share of the balance's scale, below which the root is
            found: for the paper's wheel a thousandth of a millimetre in 100 s.
        most_evaluations: Evaluations of the force from one guess at most. A wheel that rolls needs
            2 to 4, one that is stopped within a step some 20.
        shrink: Factor on the part of a Newton step that is tried next where the residual does not
            fall. Dry friction turns over within a millionth of the step: a third gets there in
            fewer evaluations than a half (17 to 27 of a block on a rough floor).
        grow: Factor on that part for the next Newton step, up to a whole one.
        shortest: Part of a Newton step that is taken even where the residual does not fall.
        decrease: Least relative decrease of the squared residual by a full step (Armijo).
    """

    tolerance: float = eqx.field(static=True, default=1e-8)
    most_evaluations: int = eqx.field(static=True, default=60)
    shrink: float = eqx.field(static=True, default=0.3)
    grow: float = eqx.field(static=True, default=2.0)
    shortest: float = eqx.field(static=True, default=1e-9)
    decrease: float = eqx.field(static=True, default=1e-4)


class Root(eqx.Module):
    """End of the search for a root.

    Attributes:
        velocity: Velocity (x, z) [m/s].
        residual: Residual [N s] at the last evaluation.
        forces: What else the balance gives at the velocity.
        jacobian: Derivative of the residual by the velocity [kg], at the last evaluation.
        forces_slope: Derivative of the forces by the velocity [their unit s/m], there.
        evaluations: Evaluations of the force.
        found: Whether a whole Newton step from there is under the tolerance.
    """

    velocity: Pair
    residual: Pair
    forces: Float[Array, " forces"]
    jacobian: Matrix
    forces_slope: Float[Array, "forces 2"]
    evaluations: Int[Array, ""]
    found: Bool[Array, ""]


class Search(eqx.Module):
    """State of a search for a root.

    Attributes:
        root: Last velocity that was accepted, and the balance there.
        step: Newton step from there [m/s].
        part: Part of it that is tried next [-].
        stuck: Of the places that it got stuck in, that with the smallest residual.
        begun: Number of guesses that it began from.
        left: Evaluations that are left from the last of them.
        ended: Whether it found the root, or has no further guess.
    """

    root: Root
    step: Pair
    part: Float[Array, ""]
    stuck: Root
    begun: Int[Array, ""]
    left: Int[Array, ""]
    ended: Bool[Array, ""]


def _linearized(balance: AbstractBalance, velocity: Pair) -> tuple[tuple, Matrix, Array]:
    """The balance at a velocity, and the derivatives of residual and forces by it."""
    columns, along = jax.linearize(balance.by_plate, velocity)
    # One direction at a time: a batched pair keeps XLA from fusing it with the plates' other sums.
    directions = jnp.eye(2, dtype=velocity.dtype)
    sums = sums_over_plates((*columns, *along(directions[0]), *along(directions[1])))
    number = len(columns)
    values, along = jax.linearize(balance.of_sums, velocity, sums[:number])
    by = along(directions[0], sums[number : 2 * number]), along(directions[1], sums[2 * number :])
    jacobian, by_velocity = (jnp.stack(pair, axis=1) for pair in zip(*by, strict=True))
    return values, jacobian, by_velocity


def _evaluated(balance: AbstractBalance, velocity: Pair, evaluations: Array) -> Root:
    (residual, forces), jacobian, slope = _linearized(balance, velocity)
    return Root(velocity, residual, forces, jacobian, slope, evaluations, jnp.asarray(False))


def newton(balance: AbstractBalance, guess: Pair, settings: NewtonSettings) -> Root:
    """Root of the balance by Newton's method with step halving, from one guess after another.

    Where the residual of a force that jumps falls along no part of a Newton step, and yet there is
    no root, the search is stuck, and begins anew: a wheel that stands and is pulled aside with a
    thousandth of its weight rests on plates of which half begin to part from the sand. The last
    step is taken without another evaluation: forces go along by their slope.

    Args:
        balance: Whose root is looked for.
        guess: Velocity (x, z) to begin with [m/s].
        settings: Numbers of the search.
    """

    tolerance = settings.tolerance * balance.speed_scale()

    def is_short(step: Pair) -> Bool[Array, ""]:
        return jnp.max(jnp.abs(step)) < tolerance

    guesses = jnp.concatenate([guess[None], balance.further_guesses()])

    def going_on(search: Search) -> Bool[Array, ""]:
        return ~search.ended

    def turn(search: Search) -> Search:
        root, step, part = search.root, search.step, search.part
        tried = _evaluated(balance, root.velocity + part * step, root.evaluations + 1)
        bound = (1 - settings.decrease * part) * balance.size(root.residual) ** 2
        accepted = balance.size(tried.residual) ** 2 <= bound
        accepted |= part <= settings.shortest
        # A guess at which there are no numbers, as of a wheel that runs away, leads nowhere.
        lost = jnp.isinf(balance.size(root.residual)) & ~jnp.isfinite(balance.size(tried.residual))
        accepted |= lost
        root = eqx.tree_at(
            lambda r: r.evaluations, _where(accepted, tried, root), tried.evaluations
        )
        step = jnp.where(accepted, -balance.solve(root.jacobian, root.residual), step)
        grown = jnp.minimum(1, settings.grow * part)
        part = jnp.where(accepted, grown, settings.shrink * part).astype(part.dtype)
        root = eqx.tree_at(lambda r: r.found, root, is_short(step))
        left = search.left - 1
        stuck = (is_short(part * step) | (left == 0)) & ~root.found
        # The best of all places that it got stuck in is the end, if no guess leads to a root.
        known = search.stuck
        better = stuck & (balance.size(root.residual) < balance.size(known.residual))
        known = _where(better, root, known)
        begun = search.begun + jnp.where(stuck, 1, 0)
        again = stuck & ~lost & (begun <= len(guesses))
        # Like the first turn, the next one is at a guess.
        anew = _first(guesses[jnp.minimum(begun, len(guesses)) - 1], root.evaluations, balance)
        return Search(
            _where(again, anew, root),
            jnp.where(again, 0, step),
            jnp.where(again, 1, part).astype(part.dtype),
            known,
            begun,
            jnp.where(again, settings.most_evaluations, left),
            root.found | lost | (stuck & ~again),
        )

    # The first turn is at the guess, and is accepted: so the force stands in the program once.
    first = _first(guess, jnp.asarray(0), balance)
    part, all_left = jnp.ones((), guess.dtype), jnp.asarray(settings.most_evaluations)
    begun = Search(first, jnp.zeros_like(guess), part, first, jnp.asarray(1), all_left, first.found)
    end = jax.lax.while_loop(going_on, turn, begun)
    root = end.root
    failed = ~root.found & (balance.size(end.stuck.residual) < balance.size(root.residual))
    best = eqx.tree_at(lambda r: r.evaluations, end.stuck, root.evaluations)
    step = jnp.where(root.found, end.step, 0)
    root = _where(failed, best, root)
    ends = root.velocity + step, root.forces + root.forces_slope @ step
    return eqx.tree_at(lambda r: (r.velocity, r.forces), root, ends)


def _first(guess: Pair, evaluations: Array, balance: AbstractBalance) -> Root:
    """Beginning of a search, before the balance is evaluated at the guess: anything is better."""
    return Root(
        velocity=guess,
        residual=jnp.full_like(guess, jnp.inf),
        forces=jnp.zeros(balance.force_count, guess.dtype),
        jacobian=jnp.eye(2, dtype=guess.dtype),
        forces_slope=jnp.zeros((balance.force_count, 2), guess.dtype),
        evaluations=evaluations,
        found=jnp.asarray(False),
    )


def _where(condition: Bool[Array, ""], first: Root, second: Root) -> Root:
    """The first root where a condition holds, else the second."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), first, second)


def root_of(
    balance: AbstractBalance, guess: Pair, settings: NewtonSettings
) -> tuple[Pair, Float[Array, " forces"], Root]:
    """Velocity and forces at the root of the balance, differentiable by all that it depends on.

    Args:
        balance: Whose root is looked for.
        guess: Velocity (x, z) to begin with [m/s]; nothing depends on it.
        settings: Numbers of the search.

    Returns:
        The velocity [m/s], the forces there, and the search's end, which is a constant.
    """
    frozen = jax.lax.stop_gradient(balance)
    root = newton(frozen, jax.lax.stop_gradient(guess), settings)
    velocity, forces = _at_root(balance, root)
    return velocity, forces, root


@eqx.filter_custom_jvp
def _at_root(balance: AbstractBalance, root: Root) -> tuple[Pair, Float[Array, " forces"]]:
    return root.velocity, root.forces


@_at_root.def_jvp
def _by_implicit_function(primals, tangents):
    balance, root = primals
    by_balance, _ = tangents
    # By the function itself, so that derivatives of this derivative see the root move.
    velocity, forces = _at_root(balance, root)
    jacobian, forces_by_velocity = _slopes(balance, velocity, root)
    _, changes = eqx.filter_jvp(lambda b: b(velocity), (balance,), (by_balance,))
    # Of what depends on nothing that changes, as the sand's force at a rig's load, there is none.
    residual, change = (
        jnp.zeros_like(value) if each is None else each
        for value, each in zip((velocity, forces), changes, strict=True)
    )
    believed = jnp.minimum(1, balance.largest_growth() / balance.growth(jacobian))
    by = -balance.solve(jacobian, believed * residual)
    return (velocity, forces), (by, change + forces_by_velocity @ by)


@eqx.filter_custom_jvp
def _slopes(
    balance: AbstractBalance, velocity: Pair, root: Root
) -> tuple[Matrix, Float[Array, "forces 2"]]:
    """Derivatives of residual and forces by the velocity: those that the search ended with."""
    return root.jacobian, root.forces_slope


@_slopes.def_jvp
def _changes_of_slopes(primals, tangents):
    def slopes(balance: AbstractBalance, velocity: Pair):
        return _linearized(balance, velocity)[1:]

    balance, velocity, _ = primals
    by_balance, by_velocity, _ = tangents
    return eqx.filter_jvp(slopes, (balance, velocity), (by_balance, by_velocity))
