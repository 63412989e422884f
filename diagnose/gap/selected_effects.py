"""Effects that a diagnosis adds to the reference model, and how far the gap shrinks with them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax
import numpy as np

from diagnose.gap.gap import Gap, is_reducible
from diagnose.gap.zeta_matching import MatchedRun, residuals_of
from diagnose.hypotheses.hypothesis import Hypothesis
from diagnose.model.augmented_model import AugmentedModel
from drftjax.effects.base import AbstractEffect


@dataclass(frozen=True)
class EffectSelectionSettings:
    """Rule by which effects are worth adding.

    Attributes:
        min_improvement: The gap over all channels must fall by this share at least [-], and in no
            channel rise by more than it.
        explained_share: Effects explain most of a gap that they shrink by this share in every
            channel [-]. On rigs with something outside the list the best set left 43 % or more of
            one channel (seven of eight sets of `drft blind make --wrong unknown --faintest 3 --seed
            361001`; in the eighth an effect of the list leaves nothing, and is named).
        part_share: Two effects or more explain a part of a gap that they shrink by this share in
            every channel [-]. One effect is not asked: of `drft blind make --wrong unknown
            --faintest 3 --seed 554001` one shrinks both channels of set_01 by 66 % and more, and
            three make x worse in set_02.
        large_gap: So many noise floors, in one channel at least, are needed for that [-]: of a
            smaller gap chance is too large a part.
    """

    min_improvement: float = 0.1
    explained_share: float = 0.75
    part_share: float = 0.5
    large_gap: float = 5.0


DEFAULT_EFFECT_SELECTION = EffectSelectionSettings()


@dataclass(frozen=True, eq=False)
class SelectedEffects:
    """Effects with their numbers, and the gap that remains with them.

    Attributes:
        effects: Empty for the reference model.
        log_zeta: Each run's log zeta over its set-up's, fitted with them [-], shape (runs,).
        matches: Each run at its matched zeta, while its condition was held out of the fit.
        gap: Before, and after on these held-out runs, by channel.
    """

    effects: tuple[AbstractEffect, ...]
    log_zeta: np.ndarray
    matches: Sequence[MatchedRun]
    gap: Mapping[str, Gap]

    @property
    def after(self) -> list[np.ndarray]:
        """By run, simulated minus recorded [m, N, N m], shape (channels, samples)."""
        return residuals_of(self.matches)

    @property
    def before(self) -> float:
        r"""Gap without them over all channels, $\sqrt{\sum_c (g_c / n_c)^2}$ [noise floors]."""
        return math.hypot(*(gap.before / gap.floor for gap in self.gap.values()))

    @property
    def remaining(self) -> float:
        """The same with them [noise floors]."""
        return math.hypot(*(gap.after / gap.floor for gap in self.gap.values()))

    def worsens_no_channel(
        self, settings: EffectSelectionSettings = DEFAULT_EFFECT_SELECTION
    ) -> bool:
        """True where no channel's gap grows by more than the allowed share, or beyond chance."""
        most = 1 + settings.min_improvement
        return all(each.after < most * max(each.before, each.floor) for each in self.gap.values())

    def explains_most(self, settings: EffectSelectionSettings = DEFAULT_EFFECT_SELECTION) -> bool:
        """True where a large gap shrinks by nearly all in every channel that has one."""
        return self._explains(settings.explained_share, settings)

    def explains_part(self, settings: EffectSelectionSettings = DEFAULT_EFFECT_SELECTION) -> bool:
        """True for two effects or more with which a large gap shrinks by half in every channel."""
        return len(self.effects) > 1 and self._explains(settings.part_share, settings)

    def _explains(self, share: float, settings: EffectSelectionSettings) -> bool:
        parts = [each for each in self.gap.values() if each.is_reducible]
        largest = max((each.before / each.floor for each in parts), default=0.0)
        return (
            largest >= settings.large_gap
            and all(each.shrinkage >= share for each in parts)
            and self.worsens_no_channel(settings)
        )

    @property
    def leaves_gap(self) -> bool:
        """True where some channel's gap stays far enough above its floor to be reduced."""
        return any(is_reducible(g.after, g.floor, g.settings) for g in self.gap.values())

    def improves_gap(self, settings: EffectSelectionSettings = DEFAULT_EFFECT_SELECTION) -> bool:
        """True where the gap shrinks by enough, and not at the cost of a channel."""
        least = (1 - settings.min_improvement) * self.before
        return self.worsens_no_channel(settings) and self.remaining < least


def best_selection(
    tried: Sequence[SelectedEffects],
    reference: SelectedEffects,
    settings: EffectSelectionSettings = DEFAULT_EFFECT_SELECTION,
) -> SelectedEffects:
    """The selection with the smallest remaining gap; the reference model where none improves it.

    Args:
        tried: Selections of effects.
        reference: The reference model.
        settings: Rule by which effects are worth adding.
    """
    improving = [each for each in tried if each.improves_gap(settings)]
    return min(improving, key=lambda each: each.remaining, default=reference)


def effects_of(hypothesis: Hypothesis) -> tuple[AbstractEffect, ...]:
    """The hypothesis's effects with their numbers, as a simulator takes them.

    A shape variant of an effect becomes the effect itself, as it has numbers of its own.
    """
    built = hypothesis.model.build(hypothesis.coordinates)
    return jax.tree.map(np.asarray, built)


def as_model(effects: Sequence[AbstractEffect]) -> tuple[AugmentedModel, np.ndarray]:
    """Effects with numbers as a model and its coordinates, shape (numbers,)."""
    model = AugmentedModel(tuple(type(each) for each in effects))
    values = [
        free.coordinate(float(getattr(effects[free.index], free.field))) for free in model.free
    ]
    return model, np.array(values, float)
