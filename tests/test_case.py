"""The runs of one rig made ready: programs that are compiled once."""

import jax
import numpy as np
import pytest

from diagnose.response import Model, predict
from drftjax.effects.catalogue import effect_class
from tests.virtual_cases import case_with

COMPILED = "/jax/core/compile/backend_compile_duration"


@pytest.fixture
def compiled():
    """Every compilation that the test causes."""
    found = []

    def listen(event: str, _: float, **__: object) -> None:
        if event == COMPILED:
            found.append(event)

    jax.monitoring.register_event_duration_secs_listener(listen)
    yield found
    jax.monitoring.unregister_event_duration_listener(listen)


def test_a_warmed_model_compiles_nothing_when_it_predicts(compiled):
    case = case_with()
    filtering = Model((effect_class("measurement_filter"),))
    case.warm(predict, [filtering])
    assert compiled
    compiled.clear()
    for run in range(len(case.candidates)):
        # As a secant step gives it, and as numpy does.
        for log_zeta in (0.0, np.float64(0.01)):
            case.predicted(filtering, run, log_zeta, np.array([0.02]))
    assert not compiled
