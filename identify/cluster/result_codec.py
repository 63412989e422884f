"""Result of a single run's fit as bytes, and back to the last bit."""

from typing import Any

import msgspec
import numpy as np

from identify.results.result import FitResult
from identify.results.values import RunFit


class SingleRunResult(msgspec.Struct, frozen=True):
    """Result of a single run's fit.

    Attributes:
        run: Values, residuals and fitted set-up.
        status, steps: End of the solve, and its number of steps.
        findings: Sentences on the result.
    """

    run: RunFit
    status: str
    steps: int
    findings: list[str]


def encode_result(result: FitResult) -> bytes:
    """Return a fit of one run as bytes."""
    (run,) = result.runs
    lone = SingleRunResult(run, result.status, result.steps, list(result.findings))
    return msgspec.msgpack.encode(lone, enc_hook=_packed)


def decode_result(data: bytes) -> SingleRunResult:
    """Return the result that was encoded."""
    return msgspec.msgpack.decode(data, type=SingleRunResult, dec_hook=_unpacked)


def _packed(value: Any) -> Any:
    # msgspec asks its hooks to raise NotImplementedError for what they do not know.
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, np.ascontiguousarray(value).tobytes()
    if isinstance(value, np.generic):
        return value.item()
    raise NotImplementedError(f"a result holds a {type(value).__name__}")


def _unpacked(kind: type, value: Any) -> Any:
    if kind is not np.ndarray:
        raise NotImplementedError(f"a result holds a {kind.__name__}")
    dtype, shape, data = value
    return np.frombuffer(data, np.dtype(dtype)).reshape(shape)
