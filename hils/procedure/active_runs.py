"""Registry of the runs under way on this computer, so that `drft hils stop` finds them.

It stands on Python's own library alone: an emergency stop reads it before all else.
"""

import json
import os
import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from stat import S_ISDIR
from typing import NamedTuple

from drftjax.common.errors import InputError

# The same for every terminal of this user's, whatever its environment says.
REGISTRY_PARENT = Path("/tmp")


class ActiveRun(NamedTuple):
    """Process that runs a rig.

    Attributes:
        pid: Its process.
        born: Start of that process, as the system counts; another one that was given the same
            number later was born later.
        port: The rig's port.
        output: Its run log, or the first and the last of several.
    """

    pid: int
    born: str
    port: str
    output: str


@contextmanager
def registered(port: str, outputs: Sequence[Path]) -> Iterator[ActiveRun]:
    """Context in which the runs of these logs can be found and stopped from another terminal.

    Raises:
        InputError: the registry's folder is not this user's own.
    """
    pid = os.getpid()
    entry = _folder() / f"{pid}.json"
    ends = dict.fromkeys([outputs[0], outputs[-1]])
    run = ActiveRun(pid, _born(pid), port, " to ".join(str(each.absolute()) for each in ends))
    entry.write_text(json.dumps(run._asdict(), separators=(",", ":")))
    try:
        yield run
    finally:
        entry.unlink(missing_ok=True)


def runs_under_way() -> list[ActiveRun]:
    """All living runs of this user; the entries of dead ones are removed."""
    found = []
    for entry in sorted(_folder().glob("*.json")):
        # One that is still being written, or that somebody else has put there, is passed over.
        with suppress(OSError, ValueError, TypeError):
            run = ActiveRun(**json.loads(entry.read_bytes()))
            if is_alive(run):
                found.append(run)
            else:
                entry.unlink(missing_ok=True)
    return found


def is_alive(run: ActiveRun) -> bool:
    """Return True where that very process still lives."""
    with suppress(OSError):
        os.kill(run.pid, 0)
        return _born(run.pid) == run.born
    return False


def send_signal(run: ActiveRun, kind: signal.Signals) -> None:
    """Send a signal to a run, unless it has ended."""
    if is_alive(run):
        with suppress(ProcessLookupError):
            os.kill(run.pid, kind)


def wait_until_ended(run: ActiveRun, within: float) -> bool:
    """Wait for a run to end, for this time at most [s]; True where it has ended."""
    deadline = time.monotonic() + within
    while is_alive(run):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)
    return True


def _folder() -> Path:
    folder = REGISTRY_PARENT / f"drft-hils-{os.getuid()}"
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    # A folder that someone else made, or may write to, could name any process of ours.
    facts = folder.lstat()
    if not S_ISDIR(facts.st_mode) or facts.st_uid != os.getuid() or facts.st_mode & 0o022:
        raise InputError(
            f"{folder} must be a folder that only its owner, this user, may write to: runs are "
            "announced there; remove it"
        )
    return folder


def _born(pid: int) -> str:
    """A process's start, as the system counts it; empty where the system does not tell."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return ""
    # A process that has ended but is not yet taken note of by its parent is a zombie.
    return "ended" if fields[0] == "Z" else fields[19]
