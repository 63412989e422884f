"""Run logs on their way into a command: found, read in a guarded way and made ready."""

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
        candidates: The runs.
        left_out: Why each other one is not among them, by its name.
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
    """Runs from files and folders; what cannot be used is left out, and says why.

    Args:
        given: Run logs, and folders of them; a file that repeats another is left out.
        ready: Makes a run ready, from its name and what was recorded.
        sinkage: Whether only runs with a sinkage can be used.
        tell: Called with a sentence for every run that is left out, unless it is the only one, and
            for readings that are.

    Raises:
        InputError: where none can be used.
    """
    files, left_out = drop_repeated_files(run_files(given))
    candidates: list[PreparedRun] = []
    with GuardedReader() as reader:
        for name, path, surveyed in zip(names_of(files), files, reader.surveys(files), strict=True):
            try:
                run = run_from_survey(*surveyed)
                each = ready(name, run)
                if sinkage:
                    each.observation.sinkage()
                candidates.append(each)
                for doubt in plausibility_warnings(drop_refused(run)):
                    tell(f"note: {path}: {doubt}")
                if refused := int(refused_readings(run).sum()):
                    are = (
                        "reading, which the loop refused, is"
                        if refused == 1
                        else ("readings, which the loop refused, are")
                    )
                    tell(f"{name}: {refused} {are} not compared")
            except InputError as problem:
                why = str(problem).removeprefix(f"{name}: ")
                left_out[name] = why if str(path) in why else f"{path}: {why}"
    if not candidates and len(files) == 1:
        raise InputError([*left_out.values()][-1])
    for why in left_out.values():
        tell(f"left out: {why}")
    if not candidates:
        raise InputError(f"none of the {len(files)} files can be used")
    return GatheredRuns(candidates, left_out)
