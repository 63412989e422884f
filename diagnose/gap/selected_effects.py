"""What a diagnosis adds to the reference model, and how far the gap shrinks with it."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax
import numpy as np

from diagnose.gap.gap import Gap
from diagnose.gap.zeta_matching import MatchedRun, residuals_of
from diagnose.hypotheses.hypothesis import Hypothesis
from diagnose.model.augmented_model import AugmentedModel
from drftjax.effects.base import AbstractEffect

# What is added helps where the gap over all channels falls by this share at least, and in none of
# them rises by more than it.
HELPS = 0.1


@dataclass(frozen=True, eq=False)
class SelectedEffects:
    """Effects with their numbers, and what is left of the gap with them.

    Attributes:
        effects: None of them where the reference model stays as it is.
        log_zeta: Each run's log zeta over its set-up's beside them, shape (runs,).
        met: Each run while its condition was left out, with the zeta that meets its mean sinkage.
        gap: Before, and after on these runs left out, by channel.
    """

    effects: tuple[AbstractEffect, ...]
    log_zeta: np.ndarray
    matches: Sequence[MatchedRun]
    gap: Mapping[str, Gap]

    @property
    def after(self) -> list[np.ndarray]:
        """By run, simulated less recorded, shape (channels, samples) [m, N, N m]."""
        return residuals_of(self.matches)

    @property
    def before(self) -> float:
        """The gap without them, over all channels [noise floors]."""
        return math.hypot(*(gap.before / gap.floor for gap in self.gap.values()))

    @property
    def left(self) -> float:
        """The gap that is left, over all channels [noise floors]."""
        return math.hypot(*(gap.after / gap.floor for gap in self.gap.values()))

    @property
    def helps(self) -> bool:
        """Whether the gap shrinks enough to speak of, and no channel pays for another."""
        spared = all(
            gap.after < (1 + HELPS) * max(gap.before, gap.floor) for gap in self.gap.values()
        )
        return spared and self.left < (1 - HELPS) * self.before


def best_selection(tried: Sequence[SelectedEffects], reference: SelectedEffects) -> SelectedEffects:
    """What leaves least of the gap, of all that helps; the reference model where nothing does."""
    helpful = [each for each in tried if each.helps]
    return min(helpful, key=lambda each: each.left, default=reference)


def effects_of(hypothesis: Hypothesis) -> tuple[AbstractEffect, ...]:
    """The effects with their numbers, as a simulator takes them.

    A form of an effect is itself here, as it has numbers of its own.
    """
    built = hypothesis.model.build(hypothesis.coordinates)
    return jax.tree.map(np.asarray, built)


def as_model(effects: Sequence[AbstractEffect]) -> tuple[AugmentedModel, np.ndarray]:
    """Effects with numbers as a model and its coordinates."""
    model = AugmentedModel(tuple(type(each) for each in effects))
    values = [
        free.coordinate(float(getattr(effects[free.index], free.field))) for free in model.free
    ]
    return model, np.array(values, float)
