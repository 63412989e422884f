"""The budget of the gap adds up, and divides it as the effects' own contributions do."""

import itertools
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnose.gap.budget import (
    BudgetShare,
    ChannelBudget,
    doubted_weights,
    gap_budget,
    shapley_values,
)
from diagnose.gap.cross_validation import HeldOutPrediction
from diagnose.gap.one_zeta import predicted_zetas

# Sums of a few numbers of size one, in double precision.
ROUNDING = 1e-12
# Zeta lifts the bench's wheel by a straight line, on which secants end in a step or two.
MATCHED = 1e-9


def by_permutations(value, players: int) -> np.ndarray:
    """Shapley values by their definition: the mean over all orders of joining."""
    found = np.zeros(players)
    for order in itertools.permutations(range(players)):
        mask = 0
        for player in order:
            found[player] += value(mask | 1 << player) - value(mask)
            mask |= 1 << player
    return found / math.factorial(players)


def test_shapley_values_are_the_mean_over_all_orders():
    worth = np.random.default_rng(3).standard_normal(16)
    worth[0] = 0.0
    found = shapley_values(lambda mask: worth[mask], 4)
    assert found == pytest.approx(by_permutations(lambda mask: worth[mask], 4), abs=ROUNDING)
    assert found.sum() == pytest.approx(worth[15], abs=ROUNDING)


def test_shapley_values_of_gloves_and_of_a_sum_are_known():
    """A left glove and two right ones; a pair is worth one."""
    left, right = 0b001, 0b110
    gloves = shapley_values(lambda mask: float(bool(mask & left) and bool(mask & right)), 3)
    assert gloves == pytest.approx([2 / 3, 1 / 6, 1 / 6], abs=ROUNDING)
    cost = np.array([3.0, -1.0, 0.5, 7.0])
    added = shapley_values(lambda m: 2 + sum(c for k, c in enumerate(cost) if m >> k & 1), 4)
    assert added == pytest.approx(cost, abs=ROUNDING)


class Bench:
    """Runs whose effects add: a signal each; the last may also act as another zeta does."""

    channels = ("x", "z")
    run_numbers = range(2)

    def __init__(self, signals: np.ndarray, left: np.ndarray, as_zeta: float):
        self.signals, self.as_zeta = signals, as_zeta
        setup = SimpleNamespace()
        self.runs = [SimpleNamespace(name=name, setup=setup) for name in "ab"]
        every: Any = None
        self.recorded = self.prediction(every, 0, 0.0, np.ones(len(signals))) - left

    def map(self, pool, work):
        return [work(run) for run in self.run_numbers]

    def sample_interval(self, run: int) -> float:
        return 0.01

    def recording(self, run: int) -> np.ndarray:
        return self.recorded

    def prediction(self, model, run: int, log_zeta: float, coordinates: np.ndarray) -> np.ndarray:
        zeta = log_zeta - self.as_zeta * (coordinates[-1] - 1)
        # Zeta lifts the wheel, and moves it along by no straight line.
        ahead = 0.5 * zeta**2 * np.linspace(0, 1, self.signals.shape[-1])
        by_zeta = np.stack([ahead, np.full(len(ahead), zeta)])
        return by_zeta - np.einsum("e,ecs->cs", coordinates, self.signals)


def budget_of(
    monkeypatch, signals: np.ndarray, left: np.ndarray, floors: dict, errors=(), as_zeta=0.0
):
    monkeypatch.setattr("diagnose.gap.budget.group_by_condition", lambda runs: [[0], [1]])
    names = tuple("abc"[: len(signals)])
    free = [SimpleNamespace(index=k, scale=1.0) for k in range(len(signals))]
    hypothesis: Any = SimpleNamespace(
        names=names,
        model=SimpleNamespace(free=free),
        by_zeta=lambda run: np.stack([np.zeros(left.shape[1]), np.ones(left.shape[1])]),
    )
    bench: Any = Bench(signals, left, as_zeta)
    ones = np.ones((2, len(signals)))
    prediction = HeldOutPrediction(bench, hypothesis, np.zeros(2), ones, [left] * 2)
    before = [left + signals.sum(axis=0)] * 2
    pool: Any = SimpleNamespace(map=lambda of, runs: [of(run) for run in runs])
    return gap_budget(prediction, before, [left] * 2, floors, dict(errors), names, pool)


def zero_mean(rows: np.ndarray) -> np.ndarray:
    """Signals without a mean in z, which another zeta would take."""
    return rows - rows.mean(axis=-1, keepdims=True)


def test_effects_at_different_times_share_a_gap_as_the_orders_of_adding_do(monkeypatch):
    time = np.arange(400)
    signals = np.zeros((2, 2, 400))
    signals[0, 0, time < 200] = 4e-3
    signals[1, 0, time >= 200] = 3e-3
    signals[:, 1] = zero_mean(signals[:, 0])
    left = 1e-4 * zero_mean(np.random.default_rng(0).standard_normal((2, 400)))
    found = budget_of(monkeypatch, signals, left, {"x": 1e-5, "z": 1e-5})["x"]

    def gap(kept: int) -> float:
        lacking = [signals[k, 0] for k in range(2) if not kept >> k & 1]
        return float(np.sqrt(np.mean(np.square(left[0] + sum(lacking)))))

    expected = by_permutations(lambda kept: gap(0) - gap(kept), 2)
    sizes = [found.effects[name].size for name in "ab"]
    assert sizes == pytest.approx(expected, rel=1e-9)
    assert sizes[0] > sizes[1] > 0


def test_shares_remainder_and_chance_add_up_to_the_gap(monkeypatch):
    random = np.random.default_rng(1)
    signals = zero_mean(1e-3 * random.standard_normal((3, 2, 300)))
    left = zero_mean(2e-4 * random.standard_normal((2, 300)))
    floors = {"x": 5e-5, "z": 4e-4}  # z: all that is left is chance
    for channel, found in budget_of(monkeypatch, signals, left, floors).items():
        shares = sum(each.share for each in found.effects.values())
        assert shares + found.remainder == pytest.approx(1.0, abs=ROUNDING)
        sizes = sum(each.size for each in found.effects.values())
        whole = sizes + found.remainder * (found.before - found.floor) + found.floor
        assert whole == pytest.approx(found.before, rel=1e-9)
        assert (found.remainder == 0.0) == (channel == "z")


def test_what_zeta_makes_up_for_is_nobodys_share(monkeypatch):
    """Nor is what zeta moves by no straight line: of an effect that halves it the rest counts."""
    signals = zero_mean(1e-3 * np.random.default_rng(2).standard_normal((2, 2, 300)))
    left, floors = np.zeros((2, 300)), {"x": 1e-5, "z": 1e-5}
    plain = budget_of(monkeypatch, signals, left, floors)
    halved = budget_of(monkeypatch, signals, left, floors, as_zeta=float(np.log(2)))
    for channel in "xz":
        for name in "ab":
            share = plain[channel].effects[name].share
            assert halved[channel].effects[name].share == pytest.approx(share, abs=MATCHED)


def test_a_number_that_the_runs_hardly_tell_widens_its_share(monkeypatch):
    signals = zero_mean(1e-3 * np.random.default_rng(4).standard_normal((2, 2, 300)))
    left = np.zeros((2, 300))
    floors = {"x": 1e-5, "z": 1e-5}

    def width(**errors: float) -> float:
        low, high = budget_of(monkeypatch, signals, left, floors, errors)["x"].effects["a"].interval
        return high - low

    assert width(a=0.5) > 5 * width(a=0.01) > 0


def test_a_condition_is_predicted_by_the_others():
    zetas = np.log([0.8, 0.82, 0.9, 1.0])
    found = predicted_zetas(zetas, [[0, 1], [2], [3]])
    assert found[:2] == pytest.approx([zetas[2:].mean()] * 2)
    assert found[3] == pytest.approx(zetas[:3].mean())
    assert predicted_zetas(zetas, [[0, 1, 2, 3]]) == pytest.approx([zetas.mean()] * 4)


def channel_budget(before: float, after: float, sizes: dict[str, float]) -> ChannelBudget:
    """Budget of a channel with a floor of one."""
    excess = before - 1
    parts = {
        name: BudgetShare(size / excess, (size / excess,) * 2, size) for name, size in sizes.items()
    }
    return ChannelBudget(before, after, 1.0, parts, (after - 1) / excess)


def test_an_effect_that_does_little_beside_what_is_left_is_not_sure():
    weights = {"backlash": 0.99, "heap": 0.98, "imbalance": 0.97, "unknown": 0.9, "drawbar": 0.3}
    x = channel_budget(100.0, 5.0, {"backlash": 90.0, "heap": 3.0, "imbalance": -1.0})
    z = channel_budget(9.0, 1.0, {"backlash": 0.0, "heap": 0.5, "imbalance": 6.0})
    found = doubted_weights(weights, {"x": x, "z": z}, "unknown")
    # The imbalance does little in x, where a gap is left, and nearly all in z.
    assert found == {**weights, "heap": 0.7}
    assert list(found) == ["backlash", "imbalance", "unknown", "heap", "drawbar"]
    # A weight below that stays as it is, and where no gap is left small effects are sure.
    faint = {**weights, "heap": 0.2}
    assert doubted_weights(faint, {"x": x, "z": z}, "unknown") == faint
    closed = channel_budget(100.0, 1.2, {"backlash": 90.0, "heap": 2.0, "imbalance": -1.0})
    sure = {name: weight for name, weight in weights.items() if name != "unknown"}
    assert doubted_weights(sure, {"x": closed, "z": z}, "unknown") == sure
    assert doubted_weights(weights, {}, "unknown") == weights


def test_few_floors_that_are_left_make_nothing_unknown_sure():
    weights = {"backlash": 0.99, "unknown": 0.98}
    z = channel_budget(90.0, 2.9, {"backlash": 85.0})
    assert doubted_weights(weights, {"z": z}, "unknown") == {**weights, "unknown": 0.7}
    # Three floors in one channel are enough.
    x = channel_budget(90.0, 3.1, {"backlash": 85.0})
    assert doubted_weights(weights, {"x": x, "z": z}, "unknown") == weights
    # Alone it is the verdict, however small the gap.
    alone = channel_budget(2.9, 2.9, {})
    assert doubted_weights({"unknown": 0.98}, {"z": alone}, "unknown") == {"unknown": 0.98}
