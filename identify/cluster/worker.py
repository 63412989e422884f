"""Fit of one run log by itself, from the bytes of its file to the bytes of its result.

This is what a worker of a cluster does, and one process just as well: both call `fit_logs`, so
both find the same numbers. For a fit of all logs together a worker only prepares them.
"""

import pickle
import tempfile
import threading
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from drftjax.cluster.worker_process import set_up_worker
from drftjax.common.errors import InputError
from identify.cluster.fit_options import FitOptions, fit_parameters

if TYPE_CHECKING:
    from drftjax.recorded.prepared_run import PreparedRun
    from drftjax.runlog.safe_reader import GuardedReader


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


def fit_logs(settings: bytes, logs: Sequence[tuple[str, bytes]]) -> list[bytes]:
    """Fit logs one after the other, each alone.

    Args:
        settings: Encoded `FitOptions`.
        logs: Digest and file contents of each.

    Returns:
        An encoded `FitReply` for each; a log that cannot be fitted does not stop the others.

    Raises:
        InputError: where this is another version of the package than the settings are of.
    """
    how = _set_up(settings)
    return [msgspec.msgpack.encode(_fit_log(settings, how, *log)) for log in logs]


def prepare_logs(settings: bytes, logs: Sequence[tuple[str, bytes]]) -> list[bytes]:
    """Prepare logs for a fit of all together.

    Args:
        settings, logs: As for `fit_logs`.

    Returns:
        For each log a pickled `PreparedRun`, named by its digest, or why there is none, a text.

    Raises:
        InputError: as `fit_logs`.
    """
    how = _set_up(settings)
    return [pickle.dumps(_prepare_log(how, *log)) for log in logs]


def _prepare_log(how: FitOptions, digest: str, data: bytes) -> "PreparedRun | str":
    try:
        return _prepared(how, digest, data)
    except InputError as problem:
        return _reason(str(problem), digest)


def _set_up(settings: bytes) -> FitOptions:
    how = msgspec.msgpack.decode(settings, type=FitOptions)
    set_up_worker(how.software)
    return how


def fit_replies(encoded: Sequence[bytes]) -> list[FitReply]:
    """Replies of `fit_logs`, decoded."""
    return [msgspec.msgpack.decode(each, type=FitReply) for each in encoded]


def _fit_log(settings: bytes, how: FitOptions, digest: str, data: bytes) -> FitReply:
    from identify.cluster.result_codec import encode_result
    from identify.fit_constant import fit
    from identify.uncertainty.noise_model import noise_model

    try:
        each = _prepared(how, digest, data)
        result = fit([each], fit_parameters(settings), noise=noise_model(how.noise))
    except InputError as problem:
        return FitReply(digest, {}, b"", _reason(str(problem), digest))
    except Exception as problem:
        # One log among thousands must not take the others with it, whatever it meets.
        return FitReply(digest, {}, b"", f"its fit broke off: {type(problem).__name__}: {problem}")
    values = {name: (v.value, v.error) for name, v in result.runs[0].values.items()}
    return FitReply(digest, values, encode_result(result), "")


def _prepared(how: FitOptions, digest: str, data: bytes) -> "PreparedRun":
    from drftjax.recorded.prepared_run import prepare_run
    from drftjax.runlog.hdf5.conversion import run_from_survey

    with tempfile.TemporaryDirectory(prefix="drft-") as folder:
        path = Path(folder) / "run.h5"
        path.write_bytes(data)
        content, violations = _reader().survey(path)
    # Sentences name the log, not where a copy of it lay.
    return prepare_run(
        digest,
        run_from_survey(content, [replace(each, path=digest) for each in violations]),
        fitted=[term.name for term in how.parameters],
        zeta=how.zeta,
        step=how.step,
        keep_rest=how.keep_rest,
        compare=how.compare,
    )


def _reason(text: str, digest: str) -> str:
    """Return a refusal without the name of the log, and without what is only true of one log."""
    alone = f"no run is left to fit ({digest}: "
    if text.startswith(alone):
        return text.removeprefix(alone).removesuffix(")")
    return text.removeprefix(f"{digest}: ")


_local = threading.local()


def _reader() -> "GuardedReader":
    """Return this thread's reader; its child ends with this process, whose end closes its input."""
    from drftjax.runlog.safe_reader import GuardedReader

    if not hasattr(_local, "reader"):
        _local.reader = GuardedReader()
    return _local.reader
