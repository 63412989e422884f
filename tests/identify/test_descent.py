"""Steps of many least-squares problems, beside solvers that go their way alone."""

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from scipy.optimize import least_squares

from identify.solver.descent import Descent, NormalEquations, gauss_newton, levenberg_marquardt

# Two ways to one minimum, of a loss that is known to be near .3: both stop at rounding.
SAME_LOSS = 1e-9
TIME = np.linspace(0.0, 2.0, 40)
DECAYS = np.array([[1.0, 2.0], [3.0, 0.7], [0.4, 5.0]])


def model(at):
    """A decay with its own amplitude and rate: the classical curved valley."""
    return jnp.exp(at[0]) * jnp.exp(-jnp.exp(at[1]) * TIME)


def data() -> np.ndarray:
    noise = 0.1 * np.random.default_rng(2).standard_normal((len(DECAYS), len(TIME)))
    return DECAYS[:, :1] * np.exp(-DECAYS[:, 1:] * TIME) + noise


def equations(points, values) -> NormalEquations:
    def one(at, wanted):
        residual = model(at) - wanted
        jacobian = jax.jacfwd(model)(at)
        return NormalEquations(
            0.5 * residual @ residual, jacobian.T @ residual, jacobian.T @ jacobian
        )

    return jax.vmap(one)(jnp.asarray(points), jnp.asarray(values))


def minimized(descent: Descent, values, free=(True, True), steps: int = 60):
    here = np.zeros((len(values), 2))
    at = equations(here, values)
    size, state = descent.begin(at)
    for _ in range(steps):
        move = descent.next_move(at, size, jnp.asarray(free), jnp.asarray(1.0))
        there = here + np.asarray(move)
        end = equations(there, values)
        counts, size, state = descent.judge(at, move, end.loss, state)
        here = np.where(np.asarray(counts)[:, None], there, here)
        at = equations(here, values)
    return here, np.asarray(at.loss)


RULES = {"damped": levenberg_marquardt(1e-3, 8.0), "halved": gauss_newton(1e-4)}


@pytest.mark.parametrize("rule", RULES)
def test_every_problem_ends_in_its_own_minimum(rule):
    values = data()
    here, loss = minimized(RULES[rule], values)
    for own, end, place in zip(values, loss, here, strict=True):
        theirs = least_squares(
            lambda at, own=own: np.asarray(model(at)) - own, np.zeros(2), xtol=1e-15, ftol=1e-15
        )
        assert end == pytest.approx(theirs.cost, rel=SAME_LOSS)
        np.testing.assert_allclose(place, theirs.x, atol=1e-4)


def test_damped_steps_are_those_of_optimistix():
    """Its own loop on the residuals ends at the same loss as its parts on normal equations."""
    values = data()
    _, loss = minimized(RULES["damped"], values)
    for own, end in zip(values, loss, strict=True):
        whole = optx.least_squares(
            lambda at, own: model(at) - own,
            optx.LevenbergMarquardt(1e-12, 1e-12),
            jnp.zeros(2),
            jnp.asarray(own),
        )
        residual = np.asarray(model(whole.value)) - own
        assert end == pytest.approx(0.5 * residual @ residual, rel=SAME_LOSS)


@pytest.mark.parametrize("rule", RULES)
def test_what_is_held_stays_and_no_step_is_too_long(rule):
    values = data()
    here, _ = minimized(RULES[rule], values, free=(True, False))
    assert (here[:, 1] == 0).all()
    at = equations(np.zeros((3, 2)), values)
    size, _ = RULES[rule].begin(at)
    longest = 0.05
    move = RULES[rule].next_move(at, size, jnp.asarray([True, True]), jnp.asarray(longest))
    far = RULES[rule].next_move(at, size, jnp.asarray([True, True]), jnp.asarray(np.inf))
    assert np.abs(move).max() == pytest.approx(longest)
    assert np.abs(far).max() > longest


@pytest.mark.parametrize("rule", RULES)
def test_a_step_that_cannot_be_simulated_does_not_count_and_the_next_is_shorter(rule):
    values = data()
    at = equations(np.zeros((3, 2)), values)
    size, state = RULES[rule].begin(at)
    free = jnp.asarray([True, True])
    move = RULES[rule].next_move(at, size, free, jnp.asarray(np.inf))
    lengths = [np.abs(move).max()]
    for loss in (np.inf, np.nan, np.inf, np.inf):
        counts, size, state = RULES[rule].judge(at, move, np.full(3, loss), state)
        assert not np.asarray(counts).any()
        move = RULES[rule].next_move(at, size, free, jnp.asarray(np.inf))
        lengths.append(np.abs(move).max())
    assert (np.diff(lengths) < 0).all()


def test_a_direction_that_nothing_determines_is_not_moved_along():
    nothing = NormalEquations(np.array([1.0]), np.array([[1.0, 0.0]]), np.diag([2.0, 0.0])[None])
    for rule in RULES.values():
        size, _ = rule.begin(nothing)
        free = jnp.asarray([True, True])
        move = np.asarray(rule.next_move(nothing, size, free, jnp.asarray(np.inf)))[0]
        assert move[0] == pytest.approx(-0.5, rel=2e-3)  # The first damping is a thousandth.
        assert move[1] == 0
