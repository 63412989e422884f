"""Reading of untrusted HDF5 files in a child process, which may hang, crash or run out of memory.

Damage to HDF5's own bookkeeping can cause all three. The child imports neither JAX nor other slow
packages; one child reads many files and is replaced when it is lost.
"""

import json
import os
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import msgspec
import numpy as np

from drftjax.common.child_process import program
from drftjax.runlog.content import Content, Dataset, Group, Level, Violation

TIME_LIMIT: Final = 20.0
"""Time that one file may take [s]; an ordinary one takes milliseconds."""


MEMORY_LIMIT: Final = 4 * 2**30
"""Address space of the child [bytes], where the system can limit it."""


_START: Final = program("drftjax.runlog.safe_reader", "serve")


Surveyed = tuple[Content | None, list[Violation]]


class _Lost(Exception):
    """The child gave no answer, for the reason in the text."""


class GuardedReader:
    """Surveys run logs in a child process; a context manager."""

    def __init__(self, time_limit: float = TIME_LIMIT, values: bool = True):
        """Start no child yet.

        Args:
            time_limit: Time for each file [s].
            values: True to return the contents beside the violations.
        """
        self._time_limit = time_limit
        self._values = values
        self._child: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stop()

    def survey(self, path: str | Path, cut_off: bool = False) -> Surveyed:
        """Survey one file as a run log.

        Args:
            path: The file.
            cut_off: True for an interrupted recording, of which the committed rows are read.

        Returns:
            Contents, None where they cannot or need not be read; and all violations.
        """
        try:
            answer = self._ask(str(Path(path).absolute()), cut_off)
        except _Lost as reason:
            self._stop()
            return None, [Violation(str(path), "/", str(reason))]
        found = (Violation(str(path), where, why, Level(how)) for where, why, how in answer[0])
        return _unpacked(answer[1]), list(found)

    def surveys(self, paths: Iterable[str | Path]) -> Iterator[Surveyed]:
        """Survey files one after the other."""
        return map(self.survey, paths)

    def _ask(self, path: str, cut_off: bool) -> Any:
        """Send a question to the child, which is started if need be, and await the answer."""
        child = self._child = self._child or _start()
        assert child.stdin is not None
        question = json.dumps({"path": path, "values": self._values, "cut_off": cut_off}) + "\n"
        try:
            child.stdin.write(question.encode())
            child.stdin.flush()
        except BrokenPipeError:
            pass  # the answer below will be missing, and says how the child ended
        deadline = time.monotonic() + self._time_limit
        length = int.from_bytes(self._take(child, 8, deadline), "little")
        return msgspec.msgpack.decode(self._take(child, length, deadline))

    def _take(self, child: "subprocess.Popen[bytes]", length: int, deadline: float) -> bytes:
        """Read so many bytes of the answer before the deadline."""
        assert child.stdout is not None
        taken = bytearray()
        with selectors.DefaultSelector() as selector:
            selector.register(child.stdout, selectors.EVENT_READ)
            while len(taken) < length:
                if not selector.select(max(0.0, deadline - time.monotonic())):
                    raise _Lost(f"is damaged: it could not be read in {self._time_limit:g} s")
                block = os.read(child.stdout.fileno(), min(length - len(taken), 2**20))
                if not block:
                    raise _Lost(_ending(child.wait()))
                taken += block
        return bytes(taken)

    def _stop(self) -> None:
        """Kill the child."""
        child, self._child = self._child, None
        if child is not None:
            child.kill()
            child.communicate()


def serve() -> None:
    """Answer questions of the parent: one per line of stdin, a packed survey each on stdout."""
    _limit_memory()
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    sys.stdout = sys.stderr
    from drftjax.runlog.hdf5.api import survey_cut_off, survey_run

    for line in sys.stdin:
        question = json.loads(line)
        survey = survey_cut_off if question["cut_off"] else survey_run
        content, violations = survey(question["path"])
        found = [(each.where, each.reason, each.level.value) for each in violations]
        packed = _packed(content) if question["values"] and content is not None else None
        answer = msgspec.msgpack.encode((found, packed))
        answers.write(len(answer).to_bytes(8, "little"))
        answers.write(answer)
        answers.flush()


def _start() -> "subprocess.Popen[bytes]":
    # Threads cost address space, and a plug-in would be code that the file chose.
    """Start the child."""
    quiet = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "HDF5_PLUGIN_PATH": os.devnull}
    return subprocess.Popen(
        [sys.executable, "-I", "-c", _START],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=os.environ | quiet,
    )


def _limit_memory() -> None:
    """Limit the memory of this process, where the system can."""
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT, MEMORY_LIMIT))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    except (ImportError, OSError, ValueError):
        pass  # not every system has limits; the time limit still holds


def _ending(code: int) -> str:
    """Clause for a child that ended by itself."""
    if code < 0:
        return f"is damaged: the HDF5 library crashed reading it ({signal.Signals(-code).name})"
    return f"is damaged: its reader ended with code {code}"


def _packed(content: Content) -> dict[str, Any]:
    """Contents as plain values that msgpack can encode."""
    groups = {
        title: (
            dict(group.attributes),
            {
                name: (_packed_values(each), list(each.shape), dict(each.attributes))
                for name, each in group.datasets.items()
            },
        )
        for title, group in content.groups.items()
    }
    return {"attributes": dict(content.attributes), "groups": groups}


def _packed_values(dataset: Dataset) -> tuple[str, bytes] | None:
    """Type and bytes of the values of a dataset."""
    values = dataset.values
    return None if values is None else (values.dtype.str, np.ascontiguousarray(values).tobytes())


def _unpacked(packed: Any) -> Content | None:
    """Contents from the values of `_packed`."""
    if packed is None:
        return None

    def dataset(values: Any, shape: list[int], attributes: Any) -> Dataset:
        """Dataset from its packed values."""
        array = values and np.frombuffer(values[1], np.dtype(values[0])).reshape(shape)
        return Dataset(array, tuple(shape), attributes)

    groups = {
        title: Group({name: dataset(*each) for name, each in datasets.items()}, attributes)
        for title, (attributes, datasets) in packed["groups"].items()
    }
    return Content(packed["attributes"], groups)
