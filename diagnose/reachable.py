"""The part of a gap that could go: what lies above the noise floor."""

# A gap that exceeds its floor by less than this share of it cannot be said to shrink.
LEAST_REACHABLE = 0.5


def can_shrink(before: float, floor: float) -> bool:
    """Whether a gap lies far enough above its floor, both in one unit."""
    return before - floor > LEAST_REACHABLE * floor


def gone(before: float, after: float, floor: float) -> float:
    """Share of a gap above its floor that is gone [-], -1 at least; zero where none is above it."""
    reachable = before - floor
    if reachable <= 0:
        return 0.0
    return max(-1.0, (before - max(after, floor)) / reachable)
