"""Prediction of runs left out by condition: does an effect found on some runs help on others?

All runs of one command and load are left out together, the effect's numbers move to where the
others alone would have them, and the left-out runs are simulated with these. The move is one
straight-line step from the numbers fitted to all runs, not a search anew; which effects are tried
was chosen on all runs too. Each run's own zeta stays its own and is fitted to it: sand is never the
same twice, and no effect can know it.
"""

from collections.abc import Sequence

import numpy as np

from diagnose.bench import Bench
from diagnose.evidence import Products, fit_line
from diagnose.hypothesis import Hypothesis, changes
from identify.candidate import Candidate

# Loads [kg, N] and commands [rad/s, m/s] are the same within this.
SAME = 1e-6
# Runs whose sands are believed to differ by more than this in log zeta do not repeat each other.
SAME_SAND = 0.2
# A run that was stopped early repeats another where it holds this share of it.
LEAST_SHARED = 0.5


def conditions(candidates: Sequence[Candidate]) -> list[list[int]]:
    """Runs of the same command and load, by number; one that was stopped early is among them."""
    groups: list[list[int]] = []
    for number, each in enumerate(candidates):
        for group in groups:
            if _alike(candidates[group[0]], each):
                group.append(number)
                break
        else:
            groups.append([number])
    return groups


def _alike(one: Candidate, other: Candidate) -> bool:
    """Whether two runs repeat one condition for as long as both go on."""
    rigs = one.setup.rig, other.setup.rig
    loads = [(each.mass_x, each.mass_z, each.drawbar_load) for each in rigs]
    if not np.allclose(*loads, rtol=0, atol=SAME):
        return False
    sands = [each.setup.terrain.zeta for each in (one, other)]
    known = [np.log(sand) for sand in sands if isinstance(sand, float)]
    if np.ptp(known or [0.0]) > SAME_SAND:
        return False
    a, b = one.setup.command, other.setup.command
    if (a.vx is None) != (b.vx is None):
        return False
    ends = a.time[-1] - a.time[0], b.time[-1] - b.time[0]
    if min(ends) < LEAST_SHARED * max(ends):
        return False
    # Straight lines agree where they agree at the corners of both.
    times = [np.asarray(each.time) - each.time[0] for each in (a, b)]
    corners = np.union1d(*times)
    corners = corners[corners <= min(ends)]

    def agree(first: Sequence[float], second: Sequence[float]) -> bool:
        values = (np.interp(corners, t, v) for t, v in zip(times, (first, second), strict=True))
        return np.allclose(*values, rtol=0, atol=SAME)

    return agree(a.omega, b.omega) and (a.vx is None or agree(a.vx, b.vx or ()))


def predicted_unseen(bench: Bench, hypothesis: Hypothesis) -> list[np.ndarray]:
    """Simulated less recorded of each run, from numbers fitted without its condition."""
    count = len(hypothesis.coordinates)
    if count == 0:
        return hypothesis.residual
    products = bench.products_of(hypothesis.columns, hypothesis.residual, hypothesis.log_zeta)
    places: dict[int, tuple[float, np.ndarray]] = {}
    for group in conditions(bench.case.candidates):
        kept = np.setdiff1d(np.arange(len(hypothesis.log_zeta)), group)
        if kept.size == 0:
            continue
        _, move = changes(hypothesis, _of_runs(products, kept))
        for run in group:
            own = _own_zeta(products, run, move)
            places[run] = hypothesis.log_zeta[run] + own, hypothesis.coordinates + move

    def of(run: int) -> np.ndarray:
        if run not in places:
            return hypothesis.residual[run]
        case = bench.case
        predicted = case.predicted(hypothesis.model, run, *places[run])
        return predicted - case.recorded(run)

    return bench.case.each_run(of)


def _of_runs(products: Products, runs: np.ndarray) -> Products:
    return Products(
        products.blocks, products.gram[runs], products.number[runs], products.log_zeta[runs]
    )


def _own_zeta(products: Products, run: int, move: np.ndarray) -> float:
    """Change of one run's log zeta that suits these numbers best."""
    gram = products.gram[run]
    moved = gram[:, :, -1] + gram[:, :, 1:-1] @ move
    fixed = np.zeros((len(gram), 2, 2))
    fixed[:, 0, 0] = gram[:, 0, 0]
    fixed[:, 0, 1] = fixed[:, 1, 0] = moved[:, 0]
    fixed[:, 1, 1] = moved[:, -1] + moved[:, 1:-1] @ move
    alone = Products(
        products.blocks,
        fixed[None],
        products.number[run][None],
        products.log_zeta[run][None],
    )
    return float(fit_line(alone, []).zeta[0])
