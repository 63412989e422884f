"""Secant search for the zeta at which a simulated run matches its mean recorded sinkage.

Sand that bears more (larger zeta) lifts the wheel, nearly in proportion to the logarithm of zeta.
The search is therefore made in log zeta, and needs a few simulations and no derivative.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ZetaMatchSettings:
    """Numbers of the secant search.

    Attributes:
        max_steps: Steps at most: with `max_step` each, they reach a fifth or five times the first
            zeta.
        max_step: Longest change of log zeta [-] that one straight line is trusted for.
        min_step: The search ends where the next change of log zeta [-] is smaller: half a
            micrometre of sinkage.
        max_miss: A mean sinkage is matched within this [m], half the noise of a good scale, also
            where the steps end before `min_step`.
        rise_per_log_zeta: Rise of the wheel [m] per unit of log zeta, about what the wheel of Fuke
            et al. 2024 shows: the slope of the first step, where the caller knows none.
    """

    max_steps: int = 8
    max_step: float = 0.2
    min_step: float = 2e-5
    max_miss: float = 1e-5
    rise_per_log_zeta: float = 0.023


DEFAULT_ZETA_MATCH = ZetaMatchSettings()


@dataclass(frozen=True, eq=False)
class ZetaMatch:
    """End of a search, of one run or of several at once: shape () or (runs,).

    Attributes:
        log_zeta: Logarithm of zeta where the search ended, over the zeta that it began from.
        miss: Mean of simulated minus recorded height of the wheel there [m].
        slope: Rise of the wheel per unit of log zeta over the last step [m].
        matched: True where the mean sinkage is matched; the search ends without that where the
            wheel does not rise with zeta, or cannot be simulated.
    """

    log_zeta: np.ndarray
    miss: np.ndarray
    slope: np.ndarray
    matched: np.ndarray


def match_mean_sinkage(
    miss: Callable[[np.ndarray], np.ndarray | float],
    start: float | np.ndarray = 0.0,
    *,
    miss_at_start: float | np.ndarray | None = None,
    slope: float | None = None,
    settings: ZetaMatchSettings = DEFAULT_ZETA_MATCH,
) -> ZetaMatch:
    r"""Find log zeta $u$ with $m(u) = 0$ by secant steps, where $m$ is the mean miss in height.

    $u_{k+1} = u_k - m_k / s_k$ with $s_k = (m_k - m_{k-1}) / (u_k - u_{k-1})$, no step longer than
    `max_step`. Each run ends on its own; the others go on.

    Args:
        miss: Simulates at log zeta, shape () or (runs,), and returns the mean of simulated minus
            recorded height [m] of the same shape; last called where the search ends, unless that
            is at the start.
        start: Log zeta to begin from, shape () or (runs,).
        miss_at_start: `miss(start)`, where it is known already.
        slope: Rise per unit of log zeta [m] at the start, above 0, where it is known.
        settings: Numbers of the search.
    """
    at = np.asarray(start, float)
    here = np.asarray(miss(at) if miss_at_start is None else miss_at_start, float)
    rise = np.full(here.shape, settings.rise_per_log_zeta if slope is None else slope)

    def next_step() -> np.ndarray:
        with np.errstate(divide="ignore", invalid="ignore"):
            step = np.clip(-here / rise, -settings.max_step, settings.max_step)
        return np.where(rise > 0, step, np.nan)

    step = next_step()
    for _ in range(settings.max_steps):
        moves = np.abs(step) >= settings.min_step
        if not moves.any():
            break
        step = np.where(moves, step, 0.0)
        there = np.asarray(miss(at + step), float)
        rise = np.where(moves, (there - here) / np.where(moves, step, 1.0), rise)
        at, here = at + step, np.where(moves, there, here)
        step = next_step()
    matched = (np.abs(here) < settings.max_miss) | (np.abs(step) < settings.min_step)
    return ZetaMatch(at, here, rise, matched)
