"""Where the height and the way count from: the wheel held where it touches the sand."""

import math
from typing import NamedTuple

from hils.guard import Reading
from hils.wire import Measurement


class Zero(NamedTuple):
    """Counts at touch-down, and what a count is worth.

    Attributes:
        x, z: Counts where the wheel touches the sand.
        x_scale, z_scale: Metres a count; x is not measured where its scale is 0.
    """

    x: float
    z: float
    x_scale: float
    z_scale: float

    def reading(self, measurement: Measurement, time: float) -> Reading:
        """The measurement in metres, arrived at this time of the run [s]."""
        return Reading(
            time,
            (measurement.x - self.x) * self.x_scale if self.x_scale else math.nan,
            (measurement.z - self.z) * self.z_scale,
            measurement.omega,
        )


def channels(x_scale: float) -> tuple[str, ...]:
    """What of /measured a rig with this scale of x gives."""
    return ("x", "z") if x_scale else ("z",)
