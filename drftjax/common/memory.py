"""Bytes of memory that one chunk of a computation may use."""

from dataclasses import dataclass
from pathlib import Path

import jax


@dataclass(frozen=True)
class ChunkMemory:
    """Size of one chunk, by the memory that is free.

    Attributes:
        share: Share of the free memory: several arrays of a chunk's size exist at once.
        minimum: Smallest chunk [bytes]: smaller ones save nothing beside the program itself.
    """

    share: float = 1 / 16
    minimum: float = 1e7


CHUNK_MEMORY = ChunkMemory()

MEMINFO = Path("/proc/meminfo")

GROUP = Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory.current")
"""Limit and use of the memory of a container."""


def chunk_bytes(maximum: float, settings: ChunkMemory = CHUNK_MEMORY) -> float:
    """Bytes that one chunk may use: a share of the free memory, and at most `maximum`."""
    free = free_bytes()
    if free is None:
        return maximum
    return max(settings.minimum, min(maximum, settings.share * free))


def free_bytes() -> float | None:
    """Free memory [bytes] of the accelerator in use, else of the machine or container.

    None where the system does not report it.
    """
    device = jax.devices()[0]
    stats = None if device.platform == "cpu" else device.memory_stats()
    if stats is not None and "bytes_limit" in stats:
        return float(stats["bytes_limit"] - stats.get("bytes_in_use", 0))
    known = [each for each in (_of_machine(), _of_container()) if each is not None]
    return min(known, default=None)


def _of_machine() -> float | None:
    """Memory that programs can still allocate [bytes], as reported by Linux."""
    try:
        lines = MEMINFO.read_text().splitlines()
    except OSError:
        return None
    found = [each.split()[1] for each in lines if each.startswith("MemAvailable:")]
    return 1024 * float(found[0]) if found else None


def _of_container() -> float | None:
    """Memory that the control group still allows [bytes]; None where it sets no limit ("max")."""
    try:
        limit, taken = (each.read_text().strip() for each in GROUP)
        return max(0.0, float(limit) - float(taken))
    except (OSError, ValueError):
        return None
