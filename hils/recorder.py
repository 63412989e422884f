"""The control loop's side of the recorder: rows go into a pipe and never wait.

The recorder is a process of its own that does nothing else (`hils.recorder_process`). The pipe
is the queue between the two: it is bounded, it outlives a killed host, and a row in it costs the
loop about a microsecond, without a thread. A pipe that is full, or whose reader is gone, means
that the recorder is lost: `alive` is false from then on and rows are dropped, so that the loop
can bring the rig to rest.
"""

import fcntl
import os
import selectors
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Final

import msgspec

from drftjax.errors import InputError
from drftjax.runlog.head import Head
from hils.row_stream import Kind, pack_end, pack_head, row_packer

SECONDS_IN_PIPE: Final = 5.0
"""How much of a run the pipe holds, where the system allows it; a recorder that took nothing for
so long counts as lost [s]."""
START_LIMIT: Final = 30.0
"""Time in which the recorder must have made its file [s]."""
CLOSE_LIMIT: Final = 120.0
"""Time in which the recorder must have closed it [s]."""

_ROOT: Final = str(Path(__file__).resolve().parents[1])
_START: Final = (
    f"import sys; sys.path.append({_ROOT!r}); from hils.recorder_process import main; main()"
)
_ROW_BYTES: Final = 256  # of all the rows of one tick, more than they are
_SMALLEST_PIPE: Final = 2**16
_LARGEST_PIPE: Final = 2**20


class Recorder:
    """Records one run into NAME.h5.part, which becomes NAME.h5 when it is closed.

    No call between the construction and `close` waits for anything. Values are plain numbers.
    Times are seconds from the run's start, increasing within each kind of row.
    """

    def __init__(self, path: str | Path, head: Head):
        """Start the recorder, and wait until it has made its file.

        Args:
            path: The run log's final name, ending in .h5; nothing may stand there.
            head: All that is known before the first row.

        Raises:
            InputError: The file cannot be made there.
        """
        self.path = Path(path)
        self._lost: str | None = None
        self._closed = False
        _require_free(self.path)
        self._command, self._measured, self._online, self._event = (
            row_packer(kind, head) for kind in Kind
        )
        taken, self._pipe = os.pipe()
        try:
            _enlarge(self._pipe, head)
            self._process = subprocess.Popen(
                [sys.executable, "-I", "-c", _START, str(self.path.absolute())],
                stdin=taken,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C is the host's to answer
            )
        except BaseException:
            os.close(self._pipe)
            raise
        finally:
            os.close(taken)
        self._answers = b""
        try:
            self._deliver(pack_head(head), time.monotonic() + START_LIMIT)
            self._await("ready", START_LIMIT)
        except BaseException:
            self._abandon()
            raise

    @property
    def alive(self) -> bool:
        """Whether every row so far has been handed over."""
        return self._lost is None

    @property
    def reason(self) -> str | None:
        """Why the recorder is lost, in a sentence without its subject; None while it lives."""
        return self._lost

    @property
    def pid(self) -> int:
        """The recorder's process."""
        return self._process.pid

    def command(self, time: float, omega: float, vx: float | None = None) -> None:
        """What was asked of the rig [s, rad/s, m/s]; vx where the head says driven."""
        if vx is None:
            self._put(self._command.pack(Kind.COMMAND, time, omega))
        else:
            self._put(self._command.pack(Kind.COMMAND, time, omega, vx))

    def measured(self, time: float, *values: float) -> None:
        """A reading: its time [s] and the head's channels in their order, x and z as a rule [m]."""
        self._put(self._measured.pack(Kind.MEASURED, time, *values))

    def online(
        self,
        time: float,
        zeta: float,
        x_sim: float,
        z_sim: float,
        vx_sim: float,
        fx_sim: float,
        tuned: int,
        late: float,
        age: float,
        flags: int,
        seq_sent: int,
        seq_received: int,
        rig_time: float,
    ) -> None:
        """One tick, as `drftjax.runlog.record.Online` says; flags as `hils.events.TickFlag`."""
        self._put(
            self._online.pack(
                Kind.ONLINE,
                time,
                zeta,
                x_sim,
                z_sim,
                vx_sim,
                fx_sim,
                tuned,
                late,
                age,
                flags,
                seq_sent,
                seq_received,
                rig_time,
            )
        )

    def event(self, time: float, code: int, arg: float = 0.0) -> None:
        """Something beside the ticks: a `hils.events.Event` and the number that goes with it."""
        self._put(self._event.pack(Kind.EVENTS, time, code, arg))

    def close(self, end_reason: str) -> Path:
        """End the recording and wait for the file; further calls do nothing.

        Args:
            end_reason: Why the run ended, such as "completed" or "interrupted".

        Returns:
            The finished run log.

        Raises:
            InputError: The recorder was lost, or could not finish; what it has is kept in
                NAME.h5.part.
        """
        if self._closed:
            return self.path
        self._closed = True
        try:
            if self._lost is not None:
                self._lost = self._last_words() or self._ending() or self._lost
                raise InputError(self._complaint())
            self._deliver(pack_end(end_reason), time.monotonic() + CLOSE_LIMIT)
            self._await("closed", CLOSE_LIMIT)
        finally:
            self._abandon()
        return self.path

    def _put(self, row: bytes) -> None:
        if self._lost is not None or self._closed:
            return
        try:
            os.write(self._pipe, row)
        except BlockingIOError:
            self._lost = "took no rows for so long that the pipe to it is full"
        except OSError:
            self._lost = self._last_words() or "ended unasked"

    def _deliver(self, data: bytes, deadline: float) -> None:
        """Write all of it, waiting for room until the deadline."""
        while data:
            try:
                data = data[os.write(self._pipe, data) :]
            except BlockingIOError:
                if time.monotonic() > deadline:
                    raise self._failure("takes no rows") from None
                time.sleep(0.005)
            except OSError:
                raise self._failure(self._last_words() or "ended unasked") from None

    def _await(self, word: str, limit: float) -> None:
        """Wait for the recorder to say the word."""
        said = self._answer(limit)
        if said is None:
            raise self._failure(self._ending() or f"did not answer in {limit:g} s")
        if said[0] != word:
            raise self._failure(said[1])

    def _answer(self, limit: float) -> tuple[str, str] | None:
        """The recorder's next word and its reason; None where it ended or the limit passed."""
        assert self._process.stdout is not None
        deadline = time.monotonic() + limit
        with selectors.DefaultSelector() as selector:
            selector.register(self._process.stdout, selectors.EVENT_READ)
            while b"\n" not in self._answers:
                if not selector.select(max(0.0, deadline - time.monotonic())):
                    return None
                block = os.read(self._process.stdout.fileno(), 2**12)
                if not block:
                    return None
                self._answers += block
        line, _, self._answers = self._answers.partition(b"\n")
        return msgspec.json.decode(line, type=tuple[str, str])

    def _last_words(self) -> str | None:
        said = self._answer(0.0)
        return said[1] if said is not None and said[0] == "failed" else None

    def _ending(self) -> str | None:
        """How the process ended; None where it has not."""
        with suppress(subprocess.TimeoutExpired):
            code = self._process.wait(timeout=1.0)
            return f"was ended by {signal.Signals(-code).name}" if code < 0 else "ended unasked"
        return None

    def _failure(self, reason: str) -> InputError:
        self._lost = reason
        return InputError(self._complaint())

    def _complaint(self) -> str:
        part = part_path(self.path)
        kept = f"; what it has is in {part}: drft log repair {part}" if part.exists() else ""
        return f"{self.path}: the recorder {self._lost}{kept}"

    def _abandon(self) -> None:
        """Let go of the process; one that is at work ends by itself when the pipe is closed."""
        if self._pipe >= 0:
            os.close(self._pipe)
            self._pipe = -1
        if self._process.stdout is not None:
            self._process.stdout.close()


def part_path(path: Path) -> Path:
    """Where a run log stands while it is recorded."""
    return path.with_name(path.name + ".part")


def _require_free(path: Path) -> None:
    part = part_path(path)
    if path.suffix != ".h5":
        raise InputError(f"{path}: a run log's name must end in .h5")
    if not path.parent.is_dir():
        raise InputError(f"{path} cannot be recorded: there is no folder {path.parent}")
    if path.exists():
        raise InputError(f"{path} is already there; move it away or record under another name")
    if part.exists():
        raise InputError(
            f"{part} is already there, a recording at work or cut off; "
            f"drft log repair {part}, or move it away"
        )


def _enlarge(pipe: int, head: Head) -> None:
    os.set_blocking(pipe, False)
    size = _LARGEST_PIPE
    if head.online is not None:
        size = int(SECONDS_IN_PIPE / head.online.tick * _ROW_BYTES)
    with suppress(OSError, AttributeError):  # not every system lets its pipes grow
        size = min(max(size, _SMALLEST_PIPE), _LARGEST_PIPE)
        fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, size)
