"""Markov chains of the No-U-Turn sampler, side by side, over a density of coordinates.

M. D. Hoffman, A. Gelman: The No-U-Turn Sampler, JMLR 15:1593, 2014, with multinomial sampling of
the trajectory, by BlackJAX. Coordinates are whitened by an approximate covariance, so that few
leapfrog steps are needed; the step is found by dual averaging.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from drftjax.common.errors import InputError
from identify.solver.multistart import DRAWS_SEED


@dataclass(frozen=True)
class PosteriorSettings:
    """Numbers of the Markov chains and of the sentences on them.

    Attributes:
        adjusted: Adjust the likelihood to the covariance of the standard errors, which counts the
            residuals' correlation and the simulation's own error; else residuals are white. See
            `identify.uncertainty.posterior_density`.
        chains: Chains side by side; R-hat compares them, and four are what its limits are made for.
        warmup: Transitions of each chain that find the step and forget the start; in whitened
            coordinates the step is found within some forty.
        draws: Draws that each chain keeps. The spread of a value is known from half as many
            effective ones, and R-hat of three values of four chains of 350 that agree passes its
            limit in some 98 of 100 cases.
        spread: Spread of the chains' starts about the fit, in its covariance: wider than the
            posterior, so that R-hat sees chains that have not met.
        acceptance: Mean acceptance that the step is found for [-]; Stan's.
        first_step: Step to begin with, in whitened coordinates, whose best step is about one.
        max_doublings: Doublings of a trajectory, at most; two or three are usual here.
        divergence: Error of the energy from which on a transition has diverged; Stan's.
        level: Level of the interval [-]; that of profiles and bootstraps.
        largest_rhat: R-hat above which chains differ (Vehtari et al. 2021).
        min_effective: Effective samples, in the bulk and in the tails, below which the ends of the
            interval are not worth their digits.
        seed: Of starts and draws.
    """

    adjusted: bool = True
    chains: int = 4
    warmup: int = 50
    draws: int = 350
    spread: float = 1.5
    acceptance: float = 0.8
    first_step: float = 0.5
    max_doublings: int = 6
    divergence: int = 1000
    level: float = 0.90
    largest_rhat: float = 1.01
    min_effective: float = 100.0
    seed: int = DRAWS_SEED

    def __post_init__(self) -> None:
        for name, least in (("chains", 2), ("warmup", 20), ("draws", 20)):
            if getattr(self, name) < least:
                raise InputError(
                    f"{name} of the posterior is {getattr(self, name)}, must be at least {least}"
                )


POSTERIOR_SETTINGS = PosteriorSettings()


@dataclass(frozen=True, eq=False)
class ChainStatistics:
    """Course of the chains, shape (chains, draws) each.

    Attributes:
        diverging: True where the energy was lost on the way.
        energy: Energy of the transition [-].
        acceptance_rate: Mean acceptance along the trajectory [-].
        n_steps: Leapfrog steps.
        lp: Logarithm of the density of coordinates, less a constant.
    """

    diverging: np.ndarray
    energy: np.ndarray
    acceptance_rate: np.ndarray
    n_steps: np.ndarray
    lp: np.ndarray


def sample_chains(
    density: Callable[[Float[Array, " coordinates"]], Float[Array, ""]],
    centre: np.ndarray,
    covariance: np.ndarray,
    settings: PosteriorSettings = POSTERIOR_SETTINGS,
    progress: Callable[[str, int, int], None] | None = None,
) -> tuple[np.ndarray, ChainStatistics, float]:
    """Run chains of the No-U-Turn sampler side by side.

    Args:
        density: Logarithm of the density of coordinates, less a constant.
        centre: Point about which the chains start, shape (coordinates,).
        covariance: Approximate covariance, which whitens them, shape (coordinates, coordinates).
        settings: Decision numbers.
        progress: Called with the stage, the number of transitions made and of all in that stage.

    Returns:
        Draws of coordinates, shape (chains, draws, coordinates); the course of the chains; the
        leapfrog step found.

    Raises:
        InputError: where no start has a density.
    """
    from blackjax.adaptation.step_size import dual_averaging_adaptation

    key, start = jax.random.split(jax.random.key(settings.seed))
    root = jnp.linalg.cholesky(jnp.asarray(covariance))
    place = jnp.asarray(centre), root
    # BlackJAX mixes integers and reals.
    with jax.numpy_dtype_promotion("standard"):
        states = _started(density, place, start, settings)
        begin, update, end = dual_averaging_adaptation(settings.acceptance)
        adaptation = begin(settings.first_step)
        kept: list[tuple] = []
        for number in range(settings.warmup + settings.draws):
            warm = number < settings.warmup
            key, used = jax.random.split(key)
            step = jnp.exp(adaptation.log_step_size) if warm else end(adaptation)
            # As a number of one type and place, or the first would be compiled for itself.
            step = jnp.asarray(float(step), place[0].dtype)
            states, course = _transition(
                density,
                place,
                jax.random.split(used, settings.chains),
                states,
                step,
                settings.max_doublings,
                settings.divergence,
            )
            if warm:
                adaptation = update(adaptation, course[2].mean())
            else:
                kept.append(tuple(map(np.asarray, (states.position, *course, states.logdensity))))
            if progress:
                stage = ("warm-up", number + 1, settings.warmup)
                done = ("draw", number + 1 - settings.warmup, settings.draws)
                progress(*(stage if warm else done))
        found = float(end(adaptation))
    whitened, *columns = (np.stack(each, axis=1) for each in zip(*kept, strict=True))
    points = np.asarray(centre) + whitened @ np.asarray(root).T
    return points, ChainStatistics(*columns), found


# Halvings of a start's distance from the fit until it can be simulated.
HALVINGS = 6


def _started(density: Any, place: tuple, key: Array, settings: PosteriorSettings) -> Any:
    """Return the chains' starts; one without a density is moved towards the fit."""
    shape = settings.chains, len(place[0])
    whitened = settings.spread * jax.random.normal(key, shape, place[0].dtype)
    for _ in range(HALVINGS):
        states = _states(density, place, whitened)
        fine = jnp.isfinite(states.logdensity)
        if bool(fine.all()):
            return states
        whitened = jnp.where(fine[:, None], whitened, whitened / 2)
    raise InputError("the chains of the posterior find no start about the fit that is simulated")


def _whitened(density: Any, place: tuple) -> Callable[[Array], Array]:
    centre, root = place
    return lambda whitened: density(centre + root @ whitened)


@eqx.filter_jit
def _states(density: Any, place: tuple, whitened: Array) -> Any:
    import blackjax.mcmc.nuts as nuts

    return jax.lax.map(lambda each: nuts.init(each, _whitened(density, place)), whitened)


@eqx.filter_jit
def _transition(
    density: Any,
    place: tuple,
    keys: Array,
    states: Any,
    step: Any,
    max_doublings: int,
    divergence: int,
) -> tuple[Any, tuple]:
    """Return the chains' next states, and their divergence, energy, acceptance and steps."""
    import blackjax.mcmc.nuts as nuts

    kernel = nuts.build_kernel(divergence_threshold=divergence)
    mass = jnp.ones_like(place[0])

    def one(chain: tuple) -> tuple[Any, tuple]:
        key, state = chain
        state, info = kernel(key, state, _whitened(density, place), step, mass, max_doublings)
        return state, (
            info.is_divergent,
            info.energy,
            info.acceptance_rate,
            info.num_integration_steps,
        )

    return jax.lax.map(one, (keys, states))
