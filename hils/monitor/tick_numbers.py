"""Numbers of one tick, as they are streamed to another program."""

from typing import Final, NamedTuple


class TickNumber(NamedTuple):
    """One number of a tick.

    Attributes:
        unit: Of the number; "1" for none.
        meaning: In a few words.
    """

    unit: str
    meaning: str


TICK_NUMBERS: Final = {
    "timestamp": TickNumber("s", "time of day when it was sent, since 1970"),
    "time": TickNumber("s", "time in the run"),
    "zeta": TickNumber("1", "scaling factor in use"),
    "sinkage_measured": TickNumber("m", "sinkage of the newest reading"),
    "sinkage_simulated": TickNumber("m", "simulated sinkage"),
    "x_measured": TickNumber("m", "travel of the newest reading, where the rig measures it"),
    "x_simulated": TickNumber("m", "simulated travel"),
    "omega_commanded": TickNumber("rad/s", "angular velocity commanded"),
    "omega_measured": TickNumber("rad/s", "angular velocity measured, where the rig measures it"),
    "vx_commanded": TickNumber("m/s", "carriage speed commanded"),
    "vx_simulated": TickNumber("m/s", "simulated carriage speed"),
    "fx": TickNumber("N", "simulated force of the sand along x"),
    "fz": TickNumber("N", "simulated force of the sand along z"),
    "flags": TickNumber("1", "bits of /online/flags in the run log"),
    "age": TickNumber("s", "age of the newest reading"),
    "late": TickNumber("s", "time over the deadline"),
}
"""All of them, in their order. One that is not known on a tick is left out of its message."""


def json_schema() -> dict[str, object]:
    """JSON schema of a tick's message."""
    return {
        "type": "object",
        "title": "Tick",
        "properties": {
            name: {"type": "number", "description": f"{each.meaning} [{each.unit}]"}
            for name, each in TICK_NUMBERS.items()
        },
    }
