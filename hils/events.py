"""Codes in a run log's /events and bits in the flags of its /online.

A code, once given, keeps its meaning: run logs outlive the program that wrote them. Both tables
stand in each file, as `flag_values` and `flag_masks` beside `flag_meanings`.
"""

import enum
from collections.abc import Mapping
from enum import IntEnum, IntFlag
from typing import Final


class Event(IntEnum):
    """Events beside the ticks. `arg` is the number that goes with one, 0 where none does."""

    # The procedure.
    CONNECTED = 1  # arg: the rig's boot_id
    TOUCHED_DOWN = 2  # arg: the height at touch-down before zeroing [counts]
    ARMED = 3
    SETTLED = 5  # arg: the sinkage at rest [m]
    STARTED = 6  # arg: zeta at the start [-]
    PROFILE_ENDED = 7
    RAMPED_DOWN = 8
    STOP_SENT = 9
    DISCONNECTED = 10
    # The loop.
    OVERRUN = 20  # arg: time over the deadline [s]
    TICKS_SKIPPED = 21  # arg: how many
    HOST_SLEPT = 25  # arg: time for which the host's computer slept during the run [s]
    # Readings and commands.
    READING_REFUSED = 30  # arg: the height read [m], or the travel where that jumped
    READINGS_REFUSED_IN_A_ROW = 31  # arg: how many
    SENSOR_STUCK = 32  # arg: for how long [s]
    SENSOR_MOVES_AGAIN = 33
    READINGS_STALE = 34  # arg: age of the newest, or of the command that it answers [s]
    COMMAND_LIMITED = 35  # arg: the carriage speed that was asked for [m/s]
    DRIVE_OFF = 36  # arg: measured minus commanded omega [rad/s]
    DRIVE_FOLLOWS = 37
    X_STUCK = 38  # arg: for how long, while the carriage was driven [s]
    X_MOVES_AGAIN = 39
    # The rig and the wire.
    RIG_STATE = 40  # arg: the state
    RIG_FAULT = 41  # arg: the fault's number
    RIG_RESET = 42  # arg: the new boot_id
    EMERGENCY_STOP = 43  # arg: the reason's number
    FRAMES_DROPPED = 44  # arg: how many since the last such event
    RIG_CLOCK_JUMPED = 45  # arg: by how much, against the host's clock [s]
    # What the rig measures, against what was commanded (hils.control.safety).
    RUNAWAY = 70  # arg: the angular velocity measured [rad/s]
    DRIVE_DEVIATES = 71  # arg: the same
    MOVES_AT_REST = 72  # arg: angular velocity [rad/s] or travel [m] measured
    NOT_SLOWING = 73  # arg: the angular velocity measured after STOP [rad/s]
    CARRIAGE_DEVIATES = 74  # arg: the speed measured [m/s]
    STAYS_STUCK = 75  # arg: for how long [s]
    READINGS_TOO_OLD = 76  # arg: age of the newest [s]
    ZETA_DOUBTED = 77  # arg: zeta(0) by statics [-]
    SIMULATION_JUMPS = 78  # arg: change of the simulated height [m]
    SPEED_DOUBTED = 79  # arg: the carriage speed that was asked for [m/s]
    ZETA_AT_BOUND = 80  # arg: the bound [-]
    OMEGA_LOST = 81  # omega is no longer measured; its last value stands in the log
    # What ended the run early.
    LINK_LOST = 50
    INTERRUPTED = 51  # arg: the signal's number
    STOP_ASKED = 52  # arg: the signal's number
    FAILED = 53
    DIVERGED = 54  # arg: the simulated height [m]
    # The recorder's own.
    ROW_NOT_FINITE = 60  # arg: 1 a command, 2 a measurement; the row is left out


# What a person must look at though the run may have gone on.
FINDINGS: Final = frozenset(
    {each for each in Event if 70 <= each < 81} | {Event.SENSOR_STUCK, Event.X_STUCK}
)


class TickFlag(IntFlag):
    """Bits of the flags of one tick."""

    FRESH = 1 << 0  # a reading not seen before had come: the next row of /measured
    REFUSED = 1 << 1  # it was refused, so zeta was held
    STUCK = 1 << 2  # the sensor counts as stuck
    LATE = 1 << 3  # the deadline was missed
    SKIPPED = 1 << 4  # ticks before this one were skipped
    LIMITED = 1 << 5  # a command was held back by a limit
    RAMPING = 1 << 6  # past the profile, ramping down to rest
    OLD = 1 << 7  # the reading answers a command too old to tune by, so zeta was held
    DRIVE_OFF = 1 << 8  # the wheel does not turn as commanded
    X_STUCK = 1 << 9  # x stands still though the carriage is driven
    HELD = 1 << 10  # zeta was held: the wheel stands, z is stuck or zeta is at a bound
    NOT_FINITE = 1 << 31  # a number of this row was not finite; 0 stands for it


EVENT_MEANINGS: Final[Mapping[int, str]] = {int(each): str(each.name).lower() for each in Event}


"""The code table of /events."""


FLAG_MEANINGS: Final[Mapping[int, str]] = {int(each): str(each.name).lower() for each in TickFlag}


"""The bits of /online/flags."""


class Phase(enum.Enum):
    """Phase of a run."""

    CHECKING = "checking"
    SETTLING = "settling on the sand"
    COUNTDOWN = "countdown"
    RUNNING = "running"
    RAMPING = "ramping down"
    STOPPING = "coming to rest"
    CLOSING = "closing the file"
