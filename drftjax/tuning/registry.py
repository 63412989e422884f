"""Tuners of zeta by name, those of installed packages included, and their numbers in a file.

A package adds a tuner by the entry-point group `drft.tuners`: its name, and a class derived from
`drftjax.tuning.step_tuner.AbstractTuner` that takes `tick` and its numbers as keywords
(`settings` is no number).
"""

import inspect
from functools import cache

import msgspec

from drftjax.common.errors import InputError
from drftjax.common.packages import require_known, with_plugins
from drftjax.tuning.kalman_tuner import KalmanTuner
from drftjax.tuning.pi_tuner import ProportionalIntegralTuner
from drftjax.tuning.step_tuner import AbstractTuner, StepTuner

GROUP = "drft.tuners"


OWN: dict[str, type[AbstractTuner]] = {
    "step": StepTuner,
    "pi": ProportionalIntegralTuner,
    "kalman": KalmanTuner,
}


@cache
def tuners() -> dict[str, type[AbstractTuner]]:
    """Classes of tuners by name.

    Raises:
        InputError: names a plug-in that is no tuner, is abstract, or takes a name twice.
    """
    return with_plugins(OWN, GROUP, AbstractTuner, "tuner")


class TunerSetUp(msgspec.Struct, frozen=True):
    """Tuner by name, and those of its numbers that differ from its defaults.

    Attributes:
        name: Key of `tuners`.
        numbers: Values by field, in the tuner's own units.
    """

    name: str = "step"
    numbers: dict[str, float] = msgspec.field(default_factory=dict)

    def build(self, tick: float) -> AbstractTuner:
        """The tuner with these numbers.

        Args:
            tick: Control period [s].

        Raises:
            InputError: for an unknown tuner, a number that it does not have, or a value out of
                bounds.
        """
        known = tuners()
        require_known("the tuner", self.name, known)
        kind = known[self.name]
        given = inspect.signature(kind).parameters
        fields = [name for name in given if name not in ("tick", "settings")]
        for name in self.numbers:
            if name not in fields:
                raise InputError(
                    f"the tuner {self.name!r} has no number {name!r}, it has {', '.join(fields)}"
                )
        return kind(tick=tick, **self.numbers)  # pyright: ignore[reportArgumentType, reportCallIssue]
