"""The root of a step's balance on a block on a rough floor, whose motion is known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

from drftjax.physics.implicit import AbstractBalance, NewtonSettings, newton, root_of

MASS, STEP, FRICTION, WIDTH = 2.0, 0.01, 5.0, 1e-6
SETTINGS = NewtonSettings()
# Differences of central width 1e-5 of a smooth function: their square.
DIFFERENCE, ROUNDING = 1e-6, 1e-12


class Block(AbstractBalance):
    """A block that is pushed over a floor with dry friction, free along both axes.

    Attributes:
        before: Velocity before the step [m/s].
        push: Force [N].
        friction: Dry friction [N].
    """

    before: Float[Array, "2"]
    push: Float[Array, "2"]
    friction: Float[Array, ""]

    @property
    def force_count(self):
        return 2

    def by_plate(self, velocity):
        speed = jnp.sqrt(jnp.sum(velocity**2) + WIDTH**2)
        # A floor of four plates that bear a quarter each.
        return tuple(jnp.repeat(-self.friction * v / speed, 4) / 4 for v in velocity)

    def of_sums(self, velocity, sums):
        force = self.push + jnp.stack(sums)
        return MASS * (velocity - self.before) - STEP * force, force

    def solve(self, jacobian, residual):
        (a, b), (c, d) = jacobian
        first, second = residual
        return jnp.stack([d * first - b * second, a * second - c * first]) / (a * d - b * c)

    def growth(self, jacobian):
        return jnp.abs(jnp.linalg.inv(jacobian / MASS)).sum(axis=0)

    def largest_growth(self):
        # Friction along a slope turns an impulse, which counts both components: up to 1.4.
        return jnp.asarray(2.0)

    def further_guesses(self):
        return jnp.zeros((0, 2))

    def speed_scale(self):
        return jnp.ones(())

    def size(self, residual):
        return jnp.sqrt(jnp.sum(residual**2)) / MASS


def block(before, push) -> Block:
    return Block(jnp.asarray(before), jnp.asarray(push), jnp.asarray(FRICTION))


def velocity_of(balance: Block):
    return root_of(balance, balance.before, SETTINGS)[0]


def test_a_sliding_block_is_slowed_by_its_friction():
    velocity = velocity_of(block([0.3, 0.4], [0.0, 0.0]))
    # Along the way it goes: 0.5 m/s less h F / m.
    np.testing.assert_allclose(velocity, np.array([0.6, 0.8]) * (0.5 - STEP * FRICTION / MASS))


@pytest.mark.parametrize("before", [0.0, 0.015, -0.02, -0.028])
def test_a_block_that_friction_can_stop_stands(before):
    velocity, _, root = root_of(
        block([before, 0.0], [1.0, 0.0]), jnp.asarray([before, 0]), SETTINGS
    )
    assert bool(root.found)
    # v / sqrt(v^2 + w^2) is the part of the friction that holds it: at most 0.96 here.
    assert abs(float(velocity[0])) < 4 * WIDTH


def test_forces_are_those_at_the_root():
    balance = block([0.3, -0.1], [2.0, 1.0])
    velocity, forces, _ = root_of(balance, balance.before, SETTINGS)
    np.testing.assert_allclose(MASS * (velocity - balance.before), STEP * forces, atol=ROUNDING)


@pytest.mark.parametrize("before", [[0.3, -0.1], [0.01, 0.0]])
def test_derivatives_agree_three_ways(before):
    push = jnp.asarray([2.0, 1.0])

    def outcome(friction):
        balance = Block(jnp.asarray(before), push, friction)
        return root_of(balance, balance.before, NewtonSettings(tolerance=1e-15))[0]

    at = jnp.asarray(FRICTION)
    forward, backward = (jax.jit(mode(outcome))(at) for mode in (jax.jacfwd, jax.jacrev))
    width = 1e-5 * FRICTION
    difference = (outcome(at + width) - outcome(at - width)) / (2 * width)
    np.testing.assert_allclose(forward, backward, rtol=ROUNDING, atol=0)
    np.testing.assert_allclose(forward, difference, rtol=DIFFERENCE, atol=1e-15)


def test_the_last_step_is_taken_by_the_slope_alone():
    balance = block([0.0152, 0.01], [1.0, 0.5])
    share = 1e-3 * WIDTH
    exact = newton(balance, balance.before, NewtonSettings(tolerance=1e-15))
    near = newton(balance, balance.before, NewtonSettings(tolerance=share))
    assert bool(near.found)
    # Of second order: a thousandth of the width, squared, and as much of the friction.
    np.testing.assert_allclose(near.velocity, exact.velocity, rtol=0, atol=1e-6 * WIDTH)
    np.testing.assert_allclose(near.forces, exact.forces, rtol=0, atol=1e-6 * FRICTION)


def test_the_search_ends_where_it_may_not_go_on():
    balance = block([0.3, 0.4], [0.0, 0.0])
    root = newton(balance, jnp.asarray([-5.0, 3.0]), NewtonSettings(most_evaluations=2))
    assert int(root.evaluations) == 2
    assert not bool(root.found)


class Hollow(Block):
    """A block whose residual along x has a hollow that does not reach down to zero."""

    guesses: tuple = ((0.5, 0.0),)

    def by_plate(self, velocity):
        return velocity[:1], velocity[1:]

    def of_sums(self, velocity, sums):
        hollow = 1 - velocity[0] - 0.9 * jnp.exp(-(((velocity[0] + 0.3) / 0.1) ** 2))
        return jnp.stack([hollow, velocity[1]]), velocity

    def further_guesses(self):
        return jnp.asarray(self.guesses, float).reshape(-1, 2)


@pytest.mark.parametrize("guesses", [(), ((0.5, 0.0),)], ids=["none", "one"])
def test_a_search_that_is_stuck_begins_anew_where_it_is_told_to(guesses):
    nothing = jnp.zeros(2)
    balance = Hollow(nothing, nothing, jnp.zeros(()), guesses)
    root = newton(balance, jnp.asarray([-0.34, 0.0]), SETTINGS)
    assert bool(root.found) == bool(guesses)
    # The bottom of the hollow, where its slope is that of the line, or the root.
    assert float(root.velocity[0]) == pytest.approx(1.0 if guesses else -0.29, abs=0.01)
    assert int(root.evaluations) <= (1 + len(guesses)) * SETTINGS.most_evaluations


def test_a_guess_without_numbers_ends_the_search():
    balance = block([0.3, 0.4], [float("nan"), 0.0])
    root = newton(balance, balance.before, SETTINGS)
    assert int(root.evaluations) == 1
    assert not bool(root.found)


def test_runs_side_by_side_end_where_each_ends_alone():
    pushes = jnp.linspace(0.0, 9.0, 7)[:, None] * jnp.asarray([1.0, 0.5])
    together = jax.vmap(lambda push: velocity_of(block([0.01, 0.0], push)))(pushes)
    alone = [velocity_of(block([0.01, 0.0], push)) for push in pushes]
    np.testing.assert_allclose(together, np.stack(alone), atol=ROUNDING)
