"""Run logs and result files on disk. The only package that talks to the HDF5 library.

A file is written as an image in memory and put in place whole, or, while a run is made, row by
row by `recording`. It is surveyed by `reading` before anything is read.
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
    """Read a run log; an InputError names the file and the first reason to refuse it.

    Damage to HDF5's own metadata can hang or crash the library. For a file of unknown origin use
    `drftjax.runlog.check.read_run_guarded`.
    """
    content, violations = survey_run(path)
    return run_from_survey(content, violations)


def survey_run(path: Name) -> tuple[Content | None, list[Violation]]:
    """A file's contents and everything that is wrong with it as a run log."""
    return survey(Path(path), SCHEMA, SCHEMA_VERSION, examine)


def survey_cut_off(path: Name) -> tuple[Content | None, list[Violation]]:
    """The committed rows of a recording that was cut off, and what is wrong with them."""
    return survey_recording(Path(path))


def write_run(path: Name, run: RunLog) -> None:
    """Write a run log whole or not at all; a file of that name is replaced."""
    replace_file(Path(path), with_checksum(image(to_content(run), AXES)))


def write_result(
    path: Name,
    schema: str,
    attributes: Mapping[str, Attribute],
    groups: Mapping[str, Columns],
    version: int = 1,
) -> None:
    """Write a result file of another schema, with a run log's care.

    Args:
        path: Final name; what stood there is replaced.
        schema: Name of the kind of file, such as "drft-fit".
        attributes: Text, numbers and flat lists of either, on the root.
        groups: Datasets as (array, unit) by group and name; a `ResultGroup` adds attributes.
            Arrays of any rank; an infinite or absent number is allowed in a result.
        version: Version of that schema.
    """
    content = result_content(schema, version, attributes, groups)
    replace_file(Path(path), with_checksum(image(content, {})))


def read_result(path: Name, schema: str, version: int = 1) -> ResultFile:
    """Read a result file of this schema; an InputError names the file and the reason."""
    content, violations = survey(Path(path), schema, version, lambda _: ())
    return result_from(require_readable(content, violations))
