"""Fit of one run log by itself, from the bytes of its file to the bytes of its result.

This is what a worker of a cluster does, and one process just as well: both call `fit_logs`, so
both find the same numbers. JAX is set up on the first call, with one device and one thread, for a
machine is filled by as many workers as it has cores.
"""

import os
import tempfile
import threading
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from drftjax import __version__
from drftjax.common.errors import InputError
from drftjax.runlog.record import CHANNELS

if TYPE_CHECKING:
    from drftjax.runlog.safe_reader import GuardedReader
    from identify.parameters.parameter import Parameter

ONE_THREAD = "--xla_cpu_multi_thread_eigen=false"


class ParameterSpec(msgspec.Struct, frozen=True):
    """A parameter that each log has for itself, as plain values.

    Attributes:
        name: Its full name, such as terrain.zeta.
        bounds: Lowest and highest value, where it has both.
        prior: Mean and standard error of what is believed before the runs.
        start: Where the fit starts; the set-up's value where none is given.
    """

    name: str
    bounds: tuple[float, float] | None
    prior: tuple[float, float] | None
    start: float | None


class FitOptions(msgspec.Struct, frozen=True):
    """Settings that the fits of one store have in common.

    Attributes:
        parameters: Fitted parameters, one value for each log.
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


class FitReply(msgspec.Struct, frozen=True):
    """Outcome of the fit of one run log.

    Attributes:
        digest: Its name on the wire.
        values: Value and standard error by parameter.
        result: The encoded result, empty where there is none.
        failure: Why there is none.
    """

    digest: str
    values: dict[str, tuple[float, float]]
    result: bytes
    failure: str


def parameter_specs(parameters: Sequence["Parameter"]) -> tuple[ParameterSpec, ...]:
    """Return parameters as plain values.

    Raises:
        InputError: for a shared one, which no log has for itself.
    """
    from identify.parameters.bijector import Interval

    shared = [each.quantity.label for each in parameters if each.shared]
    if shared:
        raise InputError(
            f"--cluster fits every run alone, so {', '.join(shared)} cannot be shared; "
            "fit it with --own, or without --cluster"
        )
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
            )
        )
    return tuple(plain)


def fit_logs(settings: bytes, logs: Sequence[tuple[str, bytes]]) -> list[bytes]:
    """Fit logs one after the other, each alone.

    Args:
        settings: Encoded `Settings`.
        logs: Digest and file contents of each.

    Returns:
        An encoded `FitReply` for each; a log that cannot be fitted does not stop the others.

    Raises:
        InputError: where this is another version of the package than the settings are of.
    """
    how = msgspec.msgpack.decode(settings, type=FitOptions)
    if how.software != __version__:
        raise InputError(
            f"a worker has drftjax {__version__}, must have {how.software}, as it is here"
        )
    _set_up()
    return [msgspec.msgpack.encode(_fit_log(settings, how, *log)) for log in logs]


def fit_replies(encoded: Sequence[bytes]) -> list[FitReply]:
    """Replies of `fit_logs`, decoded."""
    return [msgspec.msgpack.decode(each, type=FitReply) for each in encoded]


def _fit_log(settings: bytes, how: FitOptions, digest: str, data: bytes) -> FitReply:
    from drftjax.recorded.prepared_run import prepare_run
    from drftjax.runlog.hdf5.conversion import run_from_survey
    from identify.cluster.result_codec import encode_result
    from identify.fit_constant import fit
    from identify.uncertainty.noise_model import noise_model

    try:
        with tempfile.TemporaryDirectory(prefix="drft-") as folder:
            path = Path(folder) / "run.h5"
            path.write_bytes(data)
            content, violations = _reader().survey(path)
        # Sentences name the log, not where a copy of it lay.
        run = run_from_survey(content, [replace(each, path=digest) for each in violations])
        each = prepare_run(
            digest,
            run,
            fitted=[term.name for term in how.parameters],
            zeta=how.zeta,
            step=how.step,
            keep_rest=how.keep_rest,
            compare=how.compare,
        )
        result = fit([each], _parameters(settings), noise=noise_model(how.noise))
    except InputError as problem:
        return FitReply(digest, {}, b"", _reason(str(problem), digest))
    except Exception as problem:
        # One log among thousands must not take the others with it, whatever it meets.
        return FitReply(digest, {}, b"", f"its fit broke off: {type(problem).__name__}: {problem}")
    values = {name: (v.value, v.error) for name, v in result.runs[0].values.items()}
    return FitReply(digest, values, encode_result(result), "")


def _reason(text: str, digest: str) -> str:
    """Return a refusal without the name of the log, and without what is only true of one log."""
    alone = f"no run is left to fit ({digest}: "
    if text.startswith(alone):
        return text.removeprefix(alone).removesuffix(")")
    return text.removeprefix(f"{digest}: ")


@lru_cache
def _parameters(encoded: bytes) -> list["Parameter"]:
    """Return the options' parameters; made once, as programs are compiled for these objects."""
    from identify.parameters.parameter import parameter

    settings = msgspec.msgpack.decode(encoded, type=FitOptions)
    return [
        parameter(t.name, shared=False, bounds=t.bounds, prior=t.prior, start=t.start)
        for t in settings.parameters
    ]


@lru_cache
def _set_up() -> None:
    """Configure JAX for one device and one thread."""
    flags = os.environ.get("XLA_FLAGS", "")
    if "xla_cpu_multi_thread_eigen" not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {ONE_THREAD}".strip()
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    from drftjax.common.jax_config import configure_jax

    configure_jax(devices=1)


_local = threading.local()


def _reader() -> "GuardedReader":
    """Return this thread's reader; its child ends with this process, whose end closes its input."""
    from drftjax.runlog.safe_reader import GuardedReader

    if not hasattr(_local, "reader"):
        _local.reader = GuardedReader()
    return _local.reader
