"""Run log written row by row, readable at any time and after a kill.

The file is kept in HDF5's single-writer-multiple-readers mode, so that it is consistent on disk
after each flush. `/n_committed` is written after the rows that it counts. When the recording is
finished, its rows become an ordinary run log under the final name, put in place atomically; until
then they stay where they are.
"""

import os
from dataclasses import replace
from pathlib import Path
from typing import Final

import h5py
import numpy as np
from numpy.typing import NDArray

from drftjax.common.errors import InputError
from drftjax.common.output_files import put_new_file
from drftjax.runlog import recording_lock
from drftjax.runlog.content import Attribute
from drftjax.runlog.hdf5.checksum import with_checksum
from drftjax.runlog.hdf5.conversion import flag_table, online_attributes
from drftjax.runlog.hdf5.examination import require_readable
from drftjax.runlog.hdf5.reading import COMMITTED, GROUPS, SIZE_LIMIT, survey_recording
from drftjax.runlog.hdf5.writing import image, put_attributes, scale_rows
from drftjax.runlog.header import Head
from drftjax.runlog.recording_lock import RESERVE, require_room
from drftjax.runlog.schema import AXES, SCHEMA, SCHEMA_VERSION, TEXTS, Column

ROWS_IN_CHUNK: Final = 512
"""Rows that a kill within a write can reach: a chunk of float64 is a page of memory."""


class Recording:
    """Run log while it is recorded; used by one thread.

    Attributes:
        part: Path of the recording, until it is finished.
        rows: Number of committed rows by group.
    """

    def __init__(self, part: Path, claimed: int, head: Head):
        """Create the file, with a header and no rows.

        Args:
            part: Path of the recording.
            claimed: Descriptor from `recording_lock.claim_file`; closed when the recording ends.
            head: Header of the run log.

        Raises:
            InputError: there is no room for it, or the claimed file no longer exists.
            OSError: it cannot be created.
        """
        self.part = part
        # HDF5 keeps a descriptor of its own; this one is for the lock, and to sync by.
        self._handle = claimed
        self.rows = dict.fromkeys(_groups(head), 0)
        self._waiting: dict[str, list[NDArray[np.float64]]] = {each: [] for each in self.rows}
        self._waiting_bytes = self._written_bytes = 0
        if recording_lock.place_of(claimed, part) != part:
            raise InputError(f"{part} was moved or removed before the first row")
        self._require_room_for_rows()
        self._file = h5py.File(part, "w", libver=("v110", "v110"))
        self._columns = {each: _make_group(self._file, each, head) for each in self.rows}
        self._committed = self._file.create_dataset(
            COMMITTED, (len(GROUPS),), "<u8", chunks=(len(GROUPS),), fletcher32=True
        )
        put_attributes(self._committed, {"units": "1", "groups": " ".join(GROUPS)})
        put_attributes(self._file.create_group("setup"), head.setup.known())
        put_attributes(self._file, _root_attributes(head))
        self._file.swmr_mode = True
        self._write_committed()
        recording_lock.hold_lock(claimed, part)  # HDF5 let go of it when it opened the file

    def append(self, title: str, rows: NDArray[np.float64]) -> None:
        """Take rows of one group, shape (rows, columns), columns as in `Head.columns`."""
        self._waiting[title].append(rows)
        self._waiting_bytes += rows.nbytes

    def commit(self) -> None:
        """Write the waiting rows; from then on a kill of this process does not lose them.

        Raises:
            InputError: there is no room for them, or the file was removed; nothing was written.
        """
        if not self._waiting_bytes:
            return
        if not os.fstat(self._handle).st_nlink:
            raise _removed(self.part)
        self._require_room_for_rows()
        for title, blocks in self._waiting.items():
            if blocks:
                self._write(title, np.concatenate(blocks))
                blocks.clear()
        self._written_bytes += self._waiting_bytes
        self._waiting_bytes = 0
        self._file.flush()
        self._write_committed()

    def sync(self) -> None:
        """Wait until the committed rows are on the disk itself; may be called by any thread."""
        os.fsync(self._handle)

    def finish(self, path: Path, end_reason: str) -> None:
        """Make an ordinary run log of the committed rows, and remove the recording.

        Args:
            path: Final name.
            end_reason: Reason why the run ended.

        Raises:
            InputError: the rows are no valid run log, cannot be written, or the final name is
                taken; the recording is kept. Or it was moved: the run log then lies beside it, as
                the message says. Or it was removed.
        """
        place = self._close()
        if place is None:
            raise _removed(self.part)
        moved = place != self.part
        content, violations = survey_recording(place)
        content = require_readable(content, violations)
        attributes = {**content.attributes, "complete": 1, "end_reason": end_reason}
        whole = with_checksum(image(replace(content, attributes=attributes), AXES))
        final = place.with_name(path.name) if moved else path
        try:
            put_new_file(final, whole)
        except InputError as error:
            if moved:
                mended = f"drft log repair {place}{' -o ANOTHER.h5' if final.exists() else ''}"
                raise InputError(f"{error}; its rows are kept: {mended}") from error
            raise
        place.unlink()
        if moved:
            raise InputError(f"{self.part} was moved while it was recorded; the run log is {final}")

    def drop(self) -> None:
        """Close and remove the file."""
        place = self._close()
        if place is not None:
            place.unlink()

    def _close(self) -> Path | None:
        """Close the file, and return its present path; None where it was removed."""
        self._file.close()
        try:
            return recording_lock.place_of(self._handle, self.part)
        finally:
            os.close(self._handle)

    def _write(self, title: str, rows: NDArray[np.float64]) -> None:
        """Append rows to the datasets of a group."""
        start = self.rows[title]
        end = start + len(rows)
        for column, dataset in enumerate(self._columns[title]):
            dataset.resize((end,))
            dataset[start:end] = rows[:, column]
        self.rows[title] = end

    def _write_committed(self) -> None:
        """Write the numbers of committed rows."""
        self._committed[:] = [self.rows.get(title, 0) for title in GROUPS]
        self._file.flush()

    def _require_room_for_rows(self) -> None:
        """Refuse to go on without room for the waiting rows and the finished file beside them."""
        new = 2 * self._waiting_bytes + RESERVE
        written = self._written_bytes + self._waiting_bytes
        require_room(self._handle, new + written)
        import resource  # here, as not every system has it

        limit, _ = resource.getrlimit(resource.RLIMIT_FSIZE)
        if limit != resource.RLIM_INFINITY and limit < os.fstat(self._handle).st_size + new:
            raise InputError(f"a file may not grow past {limit / 2**20:.1f} MiB here")
        if written > SIZE_LIMIT:
            raise InputError(f"the run log has {SIZE_LIMIT / 2**20:.0f} MiB, the most it may have")


def _removed(part: Path) -> InputError:
    """Error for a recording that was removed."""
    return InputError(f"{part} was removed while it was recorded; nothing is left of it")


def _groups(head: Head) -> list[str]:
    """Groups that a recording has."""
    return [each for each in GROUPS if each != "online" or head.online is not None]


def _root_attributes(head: Head) -> dict[str, Attribute]:
    """Attributes of the root of a recording."""
    texts = {name: getattr(head, name, None) for name in TEXTS}
    return {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "source": head.source,
        "title": head.title,
        **{name: text for name, text in texts.items() if text is not None},
        "complete": 0,
        "end_reason": "still being recorded, or cut off",
    }


def _make_group(file: h5py.File, title: str, head: Head) -> list[h5py.Dataset]:
    """Create an empty group; its datasets in the order of a row."""
    node = file.create_group(title)
    more: dict[str, dict[str, Attribute]] = {"code": flag_table("flag_values", head.event_meanings)}
    if title == "online" and head.online is not None:
        put_attributes(node, online_attributes(head.online))
        more["flags"] = flag_table("flag_masks", head.online.flag_meanings)
    columns = head.columns(title)
    made = [_make_column(node, each, more.get(each.name, {})) for each in columns]
    scale_rows(node, columns[0].name)
    return made


def _make_column(
    node: h5py.Group, column: Column, attributes: dict[str, Attribute]
) -> h5py.Dataset:
    # No packing and no shuffling: a chunk that grows is written again in its place, its first
    # bytes unchanged.
    """Create an empty dataset that can grow."""
    made = node.create_dataset(
        column.name,
        (0,),
        np.dtype(column.dtype).newbyteorder("<"),
        maxshape=(None,),
        chunks=(ROWS_IN_CHUNK,),
        fletcher32=True,
    )
    put_attributes(made, {"units": column.unit, **attributes})
    return made
