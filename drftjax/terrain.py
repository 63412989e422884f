"""The sand: a stress law and its scaling factor."""

import equinox as eqx

from drftjax.scaling import AbstractZeta, ConstantZeta
from drftjax.stress import AbstractStressLaw, Dynamic


def _table_3_zeta() -> AbstractZeta:
    return ConstantZeta(0.7823)


class Terrain(eqx.Module):
    """Sand under the wheel; the default is Toyoura sand as in Table 3 of Fuke et al. 2024.

    Attributes:
        zeta: Scaling factor [-] over a run.
        law: Stress on a moving plate.
    """

    zeta: AbstractZeta = eqx.field(default_factory=_table_3_zeta)
    law: AbstractStressLaw = eqx.field(default_factory=Dynamic)
