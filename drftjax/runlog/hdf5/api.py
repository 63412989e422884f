"""Reading and writing of run logs and result files.

A file is written as an image in memory and put in place atomically, or, while a run is recorded,
row by row by `recording`. It is surveyed by `reading` before any value is read.
"""

from collections.abc import Mapping
from pathlib import Path

from drftjax.common.output_files import replace_file
from drftjax.runlog.content import Attribute, Content, Violation
from drftjax.runlog.hdf5.checksum import with_checksum
from drftjax.runlog.hdf5.conversion import run_from_survey, to_content
from drftjax.runlog.hdf5.examination import examine, require_readable
from drftjax.runlog.hdf5.reading import OBJECT_LIMIT, SIZE_LIMIT, survey, survey_recording
from drftjax.runlog.hdf5.writing import image
from drftjax.runlog.record import RunLog
from drftjax.runlog.result_file import Columns, ResultFile, result_content, result_from
from drftjax.runlog.schema import AXES, SCHEMA, SCHEMA_VERSION

__all__ = [
    "OBJECT_LIMIT",
    "SIZE_LIMIT",
    "read_result",
    "read_run",
    "survey_cut_off",
    "survey_run",
    "write_result",
    "write_run",
]


Name = str | Path


def read_run(path: Name) -> RunLog:
    """Read a run log.

    Damage to HDF5's own metadata can hang or crash the library. For a file of unknown origin use
    `drftjax.runlog.check.read_run_guarded`.

    Raises:
        InputError: names the file and the first reason to refuse it.
    """
    content, violations = survey_run(path)
    return run_from_survey(content, violations)


def survey_run(path: Name) -> tuple[Content | None, list[Violation]]:
    """Contents of a file, and its violations of the run-log format."""
    return survey(Path(path), SCHEMA, SCHEMA_VERSION, examine)


def survey_cut_off(path: Name) -> tuple[Content | None, list[Violation]]:
    """Committed rows of an interrupted recording, and violations in them."""
    return survey_recording(Path(path))


def write_run(path: Name, run: RunLog) -> None:
    """Write a run log atomically; an existing file of that name is replaced.

    Raises:
        InputError: the file cannot be written.
    """
    replace_file(Path(path), with_checksum(image(to_content(run), AXES)))


def write_result(
    path: Name,
    schema: str,
    attributes: Mapping[str, Attribute],
    groups: Mapping[str, Columns],
    version: int = 1,
) -> None:
    """Write a result file of another schema, as carefully as a run log.

    Args:
        path: Final name; an existing file is replaced.
        schema: Name of the kind of file, such as "drft-fit".
        attributes: Text, numbers and flat lists of either, on the root.
        groups: Datasets as (array, unit) by group and name; a `ResultGroup` adds attributes. Arrays
            have any rank, and may hold infinite numbers and NaN.
        version: Version of that schema.

    Raises:
        InputError: a dataset does not hold real numbers, or the file cannot be written.
    """
    content = result_content(schema, version, attributes, groups)
    replace_file(Path(path), with_checksum(image(content, {})))


def read_result(path: Name, schema: str, version: int = 1) -> ResultFile:
    """Read a result file of a schema.

    Raises:
        InputError: names the file and the reason to refuse it.
    """
    content, violations = survey(Path(path), schema, version, lambda _: ())
    return result_from(require_readable(content, violations))
