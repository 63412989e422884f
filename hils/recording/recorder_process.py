"""The recorder: a process that takes rows from a pipe, writes them, and does nothing else.

It answers on its standard output, a line of JSON each: ["ready", ""], ["begun", ""],
["closed", ""] or ["failed", reason]. When the pipe ends without an end, the host is gone, and it
finishes the file with what it has.
"""

import contextlib
import json
import os
import signal
import sys
import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from drftjax.common.errors import InputError
from drftjax.runlog.hdf5.recording import Recording
from drftjax.runlog.recording_lock import claim_file, part_path, release_claim, require_place
from hils.recording.row_stream import Kind, RowStream
from hils.recording.sanitize import Rows, RowSanitizer

HOST_GONE: Final = "the control program ended without closing the recording"


_BLOCK: Final = 2**20


@dataclass(frozen=True)
class WriterSettings:
    """Rhythm of the writing.

    Attributes:
        poll_interval: From one look into the pipe to the next [s].
        commit_interval: From one commit of the rows to the next [s]; so much may be lost with a
            kill of both processes.
        sync_interval: From one sync of the disk to the next [s]; so much may be lost with the
            power.
    """

    poll_interval: float = 0.02
    commit_interval: float = 0.25
    sync_interval: float = 1.0


DEFAULT_WRITER = WriterSettings()


class RecorderProcess:
    """Writes one run log."""

    def __init__(
        self, path: Path, rows: int, answers: int, settings: WriterSettings = DEFAULT_WRITER
    ):
        """Write nothing yet.

        Args:
            path: The run log's final name.
            rows: Descriptor of the pipe's reading end.
            answers: Descriptor that takes the answers.
            settings: Rhythm of the writing.
        """
        self._settings = settings
        self._path = path
        self._rows, self._answers = rows, answers
        self._stream = RowStream()
        self._sanitizer = RowSanitizer()
        self._claimed: int | None = None
        self._recording: Recording | None = None
        self._host = os.getppid()

    def run(self) -> None:
        """Record until the end has come."""
        try:
            reason = self._record()
        except Exception as error:
            # The host learns it from its next row, while the file is being finished.
            reason = f"stopped: {_sentence(error)}"
            self._answer("failed", reason)
            os.close(self._rows)
            try:
                self._finish(reason)
            except Exception as after:
                if _sentence(after) not in reason:
                    self._answer("failed", f"could not finish: {_sentence(after)}")
            return
        try:
            kept = self._finish(reason)
        except Exception as error:
            self._answer("failed", f"could not finish: {_sentence(error)}")
        else:
            self._answer("closed", "" if kept else "empty")

    def _record(self) -> str:
        """Write rows until the stream ends; the reason of its end."""
        os.set_blocking(self._rows, False)
        require_place(self._path)
        self._claimed = claim_file(self._path)
        self._answer("ready", "")
        commit_at = sync_at = time.monotonic()
        sync: Future[None] | None = None
        with ThreadPoolExecutor(1) as syncing:
            while True:
                going = self._write_rows()
                now = time.monotonic()
                if self._recording is not None and (now >= commit_at or not going):
                    self._recording.commit()
                    commit_at = now + self._settings.commit_interval
                    # In a thread, because a slow disk may take seconds.
                    if now >= sync_at and (sync is None or sync.done()):
                        _require_synced(sync)
                        sync = syncing.submit(self._recording.sync)
                        sync_at = now + self._settings.sync_interval
                if not going:
                    break
                time.sleep(self._settings.poll_interval)
        _require_synced(sync)
        return HOST_GONE if self._stream.end_reason is None else self._stream.end_reason

    def _write_rows(self) -> bool:
        """Write what is in the pipe; False when nothing will follow."""
        host_is_there = os.getppid() == self._host
        while True:
            try:
                data = os.read(self._rows, _BLOCK)
            except BlockingIOError:
                # A forked copy of the host may hold the pipe open after it.
                return host_is_there
            if not data:
                return False
            begun = self._stream.head is not None
            found = self._stream.feed(data)
            if not begun and self._stream.head is not None:
                assert self._claimed is not None
                part = part_path(self._path)
                self._recording = Recording(part, self._claimed, self._stream.head)
                self._answer("begun", "")
            for kind, rows in found.items():
                self._append(kind, rows)
            if self._stream.end_reason is not None:
                return False

    def _append(self, kind: Kind, rows: Rows) -> None:
        assert self._recording is not None
        sound, events = self._sanitizer.sanitize(kind, rows)
        title = kind.name.lower()
        if title in self._recording.rows and len(sound):
            self._recording.append(title, sound)
        if len(events):
            self._append(Kind.EVENTS, events)

    def _finish(self, reason: str) -> bool:
        """Close the file; False where there is nothing to keep."""
        recording = self._recording
        if recording is None:
            if self._claimed is not None:
                release_claim(self._claimed, self._path)
            return False
        if not recording.rows["command"] or not recording.rows["measured"]:
            recording.drop()
            return False
        recording.finish(self._path, reason)
        return True

    def _answer(self, word: str, reason: str) -> None:
        with contextlib.suppress(OSError):  # the host may be gone
            os.write(self._answers, json.dumps([word, reason]).encode() + b"\n")


def _require_synced(sync: Future[None] | None) -> None:
    """Raise what became of rows on their way to the disk, once that is known."""
    if sync is not None:
        try:
            sync.result()
        except OSError as error:
            cause = error.strerror or str(error)
            raise InputError(f"the disk did not take what was written: {cause}") from error


def _sentence(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def main() -> None:
    """Record what standard input brings into the run log that the first argument names."""
    for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(each, signal.SIG_IGN)  # the host closes the recording, or is gone
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    RecorderProcess(Path(sys.argv[1]), sys.stdin.fileno(), sys.stdout.fileno()).run()
