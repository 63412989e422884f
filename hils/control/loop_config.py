"""Inputs of the loop, as values that a run log keeps: a run can be replayed from them."""

import copy
import math
from functools import lru_cache
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from drftjax.common.arrays import as_real, require_between
from drftjax.common.errors import InputError
from drftjax.common.structured_files import explain
from drftjax.setups.chosen_step import choose_setup_step
from drftjax.setups.setup import SetUp
from drftjax.setups.terrain_setup import drop_unused_numbers
from drftjax.simulation.simulator import Simulator
from drftjax.simulation.step_choice import StepChoice
from drftjax.tuning.registry import TunerSetUp
from drftjax.tuning.step_tuner import tick_commands
from hils.control.compiled_step import CompiledStep
from hils.control.limits import CommandLimits, ReadingLimits, require_profile

SHORTEST_TICK, LONGEST_TICK = 5e-4, 0.1


MOST_TICKS = 2e6


# No single-wheel rig is faster [rad/s], [m/s].
FASTEST_WHEEL, FASTEST_CARRIAGE = 100.0, 10.0


class ZetaHold(msgspec.Struct, frozen=True):
    """Conditions under which zeta is held, whatever the tuner says.

    Attributes:
        standing_omega: Commanded angular velocity up to which the wheel stands [rad/s]: a simulated
            wheel that stands hardly moves whatever zeta is, so that a tuner runs away.
        min_zeta, max_zeta: Bounds of zeta [-]; sand beyond them does not exist.
    """

    standing_omega: float = 0.02
    min_zeta: float = 0.05
    max_zeta: float = 20.0


class LoopSetUp(msgspec.Struct, frozen=True, kw_only=True):
    """The loop before a run.

    Attributes:
        setup: Wheel, sand and rig as the operator believes them to be, and the profile.
        tuner: Rule that moves zeta.
        tick: Control period [s].
        tuning_ticks: Ticks from one step of the tuner to the next, at least.
        readings: Limits of the readings.
        commands: Limits of the commands.
        ramp: Change of the angular velocity when a run is ended early [rad/s2].
        hold: Where zeta is held; None in logs of a program that held it nowhere.
    """

    setup: SetUp
    commands: CommandLimits
    tuner: TunerSetUp = TunerSetUp()
    tick: float = 0.01
    tuning_ticks: int = 1
    readings: ReadingLimits = ReadingLimits()
    ramp: float = 1.0
    hold: ZetaHold | None = ZetaHold()


class Start(msgspec.Struct, frozen=True):
    """Start of the loop, as touch-down and rest have shown it.

    Attributes:
        sinkage: H at rest, when the loop starts [m].
        zeta: Scaling factor at the start [-]; NaN where nothing tells it and nothing is simulated.
    """

    sinkage: float
    zeta: float


class LoopRecord(msgspec.Struct, frozen=True):
    """The loop of one run: kept in the run log's /online as JSON."""

    loop: LoopSetUp
    start: Start

    def text(self) -> str:
        """As JSON, whose numbers read back bit for bit."""
        return msgspec.json.encode(self).decode()

    @classmethod
    def read(cls, text: str) -> "LoopRecord":
        """From its JSON.

        Raises:
            InputError: it is none.
        """
        try:
            record = msgspec.json.decode(text, type=dict[str, dict[str, Any]])
            loop = record.get("loop", {})
            loop.setdefault("hold", None)
            if isinstance(setup := loop.get("setup"), dict):
                record["loop"]["setup"] = drop_unused_numbers(setup)
            return msgspec.convert(record, cls)
        except msgspec.DecodeError as error:
            wrong = isinstance(error, msgspec.ValidationError)
            why = explain(str(error), cls) if wrong else "it is not JSON"
            raise InputError(f"the run's record of its loop cannot be read: {why}") from None


class LoopPhysics:
    """The loop made ready: step compiled, profile laid out.

    Args:
        loop: Its numbers.

    Attributes:
        loop: The same.
        simulator: Of the step.
        step: A tick.
        omega: Angular velocity at the end of each substep of each tick, shape (ticks, substeps)
            [rad/s].
        step_choice: The integrator step that was chosen, and its estimated error; None where the
            set-up gives one.

    Raises:
        InputError: a number that cannot be, or a profile that cannot be commanded.
    """

    loop: LoopSetUp
    simulator: Simulator
    step: CompiledStep
    omega: Float[np.ndarray, "ticks substeps"]
    step_choice: StepChoice | None

    def __init__(self, loop: LoopSetUp):
        self.loop = loop
        setup = copy.deepcopy(loop.setup)
        self.step_choice = choose_setup_step(setup)
        trial = setup.trial()
        substeps = max(1, math.ceil(loop.tick / float(trial.step) - 1e-9))
        self.omega = profile(loop, substeps)
        self.simulator = trial.simulator
        self.step = CompiledStep(trial.simulator, loop.tuner.build(loop.tick), substeps)

    @property
    def ticks(self) -> int:
        """Length of the profile."""
        return len(self.omega)

    def with_readings(self, readings: ReadingLimits) -> "LoopPhysics":
        """The same, with other limits of the readings; nothing is compiled again."""
        other = copy.copy(self)
        other.loop = msgspec.structs.replace(self.loop, readings=readings)
        return other

    def precompile(self, start: Start, ticks: int = 20) -> None:
        """Make some steps beforehand, so that the first tick takes no longer than any other."""
        packed = self.begin(start)
        for number in range(ticks):
            packed = self.step(packed, start.sinkage, self.omega[min(number, self.ticks - 1)])

    def begin(self, start: Start) -> NDArray[np.float64]:
        """The packed state at the start."""
        return self.step.begin(start.sinkage, start.zeta, 0.0, self.loop.setup.start.angle)


def shared_physics(loop: LoopSetUp) -> LoopPhysics:
    """The compiled physics of a loop; repeats share it."""
    return _compiled(msgspec.json.encode(loop))


@lru_cache(maxsize=16)
def _compiled(loop: bytes) -> LoopPhysics:
    return LoopPhysics(msgspec.json.decode(loop, type=LoopSetUp))


def profile(loop: LoopSetUp, substeps: int) -> NDArray[np.float64]:
    """Angular velocity at the end of each substep of each tick, shape (ticks, substeps) [rad/s].

    Raises:
        InputError: a number of the loop that cannot be, or a profile that cannot be commanded.
    """
    require_between("tick", loop.tick, SHORTEST_TICK, LONGEST_TICK, " s")
    require_between("omega-max", loop.commands.omega, 0.0, FASTEST_WHEEL, " rad/s")
    require_between("vx-max", loop.commands.vx, 0.0, FASTEST_CARRIAGE, " m/s")
    require_between("tuning-ticks", loop.tuning_ticks, 1, 1e6)
    require_between("ramp", loop.ramp, 1e-3, loop.commands.omega_slew, " rad/s2, the slew limit")
    setup = loop.setup
    if setup.rig.carriage != "free" or setup.command.vx is not None:
        raise InputError(
            "the profile drives the carriage, but the loop drives it at the simulated speed; "
            "leave vx out of [command] and the carriage of [rig] free"
        )
    command = setup.command.build()
    require_profile(command.time, command.omega, loop.commands, "the loop")
    time = command.time - command.time[0]
    ticks = math.ceil(time[-1] / loop.tick - 1e-9)
    require_between("the number of ticks", ticks, 1, MOST_TICKS)
    commands = tick_commands(ticks, substeps, loop.tick, as_real(time), as_real(command.omega))
    return np.asarray(commands.omega)
