"""Gap with the effects of a hypothesis added one by one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.gap.cross_validation import HeldOutPrediction, at_mean_sinkage, predict_held_out
from diagnose.gap.gap import DEFAULT_GAP, Gap, GapSettings, gaps
from diagnose.gap.zeta_matching import residuals_of
from diagnose.hypotheses.hypothesis import Hypothesis
from diagnose.hypotheses.screening import ScreeningResult
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
    settings: GapSettings = DEFAULT_GAP,
) -> list[NestedModel]:
    """Gap of a pair with the one effect that leaves less of it alone, refitted, and with both.

    Args:
        found: The screening.
        chosen: The hypothesis.
        held_out: Predictions of held-out runs by the names of a hypothesis, where they are known.
        before: Residuals of each run by the reference model [m, N, N m], shape (channels, samples).
        floors: Noise floor of each channel [m, N, N m].
        whole: The gap with all of its effects, by channel.
        settings: Numbers of a gap.

    Returns:
        Empty for fewer than two effects.
    """
    if len(chosen.names) < 2:
        return []
    regressors, dataset = found.regressors, found.regressors.dataset

    def residuals(single: Hypothesis) -> list[np.ndarray]:
        prediction = held_out.get(single.names) or predict_held_out(regressors, single)
        return residuals_of(at_mean_sinkage(regressors, prediction))

    parts = [each for each in found.singles if set(each.names) < set(chosen.names)]
    tried = [(each.names, residuals(each)) for each in parts]
    scale = np.array([floors[channel] for channel in dataset.channels])[:, None]

    def squares(after: Sequence[np.ndarray]) -> float:
        """Sum of squares over all runs [noise floors squared]."""
        if not dataset.all_finite(after):
            return np.inf
        return sum(float(np.nansum(np.square(each / scale))) for each in after)

    first, after = min(tried, key=lambda each: squares(each[1]))
    second = tuple(name for name in chosen.names if name not in first)
    return [
        NestedModel(reported_names(first), gaps(dataset, before, after, floors, settings)),
        NestedModel(reported_names(first + second), whole),
    ]
