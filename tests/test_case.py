"""The runs of one rig made ready: programs that are compiled once."""

import numpy as np

from diagnose.response import Model, predict
from drftjax.effects.catalogue import effect_class
from tests.virtual_cases import case_with


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
