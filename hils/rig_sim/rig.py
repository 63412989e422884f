"""A whole rig in explicit time: sand and wheel, firmware, instruments, wire, and faults on order.

Nothing here sleeps or reads a clock: the same object lives in virtual time under an
`InProcessLink` and in real time in a process of its own (`hils.rig_sim.server`).

From power-up the wheel hangs at touch-down. The first ARM of a session releases it. When a session
opens while the rig is at rest, somebody has lifted the wheel, moved the carriage back and prepared
the sand again, so runs can follow one another.
"""

import enum
import math
from collections import deque
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

from hils.link.link import LinkLost
from hils.link.messages import READY, U32, VIRTUAL_RIG, HelloAck, Reason, RigState, wire_bytes
from hils.rig_sim.config import VirtualSetUp
from hils.rig_sim.fault_injection import FaultInjector
from hils.rig_sim.faults import FaultScript, split_frames
from hils.rig_sim.firmware import (
    DEFAULT_FIRMWARE,
    FirmwareSettings,
    MotorDemand,
    RigIdentity,
    RigProtocol,
)
from hils.rig_sim.physics import REST, RigMotion, RigPhysics
from hils.rig_sim.sensors import RandomStream, SensorNoise
from hils.rig_sim.serial_line import INSTANT, DelayedPacket, SerialLine

# Fragments longer than any frame pass as they are.
LONGEST_FRAGMENT = 256


MOST_CHANGES = 1000


class RigFault(enum.IntEnum):
    """Numbers in MEAS of faults that the virtual rig finds itself."""

    END_STOP = 100  # the wheel sank to where its upper half would touch the sand
    DIVERGED = 101  # the physics gave a number that is not finite


class RigStateChange(NamedTuple):
    """A change of the rig's state.

    Attributes:
        time: By the host's clock [s].
        state: After it.
        reason: Why.
        silence: Time since anything was last heard from the host [s].
    """

    time: float
    state: RigState
    reason: int
    silence: float


class VirtualRig:
    """A rig that is advanced in time by its caller.

    Args:
        setup: Its numbers.
        physics: Of the same set-up, compiled; made here where none is given.
        script: Its faults.
        seed: Of noise, bed preparation and boot numbers.
        baud: Bits a second on the wire, both ways; 0 for no pacing.
        latency: The host's USB adapter's latency timer [s].
        start: Time at power-up by the host's clock [s].
        boots: Count of power-ups before; another number gives other boot numbers.
        firmware: Rhythm of the firmware.
    """

    def __init__(
        self,
        setup: VirtualSetUp,
        physics: RigPhysics | None = None,
        script: FaultScript | None = None,
        seed: int = 0,
        baud: float = 0,
        latency: float = 0.0,
        start: float = 0.0,
        boots: int = 0,
        firmware: FirmwareSettings = DEFAULT_FIRMWARE,
    ):
        setup.check()
        self._setup, self._seed, self._firmware = setup, seed, firmware
        self._physics = physics or setup.build()
        self._faults = FaultInjector(script or FaultScript())
        self._noise = SensorNoise(seed)
        self._baud = baud
        self._inward, self._outward = SerialLine(baud), SerialLine(baud, latency)
        self._fragment = b""
        self._start = self._now = self._heard = self._sent_at = start
        self._boots = boots
        self._set_physics_state(self._physics.held())
        self._beds, self._firmness = 0, 1.0
        self._released: float | None = None
        self._synced = start  # the physics has come this far
        self._drive = REST
        self.changes: deque[RigStateChange] = deque(maxlen=MOST_CHANGES)
        self._protocol: RigProtocol | None = None
        self._faults.mark("power", start)
        self._prepare()
        self._boot()

    @property
    def state(self) -> RigState | None:
        """State of the firmware; None while it has no power."""
        return self._protocol.state if self._protocol else None

    @property
    def motion(self) -> RigMotion:
        """The truth, as far as the physics has come."""
        return self._motion

    @property
    def is_held(self) -> bool:
        """True while the wheel still hangs at touch-down."""
        return self._released is None

    @property
    def is_plugged(self) -> bool:
        """True while bytes can pass."""
        return not self._faults.is_unplugged(self._now)

    @property
    def occasions(self) -> dict[str, float]:
        """Times at which power, hello, arm, motion and stop came first, by the host's clock [s]."""
        return self._faults.occasions

    def advance(self, now: float, data: bytes) -> bytes:
        """Live up to this time [s], take these bytes then, and give what has come out.

        Raises:
            LinkLost: the plug is out. The rig lives on; `live` moves it.
        """
        out = self.advance_unplugged(now, data)
        if not self.is_plugged:
            raise LinkLost("the virtual rig's plug is out")
        return out

    def advance_unplugged(self, now: float, data: bytes = b"") -> bytes:
        """As `advance`; while the plug is out, nothing passes and nothing is raised."""
        self._receive(data, max(now, self._now))
        while (event := self._next_own()) < now - INSTANT:
            self._advance_to(event)
        self._advance_to(max(now, self._now))
        return self._outward.take(self._now)

    def next_event(self) -> float:
        """Time at which something will next happen or come out by itself [s]."""
        return min(self._next_own(), self._outward.next_event())

    def _next_own(self) -> float:
        """Time at which something next happens in the rig, past the present [s]."""
        times = [self._inward.next_event(), self._faults.next_edge(self._now)]
        times.append(self._now + self._firmware.clock_interval)
        return max(min(times), math.nextafter(self._now, math.inf))

    def _receive(self, data: bytes, now: float) -> None:
        """Bytes that the host sends now set out, in frames where they make some."""
        if not data or self._faults.is_unplugged(now):
            return
        frames, rest = split_frames(self._fragment, data)
        packets = self._faults.packets(frames, "rig", now)
        if len(rest) > LONGEST_FRAGMENT:
            packets.append(DelayedPacket(now, rest))
            rest = b""
        self._fragment = rest
        self._inward.send(packets)

    def _advance_to(self, now: float) -> None:
        self._now = now
        if self._faults.is_unplugged(now):
            self._inward.clear()
            self._outward.clear()
            self._fragment = b""
        if self._faults.is_powerless(now):
            self._lose_power(now)
            return
        for line in (self._inward, self._outward):
            line.pace(self._faults.line_baud(now) or self._baud)
        if self._protocol is None:
            self._boot()
        protocol = self._protocol
        assert protocol is not None
        data = self._inward.take(now)
        if data:
            self._heard = now
        before, out = protocol.state, b""
        look, silence = self._firmware.clock_interval, self._firmware.measurement_interval
        if data or now >= self._sent_at + silence - look:  # something may go out
            self._sync(now, protocol.demand)
            self._measure(protocol, now)
            out = self._own_faults(protocol, now)
        out += protocol.advance(self._rig_time(now), data)
        self._follow_state(protocol, before, now)
        if not out:
            if now >= self._sent_at + silence + look:
                self._sent_at = now
            return
        self._sent_at = now
        frames, _ = split_frames(b"", out)
        if any(len(frame) == wire_bytes(HelloAck) for frame in frames):
            self._faults.mark("hello", now)
            if protocol.state not in READY and protocol.demand.omega == 0:
                self._prepare()
        if not self._faults.is_unplugged(now):
            self._outward.send(self._faults.packets(frames, "host", now))

    def _follow_state(self, protocol: RigProtocol, before: RigState, now: float) -> None:
        """Follow a change of the firmware's state: occasions of faults, release of the wheel."""
        if protocol.demand.omega != 0:
            self._faults.mark("motion", now)
        if protocol.state is before:
            return
        self.changes.append(RigStateChange(now, protocol.state, protocol.reason, now - self._heard))
        if before is RigState.RUNNING:
            self._faults.mark("stop", now)
        if protocol.state in READY:
            self._faults.mark("arm", now)
            if self._released is None:
                self._released = self._synced = now

    # Power and bed ---------------------------------------------------------------------------

    def _boot(self) -> None:
        """Power comes: a new boot number, and scales that count from where they are."""
        self._boots += 1
        random = np.random.default_rng([self._seed, RandomStream.BOOT, self._boots])
        limits, scales = self._setup.limits, self._setup.instruments
        identity = RigIdentity(
            boot_id=int(random.integers(1, U32)),
            rig_id=VIRTUAL_RIG,
            z_scale=scales.z_scale,
            x_scale=scales.x_scale,
            omega_max=limits.omega_max,
            vx_max=limits.vx_max,
            omega_slew=limits.omega_slew,
            vx_slew=limits.vx_slew,
        )
        self._protocol = RigProtocol(identity, self._rig_time(self._now), self._firmware)
        motion = self.motion
        self._zero = motion.z, motion.x
        self.changes.append(
            RigStateChange(self._now, RigState.IDLE, Reason.NONE, self._now - self._heard)
        )
        self._measure(self._protocol, self._now)

    def _lose_power(self, now: float) -> None:
        self._sync(now, REST)
        self._protocol, self._fragment = None, b""
        self._inward.clear()

    def _prepare(self) -> None:
        """Somebody lifts the wheel to touch-down, and prepares the bed where it has stood in it."""
        if self._beds and self._released is None:
            return
        self._set_physics_state(self._physics.held())
        self._released, self._drive = None, REST
        self._firmness = self._setup.bed.firmness(self._seed, self._beds)
        self._beds += 1

    # Physics and instruments -----------------------------------------------------------------

    def _sync(self, now: float, demand: MotorDemand) -> None:
        """Bring the physics up to now by whole steps, the drive going evenly to its demand."""
        if self._released is None:
            self._synced = now
            return
        while self._synced < now:
            # The damper lets go between two blocks.
            lowered = self._released + self._physics.lowering.time
            lowering = self._synced < lowered - INSTANT  # whole steps end a rounding beside it
            end = min(now, lowered) if lowering else now
            steps = math.floor((end - self._synced) / self._physics.step + 1e-6)
            if steps < 1 and lowering and end < now:
                steps = 1
            if steps < 1:
                return
            given = self._faults.demand(demand, now)
            self._set_physics_state(
                self._physics.advance(
                    self._packed, steps, self._drive, given, lowering, self._firmness
                )
            )
            self._drive = given
            self._synced += steps * self._physics.step

    def _set_physics_state(self, packed: Float[Array, " packed"]) -> None:
        self._packed, self._motion = packed, self._physics.motion(packed)

    def _measure(self, protocol: RigProtocol, now: float) -> None:
        noise = self._noise.at(now - self._start)
        counts = self._setup.instruments.read(self.motion, self._zero, noise)
        protocol.measure(*self._faults.counts(counts, now))

    def _own_faults(self, protocol: RigProtocol, now: float) -> bytes:
        """Bytes that the rig sends where it finds a fault of its own."""
        if protocol.state is RigState.FAULT:
            return b""
        motion, code = self.motion, self._faults.drive_fault(now)
        if not all(map(math.isfinite, motion)):
            code = RigFault.DIVERGED
        elif motion.z < self._physics.lowest:
            code = RigFault.END_STOP
        return protocol.fail(Reason.DRIVE, code, self._rig_time(now)) if code else b""

    def _rig_time(self, now: float) -> float:
        error = self._faults.clock_error(now)
        return self._setup.clock.reading(now - self._start) + error
