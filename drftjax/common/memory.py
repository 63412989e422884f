"""How much memory a piece of a computation may take."""

from pathlib import Path

import jax

# A piece takes this share of what is free, as several things are held of it at once, and no less
# than so many bytes.
SHARE, LEAST = 1 / 16, 1e7


MEMINFO = Path("/proc/meminfo")


# Of a container: what it may take, and what it takes.
GROUP = Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory.current")


def piece_bytes(most: float) -> float:
    """Bytes of one piece: a share of the memory that is free, `most` at most."""
    free = free_bytes()
    return most if free is None else max(LEAST, min(most, SHARE * free))


def free_bytes() -> float | None:
    """Free memory of the accelerator that computes, else of the machine or container.

    None where nothing tells it.
    """
    device = jax.devices()[0]
    told = None if device.platform == "cpu" else device.memory_stats()
    if told is not None and "bytes_limit" in told:
        return float(told["bytes_limit"] - told.get("bytes_in_use", 0))
    known = [each for each in (_of_machine(), _of_container()) if each is not None]
    return min(known, default=None)


def _of_machine() -> float | None:
    """What programs can still have [bytes], as Linux tells it."""
    try:
        lines = MEMINFO.read_text().splitlines()
    except OSError:
        return None
    found = [each.split()[1] for each in lines if each.startswith("MemAvailable:")]
    return 1024 * float(found[0]) if found else None


def _of_container() -> float | None:
    """What its control group leaves [bytes]; None where it sets no limit ("max")."""
    try:
        limit, taken = (each.read_text().strip() for each in GROUP)
        return max(0.0, float(limit) - float(taken))
    except (OSError, ValueError):
        return None
