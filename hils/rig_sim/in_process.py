"""A virtual rig, a soft link and a virtual clock tied together: runs that take no time."""

from functools import cache
from typing import NamedTuple

import msgspec

from hils.clock import VirtualClock
from hils.link.link import InProcessLink
from hils.rig_sim.config import PhysicsSetUp, VirtualSetUp
from hils.rig_sim.faults import FaultScript
from hils.rig_sim.physics import RigPhysics
from hils.rig_sim.rig import VirtualRig

# Plates and step of a rig that is quick to run: right to 0.2 mm on the paper's profile.
QUICK = PhysicsSetUp(step=1e-3, plate_size=8e-3)


class SoftRig(NamedTuple):
    """A rig in virtual time.

    Attributes:
        rig: The rig itself, with the truth to compare with.
        link: The host's end of the line to it.
        clock: Sleeping on it moves the rig.
    """

    rig: VirtualRig
    link: InProcessLink
    clock: VirtualClock


def soft_rig(
    setup: VirtualSetUp | None = None,
    script: FaultScript | None = None,
    seed: int = 0,
    baud: float = 0,
    latency: float = 0.0,
    start: float = 1000.0,
    grain: float = 1e-3,
) -> SoftRig:
    """A virtual rig in virtual time; rigs of the same physics share one compiled program.

    Args:
        setup: The rig's numbers; the default is the paper's rig, in `QUICK` physics.
        script, seed, baud, latency: As for `VirtualRig`.
        start: The clock's first reading, the rig's power-up [s].
        grain: How finely link and rig look at the clock [s].
    """
    setup = setup or VirtualSetUp(physics=QUICK)
    clock = VirtualClock(start, grain)
    rig = VirtualRig(setup, rig_physics(setup), script, seed, baud, latency, start)
    return SoftRig(rig, InProcessLink(rig, clock), clock)


def rig_physics(setup: VirtualSetUp) -> RigPhysics:
    """The compiled physics of a set-up, made once in a program's life."""
    physics = VirtualSetUp(
        wheel=setup.wheel,
        terrain=setup.terrain,
        rig=setup.rig,
        effects=setup.effects,
        physics=setup.physics,
    )
    return _compiled(msgspec.json.encode(physics))


@cache
def _compiled(setup: bytes) -> RigPhysics:
    return msgspec.json.decode(setup, type=VirtualSetUp).build()
