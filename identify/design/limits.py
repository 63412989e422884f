"""Limits of a rig, which a designed run keeps."""

import math
from dataclasses import dataclass

import numpy as np

from drftjax.common.arrays import require_between
from drftjax.common.errors import InputError
from drftjax.runlog.record import RecordedCommand
from drftjax.setups.setup import CommandSetUp

# Share of a limit by which it may be exceeded: numbers in files are rounded [-].
ROUNDING_SHARE = 1e-3


@dataclass(frozen=True)
class Limits:
    """Limits of the rig.

    Attributes:
        speed: Largest angular velocity [rad/s].
        acceleration: Largest angular acceleration [rad/s2].
        duration: Of the run, its rests included [s].
        loads: Lowest and highest vertical load [N]; the set-up's own only where None.
        travel: Longest travel of the rim; that of the wheel is shorter by slip [m].
    """

    speed: float = math.radians(300.0)
    acceleration: float = math.radians(50.0)
    duration: float = 24.0
    loads: tuple[float, float] | None = None
    travel: float = math.inf

    @property
    def rest(self) -> float:
        """Rest before and after the motion [s]."""
        return min(1.0, self.duration / 20)

    def fastest_profile(self) -> CommandSetUp:
        """Profile that speeds up as fast as the limits allow: the hardest to simulate."""
        ramp = min(self.speed / self.acceleration, (self.duration - 2 * self.rest) / 2)
        ends = (0.0, self.rest, self.rest + ramp, self.duration - self.rest - ramp)
        time = [*ends, self.duration - self.rest, self.duration]
        # A triangle's peak is one knot, not two.
        top = ramp * self.acceleration
        if time[3] - time[2] < ROUNDING_SHARE * ramp:
            return CommandSetUp([*time[:3], *time[4:]], [0.0, 0.0, top, 0.0, 0.0])
        return CommandSetUp(time, [0.0, 0.0, top, top, 0.0, 0.0])

    def violations(self, command: RecordedCommand, radius: float) -> list[str]:
        """Violations of the limits by a profile, in words; none where it can be run.

        Args:
            command: The profile, with a wheel that is driven.
            radius: Of the rim [m].
        """
        time, omega = np.asarray(command.time), np.asarray(command.omega)
        fastest = float(np.abs(np.diff(omega) / np.diff(time)).max(initial=0.0))
        asked = (
            ("speed", math.degrees(float(np.abs(omega).max())), math.degrees(self.speed), "deg/s"),
            ("acceleration", math.degrees(fastest), math.degrees(self.acceleration), "deg/s2"),
            ("duration", float(time[-1] - time[0]), self.duration, "s"),
            ("travel", travel_of(command, radius), self.travel, "m"),
        )
        return [
            f"its {name} of {value:.3g} {unit} is beyond {most:.3g} {unit}"
            for name, value, most, unit in asked
            if value > (1 + ROUNDING_SHARE) * most
        ]

    def check(self, radius: float) -> None:
        """Raise InputError for limits that no run can keep, or that no step can simulate."""
        require_between("the largest speed", math.degrees(self.speed), 1.0, 3000.0, " deg/s")
        require_between(
            "the largest acceleration",
            math.degrees(self.acceleration),
            0.1,
            1e4,
            " deg/s2",
        )
        require_between("the duration", self.duration, 1.0, 600.0, " s")
        if self.travel != math.inf:
            require_between("the largest travel", self.travel, 0.01, 1000.0, " m")
        if self.loads is not None:
            low, high = self.loads
            require_between("the lowest load", low, 1.0, 1e4, " N")
            require_between("the highest load", high, 1.0, 1e4, " N")
            if low >= high:
                raise InputError(f"the loads are {low:g} to {high:g} N; the first must be less")


def travel_of(command: RecordedCommand, radius: float) -> float:
    """Return the travel of the rim [m]; that of the wheel is shorter by slip.

    Args:
        command: Angular velocity over time.
        radius: Of the rim [m].
    """
    return radius * float(np.trapezoid(np.abs(command.omega), command.time))
