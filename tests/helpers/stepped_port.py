"""A port to a rig in virtual time."""

from drftjax.common.errors import InputError
from hils.clock import VirtualClock
from hils.link.link import SteppedRig
from hils.link.ports import AbstractPort

GRAIN = 1e-3


class SteppedPort(AbstractPort):
    """The port of a rig that is advanced in time: waiting on it is what lets time pass."""

    def __init__(self, rig: SteppedRig, clock: VirtualClock):
        self._rig, self._clock, self._came = rig, clock, b""
        self.lost = False

    @property
    def name(self) -> str:
        return "the stepped rig"

    def read(self, limit: int) -> bytes:
        self._exchange(b"")
        data, self._came = self._came[:limit], self._came[limit:]
        return data

    def write(self, data: bytes) -> int:
        self._exchange(data)
        return len(data)

    def wait(self, readable: bool, writable: bool, deadline: float) -> None:
        while not (writable or self._came) and self._clock.now() < deadline:
            self._clock.sleep_until(min(deadline, self._clock.now() + GRAIN))
            self._exchange(b"")

    def wake(self) -> None:
        pass

    def close(self) -> None:
        self.lost = True

    def _exchange(self, data: bytes) -> None:
        if self.lost:
            raise InputError("the port is closed")
        self._came += self._rig.advance(self._clock.now(), data)
