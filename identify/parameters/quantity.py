"""Quantity: a number of the simulator that can be fitted; its name, place and bounds."""

from collections.abc import Callable

import equinox as eqx
from jaxtyping import Array, Float

from drftjax.common.errors import InputError
from drftjax.effects.base import AbstractEffect
from drftjax.effects.serialization import entry_of, name_of
from drftjax.physics.stress import COEFFICIENT_NAMES
from drftjax.setups.setup import SetUp
from drftjax.simulation.trial import Trial
from identify.parameters.bijector import AbstractBijector

Get = Callable[[Trial], Float[Array, ""]]


Put = Callable[[Trial, Float[Array, ""]], Trial]


# Phases of a command, in time: `identify.parameters.phase_zeta` says which is when.
PHASES = ("stand", "accelerate", "steady", "decelerate", "rest")


PHASE_PREFIX = "terrain.zeta."


COEFFICIENT_PREFIX = "terrain.coefficients."


SHORT_NAMES = {
    **{f"zeta.{name}": PHASE_PREFIX + name for name in PHASES},
    **{name: COEFFICIENT_PREFIX + name for name in COEFFICIENT_NAMES},
    "zeta": "terrain.zeta",
    "lambda": "terrain.inertial_coefficient",
}


def is_zeta_name(name: str) -> bool:
    """True if a quantity's full name is that of zeta, of a whole run or of a phase of it."""
    return name == SHORT_NAMES["zeta"] or name.startswith(PHASE_PREFIX)


class Quantity(eqx.Module):
    """One number of a trial that can be fitted.

    Attributes:
        name: As users write it: its place in a set-up file, where an effect's table goes by the
            effect's name.
        unit: Its unit, "-" for none.
        get, put: Getter of the number in a trial, and setter that returns a new trial.
        bijector: Its natural bounds.
    """

    name: str = eqx.field(static=True)
    unit: str = eqx.field(static=True)
    get: Get = eqx.field(static=True)
    put: Put = eqx.field(static=True)
    bijector: AbstractBijector

    @property
    def label(self) -> str:
        """Short name in reports, where there is one."""
        return {full: short for short, full in SHORT_NAMES.items()}.get(self.name, self.name)

    @property
    def is_zeta(self) -> bool:
        """True for zeta, of a whole run or of a phase of it."""
        return is_zeta_name(self.name)

    def record(self, setup: SetUp, value: float) -> None:
        """Write the number into a set-up; the zeta of a phase is one of several, written whole."""
        if self.name.startswith(PHASE_PREFIX):
            return
        if self.name.startswith(COEFFICIENT_PREFIX):
            setup.terrain.put_coefficient(self.name.removeprefix(COEFFICIENT_PREFIX), value)
            return
        section, field = self.name.split(".")
        for place, entry in enumerate(setup.effects):
            if name_of(entry) == section:
                known = entry_of(entry) if isinstance(entry, AbstractEffect) else entry
                setup.effects[place] = {**known, field: value}
                return
        setattr(getattr(setup, section), field, value)

    def read(self, trial: Trial) -> Float[Array, ""]:
        """Return the number in this trial.

        Raises:
            InputError: where the trial's wheel, terrain or rig has no such number, or several.
        """
        try:
            value = self.get(trial)
        except AttributeError:
            raise InputError(f"this set-up has no {self.name} to fit") from None
        if value.ndim:
            raise InputError(
                f"its {self.name} is {value.size} values over time, must be one number to be fitted"
            )
        return value

    def write(self, trial: Trial, value: Float[Array, ""]) -> Trial:
        """Return the trial with another number in this place."""
        return self.put(trial, value)
