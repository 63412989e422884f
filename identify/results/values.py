"""Fitted values, and one run's fit."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from drftjax.common.text import value_with_error
from drftjax.setups.setup import RigSetUp, SetUp, WheelSetUp
from identify.parameters.parameter import Parameter, typical_change
from identify.parameters.quantity import is_zeta_name


@dataclass(frozen=True)
class IdentifiabilitySettings:
    """Numbers that say from which standard error on a value is not identified.

    Attributes:
        identified_error: Standard error, as a share of the value, above which the runs determine
            hardly more than the order of size.
        reported_error: The same, above which nothing is worth a place in a table.
    """

    identified_error: float = 0.5
    reported_error: float = 100.0


IDENTIFIABILITY = IdentifiabilitySettings()


@dataclass(frozen=True)
class Value:
    """A fitted number.

    Attributes:
        value, error: The number and its standard error, in `unit`.
        unit: "-" for none.
        label: Its short name in reports.
        at_bound: True where the fit ended at a bound of it, where its error means nothing.
    """

    value: float
    error: float
    unit: str
    label: str
    at_bound: bool = False

    @property
    def size(self) -> float:
        """Size that the error is compared with: the value, or its typical change if larger."""
        return max(abs(self.value), typical_change(self.label))

    @property
    def identified(self) -> bool:
        """True where the runs determine more than its order of size."""
        return self.error <= IDENTIFIABILITY.identified_error * self.size

    def cell(self) -> str:
        """Return value and error, as a table shows them."""
        if self.at_bound:
            return f"{self.value:.5g}, at a bound"
        if not self.error < IDENTIFIABILITY.reported_error * self.size:
            return "not identified"
        return value_with_error(self.value, self.error)

    def __str__(self) -> str:
        unit = "" if self.unit == "-" else f" {self.unit}"
        if self.at_bound:
            return f"{self.label} = {self.value:.5g}{unit}, at a bound"
        return f"{self.label} = {value_with_error(self.value, self.error)}{unit}"


def values_of(
    parameters: Sequence[Parameter], coordinates: Float[Array, " parameters"], errors: np.ndarray
) -> dict[str, Value]:
    """Return values and standard errors by name; errors are scaled by the bijector's slope.

    Args:
        parameters: Fitted parameters.
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
        name: Name of the run in reports.
        setup: Its set-up with the fitted values put in.
        values: Its own fitted values, by name.
        time: Recorded times [s], shape (samples,).
        counts: True for the samples that were compared, shape (samples,).
        channels: Names of the channels compared.
        recorded: Recorded channels [m, N, N m], shape (channels, samples).
        before, after: Simulated channels before and after the fit, like `recorded`.
        status: End of the run: "converged"; "poor fit", where it is off by more than chance; "at a
            bound", where one of its values has run into one; "stalled", where more was to gain;
            "diverged", where it could no longer be simulated and was put aside, so that it does
            not bear on the others.
        path: zeta(t), where that was fitted.
        believed: Wheel and rig of its set-up before the fit, where these are kept.
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
        """True where its zeta was fitted to this run only."""
        return self.path is not None or any(map(is_zeta_name, self.values))

    @property
    def residuals(self) -> dict[str, np.ndarray]:
        """Simulated minus recorded after the fit, by channel [m, N, N m]."""
        return dict(zip(self.channels, self.after - self.recorded, strict=True))

    @property
    def predictions(self) -> dict[str, np.ndarray]:
        """Simulated channels after the fit, by channel [m, N, N m]."""
        return dict(zip(self.channels, self.after, strict=True))

    def rmse(self, fitted: bool = True) -> dict[str, float]:
        """Return the RMS of simulated minus recorded where compared, by channel [m, N, N m]."""
        residual = (self.after if fitted else self.before) - self.recorded
        errors = np.sqrt(np.mean(residual[:, self.counts] ** 2, axis=1))
        return dict(zip(self.channels, errors.tolist(), strict=True))
