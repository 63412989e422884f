"""Repair of an interrupted recording into an ordinary run log."""

from dataclasses import replace
from pathlib import Path

from drftjax.common.errors import InputError, missing_path
from drftjax.common.output_files import require_places
from drftjax.runlog.hdf5.api import write_run
from drftjax.runlog.hdf5.conversion import run_from_survey
from drftjax.runlog.record import RunLog
from drftjax.runlog.recording_lock import PART
from drftjax.runlog.safe_reader import TIME_LIMIT, GuardedReader

CUT_OFF = "cut off; the committed rows were kept"
"""End reason of a repaired run."""


def repair(part: Path, output: Path | None = None, force: bool = False) -> tuple[Path, RunLog]:
    """Copy the committed rows of an interrupted recording into an ordinary run log.

    Args:
        part: The recording, NAME.h5.part, which is not changed.
        output: File to write; NAME.h5 where it is None.
        force: True to replace an existing file.

    Returns:
        Path of the written file, and the run in it.

    Raises:
        InputError: the file is not a recording, is still being recorded, is damaged or has no row;
            or the output exists.
    """
    whole = part.with_name(part.name.removesuffix(PART))
    if not part.exists():
        closed = f"there is no such file; {whole} is there, which needs no repair"
        raise InputError(f"{part}: {closed if whole.exists() else missing_path(part)}")
    if output is None:
        if not part.name.endswith(f".h5{PART}"):
            raise InputError(
                f"{part}: the name of a recording that was cut off ends in .h5{PART}; if this is "
                "one, name the output too"
            )
        output = whole
    if output.exists() and not force:
        raise InputError(f"{output} is already there; give --force to replace it")
    require_places([output], [part])
    with GuardedReader(TIME_LIMIT) as reader:
        run = replace(run_from_survey(*reader.survey(part, cut_off=True)), end_reason=CUT_OFF)
    write_run(output, run)
    return output, run
