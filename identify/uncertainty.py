"""Standard errors of fitted coordinates, honest about residuals that follow one another."""

import numpy as np

from identify.solve import normal_equations

# Beyond this the inflation is no longer an estimate but a statement that the samples are one.
LARGEST_CORRELATION = 0.9999


def lag_one_correlation(residual: np.ndarray, counts: np.ndarray) -> float:
    """Correlation of a residual with its neighbour [-], over the samples that count."""
    both = counts[1:] & counts[:-1]
    power = np.sum(residual[counts] ** 2)
    if power == 0 or not both.any():
        return 0.0
    scale = counts.sum() / both.sum()
    return float(
        np.clip(scale * np.sum(residual[1:] * residual[:-1] * both) / power, 0, LARGEST_CORRELATION)
    )


def covariance(
    residual: np.ndarray,
    blocks: np.ndarray,
    counts: np.ndarray,
    shared: int,
    belief_slope: np.ndarray,
    offset: np.ndarray,
    phase: np.ndarray,
) -> np.ndarray:
    """Covariance of (shared, run 1's own, run 2's own, ...) coordinates.

    The residual of each run and channel is taken as first-order autoregressive: its variance is
    measured, and (1 + rho) / (1 - rho) samples count as one. Beyond that the simulation itself may
    be off by a constant in every phase of the command, which no number of samples averages away.
    A direction that the data do not see gets a very large variance.

    Args:
        residual: Weighted residuals at the optimum, shape (runs, channels, samples).
        blocks: Their derivative by (shared, own) coordinates, shape (..., shared + own).
        counts: True for samples that were recorded, shape (runs, channels, samples).
        shared: Number of shared coordinates.
        belief_slope: Derivative of each coordinate's prior residual; zero where it has none.
        offset: Weighted residual that one standard deviation of such a constant makes, shape
            (runs, channels, samples).
        phase: Number of each sample's phase, shape (runs, samples).

    Returns:
        Covariance, shape (shared + runs * own,) squared.
    """
    number = np.maximum(counts.sum(axis=2), 1)
    variance = np.maximum((residual**2).sum(axis=2) / number, 1.0)
    inflation = variance.copy()
    for run, channel in np.ndindex(variance.shape):
        rho = lag_one_correlation(residual[run, channel], counts[run, channel])
        inflation[run, channel] *= (1 + rho) / (1 - rho)
    scale = counts / np.sqrt(inflation)[:, :, None]
    information, _ = normal_equations(blocks * scale[..., None], shared, residual)
    information -= _hidden(blocks * scale[..., None], offset * scale, phase, shared)
    information += np.diag(belief_slope**2)
    size = len(information)
    values, vectors = np.linalg.eigh(information)
    floor = values.max() * np.finfo(float).eps * size if size else 0.0
    return (vectors / np.maximum(values, max(floor, np.finfo(float).tiny))) @ vectors.T


def _hidden(blocks: np.ndarray, offset: np.ndarray, phase: np.ndarray, shared: int) -> np.ndarray:
    """Information that an unknown constant in each run, channel and phase takes away.

    By Sherman and Morrison, with the constant's unit vector u: J^T u u^T J / (1 + u^T u).
    """
    runs, channels, _ = offset.shape
    own = blocks.shape[-1] - shared
    size = shared + runs * own
    hidden = np.zeros((size, size))
    for run in range(runs):
        place = np.r_[0:shared, shared + run * own : shared + (run + 1) * own]
        for channel in range(channels):
            for here in (phase[run] == number for number in np.unique(phase[run])):
                unit = offset[run, channel, here]
                along = blocks[run, channel, here].T @ unit
                hidden[np.ix_(place, place)] += np.outer(along, along) / (1 + unit @ unit)
    return hidden
