"""Responses of the runs to further effects beside a set, by the simulator at the set's numbers.

Those of the regressors are taken about the reference model. Beside a lag, or an effect that bends
the runs' path, they are others, and rank effects wrongly whose response zeta all but makes up for.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnose.hypotheses.hypothesis import Hypothesis
from diagnose.linear.regressors import Regressors, ShapeVariant
from diagnose.model.augmented_model import (
    COLUMN_COUNTS,
    AugmentedModel,
    Directions,
)
from diagnose.run_pool import RunPool
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import shapes, strengths

# Those of the program that differentiates small sets, which is compiled already.
COLUMNS = COLUMN_COUNTS[0]


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

    def by_name(self) -> dict[str, list[np.ndarray]]:
        """By further effect, by run: its own columns, shape (channels, samples, strengths)."""
        strengths_of_all = sum(len(each.columns) for each in self.variants)
        found = {}
        for each in self.variants:
            own = [column - strengths_of_all for column in each.columns]  # from the last column
            found[each.effect.about.name] = [of_run[:, :, own] for of_run in self.columns]
        return found


def exact_responses(
    regressors: Regressors,
    here: Hypothesis,
    variants: Sequence[ShapeVariant],
    pool: RunPool,
) -> FurtherResponses:
    """Differentiate the runs at a set's numbers by its own and by further effects' strengths.

    Of an effect that the common program lacks, or beside a set with one, the regressors' stand.

    Args:
        regressors: The runs.
        here: The set, with columns at its numbers.
        variants: One of each further effect.
        pool: Threads.

    Returns:
        The set's columns with those of the further effects behind.
    """
    taken = [1 + column for each in variants for column in each.columns]
    columns = [
        np.concatenate([own, known[:, :, taken]], axis=2)
        for own, known in zip(here.columns, regressors.columns, strict=True)
    ]
    numbered, place = [], 0
    for each in variants:
        numbered.append(replace(each, columns=tuple(range(place, place + len(each.columns)))))
        place += len(each.columns)
    common = regressors.common_model
    if set(here.model.effects) <= set(common.effects):
        rows = _rows(common)
        wanted = [
            (rows[each.effect, name], 1 + len(here.coordinates) + column)
            for each in numbered
            if each.effect in common.effects
            for name, column in zip(strengths(each.effect), each.columns, strict=True)
        ]
        start = _start(common, here, variants)
        for first in range(0, len(wanted), COLUMNS):
            some = wanted[first : first + COLUMNS]
            slopes = _slopes(regressors, here, start, [row for row, _ in some], pool)
            for own, slope in zip(columns, slopes, strict=True):
                own[:, :, [column for _, column in some]] = slope[:, :, 1 : 1 + len(some)]
    return FurtherResponses(tuple(numbered), columns)


def _rows(common: AugmentedModel) -> dict[tuple[type[AbstractEffect], str], int]:
    """Place of each number of the common program, by effect and name."""
    return {(common.effects[f.index], f.field): row for row, f in enumerate(common.free)}


def _start(
    common: AugmentedModel, here: Hypothesis, variants: Sequence[ShapeVariant]
) -> np.ndarray:
    """Coordinates of the common program at a set's numbers, the other effects at their null."""
    start, rows = common.null(), _rows(common)
    for free, value in zip(here.model.free, here.coordinates, strict=True):
        start[rows[here.model.effects[free.index], free.field]] = value
    for each in variants:
        if each.effect in common.effects:
            for name, value in zip(shapes(each.effect), each.shapes, strict=True):
                start[rows[each.effect, name]] = np.log(value)
    return start


def _slopes(
    regressors: Regressors,
    here: Hypothesis,
    start: np.ndarray,
    rows: Sequence[int],
    pool: RunPool,
) -> list[np.ndarray]:
    """By run, derivatives by (own log zeta, `COLUMNS` coordinates) [m, N, N m].

    Args:
        regressors: The runs.
        here: The set.
        start: Coordinates of the common program, shape (its free numbers,).
        rows: Places of the coordinates among them; columns past these are zero.
        pool: Threads.

    Returns:
        Each of shape (channels, samples, 1 + COLUMNS).
    """
    common = regressors.common_model
    mix = np.zeros((len(start), COLUMNS))
    mix[rows, np.arange(len(rows))] = 1
    directions = Directions(common, ({},) * len(common.effects), start, mix, COLUMNS)
    nothing = np.zeros(COLUMNS)  # added to the start
    return regressors.dataset.derivatives(pool, directions, here.log_zeta, nothing)
