"""Frames of a rig with the times at which they came, and what they tell together."""

from typing import NamedTuple

from hils.link.messages import READY, Frame, Measurement, Message, RigState, StateReport


class ReceivedFrame(NamedTuple):
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


def is_ready(each: ReceivedFrame) -> bool:
    """True for a STATE or MEAS that says ARMED or RUNNING."""
    return isinstance(each.message, StateReport | Measurement) and each.state in READY


def is_safe(each: ReceivedFrame) -> bool:
    """True for a frame that says SAFE."""
    return each.state is RigState.SAFE


def measurements(heard: list[ReceivedFrame]) -> list[tuple[ReceivedFrame, Measurement]]:
    """The MEAS among frames."""
    return [(each, each.message) for each in heard if isinstance(each.message, Measurement)]


def omegas(heard: list[ReceivedFrame]) -> list[float]:
    """Angular velocities that are measured [rad/s], those that are no number left out."""
    return [meas.omega for _, meas in measurements(heard) if meas.omega == meas.omega]


def state_names(heard: list[ReceivedFrame]) -> str:
    """The states that frames tell, each change once."""
    names = [each.state.name for each in heard if each.state is not None]
    changes = [name for place, name in enumerate(names) if names[place - 1 : place] != [name]]
    return ", ".join(changes) or "no state"
