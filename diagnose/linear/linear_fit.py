"""How well effects explain a case, judged on straight lines through the baseline.

Every run and block gives a matrix of products of its columns: its own zeta, every effect's
strengths, and what the baseline leaves. All fits on straight lines then cost a few numbers each.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.linear.residual_blocks import KINDS

# A model's own error, in each block, that no fit is asked to go under [m, N, N m].
FLOOR = {
    ("z", "slow"): 20e-6,
    ("z", "fast"): 10e-6,
    ("x", "slow"): 20e-6,
    ("x", "fast"): 20e-6,
    ("fx", "slow"): 0.3,
    ("fx", "fast"): 0.5,
    ("fz", "slow"): 0.3,
    ("fz", "fast"): 0.5,
    ("torque", "slow"): 0.03,
    ("torque", "fast"): 0.05,
}


# Scatter of log zeta from run to run that says nothing.
ZETA_SCATTER = 0.012


# How many independent statements a block makes: per bin, and per sample.
WORTH = {"slow": 0.1, "fast": 0.01}


ZETA_WORTH = 0.6


TURNS = 8


# Share of an effect's response that its straight line may be wrong by.
LINES_ERR = 0.1


# How straight lines are judged, order by order: the share of the worst block's distance from its
# floor that floors are raised to, and the share of a response that a line may be wrong by. The last
# takes lines at their word: an effect that zeta all but makes up for is small only on the whole.
ORDERS = ((0.3, LINES_ERR), (0.1, LINES_ERR), (0.0, LINES_ERR), (0.0, 0.0))


@dataclass(frozen=True)
class GramMatrices:
    """Products of columns, by run and block.

    Attributes:
        blocks: (channel, kind) of each block.
        gram: Products of (own zeta, columns..., residual), shape (runs, blocks, n, n).
        number: Samples in each, shape (runs, blocks).
        log_zeta: The baseline's log zeta of each run, over one reference for all.
    """

    blocks: tuple[tuple[str, str], ...]
    gram: np.ndarray
    sample_count: np.ndarray
    log_zeta: np.ndarray


@dataclass(frozen=True)
class LinearFit:
    """A fit on straight lines.

    Attributes:
        score: What it is worth: half the weighted sum of the logarithms of what is left, less.
        strengths: Coordinates of the columns used.
        zeta: Change of each run's log zeta.
        left: Mean square left in each block.
        scatter: Mean square of log zeta about its mean.
    """

    score: float
    coefficients: np.ndarray
    log_zeta_change: np.ndarray
    mean_square: np.ndarray
    zeta_variance: float


def fit_linear(
    products: GramMatrices,
    columns: Sequence[int],
    runs: np.ndarray | None = None,
    prior: np.ndarray | None = None,
    at: np.ndarray | None = None,
    least: np.ndarray | None = None,
    trust: float = LINES_ERR,
    coarse: float = 1.0,
) -> LinearFit:
    """The best fit of some columns, every block weighed by what it leaves.

    Args:
        products: Of the case.
        columns: Which columns act, by their number.
        runs: Which runs count; all where none are given.
        prior: Width of the belief about each column's coefficient; none where left out.
        at: Values the coefficients count from, for that belief; zero where left out.
        least: Least change of each coefficient; none where left out.
        trust: Share of the columns' response that a straight line may be wrong by.
        coarse: Every block's floor is taken this much higher, so that the blocks that are missed
            by most lead.
    """
    p = len(columns)
    chosen = np.arange(len(products.gram)) if runs is None else np.flatnonzero(runs)
    r = len(chosen)
    take = np.r_[0, 1 + np.asarray(columns, int), products.gram.shape[-1] - 1]
    gram = products.gram[np.ix_(chosen, np.arange(len(products.blocks)), take, take)]
    number = products.sample_count[chosen]
    total = number.sum(axis=0)
    floor = (coarse * np.array([FLOOR[b] for b in products.blocks])) ** 2
    worth = total * np.array([WORTH[kind] for _, kind in products.blocks])
    u0 = products.log_zeta[chosen]
    centre = np.eye(r) - 1.0 / r
    left = gram[:, :, -1, -1].sum(axis=0) / np.maximum(total, 1)
    scatter = float(u0 @ centre @ u0) / max(r - 1, 1)
    zeta_worth = ZETA_WORTH * (r - 1)
    ridge = np.zeros(p) if prior is None else 1 / np.asarray(prior) ** 2
    here = np.zeros(p) if at is None else np.asarray(at)
    solution = np.zeros(p + r)
    wrong = np.zeros(len(total))
    for _ in range(TURNS):
        weight = worth / (np.maximum(total, 1) * (left + floor + wrong))
        summed = np.einsum("b,rbij->rij", weight, gram)
        normal = np.zeros((p + r, p + r))
        right = np.zeros(p + r)
        normal[:p, :p] = summed[:, 1:-1, 1:-1].sum(axis=0) + np.diag(ridge)
        right[:p] = -summed[:, 1:-1, -1].sum(axis=0) - ridge * here
        own = np.arange(p, p + r)
        normal[own, own] = summed[:, 0, 0]
        normal[:p, p:] = summed[:, 1:-1, 0].T
        normal[p:, :p] = summed[:, 1:-1, 0]
        right[p:] = -summed[:, 0, -1]
        hold = zeta_worth / max(r - 1, 1) / (scatter + ZETA_SCATTER**2)
        normal[p:, p:] += hold * centre
        right[p:] -= hold * centre @ u0
        size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        scaled = normal / np.outer(size, size) + 1e-10 * np.eye(p + r)
        solution = np.linalg.solve(scaled, right / size) / size
        if least is not None and (low := np.flatnonzero(solution[:p] < least)).size:
            # What would fall under its least stays there, and the others are found anew.
            free = np.setdiff1d(np.arange(p + r), low)
            solution[low] = least[low]
            held = (right - normal[:, low] @ least[low])[free]
            inner = scaled[np.ix_(free, free)]
            solution[free] = np.linalg.solve(inner, held / size[free]) / size[free]
        full = np.concatenate(
            [solution[p:, None], np.tile(solution[:p], (r, 1)), np.ones((r, 1))], axis=1
        )
        left = np.einsum("ri,rbij,rj->b", full, gram, full) / np.maximum(total, 1)
        left = np.maximum(left, 0)
        response = np.concatenate([full[:, :-1], np.zeros((r, 1))], axis=1)
        response[:, 0] = 0
        wrong = np.einsum("ri,rbij,rj->b", response, gram, response) / np.maximum(total, 1)
        wrong = trust**2 * np.maximum(wrong, 0)
        moved = u0 + solution[p:]
        scatter = float(moved @ centre @ moved) / max(r - 1, 1)
    score = log_score(products.blocks, total, left + wrong, scatter, r, coarse)
    return LinearFit(score, solution[:p], solution[p:], left, scatter)


def floor_inflation(blocks: Sequence[tuple[str, str]], left: np.ndarray, share: float) -> float:
    """A share of how many floors the worst block is missed by; one at least."""
    floor = np.array([FLOOR[block] for block in blocks])
    return max(1.0, share * float((np.sqrt(left) / floor).max()))


def log_score(
    blocks: Sequence[tuple[str, str]],
    number: np.ndarray,
    left: np.ndarray,
    scatter: float,
    runs: int,
    coarse: float = 1.0,
) -> float:
    """What a model is worth by what it leaves: mean squares by block, and the scatter of zeta."""
    floor = (coarse * np.array([FLOOR[block] for block in blocks])) ** 2
    worth = number * np.array([WORTH[kind] for _, kind in blocks])
    score = -0.5 * float((worth * np.log(left + floor)).sum())
    return score - 0.5 * ZETA_WORTH * (runs - 1) * float(np.log(scatter + ZETA_SCATTER**2))


def block_names(channels: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Blocks of these channels."""
    return tuple((channel, kind) for channel in channels for kind in KINDS)
