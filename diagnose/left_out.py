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


def conditions(candidates: Sequence[Candidate]) -> list[list[int]]:
    """Runs of the same command and load, by number."""
    groups: dict[tuple, list[int]] = {}
    for number, each in enumerate(candidates):
        groups.setdefault(_condition(each), []).append(number)
    return list(groups.values())


def _condition(candidate: Candidate) -> tuple:
    command, rig = candidate.setup.command, candidate.setup.rig
    knots = tuple(np.round(command.time, 6)), tuple(np.round(command.omega, 6))
    return (*knots, round(rig.mass_x, 6), round(rig.mass_z, 6), round(rig.drawbar_load, 6))


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
