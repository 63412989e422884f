"""The search: which effects, alone or in pairs, explain a case."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnose.dataset import RigDataset, match_initial_zeta
from diagnose.hypotheses.hypothesis import (
    Hypothesis,
    linear_fit_of,
    linear_start,
    predicted_score,
    refine,
    relinearize,
)
from diagnose.hypotheses.pair_screening import refine_pairs
from diagnose.linear.linear_fit import FLOOR, ORDERS, LinearFit, floor_inflation
from diagnose.linear.regressors import Regressors, ShapeVariant
from diagnose.model.augmented_model import AugmentedModel, predict, predict_with_jacobian
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import field_metadata, strengths

# Effects that straight lines put first are simulated; straight lines may order them, not decide.
# So many are even where no line gains anything worth saying, and so many at most.
FEWEST_SINGLES, SINGLES = 6, 16


WORTH_SAYING = 1.5


TURNS = 2


# The leading ones go on, with fresh derivatives, while that gains something.
FINISHED = 4


REFRESHED = 2


ROUNDS = 3


MORE_TURNS = 5


WORTH_A_ROUND = 3.0


# A hypothesis this far behind the best is not taken further.
HOPELESS = 100.0


# Strengths far from zero are tried one by one where the gap is so many times a model's own error.
FAR = 30.0


# Pairs are looked for where the best single effect leaves this many times a model's own error.
MUCH = 1.5


Report = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class ScreeningResult:
    """What a search found.

    Attributes:
        bench: The case, linearised.
        none: The reference model with each run's own zeta, settled.
        singles: Effects simulated alone, best first.
        pairs: Pairs simulated, best first.
    """

    regressors: Regressors
    none: Hypothesis
    singles: tuple[Hypothesis, ...]
    pairs: tuple[Hypothesis, ...]


def screen_effects(
    case: RigDataset, effects: Sequence[type[AbstractEffect]], report: Report = lambda stage: None
) -> ScreeningResult:
    """Screen every effect, simulate the leading ones, then pairs of them with all.

    Args:
        case: Runs of one rig.
        effects: The catalogue.
        report: Called with what is done next.
    """
    report("baseline: zeta of each run")
    log_zeta = match_initial_zeta(case)
    case = case.with_fewer_plates()
    report(f"linearising {len(case.runs)} runs, and {len(effects)} effects along them")
    bench = Regressors.of(case, log_zeta, effects)
    none = refine(bench, linear_start(bench, []), 3)
    report("screening")
    ranked = _ranked(bench)
    report(f"simulating the leading {len(ranked)} effects")
    starts = [linear_start(bench, [variant], line) for variant, line in ranked]
    case.precompile(predict, [each.model for each in starts])
    singles = case.map_items(lambda each: refine(bench, each, TURNS), starts)
    if floor_inflation(bench.gram_matrices.blocks, none.fit.mean_square, 1.0) > FAR:
        singles = _with_far(bench, singles)
    singles = _finished(bench, singles)
    pairs: list[Hypothesis] = []
    if singles and _leaves_much(bench, singles[0]):
        report("pairs of effects")
        pairs = _finished(bench, refine_pairs(bench, singles))
    return ScreeningResult(bench, none, tuple(singles), tuple(pairs))


def _with_far(bench: Regressors, singles: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Singles, and in their place those that do better from a strength far from zero."""
    afar = [
        (variant, coordinate, values)
        for variant in bench.variants
        for coordinate, values in _far(variant.effect).items()
    ]
    models = [*dict.fromkeys(AugmentedModel((variant.effect,)) for variant, _, _ in afar)]
    bench.dataset.precompile(predict, models)
    bench.dataset.precompile(predict_with_jacobian, models)

    def tried(far: tuple[ShapeVariant, int, list[float]]) -> Hypothesis:
        variant, coordinate, values = far
        start = linear_start(bench, [variant])
        ways = [replace(start, ahead=_to(start, coordinate, value)) for value in values]
        found = [refine(bench, each, 1) for each in ways]
        best = max(found, key=lambda each: each.score if each.is_simulated else -np.inf)
        if not best.is_simulated:
            return best
        # The way there was long: what it tells of the columns holds for no small step.
        return refine(bench, relinearize(bench, best), MORE_TURNS)

    found = {each.names: each for each in singles}
    for best in bench.dataset.map_items(tried, afar):
        better = best.names not in found or best.score > found[best.names].score
        if best.is_simulated and better:
            found[best.names] = best
    return list(found.values())


def _far(effect: type[AbstractEffect]) -> dict[int, list[float]]:
    """The values far from zero to try [typical sizes], by the strength's place; few have any."""
    about = [field_metadata(effect)[name] for name in strengths(effect)]
    return {
        place: [value / each["typical"] for value in each["far"]]
        for place, each in enumerate(about)
        if each["far"]
    }


def _to(start: Hypothesis, coordinate: int, value: float) -> tuple[np.ndarray, np.ndarray]:
    """The way from a proposal's null to one strength alone."""
    assert start.proposed_step is not None
    zeta, change = start.proposed_step
    there = change.copy()
    there[coordinate] = value - start.coordinates[coordinate]
    return np.zeros_like(zeta), there


def _finished(bench: Regressors, hypotheses: list[Hypothesis]) -> list[Hypothesis]:
    """The leading hypotheses settled to their end, all of them best first."""
    side_by_side = bench.dataset.map_items
    worth = side_by_side(lambda each: predicted_score(bench, each), hypotheses)
    ranked = sorted(zip(worth, hypotheses, strict=True), key=lambda each: -each[0])
    hypotheses = [each for _, each in ranked]
    done: list[Hypothesis] = []
    hopeful = [each for each in hypotheses[:REFRESHED] if _leaves_much(bench, each)]
    bench.dataset.precompile(predict_with_jacobian, [each.model for each in hopeful])
    leading = side_by_side(lambda each: refine(bench, each, MORE_TURNS), hypotheses[:FINISHED])
    for place, each in enumerate(leading):
        for _ in range(ROUNDS):
            if place >= REFRESHED or not each.is_simulated or not _leaves_much(bench, each):
                break
            if done and each.score < done[0].score - HOPELESS:
                break
            further = refine(bench, relinearize(bench, each), MORE_TURNS)
            gained = further.score - each.score
            each = further
            if gained < WORTH_A_ROUND:
                break
        done.append(each)
    return sorted(done + hypotheses[FINISHED:], key=lambda each: -each.score)


def _ranked(bench: Regressors) -> list[tuple[ShapeVariant, LinearFit]]:
    """The leading effects' best variants by straight lines, judged coarsely and finely.

    Where the gap is large a straight line's own error hides what an effect explains; so the
    orders take turns.
    """
    start = linear_fit_of(bench, [])
    orders = []
    telling: set[str] = set()
    for share, trust in ORDERS:
        coarse = floor_inflation(bench.gram_matrices.blocks, start.mean_square, share)
        nothing = linear_fit_of(bench, [], coarse, trust).score
        best: dict[str, tuple[ShapeVariant, LinearFit]] = {}
        for variant in bench.variants:
            line = linear_fit_of(bench, [variant], coarse, trust)
            name = variant.effect.about.name
            if name not in best or line.score > best[name][1].score:
                best[name] = variant, line
        orders.append(sorted(best.values(), key=lambda each: -each[1].score))
        telling |= {n for n, (_, line) in best.items() if line.score > nothing + WORTH_SAYING}
    found: dict[str, tuple[ShapeVariant, LinearFit]] = {}
    for pair in zip(*orders, strict=True):
        for variant, line in pair:
            found.setdefault(variant.effect.about.name, (variant, line))
    leading = [
        pair
        for place, (name, pair) in enumerate(found.items())
        if place < FEWEST_SINGLES or name in telling
    ]
    return leading[:SINGLES]


def _leaves_much(bench: Regressors, best: Hypothesis) -> bool:
    """Whether a hypothesis leaves more than a model's own error in the slow part of a channel."""
    blocks = bench.gram_matrices.blocks
    return any(
        np.sqrt(left) > MUCH * FLOOR[block]
        for block, left in zip(blocks, best.fit.mean_square, strict=True)
        if block[1] == "slow"
    )
