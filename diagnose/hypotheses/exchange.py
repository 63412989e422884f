"""Look-alikes: effects that move the runs nearly as one of a set does, tried in its place.

A set grows by one effect after another. Where two effects look alike, such as a lag of the drive
and a filter of the instruments, the one that leads early may be the wrong one, and what is added
later makes up for it.
"""

from dataclasses import dataclass, replace

import numpy as np

from diagnose.hypotheses.hypothesis import Hypothesis, least_changes
from diagnose.hypotheses.linear_ranking import best_variants
from diagnose.hypotheses.set_screening import joined_from_null, without_effect
from diagnose.linear.regressors import Regressors, ShapeVariant
from diagnose.run_pool import RunPool
from drftjax.effects.catalogue import reported_names


@dataclass(frozen=True)
class ExchangeSettings:
    """Numbers by which effects of a set are exchanged.

    Attributes:
        min_alike: Share of an effect's response that another's makes up for, beside zeta, at least
            [-].
        max_alike: Effects tried in the place of one, at most.
    """

    min_alike: float = 0.5
    max_alike: int = 5


DEFAULT_EXCHANGE = ExchangeSettings()


def exchanged_sets(
    regressors: Regressors,
    best: Hypothesis,
    pool: RunPool,
    settings: ExchangeSettings = DEFAULT_EXCHANGE,
) -> list[Hypothesis]:
    """A set with one effect after the other replaced by its look-alikes, each with a step proposed.

    Args:
        regressors: The runs.
        best: The set, simulated.
        pool: Threads.
        settings: Numbers of the choice.
    """
    found = []
    for place in range(len(best.model.effects)):
        kept = without_effect(best, place)
        part = _response(best, place)
        rest = replace(
            kept,
            residual=[left - own for left, own in zip(best.residual, part, strict=True)],
            proposed_step=None,
        )
        names = set(look_alikes(regressors, best, part, pool, settings))
        variants = [
            each
            for each in regressors.variants
            if each.effect.about.name in names
            and len(reported_names((*rest.names, each.effect.about.name))) == len(best.names)
        ]
        if not variants:
            continue
        weights = regressors.settings
        matrices = regressors.gram_matrices_beside_all(
            rest.columns, rest.residual, rest.log_zeta, pool
        )
        (alike,) = best_variants(
            matrices,
            least_changes(rest),
            variants,
            best.fit.mean_square,
            [(0.0, weights.linear_error)],
            weights,
        )
        found += [joined_from_null(regressors, rest, *each) for each in alike.values()]
    return found


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
) -> list[str]:
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
    gram = _beside_zeta(products.weighed(regressors.settings))
    shares: dict[str, float] = {}
    for variant in regressors.variants:
        name = variant.effect.about.name
        if name in best.names:
            continue
        share = _made_up(gram, variant)
        shares[name] = max(share, shares.get(name, 0.0))
    alike = [name for name, share in shares.items() if share > settings.min_alike]
    return sorted(alike, key=lambda name: -shares[name])[: settings.max_alike]


def _beside_zeta(weighed: np.ndarray) -> np.ndarray:
    """Products of all columns, less what each run's own zeta makes up for, shape (n, n).

    `weighed` are the runs' weighed gram matrices, shape (runs, n, n).
    """
    own = weighed[:, 0]
    power = np.maximum(own[:, 0], 1e-300)
    return (weighed - own[:, :, None] * own[:, None, :] / power[:, None, None]).sum(axis=0)


def _made_up(gram: np.ndarray, variant: ShapeVariant) -> float:
    """Share of the first column behind zeta that a variant's columns make up for [-]."""
    taken = [2 + column for column in variant.columns]
    cross, power = gram[taken, 1], gram[1, 1]
    fitted = np.linalg.lstsq(gram[np.ix_(taken, taken)], cross, rcond=1e-10)[0]
    return float(cross @ fitted / power) if power > 0 else 0.0
