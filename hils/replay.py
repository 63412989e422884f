"""Replay of a recorded run in its own loop, from its readings: the same zeta, bit for bit.

The run log keeps all inputs of the loop, and the loop's tick is a pure function of them
(`hils.control.tick`). Its results can be computed again and compared with the recorded ones: zeta,
the simulated wheel, and the commands of the rig.

Another processor, or another version of JAX, may round differently in the last bit.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

import drftjax
from drftjax.common.errors import InputError
from drftjax.effects.serialization import Entry
from drftjax.runlog.record import Online, RunLog
from drftjax.tuning.replay import ReplayedTuning
from hils.control.limits import REST, Reading, RigCommand
from hils.control.loop_config import LoopPhysics, LoopRecord, shared_physics
from hils.control.tick import LoopState, TickInput, TickOutput, begin, step_tick
from hils.events import TickFlag
from hils.procedure.initial_state import zeta_by_sinkage

Reals = NDArray[np.float64]


COMPARED = ("zeta", "x_sim", "z_sim", "vx_sim", "fx_sim", "fz_sim", "tuned")


class Difference(NamedTuple):
    """Difference of one channel between replay and recording.

    Attributes:
        name: The channel.
        rows: Number of rows that differ.
        first: Time of the first one [s].
        largest: Largest difference, in the channel's unit.
    """

    name: str
    rows: int
    first: float
    largest: float


class Replay(NamedTuple):
    """Result of a replay.

    Attributes:
        ticks: Number of ticks.
        zeta: Replayed scaling factor on each row of /online [-], shape (ticks,).
        differences: Channels that differ in any bit.
        software_version: Of the program that recorded the run; None where it is not known.
    """

    ticks: int
    zeta: Reals
    differences: tuple[Difference, ...]
    software_version: str | None

    @property
    def exact(self) -> bool:
        """True where every number agrees bit for bit."""
        return not self.differences

    def sentence(self) -> str:
        """The outcome, for a person."""
        if self.exact:
            return f"{self.ticks} ticks: zeta, the simulation and the commands agree bit for bit"
        parts = [
            f"{each.name} differs in {each.rows} rows from {each.first:g} s on, "
            f"by {each.largest:.3g} at most"
            for each in self.differences
        ]
        other = ""
        if self.software_version not in (None, drftjax.__version__):
            other = f" (recorded by drft {self.software_version}, this is {drftjax.__version__})"
        return f"{self.ticks} ticks: {'; '.join(parts)}{other}"


def replay(run: RunLog) -> Replay:
    """Feed a run's readings to its loop again, and compare the results with the recorded ones.

    Args:
        run: Recorded by the loop, with /online and the record of its loop in it.

    Raises:
        InputError: The run lacks inputs of its loop.
    """
    online, record = _loop_of(run)
    physics = shared_physics(record.loop)
    outputs = _replay_ticks(run, online, physics, begin(physics, record.start))
    found = {
        "zeta": [each.after.zeta for each in outputs],
        "x_sim": [each.before.x for each in outputs],
        "z_sim": [each.before.z for each in outputs],
        "vx_sim": [each.before.vx for each in outputs],
        "fx_sim": [each.before.fx for each in outputs],
        "fz_sim": [each.before.fz for each in outputs],
        "tuned": [float(each.tuned) for each in outputs],
    }
    recorded = {name: getattr(online, name) for name in COMPARED}
    recorded = {name: values for name, values in recorded.items() if values is not None}
    differences = [
        *_differences(online.time, recorded, found),
        *_command_differences(run, outputs, online.tick),
    ]
    zeta = np.array(found["zeta"])
    return Replay(len(outputs), zeta, tuple(differences), run.software_version)


def replay_tuning(run: RunLog, effects: Sequence[Entry], x: float = 0.0) -> ReplayedTuning:
    """Feed a run's readings to its loop, with these effects in its simulation and no others.

    zeta(0) changes by the factor that statics gives for the wheel to rest at the same sinkage. The
    rig moved at the speed that the original simulation gave it.

    Args:
        run: Recorded by the loop, with /online and the record of its loop in it.
        effects: Entries of the effects beyond the reference model.
        x: Start of the simulated wheel on the scale of the effects' places [m].

    Returns:
        zeta and error on the rows of /online.

    Raises:
        InputError: The run lacks inputs of its loop, or its wheel could not rest so deep with
            these effects.
    """
    online, record = _loop_of(run)
    loop, start = record.loop, record.start
    setup = msgspec.structs.replace(loop.setup, effects=list(effects))
    physics = shared_physics(msgspec.structs.replace(loop, setup=setup))
    zeta = start.zeta
    if loop.setup.effects != setup.effects:
        before, after = (
            zeta_by_sinkage(msgspec.json.encode(each))(start.sinkage)
            for each in (loop.setup, setup)
        )
        zeta *= after / before
    if not (math.isfinite(zeta) and zeta > 0):
        raise InputError(
            f"with these effects no zeta lets the wheel rest {1e3 * start.sinkage:.4g} mm deep"
        )
    packed = physics.step.begin(start.sinkage, zeta, x, setup.start.angle)
    state = begin(physics, start)._replace(packed=packed)
    outputs = _replay_ticks(run, online, physics, state)
    return ReplayedTuning(
        online.time,
        np.array([each.after.zeta for each in outputs]),
        np.array([each.after.error for each in outputs]),
    )


def _loop_of(run: RunLog) -> tuple[Online, LoopRecord]:
    """Rows of /online, and the record of the loop that the run was made in."""
    online = run.online
    if online is None:
        raise InputError("the run has no /online: it was not made in the loop")
    if online.loop is None:
        raise InputError("/online does not say what the loop was given: it has no attribute loop")
    record = LoopRecord.read(online.loop)
    if record.loop.tick != online.tick:
        raise InputError(
            f"/online has the tick {online.tick:g} s, its loop has {record.loop.tick:g} s"
        )
    return online, record


def _replay_ticks(
    run: RunLog, online: Online, physics: LoopPhysics, state: LoopState
) -> list[TickOutput]:
    """Outputs of a loop on every row of /online, fed with the recorded inputs."""
    outputs = list[TickOutput]()
    for number, given in _recorded_inputs(run, online):
        skipped = number - state.number
        if skipped < 0:
            raise InputError(f"/online/time has two rows for the tick {number}")
        state, output = step_tick(physics, state, given._replace(skipped=skipped))
        outputs.append(output)
    return outputs


def _recorded_inputs(run: RunLog, online: Online) -> Iterator[tuple[int, TickInput]]:
    """Number and inputs of each recorded tick, but for the skipped ticks before it."""
    measured = run.measured
    if measured.z is None:
        raise InputError("the run has no /measured/z, which the loop was given")
    # x decides nothing, and a rig need not measure it.
    x = np.zeros_like(measured.z) if measured.x is None else measured.x
    readings = zip(measured.time.tolist(), x.tolist(), measured.z.tolist(), strict=True)
    for time, flags in zip(online.time.tolist(), online.flags.tolist(), strict=True):
        number = round(time / online.tick)
        if time != number * online.tick:
            raise InputError(f"/online/time has {time!r} s, which is no whole number of ticks")
        reading = None
        if flags & TickFlag.FRESH:
            row = next(readings, None)
            if row is None:
                raise InputError(f"/measured has no row for the reading of {time:g} s")
            # The rig's own omega is not recorded; it decides nothing but a flag.
            reading = Reading(*row, omega=math.nan)
        ramping, old = bool(flags & TickFlag.RAMPING), bool(flags & TickFlag.OLD)
        yield number, TickInput(reading, ramping=ramping, old=old)


def _differences(
    time: Reals, recorded: Mapping[str, NDArray[Any]], found: Mapping[str, list[float]]
) -> Iterator[Difference]:
    for name, values in recorded.items():
        before, after = values.astype(np.float64), np.array(found[name])
        rows = np.flatnonzero(before.view(np.uint64) != after.view(np.uint64))
        if rows.size:
            largest = float(np.abs(before - after)[rows].max())
            yield Difference(name, rows.size, float(time[rows[0]]), largest)


def _command_differences(
    run: RunLog, outputs: list[TickOutput], tick: float
) -> Iterator[Difference]:
    command = run.command
    demands = list(_demands(outputs, tick))
    if command.vx is None or command.time.size < len(demands):
        raise InputError("/command does not have a row of omega and vx for each tick")
    recorded = {"omega": command.omega[: len(demands)], "vx": command.vx[: len(demands)]}
    found = {"omega": [each.omega for each in demands], "vx": [each.vx for each in demands]}
    yield from _differences(command.time, recorded, found)


def _demands(outputs: list[TickOutput], tick: float) -> Iterator[RigCommand]:
    """Rows of /command: at rest at first, and the held command where ticks were skipped."""
    next_number = 0
    yield REST
    for each in outputs:
        if each.number > next_number:
            yield each.held
        # A refused command ends the run, and the tick has no row.
        yield each.demand or each.held
        next_number = each.number + 1
