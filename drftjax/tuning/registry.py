"""Tuners of zeta by name, and their numbers in a file."""

import inspect
from collections.abc import Callable
from typing import Literal

import msgspec

from drftjax.common.errors import InputError
from drftjax.tuning.kalman_tuner import KalmanTuner
from drftjax.tuning.pi_tuner import ProportionalIntegralTuner
from drftjax.tuning.step_tuner import AbstractTuner, StepTuner

TUNERS: dict[str, Callable[..., AbstractTuner]] = {
    "step": StepTuner,
    "pi": ProportionalIntegralTuner,
    "kalman": KalmanTuner,
}


class TunerSetUp(msgspec.Struct, frozen=True):
    """A tuner by name, and those of its numbers that are not its own defaults."""

    name: Literal["step", "pi", "kalman"] = "step"
    numbers: dict[str, float] = msgspec.field(default_factory=dict)

    def build(self, tick: float) -> AbstractTuner:
        """The tuner at this control period [s].

        Raises:
            InputError: a number that it does not have, or that cannot be.
        """
        kind = TUNERS[self.name]
        known = [name for name in inspect.signature(kind).parameters if name != "tick"]
        for name in self.numbers:
            if name not in known:
                raise InputError(
                    f"the tuner {self.name!r} has no number {name!r}, it has {', '.join(known)}"
                )
        return kind(tick=tick, **self.numbers)
