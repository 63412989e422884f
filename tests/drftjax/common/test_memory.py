"""Pieces of a computation are as large as memory allows, and draw the same whatever their size."""

from functools import partial

import numpy as np
import pytest

from drftjax.common import memory
from drftjax.common.memory import CHUNK_MEMORY, ChunkMemory, chunk_bytes, free_bytes
from identify.fit_constant import fit
from identify.parameters.parameter import own
from identify.uncertainty.bootstrap import noise_chunks
from tests.helpers.synthetic_runs import SLOW, coarse, recorded, setup_of

MEMINFO = "MemTotal:  8000 kB\nMemFree:  100 kB\nMemAvailable:  4000 kB\n"
# Sums over other numbers of draws at once may round otherwise.
ROUNDING = 1e-9


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A machine with 4,000 kB free, and files that say what its container may take."""
    group = tmp_path / "memory.max", tmp_path / "memory.current"
    monkeypatch.setattr(memory, "MEMINFO", tmp_path / "meminfo")
    monkeypatch.setattr(memory, "GROUP", group)
    (tmp_path / "meminfo").write_text(MEMINFO)
    return group


def test_free_memory_is_what_machine_and_container_leave(machine):
    assert free_bytes() == 4000 * 1024
    for limit, left in (("max\n", 4000 * 1024), ("3000000\n", 1e6), ("1000000\n", 0.0)):
        machine[0].write_text(limit)
        machine[1].write_text("2000000\n")
        assert free_bytes() == left
    memory.MEMINFO.unlink()
    machine[0].write_text("max\n")
    assert free_bytes() is None
    assert chunk_bytes(1e8) == 1e8


def test_a_piece_is_a_share_of_what_is_free(monkeypatch):
    for free, piece in ((0.0, CHUNK_MEMORY.minimum), (8e8, 5e7), (1e12, 1e8)):
        monkeypatch.setattr(memory, "free_bytes", lambda free=free: free)
        assert chunk_bytes(1e8) == piece
    assert chunk_bytes(1e12, ChunkMemory(share=0.5)) == 5e11


def test_pieces_of_any_size_draw_the_same(monkeypatch):
    runs = [
        coarse(f"run {number}", recorded(setup_of(SLOW, 0.75), seed=number)) for number in range(2)
    ]
    result = fit(runs, [own("zeta")])
    found, pieces = [], []
    small = partial(chunk_bytes, settings=ChunkMemory(minimum=1.0))
    monkeypatch.setattr("identify.uncertainty.bootstrap.chunk_bytes", small)
    for free in (1e12, 0.0):
        monkeypatch.setattr(memory, "free_bytes", lambda free=free: free)
        random = np.random.default_rng(2)
        pieces.append([len(each) for each in noise_chunks(result.estimate, 45, random)])
        found.append(result.bootstrap(45, seed=2).bootstraps[0])
    assert pieces == [[45], [20, 20, 5]]
    np.testing.assert_allclose(found[0].draws, found[1].draws, rtol=ROUNDING)
    for name, channels in found[0].bands.items():
        for channel, band in channels.items():
            other = found[1].bands[name][channel]
            np.testing.assert_allclose(band, other, rtol=0, atol=ROUNDING)
