"""The diagnosis on small cases: short runs of a wheel with something added, or nothing."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from diagnose.dataset import RigDataset, match_initial_zeta
from diagnose.gap.cross_validation import MAX_LINEAR_STEP, predict_held_out
from diagnose.gap.gap import Gap, gaps, shrinkage
from diagnose.gap.selected_effects import SelectedEffects
from diagnose.hypotheses import set_screening
from diagnose.hypotheses.hypothesis import Hypothesis, linear_start
from diagnose.hypotheses.refinement import refine, relinearize
from diagnose.hypotheses.set_candidates import set_candidates
from diagnose.hypotheses.set_screening import refine_sets
from diagnose.linear.linear_fit import GramMatrices, fit_linear
from diagnose.linear.linearized_runs import linearize_runs
from diagnose.linear.regressors import Regressors
from diagnose.model.augmented_model import shared_model
from diagnose.pipeline import _Diagnosing, _Weighed, diagnose
from diagnose.report.text import step_sentences
from diagnose.selection.verdict import (
    weight_by_name,
)
from diagnose.settings import DEFAULT_SETTINGS
from drftjax.effects.drive import SpeedGain, SpeedHarmonics, SpeedRipple
from drftjax.effects.rig import Drawbar
from drftjax.effects.sensor import SinkageGain, TravelGain
from drftjax.effects.surface import SurfaceSlope
from drftjax.effects.terrain import SlipSoftening
from drftjax.recorded.repeats import group_by_condition
from tests.helpers.rig_datasets import WITHOUT_NEXT_RUN, dataset_with

# One node's map stands for several steps, which is 2 to 5 % here.
LINES = 0.05
# The runs' noise is 20 um [m]: half as much again for plates and steps, and twice as much where a
# run left out lends its zeta nothing.
LEFT, UNSEEN = 30e-6, 40e-6
# Three short runs with 20 um of noise tell a slope over 0.3 m to some tenths of a per cent.
TOLD = 0.01
# Sums of a few doubles, and of straight lines what their slight belief in nothing holds back.
ROUNDING, HELD_BACK = 1e-12, 1e-9
# Four steps come within half a typical size of three of them; a bound in the unit of the size stops
# them two sizes short.
STEPS = 0.5 * 0.1
# Far enough that a run is simulated there, and not taken by a straight line.
APART = 5 * MAX_LINEAR_STEP
# No close call: a tenth for all else together.
SURE = 0.9

CATALOGUE = (Drawbar, SurfaceSlope, TravelGain)


@pytest.fixture(scope="module")
def sloping() -> RigDataset:
    return dataset_with({"name": "surface_slope", "slope": 0.02})


@pytest.fixture(scope="module")
def regressors(sloping, pool) -> Regressors:
    return regressors_of(sloping, CATALOGUE, pool)


def regressors_of(dataset: RigDataset, effects, pool) -> Regressors:
    dataset = dataclasses.replace(dataset, shared=shared_model(effects))
    linearized = linearize_runs(dataset, match_initial_zeta(dataset, pool), pool)
    return Regressors.of(dataset, linearized, effects, pool)


def refined(regressors: Regressors, effect, simulations: int, pool) -> Hypothesis:
    start = linear_start(regressors, [variant(regressors, effect)])
    return refine(regressors, start, simulations, pool)


def variant(regressors: Regressors, effect):
    return next(v for v in regressors.variants if v.effect is effect)


def test_a_lines_column_is_what_a_small_strength_does(regressors):
    dataset, column = regressors.dataset, variant(regressors, Drawbar).columns[0]
    model = linear_start(regressors, [variant(regressors, Drawbar)]).model
    for run, log_zeta in enumerate(regressors.log_zeta):
        both = [dataset.prediction(model, run, log_zeta, np.array([s])) for s in (-0.05, 0.05)]
        change = (both[1] - both[0]) / 0.1
        x = dataset.channels.index("x")
        line = regressors.columns[run][x, :, 1 + column]
        assert np.abs(line - change[x]).max() < LINES * np.abs(change[x]).max()


def test_a_wrong_scales_column_knows_that_the_wheel_starts_elsewhere(sloping, pool):
    regressors = regressors_of(sloping, (SinkageGain,), pool)
    start = linear_start(regressors, [variant(regressors, SinkageGain)])
    exact = relinearize(regressors, start, pool)
    z = sloping.channels.index("z")
    for line, true in zip(regressors.columns, exact.columns, strict=True):
        # A column that forgets the start is 23 % off.
        error = line[z, :, 1] - true[z, :, 1]
        assert np.linalg.norm(error) < LINES * np.linalg.norm(true[z, :, 1])


def test_a_settled_slope_has_its_true_value_and_leaves_the_noise(regressors, pool):
    slope = refine(
        regressors,
        linear_start(regressors, [variant(regressors, SurfaceSlope)]),
        8,
        pool,
    )
    true = 0.02 / slope.model.free[0].scale
    assert slope.coordinates[0] == pytest.approx(true, rel=TOLD)
    for residual in slope.residual:
        assert np.sqrt(np.mean(residual**2)) < LEFT


def test_left_out_runs_are_predicted_by_the_true_effect_alone(regressors, pool):
    slope, gain = (
        refine(
            regressors,
            linear_start(regressors, [variant(regressors, effect)]),
            8,
            pool,
        )
        for effect in (SurfaceSlope, TravelGain)
    )
    z = regressors.dataset.channels.index("z")

    def missed(hypothesis) -> float:
        unseen = predict_held_out(regressors, hypothesis, pool).residual
        return float(np.sqrt(np.mean(np.concatenate([each[z] for each in unseen]) ** 2)))

    assert missed(slope) < UNSEEN < 10 * UNSEEN < missed(gain)


def test_runs_by_the_numbers_of_all_have_the_zeta_that_suits_each_alone(regressors, pool):
    """Whatever the zetas of a fit, which a bed's scatter may hold together against the runs."""
    slope = refined(regressors, SurfaceSlope, 8, pool)
    held_together = dataclasses.replace(
        slope,
        log_zeta=slope.log_zeta + APART,
        residual=[r + APART * slope.by_zeta(run) for run, r in enumerate(slope.residual)],
    )
    own, again = (
        predict_held_out(regressors, each, pool).by_all for each in (slope, held_together)
    )
    assert own is not None
    assert again is not None
    assert again.log_zeta == pytest.approx(own.log_zeta, abs=0.01 * APART)
    for one, other in zip(own.residual, again.residual, strict=True):
        assert np.sqrt(np.mean((one - other) ** 2)) < 0.1 * LEFT


def test_two_forms_of_one_effect_are_no_pair(pool, monkeypatch):
    """The verdict would name one effect, and its numbers stand twice."""
    forms = (SpeedRipple, SpeedHarmonics)
    dataset = dataset_with({"name": "drawbar", "force": 4.0})
    regressors = regressors_of(dataset, (*forms, SurfaceSlope), pool)
    alone = [refined(regressors, each, 1, pool) for each in (*forms, SurfaceSlope)]
    singles = sorted(alone, key=lambda each: -each.score)
    # Which pairs are tried is asked, not what becomes of them.
    monkeypatch.setattr(set_screening, "race", lambda regressors, starts, *_: list(starts))
    pairs = {frozenset(each.names) for each in refine_sets(regressors, singles, singles, pool)}
    assert pairs == {frozenset((form.about.name, "surface_slope")) for form in forms}


def test_a_pair_starts_with_what_straight_lines_give_to_both(regressors, pool):
    gain = refine(
        regressors,
        linear_start(regressors, [variant(regressors, TravelGain)]),
        3,
        pool,
    )
    proposal = next(set_candidates(regressors, [gain], [gain], pool))
    assert proposal.names == {"travel_gain", "surface_slope"}
    pair = proposal.build()
    # The slope's true 20 mm/m alone makes the gap. A straight line's belief shortens its step, so
    # more than half of it is asked, and not all.
    way = pair.coordinates + pair.proposed_step[1]
    strength = way[-1] * pair.model.free[-1].scale
    assert 0.01 < strength < 0.03


def test_repeats_are_one_condition(sloping):
    assert group_by_condition(sloping.runs) == [[0, 1], [2]]


def test_a_slope_is_named_and_its_gap_closed(sloping):
    found = diagnose(sloping, CATALOGUE, settings=WITHOUT_NEXT_RUN)
    assert found.verdict == ("surface_slope",)
    assert found.weights["surface_slope"] > SURE
    # Probabilities that each takes part: a set counts for each of its names.
    assert sum(found.weights.values()) >= 1 - ROUNDING
    assert all(0 <= weight <= 1 for weight in found.weights.values())
    assert found.gap["z"].before > 10 * found.gap["z"].floor
    # All of it, as far as the floor tells.
    assert found.gap["z"].shrinkage > 0.95
    value = found.parameters["surface_slope"]["slope"]
    assert abs(value.value - 0.02) < 4 * value.error
    assert found.document()["verdict"] == ["surface_slope"]
    assert (found.stepwise, step_sentences(found), found.document()["steps"]) == ([], [], [])
    assert any("repeats" in note for note in found.notes)


def test_an_effect_by_which_a_run_left_out_cannot_be_simulated_explains_nothing(
    sloping, monkeypatch
):
    def lost(regressors, hypothesis, pool):
        unseen = predict_held_out(regressors, hypothesis, pool)
        if hypothesis.names != ("surface_slope",):
            return unseen
        first, *others = unseen.residual
        return dataclasses.replace(unseen, residual=[np.full_like(first, np.nan), *others])

    monkeypatch.setattr("diagnose.pipeline.predict_held_out", lost)
    found = diagnose(sloping, CATALOGUE, settings=WITHOUT_NEXT_RUN)
    assert "surface_slope" not in found.weights
    assert all(np.isfinite(gap.after) for gap in found.gap.values())


def test_a_form_has_the_name_of_its_effect_wherever_it_is_reported():
    no_pure_sine = {"cosine": 0.1, "sine": 0.0, "cosine2": 0.0, "sine2": 0.04, "order": 9.0}
    dataset = dataset_with({"name": "speed_harmonics", **no_pure_sine})
    offered = SpeedRipple, SpeedHarmonics, SpeedGain
    found = diagnose(dataset, offered, settings=WITHOUT_NEXT_RUN)
    assert found.chosen.names == ("speed_harmonics",)
    assert found.verdict == ("speed_ripple",)
    assert {*found.parameters} == {"speed_ripple"}
    assert found.budget["x"].is_reducible
    for channel in found.budget.values():
        assert {*channel.effects} == {"speed_ripple"}


def test_nothing_added_is_none():
    found = diagnose(dataset_with(), CATALOGUE, settings=WITHOUT_NEXT_RUN)
    assert found.verdict == ("none",)
    assert found.parameters == {}


def test_one_run_says_what_cannot_be_concluded(sloping):
    alone = RigDataset.of([sloping.runs[0]])
    found = diagnose(alone, CATALOGUE, settings=WITHOUT_NEXT_RUN)
    assert any("One run only" in note for note in found.notes)
    assert any("No run was repeated" in note for note in found.notes)


# Numbers by hand ---------------------------------------------------------------------------------


def made_products() -> GramMatrices:
    """One run and block: zeta moves nothing, a column of ones misses a residual of -2."""
    columns = np.stack([np.zeros(4), np.ones(4), np.full(4, -2.0)], axis=1)
    gram = (columns.T @ columns)[None, None]
    return GramMatrices((("z", "slow"),), gram, np.array([[4]]), np.zeros(1))


def test_a_line_takes_away_what_its_column_can():
    line = fit_linear(made_products(), [0], linear_error=0.0)
    assert line.coefficients[0] == pytest.approx(2.0, rel=HELD_BACK)
    assert line.mean_square[0] == pytest.approx(0.0, abs=HELD_BACK)


def test_a_line_stays_at_its_least():
    line = fit_linear(made_products(), [0], lower=np.array([3.0]), linear_error=0.0)
    assert line.coefficients[0] == pytest.approx(3.0)
    assert line.mean_square[0] == pytest.approx(1.0, rel=HELD_BACK)


def test_a_bound_of_a_strength_counts_in_its_own_unit(pool):
    # A loss of 0.3 is three typical sizes, and may be one, or ten sizes, at most.
    dataset = dataset_with({"name": "slip_softening", "loss": 0.3, "half": 0.01})
    regressors = regressors_of(dataset, (SlipSoftening,), pool)
    start = linear_start(regressors, [regressors.variants[2]])
    found = refine(regressors, start, 4, pool)
    assert found.coordinates[0] * found.model.free[0].scale == pytest.approx(0.3, abs=STEPS)


def test_the_reference_model_leaves_what_it_leaves_wherever(sloping):
    random = np.random.default_rng(0)
    left = [3e-5 * random.standard_normal((2, len(sloping.time(run)))) for run in range(3)]
    found = gaps(sloping, left, left, {"x": 5e-5, "z": 1e-5})
    assert {gap.interval for gap in found.values()} == {(0.0, 0.0)}


def test_shrinkage_counts_from_the_floor():
    assert shrinkage(1.1, 0.6, 0.1) == pytest.approx(0.5)
    assert shrinkage(1.1, 0.05, 0.1) == pytest.approx(1.0)
    assert shrinkage(0.1, 0.1, 0.1) == 0.0


def test_effects_explain_most_of_a_large_gap():
    def selected(*gaps: tuple[float, float]) -> SelectedEffects:
        found = {
            name: Gap(before, after, 1.0, shrinkage(before, after, 1.0), None)
            for name, (before, after) in zip("xz", gaps, strict=True)
        }
        return SelectedEffects((), np.zeros(1), [], found)

    assert selected((50.0, 3.0), (5.0, 1.2)).explains_most()
    assert not selected((50.0, 3.0), (5.0, 2.2)).explains_most()  # z: under three quarters
    assert not selected((4.0, 1.0), (3.0, 1.0)).explains_most()  # not large
    assert not selected((50.0, 3.0), (1.0, 1.3)).explains_most()  # z gets worse
    assert selected((50.0, 3.0), (5.0, 1.2)).leaves_gap
    assert not selected((50.0, 1.4), (5.0, 1.2)).leaves_gap  # half a floor is chance


def test_two_effects_may_explain_a_part_of_a_large_gap():
    def explains(count: int, *gaps: tuple[float, float]) -> bool:
        found = {
            name: Gap(before, after, 1.0, shrinkage(before, after, 1.0), None)
            for name, (before, after) in zip("xz", gaps, strict=True)
        }
        effects = SurfaceSlope(0.01), Drawbar(1.0)
        selected = SelectedEffects(effects[:count], np.zeros(1), [], found)
        assert not selected.explains_most()
        return selected.explains_part()

    assert explains(2, (50.0, 5.0), (10.0, 4.0))
    assert not explains(1, (50.0, 5.0), (10.0, 4.0))
    assert not explains(2, (50.0, 5.0), (10.0, 6.0))  # z: under a half
    assert not explains(2, (4.0, 1.0), (4.0, 1.0))  # not large
    assert not explains(2, (50.0, 5.0), (1.0, 1.3))  # z gets worse


@pytest.mark.parametrize("explaining", [("a",), ("a", "b"), None])
def test_the_smallest_set_that_explains_the_gap_is_named(explaining, monkeypatch):
    """Of a likeliest set and a larger one, each of which may explain a gap of ten floors."""
    share = {("unknown",): 0.9, ("a",): 0.08, ("a", "b"): 0.02}
    one, two = (SimpleNamespace(names=names) for names in list(share)[1:])
    weighed = _Weighed(None, [one, two], {}, share, ("unknown",), [["unknown"]], one)

    def measured(_, weighed, reference):
        # Two floors are a quarter of the gap, and still a gap.
        after = 1.0 if weighed.chosen.names == explaining else 2.0 + 4.0 * (weighed.chosen is one)
        gap = {"x": Gap(10.0, after, 1.0, shrinkage(10.0, after, 1.0), None)}
        return SimpleNamespace(selected=SelectedEffects((), np.zeros(1), [], gap))

    monkeypatch.setattr(_Diagnosing, "measure_gap", measured)
    diagnosing = _Diagnosing(None, None, print, DEFAULT_SETTINGS)
    likeliest = diagnosing.measure_gap(weighed, None)
    found, gap = diagnosing.with_explaining_set(weighed, likeliest, None)
    if explaining is None:
        assert (found, gap) == (weighed, likeliest)
    else:
        assert found.verdict == found.chosen.names == explaining
        assert gap.selected.gap["x"].after == 1.0
        assert weight_by_name(found.share)["unknown"] == pytest.approx(0.27)


@pytest.mark.parametrize(
    ("alone", "left", "named"),
    [(4.5, 4.0, ("a", "b")), (6.0, 6.0, ("unknown",)), (3.5, 4.0, ("unknown",))],
)
def test_a_set_that_explains_a_part_is_named_beside_unknown(alone, left, named, monkeypatch):
    """Of an effect and a set with it, which leave so much of ten floors: with less than alone."""
    share = {("unknown",): 0.95, ("a",): 0.03, ("a", "b"): 0.02}
    one, two = (SimpleNamespace(names=names) for names in list(share)[1:])
    weighed = _Weighed(None, [one, two], {}, share, ("unknown",), [["unknown"]], one)

    def measured(_, weighed, reference):
        after = alone if weighed.chosen is one else left
        gap = {"x": Gap(10.0, after, 1.0, shrinkage(10.0, after, 1.0), None)}
        effects = (SurfaceSlope(0.01), Drawbar(1.0))[: len(weighed.chosen.names)]
        return SimpleNamespace(selected=SelectedEffects(effects, np.zeros(1), [], gap))

    monkeypatch.setattr(_Diagnosing, "measure_gap", measured)
    diagnosing = _Diagnosing(None, None, print, DEFAULT_SETTINGS)
    found, _ = diagnosing.with_explaining_set(weighed, diagnosing.measure_gap(weighed, None), None)
    assert found.verdict == named
    if named == ("a", "b"):
        # Six tenths of 0.95 and its own; a remainder is as good as sure.
        weight = weight_by_name(found.share)
        assert weight["b"] == pytest.approx(0.02 + 0.6 * 0.95)
        assert weight["unknown"] == pytest.approx(0.95)
