"""Compilation of a run's step in a thread, while the wheel is zeroed at touch-down.

Nothing moves yet, so that all of it may be refused; after ARM nothing takes longer than a tick.
"""

import concurrent.futures
import copy
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import NamedTuple

import msgspec

from drftjax.simulation.step_choice import StepChoice
from hils.control.loop_config import LoopSetUp, Start, shared_physics
from hils.control.tick import AbstractTick, FreeTick, TunedTick
from hils.procedure.initial_state import zeta_by_sinkage
from hils.procedure.operator_prompts import POLL_INTERVAL, signs_of_life


class CompiledLoop(NamedTuple):
    """A loop that is ready to run.

    Attributes:
        loop: With the integrator step that was chosen, where its set-up gives none: so the run log
            keeps it.
        tick: Work of a tick, compiled.
        statics: zeta [-] by the sinkage at rest [m].
        step_choice: The step that was chosen, and its estimated error; None where none was.
    """

    loop: LoopSetUp
    tick: AbstractTick
    statics: Callable[[float], float]
    step_choice: StepChoice | None


def compile_loop(loop: LoopSetUp, free: bool, expected: Start) -> CompiledLoop:
    """Compile what a run needs after ARM.

    Args:
        loop: Within the rig's limits.
        free: True where the carriage runs free and nothing is simulated.
        expected: Start by which some steps are made beforehand.

    Raises:
        InputError: a number of the set-up is out of bounds.
    """
    statics = zeta_by_sinkage(msgspec.json.encode(loop.setup))
    if free:
        return CompiledLoop(loop, FreeTick(loop), statics, None)
    physics = shared_physics(loop)
    tick = TunedTick(physics)
    tick.precompile(expected)
    choice = physics.step_choice
    if choice is not None:
        setup = copy.deepcopy(loop.setup)
        setup.integrator.step = choice.step
        loop = msgspec.structs.replace(loop, setup=setup)
    return CompiledLoop(loop, tick, statics, choice)


@contextmanager
def compiled_meanwhile(
    loop: LoopSetUp, free: bool, expected: Start
) -> Iterator[Future[CompiledLoop]]:
    """Context in which a loop is compiled in a thread; it ends after that."""
    with ThreadPoolExecutor(1, "compilation") as thread:
        yield thread.submit(compile_loop, loop, free, expected)


def await_compilation(
    compilation: Future[CompiledLoop], say: Callable[[str], None], meanwhile: Callable[[], None]
) -> CompiledLoop:
    """Wait for a loop that is being compiled.

    Args:
        compilation: Of `compiled_meanwhile`.
        say: Hears each second that it still goes on.
        meanwhile: Called again and again; it may raise.

    Raises:
        InputError: a number of the set-up is out of bounds.
    """
    with signs_of_life("Compiling the step", say):
        while not concurrent.futures.wait([compilation], POLL_INTERVAL).done:
            meanwhile()
    return compilation.result()
