"""The units in which a diagnosis is told."""

CHANNEL_UNITS = {"x": ("mm", 1e3), "z": ("mm", 1e3), "fx": ("N", 1.0), "fz": ("N", 1.0)}
TORQUE = ("N m", 1.0)


def shown(channel: str) -> tuple[str, float]:
    """Unit that a channel is told in, and how many of it make one of SI."""
    return CHANNEL_UNITS.get(channel, TORQUE)
