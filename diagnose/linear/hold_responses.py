"""Responses of what holds a free carriage (`diagnose.model.carriage_hold`).

Only what pulls at the carriage and what misreads a force have one: whatever the sand, the wheel or
its drive do, the carriage's motion tells of it. A linearised run, whose nodes lie far apart, would
make some of a wheel that is let go; so the responses are secants of the simulator.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from diagnose.dataset import RigDataset
from diagnose.model.augmented_model import AugmentedModel
from drftjax.effects.base import AbstractLoad, AbstractSandLoad, AbstractSensor

if TYPE_CHECKING:
    from diagnose.linear.regressors import ShapeVariant


def with_hold_responses(
    dataset: RigDataset,
    run: int,
    log_zeta: float,
    variants: Sequence["ShapeVariant"],
    columns: np.ndarray,
    plain: np.ndarray,
) -> np.ndarray:
    """Columns whose rows of forces are responses of what holds the carriage.

    Args:
        dataset: The runs.
        run: Number of one.
        log_zeta: Its log zeta over its set-up's [-].
        variants: Effects with their shapes.
        columns: Derivatives by own log zeta and every strength in its typical size [m, N, N m],
            shape (channels, samples, 1 + columns).
        plain: The reference model's channels there, shape (channels, samples).

    Returns:
        The same shape; of a driven carriage, or without forces, the same columns.
    """
    masses = dataset.holds[run].masses
    if not masses:
        return columns
    rows = [dataset.channels.index(each) for each in masses]
    held = np.array(columns)
    held[rows] = 0.0
    known = np.isfinite(plain)
    for variant in variants:
        if not _holds_or_reads(variant):
            continue
        model, null = _at_null(variant)
        strengths = [place for place, f in enumerate(model.free) if f.scale is not None]
        for place, column in zip(strengths, variant.columns, strict=True):
            # Backward, where forward the wheel sinks past its plates; nothing, where it does there.
            for sense in (1.0, -1.0):
                at = null.copy()
                at[place] = sense
                change = dataset.prediction(model, run, log_zeta, at) - plain
                if np.isfinite(change[known]).all():
                    held[rows, :, 1 + column] = sense * change[rows]
                    break
    return held


def _holds_or_reads(variant: "ShapeVariant") -> bool:
    effect = variant.effect
    is_load = issubclass(effect, AbstractLoad) and not issubclass(effect, AbstractSandLoad)
    return is_load or issubclass(effect, AbstractSensor)


def _at_null(variant: "ShapeVariant") -> tuple[AugmentedModel, np.ndarray]:
    """A model with one effect, and its coordinates at no strength and the variant's shapes."""
    model, shapes = AugmentedModel((variant.effect,)), iter(variant.shapes)
    null = [0.0 if f.scale is not None else f.coordinate(next(shapes)) for f in model.free]
    return model, np.array(null)
