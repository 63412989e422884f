"""The control loop's side of the recorder: rows go into a pipe and never wait.

The recorder is a process of its own that does nothing else (`hils.recording.recorder_process`). The
pipe is the queue between the two: it is bounded, it outlives a killed host, and a row in it costs
the loop about a microsecond, without a thread. A pipe that is full, or that nobody reads from any
more, means that the recorder is lost: `alive` is false from then on, so that the loop can bring the
rig to rest. Rows go on into a pipe that has room, for a recorder that comes to itself; else they
are dropped.
"""

import os
import selectors
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from struct import Struct
from typing import Final

import msgspec

from drftjax.common.child_process import program
from drftjax.common.errors import InputError
from drftjax.runlog.header import Head
from drftjax.runlog.recording_lock import part_path, require_free, require_place
from hils.recording.row_stream import Kind, OnlineRow, pack_end, pack_head, row_packer


@dataclass(frozen=True)
class RecorderSettings:
    """Pipe to the recorder, and patience with it.

    Attributes:
        pipe_bytes: Size of the pipe, where the system allows it; 1 MiB holds 6 s of a run at 1 kHz.
        head_reserve: Bytes of the pipe that are kept for the first rows, and for numbers of the
            head that may become longer in the end.
        check_interval: From one look at the pipe to the next [s].
        max_idle_checks: Looks in a row at which the recorder had taken nothing, after which it is
            lost. Looks are counted, not seconds: a computer that was asleep is no recorder that
            hangs. Nor is a slow disk: the recorder syncs in a thread, and reads meanwhile.
        start_time: Time in which the recorder must have made its file [s].
        close_time: Time in which the recorder must have closed it [s].
    """

    pipe_bytes: int = 2**20
    head_reserve: int = 2**12
    check_interval: float = 0.25
    max_idle_checks: int = 16
    start_time: float = 30.0
    close_time: float = 120.0


DEFAULT_RECORDER = RecorderSettings()


_START: Final = program("hils.recording.recorder_process", "main")


_UNASKED: Final = "ended unasked"


def _waiting(pipe: int) -> int:
    """Bytes that nobody has taken from the pipe yet; 0 where the system does not tell."""
    import fcntl
    import termios

    with suppress(OSError):
        return int.from_bytes(fcntl.ioctl(pipe, termios.FIONREAD, bytes(4)), sys.byteorder)
    return 0


class Recorder:
    """Records one run into NAME.h5.part, which becomes NAME.h5 when it is closed.

    Only the construction and `close` wait. Values are plain numbers. Times are seconds from the
    run's start, increasing within each kind of row.
    """

    def __init__(
        self,
        path: str | Path,
        head: Head | None = None,
        settings: RecorderSettings = DEFAULT_RECORDER,
    ):
        """Start the recorder and wait until it is there, some tenths of a second.

        Args:
            path: The run log's final name, ending in .h5; nothing may stand there.
            head: All that is known before the first row; None where `begin` brings it.
            settings: Pipe and patience.

        Raises:
            InputError: The file cannot be made there.
        """
        import fcntl

        self._settings = settings
        self.path = Path(path)
        self._lost: str | None = None
        self._begun = self._full = self._hangs = self._closed = False
        self._written = self._taken = self._idle_checks = 0
        self._check_at = 0.0
        self._answers = b""
        self._command: Struct
        self._measured: Struct
        self._online: Struct
        self._event: Struct
        require_free(self.path)
        taken, self._pipe = os.pipe()
        try:
            os.set_blocking(self._pipe, False)
            with suppress(OSError, AttributeError):  # not every system lets its pipes grow
                fcntl.fcntl(self._pipe, fcntl.F_SETPIPE_SZ, settings.pipe_bytes)
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
        try:
            self._await("ready", settings.start_time)
            if head is not None:
                self.begin(head)
                self._await("begun", settings.start_time)
        except BaseException:
            self._closed = True
            self._release()
            raise

    def require_room(self, head: Head) -> None:
        """Refuse a head that the pipe cannot take at once, before anything moves.

        Raises:
            InputError: it is larger than the pipe takes. Or the recorder has ended, its
                file was moved or removed, or the disk has filled since it started.
        """
        import fcntl

        self._require_at_work()
        try:
            most = fcntl.fcntl(self._pipe, fcntl.F_GETPIPE_SZ) - self._settings.head_reserve
        except (OSError, AttributeError):  # not every system tells
            return
        size = len(pack_head(head))
        if size > most:
            raise InputError(
                f"set-up and profile make {size} bytes of the run log's head, the pipe to the "
                f"recorder takes {most}: give a profile of fewer knots"
            )

    def _require_at_work(self) -> None:
        part = part_path(self.path)
        if self._process.poll() is not None:
            raise self._failure(self._ending() or _UNASKED)
        if not part.exists():
            raise InputError(f"{part} was moved or removed before the first row")
        try:
            require_place(self.path)
        except InputError as error:
            raise InputError(f"{self.path}: {error}") from None

    def begin(self, head: Head) -> None:
        """Have the file made, without waiting for it; once, before the first row.

        Where it cannot be made, the recorder counts as lost some rows later.
        """
        self._command, self._measured, self._online, self._event = (
            row_packer(kind, head) for kind in Kind
        )
        self._begun = True
        self._put(pack_head(head))

    @property
    def alive(self) -> bool:
        """True while every row so far has been handed over."""
        return self._lost is None

    @property
    def reason(self) -> str | None:
        """Reason why the recorder is lost, a sentence without its subject; None while it lives."""
        return self._lost

    @property
    def pid(self) -> int:
        """The recorder's process."""
        return self._process.pid

    def command(self, time: float, omega: float, vx: float | None = None) -> None:
        """Record a command [s, rad/s, m/s]; vx where the carriage is driven."""
        if vx is None:
            self._put(self._command.pack(Kind.COMMAND, time, omega))
        else:
            self._put(self._command.pack(Kind.COMMAND, time, omega, vx))

    def measured(self, time: float, *values: float) -> None:
        """Record a reading: its time [s] and the head's channels in order, usually x and z [m]."""
        self._put(self._measured.pack(Kind.MEASURED, time, *values))

    def online(self, row: OnlineRow) -> None:
        """Record a tick."""
        self._put(self._online.pack(Kind.ONLINE, *row))

    def event(self, time: float, code: int, arg: float = 0.0) -> None:
        """Record an event beside the ticks: a `hils.events.Event` and its number."""
        self._put(self._event.pack(Kind.EVENTS, time, code, arg))

    def close(self, end_reason: str) -> Path | None:
        """End the recording and wait for the file; further calls do nothing.

        Args:
            end_reason: Why the run ended, such as "completed" or "interrupted".

        Returns:
            The finished run log; None where it would have no command or no reading.

        Raises:
            InputError: The recorder was lost, or could not finish; the sentence says where what
                it has is.
        """
        if self._closed:
            return self.path if self.path.exists() else None
        self._closed = True
        deadline = time.monotonic() + self._settings.close_time
        try:
            # An end before the head would be taken for the head's length.
            if self._begun and (self._lost is None or self._full or self._hangs):
                self._deliver(pack_end(end_reason), deadline)
            self._close_pipe()
            self._await("closed", max(0.0, deadline - time.monotonic()))
            if self._lost is not None:
                raise self._failure(self._lost)
        finally:
            self._release()
        return self.path if self.path.exists() else None

    def _put(self, row: bytes) -> None:
        if self._closed or self._full or (self._lost is not None and not self._hangs):
            return
        try:
            written = os.write(self._pipe, row)
            self._written += written
            if written < len(row):  # only a head is longer than PIPE_BUF
                self._lost = f"was given a head of {len(row)} bytes, more than its pipe could take"
            elif self._lost is None and (now := time.monotonic()) >= self._check_at:
                self._check_at = now + self._settings.check_interval
                self._check_progress()
        except BlockingIOError:
            self._full = True
            self._lost = self._lost or "took no rows for so long that the pipe to it is full"
        except OSError:
            self._hangs = False
            self._lost = _UNASKED
            while (answer := self._answer(0.0)) is not None:  # what it has sent already
                if answer[0] == "failed":
                    self._fail(answer[1])

    def _check_progress(self) -> None:
        """Count a look at the pipe; a recorder that takes nothing is lost."""
        waiting = _waiting(self._pipe)
        taken = self._written - waiting
        self._idle_checks = self._idle_checks + 1 if waiting and taken == self._taken else 0
        self._taken = taken
        settings = self._settings
        if self._idle_checks >= settings.max_idle_checks:
            self._hangs = True
            self._lost = (
                f"took no rows for {settings.max_idle_checks * settings.check_interval:g} s"
            )

    def _fail(self, reason: str) -> None:
        known = self._lost not in (None, _UNASKED)
        self._lost = f"{self._lost}; {reason}" if known else reason

    def _deliver(self, data: bytes, deadline: float) -> None:
        """Write all of it, waiting for room; a pipe without a reader is left to `_await`."""
        while data:
            try:
                data = data[os.write(self._pipe, data) :]
            except BlockingIOError:
                if time.monotonic() > deadline:
                    raise self._failure("takes no rows") from None
                time.sleep(0.005)
            except OSError:
                return

    def _await(self, word: str, limit: float) -> None:
        """Wait for the recorder to say the word; others that it says before are passed over."""
        deadline = time.monotonic() + limit
        while (answer := self._answer(deadline)) is not None:
            if answer[0] == "failed":
                # It may still write until it has ended.
                while answer is not None:
                    self._fail(answer[1])
                    answer = self._answer(deadline)
                raise self._failure(self._lost or _UNASKED)
            if answer[0] == word:
                return
        if self._lost in (None, _UNASKED):
            raise self._failure(self._ending() or f"did not answer in {limit:.0f} s")
        raise self._failure(self._lost)

    def _answer(self, deadline: float) -> tuple[str, str] | None:
        """The recorder's next word and its reason; None where it ended or the deadline passed."""
        assert self._process.stdout is not None
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

    def _ending(self) -> str | None:
        """Outcome of the process; None where it has not ended."""
        with suppress(subprocess.TimeoutExpired):
            code = self._process.wait(timeout=1.0)
            return f"was ended by {signal.Signals(-code).name}" if code < 0 else _UNASKED
        return None

    def _failure(self, reason: str) -> InputError:
        self._lost = reason
        part = part_path(self.path)
        kept = ""
        if self._begun and part.exists():
            other = " -o ANOTHER.h5" if self.path.exists() else ""
            kept = f"; the rows until then are kept: drft log repair {part}{other}"
        elif self._begun and self.path.exists():
            kept = f"; the rows until then are in {self.path}"
        return InputError(f"{self.path}: the recorder {reason}{kept}")

    def _close_pipe(self) -> None:
        if self._pipe >= 0:
            os.close(self._pipe)
            self._pipe = -1

    def _release(self) -> None:
        """A recorder that is still at work ends by itself once the pipe is closed."""
        self._close_pipe()
        if self._process.stdout is not None:
            self._process.stdout.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout=1.0)
