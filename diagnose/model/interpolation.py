"""Rows of a run at other times."""

import numpy as np


def rows_at(time: np.ndarray, rows: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Rows at other times, linearly between those that there are, level beyond their ends.

    Args:
        time: Times of the rows, increasing, two or more [s], shape (rows,).
        rows: In any unit, shape (rows, ...).
        wanted: Times wanted [s], shape (wanted,).

    Returns:
        Shape (wanted, ...), in the rows' unit.
    """
    place = np.clip(np.searchsorted(time, wanted, side="right") - 1, 0, len(time) - 2)
    share = np.clip((wanted - time[place]) / (time[place + 1] - time[place]), 0, 1)
    share = share.reshape(-1, *[1] * (rows.ndim - 1))
    return rows[place] * (1 - share) + rows[place + 1] * share
