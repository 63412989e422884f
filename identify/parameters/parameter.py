"""Parameters of a fit: quantities by name, shared or one a run, with bounds, prior and start."""

import math
from collections.abc import Callable, Sequence
from difflib import get_close_matches
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from drftjax.common.errors import InputError
from drftjax.physics.stress import COEFFICIENT_NAMES
from drftjax.simulation.trial import Trial
from identify.parameters.bijector import AbstractBijector, Interval, Positive, Scaled
from identify.parameters.effect_quantities import effect_numbers, effect_quantity
from identify.parameters.quantity import (
    COEFFICIENT_PREFIX,
    PHASE_PREFIX,
    PHASES,
    SHORT_NAMES,
    Quantity,
)


def _leaf_quantity(
    name: str, unit: str, where: Callable[[Any], Any], bijector: AbstractBijector
) -> Quantity:
    """Return a quantity that is one leaf of the trial."""

    def put(trial: Trial, value: Float[Array, ""]) -> Trial:
        return eqx.tree_at(where, trial, value)

    return Quantity(name, unit, where, put, bijector)


def _put_sinkage(trial: Trial, value: Float[Array, ""]) -> Trial:
    place = trial.start.position
    return eqx.tree_at(lambda t: t.start.position, trial, place.at[1].set(-value))


def _put_x(trial: Trial, value: Float[Array, ""]) -> Trial:
    place = trial.start.position
    return eqx.tree_at(lambda t: t.start.position, trial, place.at[0].set(value))


def _put_speed(trial: Trial, value: Float[Array, ""]) -> Trial:
    velocity = trial.start.velocity
    return eqx.tree_at(lambda t: t.start.velocity, trial, velocity.at[0].set(value))


def _coefficient(number: int, name: str) -> Quantity:
    """Return one of the nine stress coefficients, of either sign."""

    def get(trial: Trial) -> Float[Array, ""]:
        return trial.simulator.terrain.law.coefficients.values[number]  # pyright: ignore

    def put(trial: Trial, value: Float[Array, ""]) -> Trial:
        where = lambda t: t.simulator.terrain.law.coefficients.values  # noqa: E731
        return eqx.tree_at(where, trial, where(trial).at[number].set(value))

    return Quantity(COEFFICIENT_PREFIX + name, "N/cm3", get, put, Scaled(0.1))


# Coordinate of an interval a thousandth of it from either end, beyond which a value is at a bound.
BOUND_COORDINATE = math.log(1e3)


# lambda may leave the physical range, so that a fit can find that it has no effect [-].
LAMBDA_BOUNDS = Interval(-20.0, 50.0)


# Smallest error of a prior, as a share of its mean: a number known better is no parameter [-].
SMALLEST_PRIOR_ERROR = 1e-9


QUANTITIES: dict[str, Quantity] = {
    each.name: each
    for each in (
        _leaf_quantity("terrain.zeta", "-", lambda t: t.simulator.terrain.zeta.value, Positive()),
        _leaf_quantity(
            "terrain.inertial_coefficient",
            "-",
            lambda t: t.simulator.terrain.law.inertial_coefficient,
            LAMBDA_BOUNDS,
        ),
        _leaf_quantity(
            "terrain.bulk_density",
            "kg/m3",
            lambda t: t.simulator.terrain.law.bulk_density,
            Positive(),
        ),
        _leaf_quantity(
            "terrain.height_decrease",
            "-",
            lambda t: t.simulator.terrain.law.height_decrease,
            Scaled(0.1),
        ),
        _leaf_quantity("wheel.radius", "m", lambda t: t.simulator.wheel.radius, Positive()),
        _leaf_quantity("wheel.width", "m", lambda t: t.simulator.wheel.width, Positive()),
        _leaf_quantity(
            "wheel.grouser_height", "m", lambda t: t.simulator.wheel.grouser_height, Positive()
        ),
        _leaf_quantity(
            "wheel.grouser_fraction", "-", lambda t: t.simulator.wheel.grouser_fraction, Positive()
        ),
        _leaf_quantity(
            "wheel.grouser_thickness",
            "m",
            lambda t: t.simulator.wheel.grouser_thickness,
            Positive(),
        ),
        _leaf_quantity("rig.gravity", "m/s2", lambda t: t.simulator.rig.gravity, Positive()),
        _leaf_quantity("rig.mass_x", "kg", lambda t: t.simulator.rig.mass_x, Positive()),
        _leaf_quantity("rig.mass_z", "kg", lambda t: t.simulator.rig.mass_z, Positive()),
        _leaf_quantity("rig.damping_x", "N s/m", lambda t: t.simulator.rig.damping_x, Scaled(10.0)),
        _leaf_quantity("rig.damping_z", "N s/m", lambda t: t.simulator.rig.damping_z, Scaled(10.0)),
        _leaf_quantity(
            "rig.drawbar_load", "N", lambda t: t.simulator.rig.drawbar_load, Scaled(1.0)
        ),
        Quantity("start.sinkage", "m", lambda t: -t.start.position[1], _put_sinkage, Scaled(1e-3)),
        Quantity("start.x", "m", lambda t: t.start.position[0], _put_x, Scaled(1e-3)),
        Quantity("start.speed", "m/s", lambda t: t.start.velocity[0], _put_speed, Scaled(1e-2)),
        _leaf_quantity("start.angle", "rad", lambda t: t.start.angle, Scaled(0.1)),
        *(_coefficient(number, name) for number, name in enumerate(COEFFICIENT_NAMES)),
    )
}


def _phase_quantity(number: int, name: str) -> Quantity:
    def get(trial: Trial) -> Float[Array, ""]:
        return trial.simulator.terrain.zeta.level[number]  # pyright: ignore

    def put(trial: Trial, value: Float[Array, ""]) -> Trial:
        level = trial.simulator.terrain.zeta.level.at[number].set(value)  # pyright: ignore
        return eqx.tree_at(lambda t: t.simulator.terrain.zeta.level, trial, level)

    return Quantity(PHASE_PREFIX + name, "-", get, put, Positive())


PHASE_QUANTITIES = {
    PHASE_PREFIX + name: _phase_quantity(number, name) for number, name in enumerate(PHASES)
}


class Parameter(eqx.Module):
    """A quantity to fit, one number for all runs or one for each.

    Attributes:
        quantity: The fitted quantity.
        shared: True for one number for all runs.
        bijector: Map of its bounds onto the solver's coordinate.
        prior_mean, prior_error: Mean and standard error of a Gaussian prior, in the quantity's
            unit; an infinite error is no prior.
        start: Start of the fit; the set-up's value where it is NaN.
    """

    quantity: Quantity
    shared: bool = eqx.field(static=True)
    bijector: AbstractBijector
    # Scalars of NumPy: filter_jit compiles a program again for every Python float.
    prior_mean: np.float64 = eqx.field(converter=np.float64, default=0.0)
    prior_error: np.float64 = eqx.field(converter=np.float64, default=math.inf)
    start: float = math.nan

    def coordinate(self, trial: Trial) -> Float[Array, ""]:
        """Return the coordinate that the solver starts from."""
        value = self.quantity.read(trial)
        return self.bijector.coordinate(value if math.isnan(self.start) else 0 * value + self.start)

    def require_start(self, trial: Trial) -> None:
        """Check that a trial has a value that the fit can start from.

        Raises:
            InputError: where it has none; with the value, and the bounds where there are some.
        """
        if bool(jnp.isfinite(self.coordinate(trial))):
            return
        name, value = self.quantity.name, float(self.quantity.read(trial))
        if isinstance(self.bijector, Interval):
            raise InputError(
                f"its {name} is {value:g}, outside the bounds {self.bijector.low:g} to "
                f"{self.bijector.high:g}; give a start within them"
            )
        raise InputError(f"its {name} is {value:g}, where no fit within its bounds starts")

    def prior_residual(self, coordinate: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Return (value - prior mean) / prior error [-]."""
        return (self.bijector.value(coordinate) - self.prior_mean) / self.prior_error

    def at_bound(self, coordinate: float, error: float) -> bool:
        """True if the value has run into one of its bounds.

        Near a bound, one unit of the coordinate is the distance to it: a value whose error is less
        than one lies inside, however wide the bounds are.

        Args:
            coordinate: The solver's.
            error: Its standard error; 0 or infinite where the runs do not determine it there.
        """
        return (
            isinstance(self.bijector, Interval)
            and abs(coordinate) > BOUND_COORDINATE
            and not 0 < error < 1
        )


def quantity(name: str) -> Quantity:
    """Return a quantity by its name, such as "terrain.zeta" or "drawbar.force", or by a short one.

    Raises:
        InputError: for an unknown name, with the nearest known ones.
    """
    full = SHORT_NAMES.get(name, name)
    every = QUANTITIES | PHASE_QUANTITIES
    of_effect = None if full in every else effect_quantity(full)
    if of_effect is not None:
        return of_effect
    if full not in every:
        short = [each for each in SHORT_NAMES if "." not in each or name.startswith("zeta.")]
        near = get_close_matches(name, [*QUANTITIES, *short, *effect_numbers()], n=3, cutoff=0.4)
        known = " or ".join(near) if near else ", ".join(QUANTITIES)
        raise InputError(f"there is no parameter {name!r}; did you mean {known}?")
    return every[full]


def typical_change(name: str) -> float:
    """Return a typical change of a quantity that may be zero, in its unit; zero for any other."""
    full = SHORT_NAMES.get(name, name)
    known = (QUANTITIES | PHASE_QUANTITIES).get(full) or effect_quantity(full)
    return known.bijector.scale if known and isinstance(known.bijector, Scaled) else 0.0


def own(name: str, **known: Any) -> Parameter:
    """Return a parameter with one value for each run; see `parameter`."""
    return parameter(name, shared=False, **known)


def shared(name: str, **known: Any) -> Parameter:
    """Return a parameter with one value for all runs; see `parameter`."""
    return parameter(name, shared=True, **known)


def require_once(parameters: Sequence[Parameter]) -> None:
    """Raise InputError for a quantity that is named twice."""
    names = [each.quantity.name for each in parameters]
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise InputError(f"{', '.join(sorted(twice))} is asked for twice; fit it shared or own")


def parameter(
    name: str,
    *,
    shared: bool,
    bounds: tuple[float, float] | None = None,
    prior: tuple[float, float] | None = None,
    start: float | None = None,
) -> Parameter:
    """Return a parameter by its name, such as "terrain.zeta" or "rig.mass_z".

    Args:
        name: See `QUANTITIES`, or NAME.NUMBER of an effect; "zeta", "lambda" and "A00" are short.
        shared: One number for all runs, or one for each.
        bounds: Lowest and highest value; the quantity's natural ones where none are given.
        prior: Mean and standard error of a Gaussian prior.
        start: Start of the fit; the set-up's value where none is given.

    Raises:
        InputError: for an unknown name, bounds that leave nothing or exclude the start, or a
            prior without a positive error.
    """
    what = quantity(name)
    bijector = what.bijector
    if bounds is not None:
        low, high = bounds
        if not (math.isfinite(low) and math.isfinite(high)):
            raise InputError(f"the bounds of {name} are {low:g} to {high:g}; both must be finite")
        if not low < high:
            raise InputError(
                f"the bounds of {name} are {low:g} to {high:g}; the first must be less"
            )
        bijector = Interval(low, high)
    if start is not None and isinstance(bijector, Interval):
        low, high = bijector.low, bijector.high
        if not low < start < high:
            raise InputError(f"{name} starts at {start:g}, outside its bounds {low:g} to {high:g}")
    elif start is not None and isinstance(bijector, Positive) and not 0 < start < math.inf:
        raise InputError(f"{name} starts at {start:g}, must be positive and finite")
    mean, error = prior or (0.0, math.inf)
    if not math.isfinite(mean):
        raise InputError(f"the prior of {name} is {mean:g} ± {error:g}; its mean must be finite")
    if not error > SMALLEST_PRIOR_ERROR * abs(mean):
        least = f"over {SMALLEST_PRIOR_ERROR * abs(mean):g}" if error > 0 else "positive"
        raise InputError(f"the prior of {name} is {mean:g} ± {error:g}; its error must be {least}")
    at = math.nan if start is None else start
    return Parameter(what, shared, bijector, np.float64(mean), np.float64(error), at)
