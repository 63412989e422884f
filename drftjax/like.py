"""A recorded run as a pattern: the set-up that another run may have."""

from pathlib import Path

from drftjax.errors import InputError
from drftjax.runlog.check import read_run_guarded
from drftjax.runlog.plausibility import require_upright, standing_problems
from drftjax.runlog.record import RunLog
from drftjax.setup import SetUp, setup_from_run


def setup_like(path: Path) -> tuple[SetUp, RunLog]:
    """The set-up of a recorded run, and the run.

    Raises:
        InputError: names the file, what it lacks or says that cannot be, and what must hold.
    """
    run = read_run_guarded(path)
    try:
        require_upright(run)
        for reason in standing_problems(run.setup.known()):
            raise InputError(f"setup sinkage_static {reason}")
        return setup_from_run(run), run
    except InputError as problem:
        raise InputError(f"{path}: {problem}") from None
