"""Damaged files, lost readers, full disks: no hang, no crash, no wrong data, no half file."""

import errno
import os
import random
import re
import resource
import time
from collections.abc import Callable
from pathlib import Path

import h5py
import pytest

from drftjax.common.errors import InputError
from drftjax.runlog import safe_reader
from drftjax.runlog.check import check_file, read_run_guarded
from drftjax.runlog.content import Level
from drftjax.runlog.hdf5.api import read_run, write_run
from drftjax.runlog.hdf5.conversion import run_from_survey
from drftjax.runlog.record import RunLog
from drftjax.runlog.safe_reader import GuardedReader
from tests.helpers.run_logs import example_run, flattened

SEALED_FLIPS = 400
# Each costs a survey in the child; the few that hang the library cost the time limit and a new
# child. An ordinary file takes a few ms, so that the limit is not reached by a busy machine.
UNSEALED_FLIPS = 250
TIME_LIMIT_S = 3.0


def flipped(data: bytes, number: int) -> bytes:
    """One random byte set to another value; the same each time for one number."""
    dice = random.Random(number)
    changed = bytearray(data)
    changed[dice.randrange(len(data))] ^= dice.randrange(1, 256)
    return bytes(changed)


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("good") / "run.h5"
    write_run(path, example_run())
    return path


def unsealed(path: Path) -> bytes:
    """The file as another program would have written it."""
    return path.read_bytes()[:-20]


def test_a_flipped_byte_is_noticed_or_without_effect(good, tmp_path):
    data, path = good.read_bytes(), tmp_path / "run.h5"
    right, refused = flattened(read_run(good)), 0
    for number in range(SEALED_FLIPS):
        path.write_bytes(flipped(data, number))
        found = read_or_refusal(lambda: read_run(path))
        if isinstance(found, str):
            assert found.startswith(f"{path}: is damaged")
            refused += 1
        else:
            assert flattened(found) == right, number
    # All but the 8 bytes of the seal's mark are guarded by it.
    assert refused > 0.99 * SEALED_FLIPS


def test_a_flipped_byte_without_a_seal_changes_no_number(good, tmp_path):
    # Text has no checksum in HDF5, so it is left out here; the seal is there for it.
    data, path = unsealed(good), tmp_path / "run.h5"
    texts = ("title", "source", "created", "run_id", "notes", "software", "events.meanings")
    right = numbers(read_run(good), texts)
    refused, slowest = 0, 0.0
    with GuardedReader(TIME_LIMIT_S) as reader:
        for number in range(UNSEALED_FLIPS):
            path.write_bytes(flipped(data, number))
            start = time.monotonic()
            surveyed = reader.survey(path)
            slowest = max(slowest, time.monotonic() - start)
            found = read_or_refusal(lambda surveyed=surveyed: run_from_survey(*surveyed))
            if isinstance(found, str):
                assert str(path) in found
                refused += 1
            else:
                assert numbers(found, texts) == right, number
    assert slowest < 2 * TIME_LIMIT_S
    # The rows alone are about a fifth of this small file, and fletcher32 guards them.
    assert refused > 0.2 * UNSEALED_FLIPS


def read_or_refusal(read: Callable[[], RunLog]) -> RunLog | str:
    try:
        return read()
    except InputError as error:
        return str(error)


def numbers(run: object, texts: tuple[str, ...]) -> dict[str, object]:
    return {name: each for name, each in flattened(run).items() if not name.startswith(texts)}


def test_the_seal_is_cut_off_by_a_program_that_edits_the_file(good, tmp_path):
    path = tmp_path / "run.h5"
    path.write_bytes(good.read_bytes())
    with h5py.File(path, "r+") as file:
        file["measured/z"][0] = -0.5
    assert read_run(path).measured.z[0] == -0.5


@pytest.mark.parametrize(
    ("deed", "limit", "reason"),
    [
        ("import time; time.sleep(60)", 0.5, "could not be read in 0.5 s"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", 60, r"crashed .*\(SIGSEGV\)"),
        ("import os; os._exit(3)", 60, "ended with code 3"),
        (
            "from drftjax.runlog import safe_reader\n"
            "safe_reader._limit_memory()\n"
            "try: bytes(5 * 2**30)\n"
            "except MemoryError: raise SystemExit(7)",
            60,
            "ended with code 7",
        ),
    ],
    ids=["hangs", "crashes", "leaves", "wants memory"],
)
def test_a_reader_that_is_lost_is_reported_and_replaced(good, monkeypatch, deed, limit, reason):
    honest = safe_reader._START
    root = Path(safe_reader.__file__).parents[2]
    with GuardedReader(limit) as reader:
        monkeypatch.setattr(
            safe_reader, "_START", f"import sys; sys.path.append({str(root)!r}); {deed}"
        )
        content, (violation,) = reader.survey(good)
        assert content is None
        assert re.search(reason, violation.reason)
        assert violation.level is Level.REFUSED
        monkeypatch.setattr(safe_reader, "_START", honest)
        reader._time_limit = 20.0
        assert reader.survey(good)[1] == []


def test_a_compression_bomb_is_refused_by_its_declared_size(tmp_path):
    path = tmp_path / "run.h5"
    write_run(path, example_run())
    with h5py.File(path, "r+") as file:
        how = {"chunks": (2**20,), "compression": "gzip", "dtype": "i1", "fillvalue": 0}
        file.create_dataset("measured/bomb", (10**9,), **how)
    assert "declares" in check_file(path)[0].reason
    with pytest.raises(InputError, match="declares"):
        read_run_guarded(path)


@pytest.fixture
def old(tmp_path) -> Path:
    path = tmp_path / "run.h5"
    write_run(path, example_run(rows=20))
    return path


def test_a_full_disk_leaves_the_old_file_whole_and_nothing_else(old):
    before = old.read_bytes()
    _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) // 2, hard))
    try:
        with pytest.raises(InputError, match=r"run\.h5 cannot be written: file too large"):
            write_run(old, example_run())
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
    assert old.read_bytes() == before
    assert list(old.parent.iterdir()) == [old]


@pytest.mark.parametrize(
    "error", [OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt()]
)
def test_a_write_that_fails_at_the_end_leaves_the_old_file_whole(old, monkeypatch, error):
    before = old.read_bytes()

    def fail(handle: int) -> None:
        raise error

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises((InputError, KeyboardInterrupt)) as caught:
        write_run(old, example_run())
    if isinstance(error, OSError):
        assert str(caught.value) == f"{old} cannot be written: no space left on device"
    assert old.read_bytes() == before
    assert list(old.parent.iterdir()) == [old]


def test_a_place_that_takes_no_file_is_named(tmp_path):
    run = example_run()
    with pytest.raises(InputError, match="there is no folder"):
        write_run(tmp_path / "nowhere" / "run.h5", run)
    with pytest.raises(InputError, match="not an ordinary file"):
        write_run(tmp_path, run)
    with pytest.raises(InputError, match="not an ordinary file"):
        write_run("/dev/full", run)
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="no folder"):
        write_run(tmp_path / "file" / "run.h5", run)
