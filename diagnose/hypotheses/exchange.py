"""Look-alikes: effects that move the runs nearly as one of a set does, tried in its place.

A set grows by one effect after another. Where two effects look alike, such as a lag of the drive
and a filter of the instruments, the one that leads early may be the wrong one, and what is added
later makes up for it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnose.hypotheses.hypothesis import Hypothesis, lower_bounds
from diagnose.hypotheses.set_candidates import joined_from_null
from diagnose.hypotheses.set_screening import without_effect
from diagnose.linear.regressors import Regressors, ShapeVariant
from diagnose.run_pool import RunPool
from drftjax.effects.catalogue import reported_names


@dataclass(frozen=True)
class ExchangeSettings:
    """Numbers by which effects of a set are exchanged.

    Attributes:
        min_alike: Share of an effect's response that another's makes up for, beside zeta, at least
            [-].
        min_alike_at_floor: The same where the set leaves no gap: there only what does as well is
            looked for.
        max_deficit: Sets that were simulated already are not begun again where they are no further
            behind the set in log score [-]; others may do better from another start.
        max_alike: Effects tried in the place of one, at most.
        max_continued: Of these so many get more than one simulation. Where others made up for a
            wrong effect, one simulation does not tell the right one yet.
    """

    min_alike: float = 0.5
    min_alike_at_floor: float = 0.8
    max_deficit: float = 30.0
    max_alike: int = 5
    max_continued: int = 2

    def where(self, leaves_gap: bool) -> "ExchangeSettings":
        """The numbers for a set that leaves a gap, or none."""
        return self if leaves_gap else replace(self, min_alike=self.min_alike_at_floor)


DEFAULT_EXCHANGE = ExchangeSettings()


@dataclass(frozen=True, eq=False)
class LookAlike:
    """An effect that changes the runs nearly as a part of a set does.

    Attributes:
        variant: The effect.
        share: Share of the part that it makes up for, beside zeta [-].
        strengths: With which it does [typical sizes], shape (strengths,).
        log_zeta_change: What zeta makes up for beside it [-], shape (runs,).
    """

    variant: ShapeVariant
    share: float
    strengths: np.ndarray
    log_zeta_change: np.ndarray


def exchanged_sets(
    regressors: Regressors,
    best: Hypothesis,
    known: Sequence[Hypothesis],
    pool: RunPool,
    settings: ExchangeSettings = DEFAULT_EXCHANGE,
) -> list[list[Hypothesis]]:
    """A set with one effect after the other replaced by its look-alikes, each with a step proposed.

    A look-alike begins with the strengths by which it does what the other did, the rest of the set
    with its numbers.

    Args:
        regressors: The runs.
        best: The set, simulated.
        known: Sets that were simulated already.
        pool: Threads.
        settings: Numbers of the choice.

    Returns:
        By effect that is replaced.
    """
    least = best.score - settings.max_deficit
    tried = [frozenset(each.names) for each in known if each.score > least]

    def is_new(names: tuple[str, ...]) -> bool:
        whole = len(reported_names(names)) == len(names)  # no two forms of one effect
        return whole and frozenset(names) not in tried

    found = []
    for place in range(len(best.model.effects)):
        kept = without_effect(best, place)
        part = _response(best, place)
        rest = replace(
            kept,
            residual=[left - own for left, own in zip(best.residual, part, strict=True)],
            proposed_step=None,
        )
        alike = look_alikes(regressors, best, part, pool, settings)
        found.append(
            [
                _in_its_place(regressors, rest, each)
                for each in alike
                if is_new((*rest.names, each.variant.effect.about.name))
            ]
        )
    return found


def _in_its_place(regressors: Regressors, rest: Hypothesis, alike: LookAlike) -> Hypothesis:
    """The rest of a set with a look-alike, which does what the effect that is missing did."""
    fit = replace(
        rest.fit,
        score=-np.inf,
        coefficients=np.r_[np.zeros(len(rest.coordinates)), alike.strengths],
        log_zeta_change=alike.log_zeta_change,
    )
    return joined_from_null(regressors, rest, [alike.variant], fit)


def _response(best: Hypothesis, place: int) -> list[np.ndarray]:
    """By run, what one effect changes, to first order, shape (channels, samples)."""
    own = [k for k, f in enumerate(best.model.free) if f.index == place and f.scale is not None]
    return [each[:, :, [1 + k for k in own]] @ best.coordinates[own] for each in best.columns]


def look_alikes(
    regressors: Regressors,
    best: Hypothesis,
    part: list[np.ndarray],
    pool: RunPool,
    settings: ExchangeSettings = DEFAULT_EXCHANGE,
) -> list[LookAlike]:
    """Effects outside a set whose response makes up for most of a part of its own, the best first.

    Args:
        regressors: The runs.
        best: The set.
        part: What one of its effects changes, by run, shape (channels, samples).
        pool: Threads.
        settings: Numbers of the choice.
    """
    columns = [np.stack([best.by_zeta(run), own], axis=2) for run, own in enumerate(part)]
    products = regressors.gram_matrices_beside_all(columns, best.residual, best.log_zeta, pool)
    weighed = products.weighed(regressors.settings)
    by_zeta = weighed[:, 0] / np.maximum(weighed[:, 0, :1], 1e-300)
    # What each run's own zeta makes up for is no part of it.
    gram = (weighed - weighed[:, 0, :, None] * by_zeta[:, None, :]).sum(axis=0)
    found: dict[str, LookAlike] = {}
    for variant in regressors.variants:
        name = variant.effect.about.name
        if name in best.names:
            continue
        alike = _made_up(gram, by_zeta, variant)
        if name not in found or alike.share > found[name].share:
            found[name] = alike
    alike = [each for each in found.values() if each.share > settings.min_alike]
    return sorted(alike, key=lambda each: -each.share)[: settings.max_alike]


def _made_up(gram: np.ndarray, by_zeta: np.ndarray, variant: ShapeVariant) -> LookAlike:
    """Share of the column behind zeta that a variant makes up for, and the strengths by which.

    Args:
        gram: Weighed products of the columns beside the runs' own zetas, zeta's first, shape (n,
            n).
        by_zeta: Change of each run's log zeta that each column is as much as, shape (runs, n).
        variant: The variant.
    """
    taken = [2 + column for column in variant.columns]
    cross, power = gram[taken, 1], gram[1, 1]
    fitted = np.linalg.lstsq(gram[np.ix_(taken, taken)], cross, rcond=1e-10)[0]
    fitted = np.maximum(fitted, lower_bounds(variant.effect))
    left = power - 2 * cross @ fitted + fitted @ gram[np.ix_(taken, taken)] @ fitted
    share = 1 - float(left / power) if power > 0 else 0.0
    return LookAlike(variant, share, fitted, by_zeta[:, 1] - by_zeta[:, taken] @ fitted)
