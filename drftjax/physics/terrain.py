"""Terrain: a stress law, and its scaling factor zeta over a run."""

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from drftjax.common.arrays import as_real, require_between
from drftjax.common.errors import InputError
from drftjax.physics.command import Command
from drftjax.physics.stress import AbstractStressLaw, Dynamic

LARGEST_ZETA = 1000.0


class AbstractZeta(eqx.Module):
    """Scaling factor of the stress law [-] as a function of time and command."""

    @abc.abstractmethod
    def __call__(self, time: Float[Array, ""], command: Command) -> Float[Array, ""]:
        """zeta [-] over the step that ends at `time` [s]."""


class ConstantZeta(AbstractZeta):
    """One zeta for the whole run.

    Attributes:
        value: zeta [-].
    """

    value: Float[Array, ""] = eqx.field(converter=as_real)

    def __check_init__(self):
        require_between("zeta", self.value, 0.0, LARGEST_ZETA)

    def __call__(self, time: Float[Array, ""], command: Command) -> Float[Array, ""]:
        return self.value


class KnotZeta(AbstractZeta):
    """zeta linear between knots in time, constant before the first and after the last.

    Attributes:
        time: Knots [s], increasing, shape (knots,).
        value: zeta at the knots [-], shape (knots,).
    """

    time: Float[Array, " knots"] = eqx.field(converter=as_real)
    value: Float[Array, " knots"] = eqx.field(converter=as_real)

    def __check_init__(self):
        require_between("zeta", self.value, 0.0, LARGEST_ZETA)
        if self.time.ndim != 1 or self.time.shape != self.value.shape:
            raise InputError(
                f"zeta has {self.value.size} values at {self.time.size} knots; "
                "give one value for each knot in time"
            )
        if not self.time.size:
            raise InputError("zeta has no knots in time, needs at least one knot")
        require_between("zeta knots", self.time, -1e9, 1e9, " s")
        if np.any(np.diff(np.asarray(self.time)) <= 0):
            raise InputError(f"zeta knots {np.asarray(self.time).tolist()} s must increase")

    def __call__(self, time: Float[Array, ""], command: Command) -> Float[Array, ""]:
        return jnp.interp(time, self.time, self.value)


class PerStepZeta(AbstractZeta):
    """zeta as each step's command gives it: the online loop's."""

    def __call__(self, time: Float[Array, ""], command: Command) -> Float[Array, ""]:
        return command.zeta


def _table_3_zeta() -> AbstractZeta:
    return ConstantZeta(0.7823)


def as_zeta(zeta: AbstractZeta | ArrayLike) -> AbstractZeta:
    """A zeta as it is, or a number as one zeta for the whole run.

    Raises:
        InputError: the number is out of bounds.
    """
    return zeta if isinstance(zeta, AbstractZeta) else ConstantZeta(as_real(zeta))


class Terrain(eqx.Module):
    """Sand under the wheel; the default is Toyoura sand as in Table 3 of Fuke et al. 2024.

    Attributes:
        zeta: Scaling factor [-] over a run; a number is one zeta for the whole run.
        law: Stress on a moving plate.
    """

    zeta: AbstractZeta = eqx.field(converter=as_zeta, default_factory=_table_3_zeta)
    law: AbstractStressLaw = eqx.field(default_factory=Dynamic)
