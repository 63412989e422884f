"""Gathering of runs: run logs found, read in a child process, prepared, or skipped by a reason."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from drftjax.common.errors import InputError
from drftjax.recorded.prepared_run import PreparedRun, names_of, prepare_run
from drftjax.recorded.refused_readings import drop_refused, refused_readings
from drftjax.runlog.files import drop_repeated_files, run_files
from drftjax.runlog.hdf5.conversion import run_from_survey
from drftjax.runlog.plausibility import plausibility_warnings
from drftjax.runlog.record import RunLog
from drftjax.runlog.safe_reader import GuardedReader


@dataclass(frozen=True)
class GatheredRuns:
    """Runs that can be simulated and compared, and those that cannot.

    Attributes:
        runs: Prepared runs.
        skipped: Reason why each other run was skipped, by its name.
    """

    runs: list[PreparedRun]
    skipped: dict[str, str]


def gather(
    given: Sequence[Path],
    ready: Callable[[str, RunLog], PreparedRun] = prepare_run,
    *,
    sinkage: bool = False,
    tell: Callable[[str], None] = lambda _: None,
) -> GatheredRuns:
    """Read and prepare runs from files and folders; those that cannot be used are skipped.

    Args:
        given: Run logs, and folders of them; a file that repeats another is skipped.
        ready: Prepares a run, from its name and its run log.
        sinkage: True where only runs with a recorded sinkage can be used.
        tell: Called with a sentence for every run that is skipped, unless it is the only one, and
            for readings that are not compared.

    Raises:
        InputError: no run can be used.
    """
    files, skipped = drop_repeated_files(run_files(given))
    prepared: list[PreparedRun] = []
    with GuardedReader() as reader:
        for name, path, surveyed in zip(names_of(files), files, reader.surveys(files), strict=True):
            try:
                run = run_from_survey(*surveyed)
                each = ready(name, run)
                if sinkage:
                    each.observation.sinkage()
                prepared.append(each)
                for doubt in plausibility_warnings(drop_refused(run)):
                    tell(f"note: {path}: {doubt}")
                if refused := int(refused_readings(run).sum()):
                    are = (
                        "reading, which the loop refused or doubted, is"
                        if refused == 1
                        else ("readings, which the loop refused or doubted, are")
                    )
                    tell(f"{name}: {refused} {are} not compared")
            except InputError as problem:
                why = str(problem).removeprefix(f"{name}: ")
                skipped[name] = why if str(path) in why else f"{path}: {why}"
    if not prepared and len(files) == 1:
        raise InputError([*skipped.values()][-1])
    for why in skipped.values():
        tell(f"left out: {why}")
    if not prepared:
        raise InputError(f"none of the {len(files)} files can be used")
    return GatheredRuns(prepared, skipped)
