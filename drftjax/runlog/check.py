"""Violations of one or several files, and reading of files of unknown origin."""

from collections.abc import Iterable
from pathlib import Path

from drftjax.common.errors import InputError
from drftjax.runlog.content import Violation
from drftjax.runlog.hdf5.conversion import run_from_survey
from drftjax.runlog.record import RunLog
from drftjax.runlog.result_file import FIT_SCHEMA, POSTERIOR_SCHEMA
from drftjax.runlog.safe_reader import TIME_LIMIT, GuardedReader
from drftjax.runlog.schema import SCHEMA


def check_file(path: str | Path, time_limit: float = TIME_LIMIT) -> list[Violation]:
    """Violations of the run-log format by one file; empty for a valid one.

    Args:
        path: The file.
        time_limit: Time in which a child process must have read it [s].
    """
    return check_files([path], time_limit)[0]


def check_files(
    paths: Iterable[str | Path], time_limit: float = TIME_LIMIT
) -> list[list[Violation]]:
    """`check_file` for several files, with one child process."""
    with GuardedReader(time_limit, values=False) as reader:
        return [violations for _, violations in reader.surveys(paths)]


def read_run_guarded(path: str | Path, time_limit: float = TIME_LIMIT) -> RunLog:
    """Read a run log of unknown origin; a damaged file cannot hang or crash the caller.

    Args:
        path: The file.
        time_limit: Time in which a child process must have read it [s].

    Raises:
        InputError: names the file and the first reason to refuse it.
    """
    return read_runs_guarded([path], time_limit)[0]


def read_runs_guarded(paths: Iterable[str | Path], time_limit: float = TIME_LIMIT) -> list[RunLog]:
    """`read_run_guarded` for several files, with one child process."""
    with GuardedReader(time_limit) as reader:
        return [run_from_survey(*surveyed) for surveyed in reader.surveys(paths)]


def require_no_recording(path: Path) -> None:
    """Refuse to replace a file that may hold a recording.

    An earlier simulation or fit may be replaced. An HDF5 file of another program, or one that
    cannot be opened, may hold a recording.

    Raises:
        InputError: names the file and its contents.
    """
    if not path.is_file() or path.stat().st_size == 0:
        return
    with GuardedReader() as reader:
        content, violations = reader.survey(path)
    if content is None:
        raise InputError(f"{violations[0]}; give another name than that, or move it away")
    schema, source = (content.attributes.get(name) for name in ("schema", "source"))
    if schema == SCHEMA and source != "simulated":
        raise InputError(
            f"{path} holds a run of source {source!r}, which no simulation or fit may replace; "
            "give another name, or move it away"
        )
    if schema not in (SCHEMA, FIT_SCHEMA, POSTERIOR_SCHEMA):
        raise InputError(
            f"{path} is an HDF5 file that holds no simulation or fit, and may hold a recording; "
            "give another name, or move it away"
        )
