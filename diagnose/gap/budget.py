r"""Budget of the gap: from the reference model down to the noise floor, divided by effect.

With the model of a set S of the chosen effects the gap of a channel is v(S), the root mean square
of its residual on held-out runs. The share of an effect is its Shapley value: the mean, over all
orders in which the effects may be added, of what the gap falls by when it is (Shapley 1953, "A
value for n-person games"; Lundberg & Lee 2017). Shares, the remainder (what all effects leave above
the floor) and chance (the floor) add up to the gap of the reference model.

A set's residual is that of the whole model and the contributions of the effects that it lacks,
$r(S) = r + \sum_{i \notin S} c_i$. $c_i$ is the mean of what effect i changes in a run beside all
others and alone, both simulated at the matched zeta (to first order, where none is found: the mean
of its change of height is taken off by the response to zeta). What of the reference model's
residual these leave, as effects do not just add, is divided among them by their size.
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.dataset import RigDataset
from diagnose.gap.cross_validation import HeldOutPrediction
from diagnose.gap.gap import MM_PER_M, is_reducible
from diagnose.gap.zeta_matching import MatchedRun, match_zeta
from diagnose.model.augmented_model import AugmentedModel
from diagnose.run_pool import RunPool
from drftjax.recorded.matched_zeta import ZetaMatchSettings
from drftjax.recorded.repeats import group_by_condition

BUDGET_MATCH = ZetaMatchSettings(min_step=2e-4)


@dataclass(frozen=True)
class BudgetSettings:
    """Numbers of a budget.

    Attributes:
        min_sure_size: An effect is sure only if it makes up for more than this many times what is
            left of some channel, where a gap is left [-].
        min_sure_remainder: That something unknown acts beside the effects is sure only where they
            leave more than this in some channel [noise floors]. What differs in form only leaves
            as much.
        most_doubted: Weight of others at most [-]: about the share of such names that were right in
            the fresh sets with which it was chosen (docs/results/blind.md).
        draws: Draws of conditions and of the effects' numbers.
        probability: Of an interval [-].
        seed: Of the draws: fixed, so that the same runs give the same intervals.
        match: Numbers of the search for a matched zeta: mean sinkages are matched to a few
            micrometres, a tenth of the noise.
    """

    min_sure_size: float = 2.0
    min_sure_remainder: float = 3.0
    most_doubted: float = 0.7
    draws: int = 200
    probability: float = 0.9
    seed: int = 0
    match: ZetaMatchSettings = BUDGET_MATCH


DEFAULT_BUDGET = BudgetSettings()


@dataclass(frozen=True)
class BudgetShare:
    """One effect's part of the gap of one channel.

    Attributes:
        share: Of the gap above the noise floor [-]; negative where the effect makes it larger.
        interval: Its 90 % interval [-]: of conditions and of the effect's numbers drawn again.
        size: The same part of the gap [m, N, N m].
    """

    share: float
    interval: tuple[float, float]
    size: float

    def document(self) -> dict:
        """Plain values; lengths in mm."""
        return {
            "share": self.share,
            "interval": list(self.interval),
            "size": self.size * MM_PER_M,
        }


@dataclass(frozen=True)
class ChannelBudget:
    """Budget of one channel, in SI units.

    Attributes:
        before, after: Gap of the reference model and of the one with all effects [m, N, N m].
        floor: Noise floor [m, N, N m].
        effects: By name. Shares and `remainder` add up to one; sizes, `remainder` times the gap
            above the floor, and the floor to `before`.
        remainder: Share of the gap above the floor that all effects leave [-].
    """

    before: float
    after: float
    floor: float
    effects: Mapping[str, BudgetShare]
    remainder: float

    @property
    def is_reducible(self) -> bool:
        """True where the gap lies far enough above the floor to be divided."""
        return is_reducible(self.before, self.floor)

    def document(self) -> dict:
        """Plain values; lengths in mm."""
        return {
            "before": self.before * MM_PER_M,
            "after": self.after * MM_PER_M,
            "floor": self.floor * MM_PER_M,
            "effects": {name: each.document() for name, each in self.effects.items()},
            "remainder": self.remainder,
            "chance": min(self.floor, self.before) * MM_PER_M,
        }


def doubted_weights(
    weights: Mapping[str, float],
    budget: Mapping[str, ChannelBudget],
    remainder: str,
    settings: BudgetSettings = DEFAULT_BUDGET,
) -> dict[str, float]:
    """Weights by which no effect is sure that does little beside the gap that is left.

    What a model lacks is never quite of the form of a listed effect. Where a gap is left, something
    else acts, and an effect that is not much larger may stand for a part of it. A gap of few floors
    is what a form leaves, and makes nothing else sure.

    Args:
        weights: By name [-].
        budget: By channel, of the effects of the verdict.
        remainder: Name of what acts beside them.
        settings: Numbers of the doubt.

    Returns:
        By name [-], heaviest first.
    """
    found = dict(weights)
    if any(is_reducible(each.after, each.floor) for each in budget.values()):
        divided = [each for each in budget.values() if each.is_reducible]
        for name in {name for each in divided for name in each.effects}:
            beside = max(abs(e.effects[name].size) / max(e.after, e.floor) for e in divided)
            if name in found and beside < settings.min_sure_size:
                found[name] = min(found[name], settings.most_doubted)
    left = max((e.after / e.floor for e in budget.values() if e.effects), default=np.inf)
    if remainder in found and left < settings.min_sure_remainder:
        found[remainder] = min(found[remainder], settings.most_doubted)
    return dict(sorted(found.items(), key=lambda each: -each[1]))


Budget = Mapping[str, ChannelBudget]


def gap_budget(
    prediction: HeldOutPrediction,
    before: Sequence[np.ndarray],
    after: Sequence[np.ndarray],
    floors: Mapping[str, float],
    strength_errors: Mapping[str, float],
    names: Sequence[str],
    pool: RunPool,
    settings: BudgetSettings = DEFAULT_BUDGET,
) -> dict[str, ChannelBudget]:
    """Budget of every channel.

    Args:
        prediction: Held-out runs by the chosen hypothesis.
        before, after: Residual of each run by the reference model and by the chosen hypothesis, at
            matched zeta [m, N, N m], shape (channels, samples).
        floors: Noise floor of each channel [m, N, N m].
        strength_errors: By effect, relative standard error of its strength [-].
        names: Names to report, in the order of the hypothesis's effects.
        pool: Threads.
        settings: Numbers of the intervals.
    """
    dataset = prediction.dataset
    parts = contributions(prediction, before, after, pool, settings)
    groups = group_by_condition(dataset.runs)
    random = np.random.default_rng(settings.seed)
    picked = random.integers(0, len(groups), (settings.draws, len(groups)))
    errors = np.array([min(strength_errors.get(name, 0.0), 1.0) for name in names])
    scales = random.standard_normal((settings.draws, len(names))) * errors
    found = {}
    for index, channel in enumerate(dataset.channels):
        products = np.array([_products(dataset, group, index, after, parts) for group in groups])
        duration = np.array([_duration(dataset, group, index, before) for group in groups])
        # In the order of what they show: draws must not depend on how files are named.
        order = np.lexsort(products.reshape(len(groups), -1).T)
        products, duration = products[order], duration[order]
        whole = products.sum(axis=0) / (duration.sum() or 1.0)
        floor = floors[channel]
        gap, left, sizes = _divided(whole, floor)
        drawn = np.array(
            [
                _shares(products[p].sum(axis=0) / (duration[p].sum() or 1.0), floor, scale)
                for p, scale in zip(picked, scales, strict=True)
            ]
        )
        excess = gap - floor
        shares = sizes / excess if excess > 0 else np.zeros(len(names))
        tail = (1 - settings.probability) / 2
        low, high = np.quantile(drawn, [tail, 1 - tail], axis=0)
        found[channel] = ChannelBudget(
            gap,
            left,
            floor,
            {
                name: BudgetShare(
                    float(share),
                    (float(min(a, share)), float(max(b, share))),
                    float(size) if excess > 0 else 0.0,
                )
                for name, share, a, b, size in zip(names, shares, low, high, sizes, strict=True)
            },
            float(max(left - floor, 0) / excess) if excess > 0 else 0.0,
        )
    return found


def contributions(
    prediction: HeldOutPrediction,
    before: Sequence[np.ndarray],
    after: Sequence[np.ndarray],
    pool: RunPool,
    settings: BudgetSettings = DEFAULT_BUDGET,
) -> list[np.ndarray]:
    """Contribution of each effect by run [m, N, N m], shape (effects, channels, samples).

    Arguments as for `gap_budget`. The contributions of a run add up to `before` less `after`.
    """
    dataset, hypothesis = prediction.dataset, prediction.hypothesis
    count, z = len(hypothesis.names), dataset.channels.index("z")
    alone = [1 << place for place in range(count)]
    beside = [sum(alone) - one for one in alone]

    def left(run: int, kept: int) -> np.ndarray:
        """Residual of a run with some of the effects, at its matched zeta."""
        log_zeta, by_zeta = prediction.log_zeta[run], hypothesis.by_zeta(run)
        at = _with_effects_only(hypothesis.model, prediction.coordinates[run], kept)
        simulated = dataset.prediction(hypothesis.model, run, log_zeta, at)
        start = MatchedRun(simulated - dataset.recording(run), log_zeta, matched=False)
        slope = float(by_zeta[z].mean())
        if not slope > 0:
            return start.residual
        found = match_zeta(dataset, hypothesis.model, run, at, start, slope, settings.match)
        if found.matched:
            return found.residual
        return start.residual - start.residual[z].mean() / slope * by_zeta

    def of(run: int) -> np.ndarray:
        gap = before[run] - after[run]
        if count <= 1:
            return gap[None][:count]
        # Of two effects, one alone is the other's lack.
        residual = {kept: left(run, kept) for kept in {*alone, *beside}}
        found = [
            np.nanmean([residual[others] - after[run], before[run] - residual[one]], axis=0)
            for one, others in zip(alone, beside, strict=True)
        ]
        parts = np.nan_to_num(np.array(found))
        size = (parts**2).sum(axis=2, keepdims=True)
        whole = size.sum(axis=0)
        share = np.divide(size, whole, out=np.full_like(size, 1 / count), where=whole > 0)
        return parts + share * (gap - parts.sum(axis=0))

    return dataset.map(pool, of)


def _with_effects_only(model: AugmentedModel, coordinates: np.ndarray, kept: int) -> np.ndarray:
    """Coordinates with the strengths of all effects at zero but those of a bit mask."""
    acts = np.array([f.scale is None or bool(kept >> f.index & 1) for f in model.free])
    return np.where(acts, coordinates, 0.0)


def _products(
    dataset: RigDataset,
    runs: Sequence[int],
    index: int,
    after: Sequence[np.ndarray],
    parts: Sequence[np.ndarray],
) -> np.ndarray:
    """Integrals over time of products of (residual with all effects, contributions)."""
    total = 0.0
    for run in runs:
        rows = np.concatenate([after[run][None, index], parts[run][:, index]])
        rows = rows[:, np.isfinite(after[run][index])]
        total = total + dataset.sample_interval(run) * rows @ rows.T
    return np.asarray(total)


def _duration(
    dataset: RigDataset, runs: Sequence[int], index: int, before: Sequence[np.ndarray]
) -> float:
    counts = (np.isfinite(before[run][index]).sum() * dataset.sample_interval(run) for run in runs)
    return float(sum(counts))


def _divided(products: np.ndarray, floor: float) -> tuple[float, float, np.ndarray]:
    """Gap before and after, and each effect's part of what lies above the floor."""
    count = len(products) - 1

    def gap(kept: int) -> float:
        lacking = np.array([1.0, *(0.0 if kept >> k & 1 else 1.0 for k in range(count))])
        return math.sqrt(max(lacking @ products @ lacking, 0.0))

    value = [gap(kept) for kept in range(1 << count)]
    sizes = shapley_values(lambda kept: value[0] - value[kept], count)
    before, after = value[0], value[-1]
    fallen = before - after
    counted = before - max(after, floor)
    return before, after, sizes * (counted / fallen if fallen > 0 else 1.0)


def _shares(products: np.ndarray, floor: float, scale: np.ndarray) -> np.ndarray:
    """Shares of the gap above the floor, where each effect's numbers are off by a share."""
    turned = np.eye(len(products))
    turned[0, 1:] = -scale
    turned[np.arange(1, len(products)), np.arange(1, len(products))] = 1 + scale
    before, _, sizes = _divided(turned @ products @ turned.T, floor)
    return sizes / (before - floor) if before > floor else np.zeros(len(scale))


def shapley_values(value: Callable[[int], float], players: int) -> np.ndarray:
    """Shapley value of each player of a game.

    Args:
        value: Worth of a coalition, by a bit mask of its players.
        players: Their number n, small: all 2^n coalitions are asked for.

    Returns:
        Shape (players,); they add up to the worth of all.
    """
    found = np.zeros(players)
    for player in range(players):
        others = [k for k in range(players) if k != player]
        for size in range(players):
            weight = 1 / (players * math.comb(players - 1, size))
            for some in itertools.combinations(others, size):
                mask = sum(1 << k for k in some)
                found[player] += weight * (value(mask | 1 << player) - value(mask))
    return found
