"""Compilation of the step beside the zeroing: order, signs of life, refusals, and the step kept."""

import copy
import threading
import time
from concurrent.futures import Future

import pytest

from drftjax.common.errors import InputError
from drftjax.setups.chosen_step import choose_setup_step
from hils.clock import VirtualClock
from hils.control.loop_config import Start, shared_physics
from hils.control.stop_request import StopRequest
from hils.link.messages import Arm
from hils.procedure import compilation
from hils.procedure.compilation import await_compilation, compile_loop
from hils.procedure.operator_prompts import UnattendedPrompts, signs_of_life
from hils.procedure.procedure import Procedure, run
from hils.recording.sinks import InMemorySink
from tests.helpers.hils_runs import START, LoggedLink, loop_setup
from tests.helpers.protocol_variants import OtherRig

PATIENCE = 60.0  # of a busy machine [s]


class Operator(UnattendedPrompts):
    """Sets an event when asked to let the wheel down, which is after it was zeroed."""

    def __init__(self):
        super().__init__(quiet=True)
        self.zeroed = threading.Event()

    def confirm(self, text, meanwhile=lambda: None):
        if text.startswith("Let the wheel down"):
            self.zeroed.set()


def refuse() -> None:
    raise InputError("enough seen")


def run_until_motion(operator: Operator) -> LoggedLink:
    """Make a run that ends before ARM; the link with what was said over it."""
    clock = VirtualClock(START)
    link = LoggedLink(OtherRig(greeting=(0x44524654, 9, 7, 1e-5, 1e-4, 2.0, 0.1, 50, 0)), clock)
    given = (Procedure(loop=loop_setup()), link, clock, InMemorySink(), operator, StopRequest())
    with pytest.raises(InputError) as refused:
        run(*given, before_motion=refuse)
    link.refusal = str(refused.value)
    return link


def test_the_wheel_is_zeroed_while_the_step_is_compiled(monkeypatch):
    operator = Operator()

    def slow(loop):
        assert operator.zeroed.wait(PATIENCE)
        return shared_physics(loop)

    monkeypatch.setattr(compilation, "shared_physics", slow)
    assert run_until_motion(operator).refusal == "enough seen"


def test_a_step_that_cannot_be_compiled_ends_the_run_before_arm(monkeypatch):
    def fails(loop):
        raise InputError("the wheel has no plates")

    monkeypatch.setattr(compilation, "shared_physics", fails)
    link = run_until_motion(Operator())
    assert link.refusal == "the wheel has no plates"
    assert not any(isinstance(message, Arm) for _, message in link.said)


def test_a_long_compilation_shows_that_it_goes_on_and_the_rig_is_heard():
    made, heard, calls = Future(), [], []
    threading.Timer(1.0, made.set_result, ["done"]).start()
    assert await_compilation(made, heard.append, lambda: calls.append(1)) == "done"
    assert heard[0].startswith("Compiling the step (0.")
    assert len(calls) > 3


def test_signs_of_life_end_with_the_work():
    heard = []
    with signs_of_life("Working", heard.append, interval=0.05):
        time.sleep(0.5)
    count = len(heard)
    time.sleep(0.15)
    assert 2 <= count == len(heard)


def test_work_that_is_done_soon_is_not_mentioned():
    heard = []
    with signs_of_life("Working", heard.append, interval=5.0):
        pass
    assert heard == []


def test_the_chosen_step_is_kept_with_the_loop_and_the_set_up_given_stays():
    loop = loop_setup()
    loop.setup.integrator.step = None
    expected = choose_setup_step(copy.deepcopy(loop.setup))
    compiled = compile_loop(loop, free=False, expected=Start(loop.setup.start.sinkage, 1.0))
    assert compiled.step_choice == expected
    assert compiled.loop.setup.integrator.step == expected.step
    assert loop.setup.integrator.step is None
