"""How far the gap shrinks as the effects of an explanation are added one by one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.gap.cross_validation import HeldOutPrediction, at_mean_sinkage, predict_held_out
from diagnose.gap.gap import Gap, gaps
from diagnose.gap.zeta_matching import residuals_of
from diagnose.hypotheses.hypothesis import Hypothesis
from diagnose.hypotheses.screening import ScreeningResult
from diagnose.run_pool import RunPool
from drftjax.effects.catalogue import reported_names


@dataclass(frozen=True)
class NestedModel:
    """The gap with some of an explanation's effects.

    Attributes:
        effects: Those added so far, the last one last.
        gap: Before any and after these, on runs left out, by channel.
    """

    effects: tuple[str, ...]
    gap: Mapping[str, Gap]

    def document(self) -> dict:
        return {
            "effects": list(self.effects),
            "gap": {channel: gap.document() for channel, gap in self.gap.items()},
        }


def stepwise_gap(
    found: ScreeningResult,
    chosen: Hypothesis,
    unseen: Mapping[tuple[str, ...], HeldOutPrediction],
    before: Sequence[np.ndarray],
    floors: Mapping[str, float],
    whole: Mapping[str, Gap],
    pool: RunPool,
) -> list[NestedModel]:
    """A pair's gap with the one effect that does most alone, refitted, and with both.

    Args:
        found: The search.
        chosen: The explanation.
        unseen: Predictions of runs left out, by explanation, as far as they are known.
        before: Residuals of each run by the reference model, shape (channels, samples) [m, N, N m].
        floors: Noise floor of each channel [m, N, N m].
        whole: The gap with all of them, by channel.
        pool: Threads.

    Returns:
        Nothing for fewer than two effects.
    """
    if len(chosen.names) < 2:
        return []
    bench, case = found.regressors, found.regressors.dataset

    def left(alone: Hypothesis) -> list[np.ndarray]:
        given = unseen.get(alone.names) or predict_held_out(bench, alone, pool)
        return residuals_of(at_mean_sinkage(bench, given, pool))

    parts = [each for each in found.singles if set(each.names) < set(chosen.names)]
    tried = [(each.names, left(each)) for each in parts]
    scale = np.array([floors[channel] for channel in case.channels])[:, None]

    def misfit(after: Sequence[np.ndarray]) -> float:
        if not case.all_finite(after):
            return np.inf
        return sum(float(np.nansum(np.square(each / scale))) for each in after)

    first, after = min(tried, key=lambda each: misfit(each[1]))
    second = tuple(name for name in chosen.names if name not in first)
    return [
        NestedModel(reported_names(first), gaps(case, before, after, floors)),
        NestedModel(reported_names(first + second), whole),
    ]
