"""Parameters: which numbers of a trial are fitted, and under what name."""

from collections.abc import Callable
from difflib import get_close_matches
from typing import Any

import equinox as eqx
from jaxtyping import Array, Float

from drftjax.errors import InputError
from drftjax.setup import SetUp
from drftjax.trial import Trial
from identify.bijector import AbstractBijector, Interval, Positive, Scaled


class Quantity(eqx.Module):
    """One number of a trial that can be fitted.

    Attributes:
        name: As users write it: its place in a set-up file.
        unit: Its unit, "-" for none.
        where: The number in a trial.
        bijector: Its bounds.
    """

    name: str = eqx.field(static=True)
    unit: str = eqx.field(static=True)
    where: Callable[[Trial], Float[Array, ""]] = eqx.field(static=True)
    bijector: AbstractBijector

    @property
    def label(self) -> str:
        """The short name in reports, where there is one."""
        return {full: short for short, full in SHORT_NAMES.items()}.get(self.name, self.name)

    def put(self, setup: SetUp, value: float) -> None:
        """Write the number into a set-up."""
        section, field = self.name.split(".")
        setattr(getattr(setup, section), field, value)

    def read(self, trial: Trial) -> Float[Array, ""]:
        """The number in this trial.

        Raises:
            InputError: where the trial's wheel, terrain or rig has no such number.
        """
        try:
            return self.where(trial)
        except AttributeError:
            raise InputError(f"this set-up has no {self.name} to fit") from None

    def write(self, trial: Trial, value: Float[Array, ""]) -> Trial:
        """The trial with another number in this place."""
        return eqx.tree_at(self.where, trial, value)


# lambda may leave the physical range a little, so that a fit can say that it does not matter.
LAMBDA_BOUNDS = Interval(-20.0, 50.0)


def _law(trial: Trial) -> Any:
    return trial.simulator.terrain.law


def _wheel(trial: Trial) -> Any:
    return trial.simulator.wheel


def _zeta(trial: Trial) -> Any:
    return trial.simulator.terrain.zeta


QUANTITIES: dict[str, Quantity] = {
    each.name: each
    for each in (
        Quantity("terrain.zeta", "-", lambda t: _zeta(t).value, Positive()),
        Quantity(
            "terrain.inertial_coefficient",
            "-",
            lambda t: _law(t).inertial_coefficient,
            LAMBDA_BOUNDS,
        ),
        Quantity("terrain.bulk_density", "kg/m3", lambda t: _law(t).bulk_density, Positive()),
        Quantity("terrain.height_decrease", "-", lambda t: _law(t).height_decrease, Scaled(0.1)),
        Quantity("wheel.radius", "m", lambda t: _wheel(t).radius, Positive()),
        Quantity("wheel.width", "m", lambda t: _wheel(t).width, Positive()),
        Quantity("wheel.grouser_height", "m", lambda t: _wheel(t).grouser_height, Positive()),
        Quantity("wheel.grouser_fraction", "-", lambda t: _wheel(t).grouser_fraction, Positive()),
        Quantity("rig.mass_x", "kg", lambda t: t.simulator.rig.mass_x, Positive()),
        Quantity("rig.mass_z", "kg", lambda t: t.simulator.rig.mass_z, Positive()),
        Quantity("rig.damping_x", "N s/m", lambda t: t.simulator.rig.damping_x, Scaled(10.0)),
        Quantity("rig.damping_z", "N s/m", lambda t: t.simulator.rig.damping_z, Scaled(10.0)),
        Quantity("rig.drawbar_load", "N", lambda t: t.simulator.rig.drawbar_load, Scaled(1.0)),
    )
}
SHORT_NAMES = {"zeta": "terrain.zeta", "lambda": "terrain.inertial_coefficient"}


class Parameter(eqx.Module):
    """A quantity to fit, one number for all runs or one for each.

    Attributes:
        quantity: What is fitted.
        shared: One number for all runs.
    """

    quantity: Quantity
    shared: bool = eqx.field(static=True)


def parameter(name: str, *, shared: bool) -> Parameter:
    """A parameter by its name, such as "terrain.zeta" or "rig.mass_z".

    Raises:
        InputError: for an unknown name, with the nearest known ones.
    """
    full = SHORT_NAMES.get(name, name)
    if full not in QUANTITIES:
        near = get_close_matches(name, [*QUANTITIES, *SHORT_NAMES], n=3, cutoff=0.4)
        known = " or ".join(near) if near else ", ".join(QUANTITIES)
        raise InputError(f"there is no parameter {name!r}; did you mean {known}?")
    return Parameter(QUANTITIES[full], shared)
