"""Set-up of a virtual rig, as a TOML file holds it.

The tables of a set-up that `drft simulate` reads ([wheel], [terrain], [rig], [[effect]]) describe
the true sand and the true rig. [start], [command] and [integrator] are the loop's business: they
may stand in the file and are not used, so that the set-up of a run serves as it is.
"""

from pathlib import Path

import msgspec
import numpy as np

from drftjax.common.arrays import require_between
from drftjax.common.errors import InputError
from drftjax.common.structured_files import to_structure
from drftjax.effects.serialization import Entry, build_effects
from drftjax.physics.integrator import ImplicitEuler
from drftjax.setups.setup import (
    CommandSetUp,
    IntegratorSetUp,
    RigSetUp,
    StartSetUp,
    WheelSetUp,
    find_outline,
    read_tables,
)
from drftjax.setups.terrain_setup import DynamicTerrain, TerrainSetUp
from drftjax.simulation.simulator import Simulator
from hils.rig_sim.physics import RigPhysics
from hils.rig_sim.sensors import Instruments, RandomStream, RigClock


class PhysicsSetUp(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[physics]: the rig's own integrator step [s] and plates [m], finer than the loop's.

    Plates are half as long as those of the wheel's set-up where no length is given: 2 mm on the
    paper's wheel.
    """

    step: float = 1e-3
    plate_size: float | None = None


class LimitSetUp(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[limits]: of angular velocity [rad/s] and carriage speed [m/s], and of their changes."""

    omega_max: float = 2.0
    vx_max: float = 0.5
    omega_slew: float = 5.0
    vx_slew: float = 2.0


class BedSetUp(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[bed]: scatter of zeta from one preparation of the sand to the next (a share, 0 for none)."""

    scatter: float = 0.0

    def firmness(self, seed: int, number: int) -> float:
        """Factor on zeta [-] of the bed that was prepared as this number."""
        random = np.random.default_rng([seed, RandomStream.BED, number])
        return float(np.exp(self.scatter * random.standard_normal()))


class VirtualSetUp(msgspec.Struct, forbid_unknown_fields=True):
    """A virtual rig as a file holds it; the default is the rig of Fuke et al. 2024."""

    title: str = "virtual rig"
    wheel: WheelSetUp = msgspec.field(default_factory=WheelSetUp)
    terrain: TerrainSetUp = msgspec.field(default_factory=DynamicTerrain)
    rig: RigSetUp = msgspec.field(default_factory=RigSetUp)
    effects: list[Entry] = msgspec.field(default_factory=list, name="effect")
    physics: PhysicsSetUp = PhysicsSetUp()
    instruments: Instruments = Instruments()
    clock: RigClock = RigClock()
    limits: LimitSetUp = LimitSetUp()
    bed: BedSetUp = BedSetUp()
    start: StartSetUp | None = None
    command: CommandSetUp | None = None
    integrator: IntegratorSetUp | None = None

    def check(self) -> None:
        """Refuse numbers that cannot be, but for those that the simulator refuses itself.

        Raises:
            InputError: says what was given and what must hold.
        """
        require_between("physics step", self.physics.step, 1e-5, 5e-3, " s")
        require_between("omega_max", self.limits.omega_max, 1e-3, 100.0, " rad/s")
        require_between("vx_max", self.limits.vx_max, 1e-4, 10.0, " m/s")
        require_between("omega_slew", self.limits.omega_slew, 1e-3, 1e4, " rad/s2")
        require_between("vx_slew", self.limits.vx_slew, 1e-3, 1e4, " m/s2")
        require_between("bed scatter", self.bed.scatter, 0.0, 1.0)
        self.instruments.check()
        self.clock.check()

    def simulator(self) -> Simulator:
        """The true wheel and sand, with the rig's own plates.

        Raises:
            InputError: says which number cannot be.
        """
        self.check()
        given = self.physics.plate_size
        plate_size = self.wheel.plate_length / 2 if given is None else given
        wheel = msgspec.structs.replace(self.wheel, plate_size=plate_size)
        return Simulator(
            wheel.build(),
            self.terrain.build(),
            # Each command says whether the carriage is driven; an effect may say how.
            msgspec.structs.replace(self.rig, carriage="driven").build(),
            ImplicitEuler(),
            tuple(build_effects(entry, place) for place, entry in enumerate(self.effects, start=1)),
        )

    def build(self) -> RigPhysics:
        """The physics, compiled; runs on the same rig may share it."""
        return RigPhysics(self.simulator(), self.physics.step)


def read_virtual_setup(path: str | Path) -> VirtualSetUp:
    """A virtual rig's set-up file (TOML or JSON); a wheel's outline is looked for beside it.

    Raises:
        InputError: names the file, the entry and what must hold.
    """
    path = Path(path)
    setup = to_structure(read_tables(path), VirtualSetUp, path)
    find_outline(setup.wheel, path)
    try:
        setup.simulator().check()
    except InputError as problem:
        raise InputError(f"{path}: {problem}") from None
    return setup
