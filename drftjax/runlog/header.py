"""Header of a run log: all that is known of a run before its first row."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from drftjax.common.errors import InputError
from drftjax.runlog import validation as rules
from drftjax.runlog.record import SENSORS, RecordedSetup
from drftjax.runlog.schema import COLUMNS, Column


@dataclass(frozen=True, kw_only=True)
class OnlineHead:
    """Numbers of a control loop that hold for a whole run.

    Attributes:
        tick: Control period [s].
        zeta_step: Change of zeta in one tuning step [-].
        tolerance: Largest sinkage error at which zeta is not changed [m].
        loop: Inputs and settings of the loop as JSON, from which the run can be replayed; None
            where they are not kept.
        flag_meanings: Word for each bit of the flags.
    """

    tick: float
    zeta_step: float
    tolerance: float
    loop: str | None = None
    flag_meanings: Mapping[int, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Head:
    """Run log without its rows.

    Attributes:
        setup: Set-up of the rig as stated by the operator.
        source: Origin of the run, such as "measured" or "virtual rig".
        title: Title for people.
        channels: Channels of /measured: some of x, z, fx, fz, torque, omega, in a row's order.
        driven: True where the carriage is driven, so that /command has vx.
        online: Numbers of the control loop; None where there is none.
        event_meanings: Words for each code of /events.
        created, run_id, notes, software, software_version: As in `RunLog`.

    Raises:
        InputError: the source or a channel is unknown.
    """

    setup: RecordedSetup
    source: str
    title: str
    channels: tuple[str, ...] = ("x", "z")
    driven: bool = False
    online: OnlineHead | None = None
    event_meanings: Mapping[int, str] = field(default_factory=dict)
    created: str | None = None
    run_id: str | None = None
    notes: str | None = None
    software: str | None = None
    software_version: str | None = None

    def __post_init__(self) -> None:
        for sentence in rules.source_problems(self.source):
            raise InputError(sentence)
        known = [each for each in SENSORS if each in self.channels]
        if not known or len(known) != len(self.channels):
            raise InputError(
                f"channels are {', '.join(self.channels) or 'none'}, they must be some of "
                f"{', '.join(SENSORS)}"
            )

    def columns(self, title: str) -> tuple[Column, ...]:
        """Columns of one row of a group while the run is recorded, in the order of its values."""
        if title == "measured":
            by_name = {each.name: each for each in COLUMNS[title]}
            return tuple(by_name[name] for name in ("time", *self.channels))
        if title == "command" and not self.driven:
            return tuple(each for each in COLUMNS[title] if each.name != "vx")
        return COLUMNS[title]
