"""Gap with the effects of a hypothesis added one by one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.gap.cross_validation import HeldOutPrediction, at_mean_sinkage, predict_held_out
from diagnose.gap.gap import DEFAULT_GAP, Gap, GapSettings, gaps
from diagnose.gap.zeta_matching import residuals_of
from diagnose.hypotheses.hypothesis import Hypothesis
from diagnose.hypotheses.screening import ScreeningResult
from diagnose.run_pool import RunPool
from drftjax.effects.catalogue import reported_names


@dataclass(frozen=True)
class NestedModel:
    """Gap with some of a hypothesis's effects.

    Attributes:
        effects: Those added so far, the last one last.
        gap: Without any and with these, on held-out runs, by channel.
    """

    effects: tuple[str, ...]
    gap: Mapping[str, Gap]

    def document(self) -> dict:
        """Plain values, in the layout of diagnosis.json."""
        return {
            "effects": list(self.effects),
            "gap": {channel: gap.document() for channel, gap in self.gap.items()},
        }


def stepwise_gap(
    found: ScreeningResult,
    chosen: Hypothesis,
    held_out: Mapping[tuple[str, ...], HeldOutPrediction],
    before: Sequence[np.ndarray],
    floors: Mapping[str, float],
    whole: Mapping[str, Gap],
    pool: RunPool,
    settings: GapSettings = DEFAULT_GAP,
) -> list[NestedModel]:
    """Gap with more and more effects of a hypothesis, each set refitted, last with all.

    Each smaller set is the best of those that were simulated.

    Args:
        found: The screening.
        chosen: The hypothesis.
        held_out: Predictions of held-out runs by the names of a hypothesis, where they are known.
        before: Residuals of each run by the reference model [m, N, N m], shape (channels, samples).
        floors: Noise floor of each channel [m, N, N m].
        whole: The gap with all of its effects, by channel.
        pool: Threads.
        settings: Numbers of a gap.

    Returns:
        Empty for fewer than two effects.
    """
    if len(chosen.names) < 2:
        return []
    regressors, dataset = found.regressors, found.regressors.dataset
    chain, names = [], set(chosen.names)
    for smaller in reversed(found.by_size[: len(chosen.names) - 1]):
        parts = [each for each in smaller if set(each.names) < names]
        if parts:
            chain.append(max(parts, key=lambda each: each.score))
            names = set(chain[-1].names)
    steps, order = [], ()
    for each in reversed(chain):
        prediction = held_out.get(each.names) or predict_held_out(regressors, each, pool)
        after = residuals_of(at_mean_sinkage(prediction, pool))
        if dataset.all_finite(after):
            order += tuple(name for name in each.names if name not in order)
            gap = gaps(dataset, before, after, floors, settings)
            steps.append(NestedModel(reported_names(order), gap))
    order += tuple(name for name in chosen.names if name not in order)
    return [*steps, NestedModel(reported_names(order), whole)]
