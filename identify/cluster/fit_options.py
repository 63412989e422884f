"""Settings of the fits on a cluster, as plain values that go over the wire and into the store."""

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from drftjax import __version__
from drftjax.cluster.store import StoreKind
from drftjax.runlog.record import CHANNELS

if TYPE_CHECKING:
    from identify.parameters.parameter import Parameter


# A store of fits of lone runs has no `shared`.
class ParameterSpec(msgspec.Struct, frozen=True, omit_defaults=True):
    """A parameter as plain values.

    Attributes:
        name: Its full name, such as terrain.zeta.
        bounds: Lowest and highest value, where it has both.
        prior: Mean and standard error of what is believed before the runs.
        start: Where the fit starts; the set-up's value where none is given.
        shared: True for one value of all logs, False for one of each.
    """

    name: str
    bounds: tuple[float, float] | None
    prior: tuple[float, float] | None
    start: float | None
    shared: bool = False


class FitOptions(msgspec.Struct, frozen=True):
    """Settings that the fits of one store have in common.

    Attributes:
        parameters: Fitted parameters.
        noise: Name of the noise model of the residuals.
        zeta: Scaling factor to start from [-]; the set-up's where none is given.
        step: Integrator step [s]; where none is given, one is chosen for each run.
        keep_rest: Compare samples after the last stop as well.
        compare: Channels that are compared.
        software: Version of this package.
    """

    parameters: tuple[ParameterSpec, ...]
    noise: str = "white"
    zeta: float | None = None
    step: float | None = None
    keep_rest: bool = False
    compare: tuple[str, ...] = CHANNELS
    software: str = __version__

    def plain_values(self) -> dict[str, Any]:
        """Plain values by name."""
        return msgspec.to_builtins(self)

    def encoded(self) -> bytes:
        """Return the bytes that a worker gets."""
        return msgspec.msgpack.encode(self)


def parameter_specs(parameters: Sequence["Parameter"]) -> tuple[ParameterSpec, ...]:
    """Return parameters as plain values."""
    from identify.parameters.bijector import Interval

    plain = []
    for each in parameters:
        within = each.bijector
        bounds = (float(within.low), float(within.high)) if isinstance(within, Interval) else None
        prior = (float(each.prior_mean), float(each.prior_error))
        start = float(each.start)
        plain.append(
            ParameterSpec(
                each.quantity.name,
                bounds,
                prior if np.isfinite(prior[1]) else None,
                start if np.isfinite(start) else None,
                each.shared,
            )
        )
    return tuple(plain)


@lru_cache
def fit_parameters(encoded: bytes) -> list["Parameter"]:
    """Return the options' parameters; made once, as programs are compiled for these objects."""
    from identify.parameters.parameter import parameter

    settings = msgspec.msgpack.decode(encoded, type=FitOptions)
    return [
        parameter(t.name, shared=t.shared, bounds=t.bounds, prior=t.prior, start=t.start)
        for t in settings.parameters
    ]


def _current(settings: dict[str, Any]) -> dict[str, Any]:
    """Return settings with the noise model by its name; earlier files have a flag instead."""
    if "autoregressive" not in settings:
        return settings
    rest = {name: value for name, value in settings.items() if name != "autoregressive"}
    return rest | {"noise": "autoregressive" if settings["autoregressive"] else "white"}


FIT_STORE = StoreKind("drft-fit-store", "fits", "log", _current)
