"""Error of the model itself: as small as its plates and step leave it, or as large as a gap."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

# Constant error of the simulation over a phase of the command [m, N, N m]: what its plates and step
# leave open in sinkage (docs/theory/integrator.md), and the same share of the rest.
MODEL_ERROR: Mapping[str, float] = MappingProxyType(
    {"x": 5e-5, "z": 2e-5, "fx": 0.1, "fz": 0.1, "torque": 0.01}
)


@dataclass(frozen=True)
class MisfitSettings:
    """Numbers that say from when on a model does not fit.

    Attributes:
        poor: Residual in noise floors from which on a fit is poor [-]; repeats of one command on
            beds that were prepared again reach two.
        noticeable: Residual, as a share of the range that the readings cover, below which it is not
            [-]: travel sums up what the wheel slips, and no radius is known to half a per mille.
        worse: Residual over that before the fit from which on a channel got worse [-].
    """

    poor: float = 3.0
    noticeable: float = 5e-4
    worse: float = 1.1


MISFIT_SETTINGS = MisfitSettings()
