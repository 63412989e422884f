"""Responses of the runs to further effects beside a set, by the simulator at the set's numbers.

Those of the regressors are taken about the reference model. Beside a lag, or an effect that bends
the runs' path, they are others, and rank effects wrongly whose response zeta all but makes up for.
An effect that the common program lacks, as it would slow it down, is simulated at a small strength
in the place of its derivative.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnose.hypotheses.hypothesis import Hypothesis
from diagnose.linear.regressors import Regressors, ShapeVariant
from diagnose.model.augmented_model import (
    COLUMN_COUNTS,
    AugmentedModel,
    Directions,
    predict,
)
from diagnose.run_pool import RunPool
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import shapes, strengths

# Those of the program that differentiates small sets, which is compiled already.
COLUMNS = COLUMN_COUNTS[0]


# Strength that is simulated of an effect that the common program lacks [typical sizes]: beyond what
# plates that enter the sand one by one make of it, and little of what effects usually are.
SMALL_STRENGTH = 0.1

# Responses by further effect, by run: one column for each strength [m, N, N m], shape (channels,
# samples, strengths).
ResponsesOf = Mapping[str, list[np.ndarray]]


@dataclass(frozen=True, eq=False)
class FurtherResponses:
    """Responses to a set of effects and to further ones at their null beside it.

    Attributes:
        variants: One of each further effect, with the numbers of its columns behind the set's.
        columns: By run, the set's columns and behind them one for each strength [m, N, N m], shape
            (channels, samples, 1 + free + strengths).
    """

    variants: tuple[ShapeVariant, ...]
    columns: list[np.ndarray]

    @classmethod
    def of(
        cls,
        regressors: Regressors,
        here: Hypothesis,
        variants: Sequence[ShapeVariant],
        exact: ResponsesOf,
    ) -> "FurtherResponses":
        """A set's responses, with those of further effects; the regressors' where none is exact.

        Args:
            regressors: The runs.
            here: The set, with columns at its numbers.
            variants: One of each further effect.
            exact: By the simulator, of these or of others.
        """
        behind, numbered, place = [], [], 0
        for each in variants:
            taken = [1 + column for column in each.columns]
            known = [every[:, :, taken] for every in regressors.columns]
            behind.append(exact.get(each.effect.about.name, known))
            numbered.append(replace(each, columns=tuple(range(place, place + len(taken)))))
            place += len(taken)
        columns = [np.concatenate(run, axis=2) for run in zip(here.columns, *behind, strict=True)]
        return cls(tuple(numbered), columns)


def exact_responses(
    regressors: Regressors,
    here: Hypothesis,
    variants: Sequence[ShapeVariant],
    pool: RunPool,
) -> ResponsesOf:
    """Differentiate the runs at a set's numbers by further effects' strengths at their null.

    Args:
        regressors: The runs.
        here: The set.
        variants: One of each further effect.
        pool: Threads.

    Returns:
        Of all effects, but those at whose small strength a run cannot be simulated.
    """
    whole = regressors.common_model_with(here.model.effects)
    known = [each for each in variants if each.effect in whole.effects]
    found: dict[str, list[np.ndarray]] = {}
    # By the program of fewer effects where it has these, as it takes half as long.
    for model in dict.fromkeys((regressors.dataset.shared, whole)):
        have = {*model.effects}
        own = [
            each
            for each in known
            if each.effect.about.name not in found and {*here.model.effects, each.effect} <= have
        ]
        if own:
            found |= _responses_by(regressors, here, own, model, pool)
    lacking = [each for each in variants if each not in known]
    return {**found, **_secants(regressors, here, lacking, pool)} if lacking else found


def _secants(
    regressors: Regressors, here: Hypothesis, variants: Sequence[ShapeVariant], pool: RunPool
) -> ResponsesOf:
    """Secants of the runs over `SMALL_STRENGTH` of further effects from their null [m, N, N m].

    Zeta changes along, so that the wheel stays about as deep: where sand gets stronger a wheel that
    rests stands for longer, which no derivative shows. What zeta does is taken off again.

    Returns:
        Of each effect with which all runs can be simulated, of shapes as `ResponsesOf` has them.
    """
    dataset = regressors.dataset

    def simulated(
        model: AugmentedModel, log_zeta: np.ndarray, coordinates: np.ndarray
    ) -> list[np.ndarray]:
        dataset.compile(pool, predict, model)
        return dataset.map(
            pool, lambda run: dataset.prediction(model, run, log_zeta[run], coordinates)
        )

    # One program of all of them: each further one would have to be compiled.
    whole = AugmentedModel((*here.model.effects, *(each.effect for each in variants)))
    null = [np.r_[np.zeros(len(each.columns)), np.log(each.shapes)] for each in variants]
    start = np.concatenate([here.coordinates, *null])
    plain = simulated(here.model, here.log_zeta, here.coordinates)
    found, first = {}, len(here.coordinates)
    for each, own in zip(variants, null, strict=True):
        steps = SMALL_STRENGTH * np.eye(len(each.columns), len(start), first)
        first += len(own)
        by_zeta = np.array([_as_zeta(regressors, column) for column in each.columns])
        moved = [
            simulated(whole, here.log_zeta - SMALL_STRENGTH * share, start + step)
            for share, step in zip(by_zeta, steps, strict=True)
        ]
        if all(dataset.all_finite(runs) for runs in moved):
            found[each.effect.about.name] = [
                np.stack(
                    [
                        (moved[k][run] - plain[run]) / SMALL_STRENGTH
                        + by_zeta[k, run] * here.columns[run][:, :, 0]
                        for k in range(len(steps))
                    ],
                    axis=2,
                )
                for run in dataset.run_numbers
            ]
    return found


def _as_zeta(regressors: Regressors, column: int) -> np.ndarray:
    """Log zeta that changes each run's sinkage about as a strength does [-], shape (runs,).

    By the responses about the reference model.
    """
    z = regressors.dataset.channels.index("z")
    found = []
    for columns in regressors.columns:
        zeta, strength = columns[z, :, 0], columns[z, :, 1 + column]
        found.append(zeta @ strength / max(zeta @ zeta, np.finfo(float).tiny))
    return np.array(found)


def _responses_by(
    regressors: Regressors,
    here: Hypothesis,
    variants: Sequence[ShapeVariant],
    whole: AugmentedModel,
    pool: RunPool,
) -> ResponsesOf:
    """Responses by the program of one model, which has the set and the further effects."""
    places, start = _rows(whole), _start(whole, here, variants)
    rows = [places[each.effect, name] for each in variants for name in strengths(each.effect)]
    chunks = [
        _slopes(regressors, here, whole, start, rows[first : first + COLUMNS], pool)
        for first in range(0, len(rows), COLUMNS)
    ]
    found, place = {}, 0
    for each in variants:
        own = range(place, place + len(each.columns))
        found[each.effect.about.name] = [
            np.stack([chunks[k // COLUMNS][run][:, :, 1 + k % COLUMNS] for k in own], axis=2)
            for run in regressors.dataset.run_numbers
        ]
        place += len(each.columns)
    return found


def _rows(whole: AugmentedModel) -> dict[tuple[type[AbstractEffect], str], int]:
    """Place of each number of a model, by effect and name."""
    return {(whole.effects[f.index], f.field): row for row, f in enumerate(whole.free)}


def _start(whole: AugmentedModel, here: Hypothesis, variants: Sequence[ShapeVariant]) -> np.ndarray:
    """Coordinates of a whole model at a set's numbers, the other effects at their null."""
    start, rows = whole.null(), _rows(whole)
    for free, value in zip(here.model.free, here.coordinates, strict=True):
        start[rows[here.model.effects[free.index], free.field]] = value
    for each in variants:
        for name, value in zip(shapes(each.effect), each.shapes, strict=True):
            start[rows[each.effect, name]] = np.log(value)
    return start


def _slopes(
    regressors: Regressors,
    here: Hypothesis,
    whole: AugmentedModel,
    start: np.ndarray,
    rows: Sequence[int],
    pool: RunPool,
) -> list[np.ndarray]:
    """By run, derivatives by (own log zeta, `COLUMNS` coordinates) [m, N, N m].

    Args:
        regressors: The runs.
        here: The set.
        whole: The model that is differentiated.
        start: Its coordinates, shape (its free numbers,).
        rows: Places of the coordinates among them; columns past these are zero.
        pool: Threads.

    Returns:
        Each of shape (channels, samples, 1 + COLUMNS).
    """
    mix = np.zeros((len(start), COLUMNS))
    mix[rows, np.arange(len(rows))] = 1
    directions = Directions(whole, ({},) * len(whole.effects), start, mix, COLUMNS)
    nothing = np.zeros(COLUMNS)  # added to the start
    return regressors.dataset.derivatives(pool, directions, here.log_zeta, nothing)
