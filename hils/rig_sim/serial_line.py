"""The wire between host and virtual rig: bytes at a baud rate's pace, held by a USB adapter.

A USB-serial adapter hands what it has received to the computer when its packet is full or when its
latency timer rings (16 ms by default in FTDI's; 1 ms where udev sets it, 0 here for none). What
goes the other way is not held.
"""

import heapq
from dataclasses import dataclass

from hils.link.messages import BITS_PER_BYTE

# What an FTDI adapter's packet holds besides two status bytes.
ADAPTER_PACKET = 62


# What waits to be sent at most; a firmware's buffer is smaller still.
LARGEST_BACKLOG = 1 << 16


# A moment computed as a sum may fall a rounding short of itself computed otherwise [s].
INSTANT = 1e-9


@dataclass(frozen=True)
class DelayedPacket:
    """Bytes that set out together.

    Attributes:
        due: When they set out [s].
        data: The bytes.
        in_order: Whether they wait for all that set out before them, as a byte stream does.
    """

    due: float
    data: bytes
    in_order: bool = True


class SerialLine:
    """One direction of the wire, in explicit time.

    Args:
        baud: Bits a second; 0 for no pacing at all.
        latency: The adapter's latency timer [s]; 0 where none holds the bytes.
    """

    def __init__(self, baud: float = 0, latency: float = 0.0):
        self.pace(baud)
        self._latency = latency
        self._waiting: list[tuple[float, int, bytes]] = []
        self._backlog = 0
        self._sent = 0
        self._last_due = self._free_at = float("-inf")
        self._moving: list[tuple[float, bytes]] = []  # start on the line, bytes still on it
        self._held = bytearray()
        self._rings_at: float | None = None
        self.overflowed = 0

    def pace(self, baud: float) -> None:
        """Carry so many bits a second from now on; 0 for no pacing at all."""
        self._byte_time = BITS_PER_BYTE / baud if baud else 0.0

    def send(self, packets: list[DelayedPacket]) -> None:
        """Put packets on their way; past a full backlog they are lost, and counted."""
        for packet in packets:
            if self._backlog + len(packet.data) > LARGEST_BACKLOG:
                self.overflowed += 1
                continue
            due = max(packet.due, self._last_due) if packet.in_order else packet.due
            if packet.in_order:
                self._last_due = due
            self._backlog += len(packet.data)
            self._sent += 1
            heapq.heappush(self._waiting, (due, self._sent, packet.data))

    def take(self, now: float) -> bytes:
        """All bytes that have arrived by `now` [s]."""
        arrived = self._arrivals(now)
        if not self._latency:
            return b"".join(data for _, data in arrived)
        out = bytearray()
        for when, data in arrived:
            if self._rings_at is not None and self._rings_at < when:
                out += self._ring()
            self._held += data
            full = len(self._held) // ADAPTER_PACKET * ADAPTER_PACKET
            if full:
                out += self._held[:full]
                del self._held[:full]
                self._rings_at = None
            if self._held and self._rings_at is None:
                self._rings_at = when + self._latency
        if self._rings_at is not None and self._rings_at <= now + INSTANT:
            out += self._ring()
        return bytes(out)

    def next_event(self) -> float:
        """Time at which `take` may next do something [s]; infinite where nothing is on its way."""
        times = [] if self._rings_at is None else [self._rings_at]
        if self._moving:
            start, data = self._moving[0]
            times.append(start + len(data) * self._byte_time)
        elif self._waiting:
            due, _, data = self._waiting[0]
            times.append(max(due, self._free_at) + len(data) * self._byte_time)
        return min(times, default=float("inf"))

    def clear(self) -> None:
        """Lose all that is on its way, as when a plug is pulled."""
        self._waiting.clear()
        self._moving.clear()
        self._held.clear()
        self._backlog, self._rings_at = 0, None
        self._last_due = self._free_at = float("-inf")

    def _ring(self) -> bytes:
        held = bytes(self._held)
        self._held.clear()
        self._rings_at = None
        return held

    def _arrivals(self, now: float) -> list[tuple[float, bytes]]:
        """Bytes off the line by `now`, each piece with the time of its last byte [s]."""
        while self._waiting and self._waiting[0][0] <= now + INSTANT:
            due, _, data = heapq.heappop(self._waiting)
            start = max(due, self._free_at)
            self._free_at = start + len(data) * self._byte_time
            self._moving.append((start, data))
        arrived = []
        while self._moving:
            start, data = self._moving[0]
            count = len(data)
            if self._byte_time:
                count = min(count, int((now + INSTANT - start) / self._byte_time))
            if count <= 0:
                break
            self._backlog -= count
            arrived.append((start + count * self._byte_time, data[:count]))
            if count < len(data):
                self._moving[0] = (start + count * self._byte_time, data[count:])
                break
            self._moving.pop(0)
        return arrived
