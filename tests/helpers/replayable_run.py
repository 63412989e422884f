"""A short run of the loop with lost frames, absurd readings and late ticks, as a run log."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from drftjax.runlog.hdf5.api import read_run
from drftjax.runlog.record import RunLog
from drftjax.setups.setup import CommandSetUp, SetUp
from drftjax.tuning.registry import TunerSetUp
from hils.clock import AbstractClock
from hils.control.limits import CommandLimits
from hils.control.loop_config import LoopSetUp
from hils.control.stop_request import StopReason, StopRequest
from hils.events import Event
from hils.procedure.operator_prompts import UnattendedPrompts
from hils.procedure.procedure import Procedure, run
from hils.recording.recorder import Recorder
from hils.rig_sim.faults import Fault, FaultScript, LostFrames, ScaleJump, Window
from hils.rig_sim.in_process import soft_rig

PROFILE = ([0.0, 0.3, 1.3, 2.0, 2.5], [0.0, 0.0, 0.5, 0.5, 0.0])
SCRIPT = FaultScript(
    seed=3,
    faults=(
        Fault(LostFrames(rate=0.3), Window(after="motion", start=0.2, duration=0.5)),
        Fault(ScaleJump(rate=0.3), Window(after="motion", start=0.8, duration=0.3)),
    ),
)


class BusyClock(AbstractClock):
    """A virtual clock on a computer that has something else to do at some moments.

    Args:
        clock: The virtual clock.
        moments: Times from which on it wakes late, once each [s].
        late: Delay of a late waking [s].
        each: Called at every waking.
    """

    def __init__(
        self,
        clock: AbstractClock,
        moments: Sequence[float],
        late: float,
        each: Callable[[], None],
    ):
        self._clock, self._moments, self._late, self._each = clock, list(moments), late, each

    def now(self) -> float:
        return self._clock.now()

    def sleep_until(self, deadline: float) -> None:
        late = 0.0
        if self._moments and deadline >= self._moments[0]:
            late = self._late
            del self._moments[0]
        self._clock.sleep_until(deadline + late)
        self._each()


def record_run(
    path: Path, tuner: str = "step", busy_at: Sequence[float] = (), stop_above: float = np.inf
) -> RunLog:
    """Record a short run on a virtual rig with faults, in virtual time, by the real recorder.

    Args:
        path: The run log.
        tuner: By name.
        busy_at: Times at which the loop misses three ticks, from the rig's power-up [s].
        stop_above: Angular velocity above which someone asks to stop [rad/s].
    """
    time, omega = PROFILE
    loop = LoopSetUp(
        setup=SetUp(command=CommandSetUp(time=time, omega=omega)),
        commands=CommandLimits(2.0, 0.3),
        tuner=TunerSetUp(tuner),
        tuning_ticks=2,
    )
    rig, link, clock = soft_rig(script=SCRIPT, seed=1)
    request = StopRequest()

    def look() -> None:
        if rig.motion.omega > stop_above and request.first_reason is None:
            request.ask(StopReason("asked to stop", Event.STOP_ASKED))

    clock = BusyClock(clock, [clock.now() + each for each in busy_at], 0.034, look)
    procedure, prompts = Procedure(loop=loop, free=False), UnattendedPrompts(quiet=True)
    run(procedure, link, clock, Recorder(path), prompts, request)
    return read_run(path)
