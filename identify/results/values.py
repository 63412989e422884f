"""Fitted values, and one run's fit."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Array, Float

from drftjax.setups.setup import RigSetUp, SetUp, WheelSetUp
from identify.parameters.parameter import Parameter, typical_change
from identify.parameters.quantity import is_zeta_name

if TYPE_CHECKING:
    pass

# A standard error of so much of the value, or more, tells little but the order of size; one of so
# many times the value leaves nothing worth a place in a table.
UNTOLD = 0.5


NOTHING_TOLD = 100.0


@dataclass(frozen=True)
class Value:
    """A fitted number.

    Attributes:
        value, error: The number and its standard error, in `unit`.
        unit: "-" for none.
        label: Its short name in reports.
        at_bound: Whether the fit ended at a bound of it, where its error means nothing.
    """

    value: float
    error: float
    unit: str
    label: str
    at_bound: bool = False

    @property
    def size(self) -> float:
        """What the error is held against: the value, or what it typically changes by if more."""
        return max(abs(self.value), typical_change(self.label))

    @property
    def identified(self) -> bool:
        """Whether the runs tell more than its order of size."""
        return self.error <= UNTOLD * self.size

    def cell(self) -> str:
        """Value and error, as a table shows them."""
        if self.at_bound:
            return f"{self.value:.5g}, at a bound"
        if not self.error < NOTHING_TOLD * self.size:
            return "not told"
        return f"{self.value:.5g} ± {self.error:.2g}"

    def __str__(self) -> str:
        unit = "" if self.unit == "-" else f" {self.unit}"
        if self.at_bound:
            return f"{self.label} = {self.value:.5g}{unit}, at a bound"
        return f"{self.label} = {self.value:.5g} ± {self.error:.2g}{unit}"


def values_of(
    parameters: Sequence[Parameter], coordinates: Float[Array, " parameters"], errors: np.ndarray
) -> dict[str, Value]:
    """Values and standard errors by name; an error is carried over by the bijector's slope.

    Args:
        parameters: What was fitted.
        coordinates, errors: Of each, and its standard error, shape (parameters,).
    """
    found = {}
    for each, at, error in zip(parameters, coordinates, errors, strict=True):
        found[each.quantity.name] = Value(
            value=float(each.bijector.value(at)),
            error=float(abs(each.bijector.slope(at)) * error),
            unit=each.quantity.unit,
            label=each.quantity.label,
            at_bound=each.at_bound(float(at), float(error)),
        )
    return found


@dataclass(frozen=True, eq=False)
class RunFit:
    """One run of a fit.

    Attributes:
        name: The run, as reports call it.
        setup: Its set-up with the fitted values put in.
        values: Its own fitted values, by name.
        time: Recorded times [s], shape (samples,).
        counts: True for the samples that were compared, shape (samples,).
        channels: Names of the channels compared.
        recorded: What was recorded [m, N, N m], shape (channels, samples).
        before, after: What was simulated before and after the fit, like `recorded`.
        status: How the run ended: "converged"; "at a bound", where one of its values has run into
            one; "stalled", where more was to gain; "diverged", where it could no longer be
            simulated and was put aside, so that it does not bear on the others.
        path: zeta(t), where that was fitted.
        believed: Its wheel and rig before the fit, where these are kept.
    """

    name: str
    setup: SetUp
    values: Mapping[str, Value]
    time: np.ndarray
    counts: np.ndarray
    channels: tuple[str, ...]
    recorded: np.ndarray
    before: np.ndarray
    after: np.ndarray
    status: str = "converged"
    path: Any = None  # a ZetaPath; decoders of results evaluate annotations, and need none of it
    believed: tuple[WheelSetUp, RigSetUp] | None = None

    @property
    def has_own_zeta(self) -> bool:
        """Whether its zeta was fitted to it alone."""
        return self.path is not None or any(map(is_zeta_name, self.values))

    @property
    def residuals(self) -> dict[str, np.ndarray]:
        """Simulated minus recorded after the fit, by channel [m, N, N m]."""
        return dict(zip(self.channels, self.after - self.recorded, strict=True))

    @property
    def predictions(self) -> dict[str, np.ndarray]:
        """What was simulated after the fit, by channel [m, N, N m]."""
        return dict(zip(self.channels, self.after, strict=True))

    def rmse(self, fitted: bool = True) -> dict[str, float]:
        """Root mean square of simulated minus recorded where compared, by channel [m, N, N m]."""
        left = (self.after if fitted else self.before) - self.recorded
        errors = np.sqrt(np.mean(left[:, self.counts] ** 2, axis=1))
        return dict(zip(self.channels, errors.tolist(), strict=True))
