"""Look-alikes: effects that move the runs nearly as one of a set does, tried in its place.

A set grows by one effect after another. Where two effects look alike, such as a lag of the drive
and a filter of the instruments, the one that leads early may be the wrong one, and what is added
later makes up for it.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnose.hypotheses.exact_responses import FurtherResponses, exact_responses
from diagnose.hypotheses.hypothesis import Hypothesis, lower_bounds
from diagnose.hypotheses.set_candidates import joined_from_null
from diagnose.hypotheses.set_screening import without_effect
from diagnose.linear.linear_fit import GramMatrices
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
        exact: By run, derivatives by the strengths at the set's numbers, shape (channels, samples,
            strengths); none where only those about the reference model are known.
    """

    variant: ShapeVariant
    share: float
    strengths: np.ndarray
    log_zeta_change: np.ndarray
    exact: list[np.ndarray] | None = None


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

    parts = [_response(best, place) for place in range(len(best.model.effects))]
    alike_by_place = look_alikes(regressors, best, parts, pool, settings)
    found = []
    for place, (part, alike) in enumerate(zip(parts, alike_by_place, strict=True)):
        rest = replace(
            without_effect(best, place),
            residual=[left - own for left, own in zip(best.residual, part, strict=True)],
            proposed_step=None,
        )
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
    return joined_from_null(regressors, rest, [alike.variant], fit, alike.exact)


def _response(best: Hypothesis, place: int) -> list[np.ndarray]:
    """By run, what one effect changes, to first order, shape (channels, samples)."""
    own = [k for k, f in enumerate(best.model.free) if f.index == place and f.scale is not None]
    return [each[:, :, [1 + k for k in own]] @ best.coordinates[own] for each in best.columns]


def look_alikes(
    regressors: Regressors,
    best: Hypothesis,
    parts: Sequence[list[np.ndarray]],
    pool: RunPool,
    settings: ExchangeSettings = DEFAULT_EXCHANGE,
) -> list[list[LookAlike]]:
    """Effects outside a set whose response makes up for most of a part of its own, the best first.

    Responses about the reference model choose each effect's shapes. The share that it makes up for
    is taken with those at the set's numbers: beside a large lag the two are far apart.

    Args:
        regressors: The runs.
        best: The set.
        parts: What each of its effects that is asked about changes: by run, shape (channels,
            samples).
        pool: Threads.
        settings: Numbers of the choice.

    Returns:
        By part.
    """
    others = [each for each in regressors.variants if each.effect.about.name not in best.names]
    asked = [
        np.stack([best.by_zeta(run), *(part[run] for part in parts)], axis=2)
        for run in regressors.dataset.run_numbers
    ]
    of_run = asked, best.residual, best.log_zeta
    about_null = regressors.gram_matrices_beside_all(*of_run, pool)
    first_shares = _made_up(regressors, about_null, len(parts), others)
    by_effect: dict[str, list[LookAlike]] = {}
    for each in itertools.chain(*first_shares):
        by_effect.setdefault(each.variant.effect.about.name, []).append(each)
    leading = [max(several, key=lambda each: each.share) for several in by_effect.values()]
    chosen = [each.variant for each in leading]
    exact = exact_responses(regressors, best, chosen, pool)
    here = FurtherResponses.of(regressors, replace(best, columns=asked), chosen, exact)
    at_set = regressors.gram_matrices_of(here.columns, best.residual, best.log_zeta, pool)
    found = []
    for shares in _made_up(regressors, at_set, len(parts), here.variants):
        alike = [
            replace(each, variant=variant, exact=exact.get(variant.effect.about.name))
            for each, variant in zip(shares, chosen, strict=True)
            if each.share > settings.min_alike
        ]
        found.append(sorted(alike, key=lambda each: -each.share)[: settings.max_alike])
    return found


def _made_up(
    regressors: Regressors,
    products: GramMatrices,
    parts: int,
    variants: Sequence[ShapeVariant],
) -> list[list[LookAlike]]:
    """What each variant makes up for of each part of a set.

    Args:
        regressors: The runs.
        products: Of the columns by zeta, of each part, and of further ones behind them.
        parts: How many.
        variants: Effects, with the numbers of their columns among the further ones.

    Returns:
        By part, by variant.
    """
    weighed = products.weighed(regressors.settings)
    by_zeta = weighed[:, 0] / np.maximum(weighed[:, 0, :1], 1e-300)
    # What each run's own zeta makes up for is no part of it.
    gram = (weighed - weighed[:, 0, :, None] * by_zeta[:, None, :]).sum(axis=0)
    found = []
    for part in range(1, 1 + parts):
        power = gram[part, part]
        shares = []
        for variant in variants:
            taken = [1 + parts + column for column in variant.columns]
            cross, own = gram[taken, part], gram[np.ix_(taken, taken)]
            fitted = np.linalg.lstsq(own, cross, rcond=1e-10)[0]
            fitted = np.maximum(fitted, lower_bounds(variant.effect))
            left = power - 2 * cross @ fitted + fitted @ own @ fitted
            share = 1 - float(left / power) if power > 0 else 0.0
            zeta = by_zeta[:, part] - by_zeta[:, taken] @ fitted
            shares.append(LookAlike(variant, share, fitted, zeta))
        found.append(shares)
    return found
