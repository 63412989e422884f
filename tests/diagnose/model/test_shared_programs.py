"""Curves that are fitted: one program of a stage gives what each curve's own class gives."""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diagnose.dataset import RigDataset, with_zeta
from diagnose.model.augmented_model import (
    AugmentedModel,
    directions_within,
    predict,
    predict_with_jacobian,
    program_within,
    with_effects,
)
from diagnose.model.shared_programs import MIN_KNOT_COUNT, in_modes, program_of
from drftjax.common.arrays import as_real
from drftjax.effects.correction import (
    STAGES,
    correction_class,
    correction_variables,
    fields,
    with_values,
)
from drftjax.effects.drive import Backlash
from drftjax.effects.rig import Drawbar
from drftjax.effects.sensor import MeasurementFilter, TravelGain
from drftjax.effects.terrain import Loosening
from drftjax.recorded.batch import PaddedObservations, between_rows
from drftjax.simulation.trial import Trial
from tests.helpers.synthetic_runs import coarse, recorded, setup_of

# The program interpolates in a longer row and picks its variable by products with 0 and 1: each
# step rounds once more, and a run of 2,000 steps gathers 1e-13 m, as does a derivative by a unit.
ROUNDING = 1e-12

PLACES = {
    "angular velocity": (0.1, 0.4, 0.7, 0.9),
    "slip speed": (-0.01, 0.0, 0.01, 0.03),
    "sinkage": (0.01, 0.02, 0.025, 0.03),
    "travel": (0.0, 0.05, 0.1, 0.2),
    "turning": (0.0, 0.5, 1.0, 2.0),
    "time": (0.0, 0.5, 1.0, 2.0),
    "wheel angle": (0.3, 1.0, 3.0, 5.0),
    "vx": (0.0, 0.02, 0.05, 0.1),
    "vz": (-0.01, -0.001, 0.001, 0.01),
}
HEIGHTS = np.array([0.5, -1.0, 0.25, 1.5])


@cache
def dataset() -> RigDataset:
    setup = setup_of(([0.0, 0.25, 0.75, 2.0], [0.0, 0.0, 1.0, 1.0]), 0.75)
    setup.integrator.step = 1e-3
    return RigDataset.of([coarse("run", recorded(setup), step=1e-3)])


def of_trial(trial: Trial, observed: PaddedObservations) -> jax.Array:
    return between_rows(trial.run_to(observed.compared_rows, ("x", "z")), observed)


def zeta_of(trial: Trial):
    return trial.simulator.terrain.zeta.value


def simulated(kind, values) -> np.ndarray:
    """The run with the curve's own class in the simulator."""
    trial = with_effects(dataset().trials[0], (with_values(kind, values),))
    return np.asarray(jax.jit(of_trial)(trial, dataset().observations[0]))


def predicted(kind, coordinates) -> np.ndarray:
    of = dataset().channels, dataset().trials[0], dataset().observations[0], as_real(0.0)
    return np.asarray(predict(AugmentedModel((kind,)), *of, np.asarray(coordinates)))


# zeta may follow all variables there are; the other stages tell theirs in their own ways.
STANDING = [("zeta", variable) for variable in correction_variables("zeta")]
STANDING += [
    (stage, variable)
    for stage in ("force_z", "speed", "height", "reading z")
    for variable in (correction_variables(stage)[0], correction_variables(stage)[-1])
]


@pytest.mark.parametrize(("stage", "variable"), STANDING)
def test_the_program_runs_as_the_curve_does(stage, variable):
    kind = correction_class(stage, variable, PLACES[variable])
    typical = STAGES[stage][2]
    of_class = simulated(kind, (typical * HEIGHTS).tolist())
    assert np.abs(predicted(kind, HEIGHTS) - of_class).max() < ROUNDING
    assert np.abs(of_class - predicted(kind, 0 * HEIGHTS)).max() > 1e3 * ROUNDING


def test_curves_of_a_stage_share_one_program():
    kinds = [correction_class("zeta", v, PLACES[v]) for v in ("travel", "wheel angle", "vz")]
    kinds.append(in_modes(kinds[0], np.eye(4)[:, :2], 1.0))
    assert len({program_of(each).effect for each in kinds}) == 1
    assert len({AugmentedModel((each,)).program[0] for each in kinds}) == 1


def test_a_curve_of_more_knots_than_the_row_has_a_longer_one():
    knots = np.linspace(0, 0.2, MIN_KNOT_COUNT + 3)
    kind = correction_class("zeta", "travel", knots.tolist())
    values = 0.1 * np.sin(30 * knots)
    assert len(fields(MIN_KNOT_COUNT + 3)) == len(program_of(kind).mix)
    assert np.abs(predicted(kind, values / 0.1) - simulated(kind, values)).max() < ROUNDING


def test_modes_are_the_curve_that_they_add_up_to():
    kind = correction_class("force_z", "travel", PLACES["travel"])
    modes = np.array([[1.0, 0.0], [2.0, 1.0], [0.0, -1.0], [0.5, 0.5]])
    amplitudes, typical = np.array([1.5, -2.0]), 0.5
    summed = typical * modes @ amplitudes
    of_modes = predicted(in_modes(kind, modes, typical), amplitudes)
    assert np.abs(of_modes - simulated(kind, summed.tolist())).max() < ROUNDING


def test_the_derivative_is_by_the_effects_own_coordinates():
    kind = in_modes(
        correction_class("zeta", "travel", PLACES["travel"]),
        np.array([[1.0], [0.5], [0.0], [-1.0]]),
        0.2,
    )
    # The gain of a reading beside it stays a number of its own.
    model = AugmentedModel((TravelGain, kind))
    at = np.array([*(0.3 for _ in range(len(model.free) - 1)), 0.5])
    of = dataset().channels, dataset().trials[0], dataset().observations[0], as_real(0.01)
    value, slope = predict_with_jacobian(directions_within(model, AugmentedModel()), *of, at)
    assert slope.shape == (*value.shape, 1 + len(at))
    trial = with_zeta(dataset().trials[0], 0.01)
    observed = dataset().observations[0]

    def of_class(both):
        scaled = eqx.tree_at(zeta_of, trial, zeta_of(trial) * jnp.exp(both[0]))
        return of_trial(with_effects(scaled, model.build(both[1:])), observed)

    exact = jax.jit(jax.jacfwd(of_class))(np.array([0.0, *at]))
    assert np.abs(slope - np.asarray(exact)).max() < ROUNDING


def test_any_other_effect_is_its_own_program():
    program = program_of(TravelGain)
    assert program.effect is TravelGain
    assert not program.held
    assert np.array_equal(program.mix, np.eye(len(program.mix)))


def test_a_program_of_many_effects_differentiates_a_model_of_few_by_its_own_coordinates():
    few = AugmentedModel((MeasurementFilter, TravelGain))
    many = AugmentedModel((Drawbar, TravelGain, Loosening, MeasurementFilter))
    of = dataset().channels, dataset().trials[0], dataset().observations[0], as_real(0.01)
    at = few.null() + np.linspace(0.3, 0.5, len(few.free))
    within, alone = directions_within(few, many), directions_within(few, AugmentedModel())
    assert within.program is many
    assert alone.program == few
    value, slope = predict_with_jacobian(within, *of, at)
    expected_value, expected = predict_with_jacobian(alone, *of, at)
    assert slope.shape == expected.shape == (*value.shape, 1 + len(few.free))
    # Both readings are linear, and act in another order: filter and gain of x may be exchanged.
    assert np.abs(value - expected_value).max() < ROUNDING
    assert np.abs(slope - expected).max() < ROUNDING
    assert np.abs(slope).max(axis=(0, 1)).min() > 1e-5


def test_a_program_of_many_effects_simulates_a_model_of_few():
    shared = AugmentedModel((Drawbar, TravelGain, MeasurementFilter))
    few = AugmentedModel((Loosening, TravelGain))
    program = program_within(few, shared)
    assert program.model.effects == (*shared.effects, Loosening)
    of = dataset().channels, dataset().trials[0], dataset().observations[0], as_real(0.01)
    at = few.null() + np.linspace(0.3, 0.5, len(few.free))
    alone, within = predict(few, *of, at), predict(few, *of, at, shared)
    assert np.abs(within - alone).max() < ROUNDING
    assert np.abs(alone - predict(few, *of, few.null())).max() > 1e3 * ROUNDING


@pytest.mark.parametrize(
    "model",
    [
        AugmentedModel(),
        AugmentedModel((Drawbar,), shapes_are_free=False),
        AugmentedModel((MeasurementFilter, TravelGain)),
        AugmentedModel((Drawbar, correction_class("zeta", "travel", PLACES["travel"]))),
    ],
    ids=["reference", "shapes held", "another order of readings", "a curve"],
)
def test_a_model_that_another_cannot_stand_for_has_a_program_of_its_own(model):
    shared = AugmentedModel((Drawbar, TravelGain, MeasurementFilter))
    assert program_within(model, shared).model == model.program[0]


def test_models_of_as_many_numbers_share_a_program():
    many = AugmentedModel((Drawbar, TravelGain, Loosening, MeasurementFilter))
    one, other = (directions_within(AugmentedModel((e,)), many) for e in (Drawbar, TravelGain))
    assert one.key == other.key
    assert directions_within(AugmentedModel((Backlash,)), many).key != one.key
