"""What to run next: a run on which two explanations of the same runs part."""

import dataclasses

import numpy as np
import pytest

from diagnose.dataset import RigDataset
from diagnose.hypotheses.screening import screen_effects
from diagnose.hypotheses.settings import ScreeningSettings
from diagnose.next_runs.discrimination import (
    DEFAULT_NEXT_RUN,
    NextRunSettings,
    _path_lengths,
    _stop_and_go,
    _variations,
    _with_speed_scaled,
    next_run,
)
from drftjax.effects.catalogue import effect_class
from tests.helpers.rig_datasets import WITH_REST, dataset_with
from tests.helpers.synthetic_runs import SLOW, coarse, recorded, setup_of

# Pairs are not looked for.
ALONE = ScreeningSettings(pair_floor=np.inf)
FLOORS = {"x": 80e-6, "z": 30e-6}
# Sums of speeds over time, of metres.
ROUNDING = 1e-12
NAMES = ("drawbar", "horizontal_coulomb", "bulldozing")


@pytest.fixture(scope="module")
def pulled():
    return dataset_with({"name": "drawbar", "force": 4.0}, settings=WITH_REST)


@pytest.fixture(scope="module")
def three(pulled, pool):
    # All pull back all the while as long as the carriage only goes forward.
    screened = screen_effects(pulled, [*map(effect_class, NAMES)], pool, settings=ALONE)
    singles = {each.names: each for each in screened.singles}
    return [singles[(name,)] for name in NAMES]


@pytest.fixture(scope="module")
def both(three):
    return three[:2]


@pytest.fixture(scope="module")
def advice(both, pulled, pool):
    return next_run(pulled, both[0], [both[1]], FLOORS, pool)


def test_it_names_the_run_that_parts_two_explanations(advice):
    assert advice["tells"] == list(NAMES[:2])
    assert "backward" in advice["run"]["run"]
    assert advice["run"]["floors"] > DEFAULT_NEXT_RUN.min_floors


def test_the_runs_that_may_be_proposed_can_be_varied(pulled):
    light = NextRunSettings(speed_factors=(2.0,), load_factors=(0.5,))
    words = [each.words for each in _variations(pulled, 0, light)]
    assert sum("at " in each for each in words) == 1
    (loaded,) = [each for each in _variations(pulled, 0, light) if each.words.endswith(" kg")]
    mass = float(pulled.trials[0].simulator.rig.mass_z)
    assert float(loaded.trial.simulator.rig.mass_z) == pytest.approx(0.5 * mass)


def test_it_names_a_channel_that_would_part_them_on_a_run_as_made(both, pulled, pool):
    # A force and a friction of one size differ where the wheel stands: in torque, by 0.14 N m.
    enough = NextRunSettings(min_floors=1.0)
    found = next_run(pulled, both[0], [both[1]], FLOORS, pool, enough)["channel"]
    assert (found["channel"], found["unit"]) == ("torque", "N m")
    assert found["floors"] > enough.min_floors
    more = NextRunSettings(min_floors=found["floors"] + 0.1)
    assert next_run(pulled, both[0], [both[1]], FLOORS, pool, more)["channel"] is None


def test_no_run_goes_farther_than_the_longest_so_far(pulled):
    farthest = max(_path_lengths(each.trial)[-1] for each in pulled.runs)
    found = {each.words: each for each in _variations(pulled, 0)}
    cut = [each for words, each in found.items() if "its first" in words and "deg/s" in words]
    assert cut
    for each in found.values():
        if "deg/s" in each.words and "stop" not in each.words:
            lasts = min(each.duration, float(np.asarray(each.trial.time)[-1]))
            gone = np.interp(lasts, np.asarray(each.trial.time), _path_lengths(each.trial))
            assert gone <= farthest * (1 + ROUNDING)


def test_no_run_outlasts_a_command_that_ends_in_motion(pulled):
    (end,) = {float(each.trial.time[-1]) for each in pulled.runs[:2]}
    assert pulled.trials[0].time[-1] > end
    for each in _variations(pulled, 0):
        assert each.duration <= end, each.words


def test_a_run_the_other_way_is_asked_for_where_none_was_made(pulled):
    def ways(case) -> list[str]:
        return [v.words for v in _variations(case, 0) if v.words.endswith(("backward", "forward"))]

    def turned(each):
        return dataclasses.replace(each, trial=_with_speed_scaled(each.trial, -1.0))

    name = pulled.runs[0].name
    assert ways(pulled) == [f"{name} backward"]
    assert ways(RigDataset.of([turned(each) for each in pulled.runs])) == [f"{name} forward"]
    first, *others = pulled.runs
    assert ways(RigDataset.of([turned(first), *others])) == []


def test_a_driven_carriage_goes_with_its_wheel(pulled):
    trial = pulled.trials[0]
    slip = 0.2
    vx = (1 - slip) * float(trial.simulator.wheel.radius) * trial.omega
    driven = dataclasses.replace(trial, vx=vx)
    for each in (
        _with_speed_scaled(driven, 2.0),
        _with_speed_scaled(driven, -1.0),
        _stop_and_go(driven, 0.8),
    ):
        expected = (1 - slip) * float(trial.simulator.wheel.radius) * np.asarray(each.omega)
        np.testing.assert_allclose(np.asarray(each.vx), expected, rtol=0, atol=ROUNDING)


def test_stop_and_go_starts_and_stops(pulled):
    trial = _stop_and_go(pulled.trials[0], top=0.8)
    time, omega = np.asarray(trial.time), np.asarray(trial.omega)
    assert omega[0] == omega[1] == 0
    assert set(np.unique(omega)) == {0.0, 0.8}
    # What is simulated of it holds a start and a stop at least.
    until = time <= trial.rows * trial.every * float(trial.step)
    assert np.count_nonzero(np.diff(omega[until] > 0)) >= 2


@pytest.mark.parametrize("channels", [("z",), ("z", "fz")])
def test_runs_without_travel_are_advised_too(channels, pool):
    vx = [0.0, 0.0, 0.05, 0.05] if "fz" in channels else None
    runs = [
        coarse(
            f"run {n}", recorded(setup_of(SLOW, zeta, vx), n, channels=channels, force_noise=1.0)
        )
        for n, zeta in enumerate((0.75, 0.76))
    ]
    case = RigDataset.of(runs)
    effects = [effect_class("vertical_spring"), effect_class("loosening")]
    found = screen_effects(case, effects, pool, settings=ALONE)
    floors = dict.fromkeys(case.channels, 1e-9)
    first, second = found.none, found.singles[0]
    told = next_run(case, first, [second], floors, pool)
    compared = {"z", "fx", "fz", "torque"} if "fz" in channels else {"x", "z", "torque"}
    asked = [each for each in (told["run"], told["channel"]) if each is not None]
    assert told["tells"] == ["none", *second.names]
    assert {each["channel"] for each in asked} <= compared


def test_one_run_is_to_part_an_explanation_from_all_its_rivals(three, pulled, pool):
    first, second, third = three
    both = next_run(pulled, first, [second, third], FLOORS, pool)
    each = [
        next_run(pulled, first, [rival], FLOORS, pool)["run"]["floors"] for rival in (second, third)
    ]
    assert both["tells"] == [*NAMES]
    # What parts two rivals parts each of them, and no better than the run that is best for it.
    assert DEFAULT_NEXT_RUN.min_floors < both["run"]["floors"] <= min(each) * (1 + ROUNDING)


def test_where_no_run_parts_all_the_likeliest_rival_counts(both, pulled, pool):
    first, second = both
    # Nothing parts an explanation from itself.
    told = next_run(pulled, first, [second, first], FLOORS, pool)
    assert told == next_run(pulled, first, [second], FLOORS, pool)
