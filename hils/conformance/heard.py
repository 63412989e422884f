"""Frames of a rig with the times at which they came, and what they tell together."""

from typing import NamedTuple

from hils.link.messages import READY, Frame, Measurement, Message, RigState, StateReport


class Heard(NamedTuple):
    """A frame of the rig's, and when it came [s]."""

    frame: Frame
    time: float

    @property
    def message(self) -> Message:
        """The frame's message."""
        return self.frame.message

    @property
    def state(self) -> RigState | None:
        """State that it tells, of HELLO_ACK, MEAS and STATE."""
        return getattr(self.frame.message, "state", None)


def is_ready(each: Heard) -> bool:
    """True for a STATE or MEAS that says ARMED or RUNNING."""
    return isinstance(each.message, StateReport | Measurement) and each.state in READY


def is_safe(each: Heard) -> bool:
    """True for a frame that says SAFE."""
    return each.state is RigState.SAFE


def measurements(heard: list[Heard]) -> list[tuple[Heard, Measurement]]:
    """The MEAS among frames."""
    return [(each, each.message) for each in heard if isinstance(each.message, Measurement)]


def omegas(heard: list[Heard]) -> list[float]:
    """Angular velocities that are measured [rad/s], those that are no number left out."""
    return [meas.omega for _, meas in measurements(heard) if meas.omega == meas.omega]


def state_names(heard: list[Heard]) -> str:
    """The states that frames tell, each change once."""
    names = [each.state.name for each in heard if each.state is not None]
    changes = [name for place, name in enumerate(names) if names[place - 1 : place] != [name]]
    return ", ".join(changes) or "no state"
