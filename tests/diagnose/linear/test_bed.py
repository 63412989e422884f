"""Evidence of the scatter of zeta, against SciPy's multivariate Student-t and by derivatives."""

import numpy as np
import pytest
from scipy.stats import multivariate_t

from diagnose.linear.bed import FreeBed, PreparedBed

# Difference quotients of a smooth function with steps of 1e-6.
DERIVATIVE = 1e-6
SPREADS = ([0.01, -0.01, 0.02, 0.0, 0.005], [0.3, -0.2, 0.0, 0.1, -0.1])


def contrasts(runs: int) -> np.ndarray:
    """Orthonormal contrasts of so many runs, shape (runs - 1, runs)."""
    basis = np.linalg.qr(np.c_[np.ones(runs), np.eye(runs)[:, 1:]])[0]
    return basis[:, 1:].T


@pytest.mark.parametrize("bed", [PreparedBed(), PreparedBed(0.03, 9.0)])
def test_evidence_is_that_of_a_student_t_of_the_contrasts(bed):
    def reference(zetas):
        n = len(zetas) - 1
        law = multivariate_t(np.zeros(n), bed.scatter**2 * np.eye(n), df=bed.statements)
        return law.logpdf(contrasts(len(zetas)) @ zetas)

    near, far = map(np.array, SPREADS)
    found = [bed.evidence(np.var(each, ddof=1), len(each) - 1) for each in (near, far)]
    assert found[0] - found[1] == pytest.approx(reference(near) - reference(far), rel=1e-9)


@pytest.mark.parametrize("bed", [PreparedBed(), FreeBed()])
def test_hold_is_the_slope_of_the_evidence(bed):
    contrasts, variance, step = 6, 4e-4, 1e-9
    rise = bed.evidence(variance + step, contrasts) - bed.evidence(variance - step, contrasts)
    # By half the sum of squares, which is half the contrasts times their mean square.
    slope = -rise / (2 * step) / (contrasts / 2)
    assert bed.hold(variance, contrasts) == pytest.approx(slope, rel=DERIVATIVE * 100)


def test_the_scatter_of_a_run_goes_from_the_belief_to_the_runs_own():
    bed = PreparedBed(scatter=0.01, statements=4.0)

    def scatter(contrasts: int) -> float:
        return float(bed.hold(0.03**2, contrasts) ** -0.5)

    assert scatter(0) == pytest.approx(0.01)
    assert 0.01 < scatter(2) < 0.03
    assert scatter(200) == pytest.approx(0.03, rel=0.02)
    assert bed.evidence(0.03**2, 200) < bed.evidence(0.01**2, 200)


def test_repeats_outweigh_what_is_usual():
    zetas = np.log([0.8, 0.88, 0.7, 0.77, 0.9, 0.99])
    found = PreparedBed().after_repeats(zetas, [[0, 1], [2, 3], [4, 5]])
    between = np.log(1.1) / np.sqrt(2)
    expected = np.sqrt((4 * 0.012**2 + 3 * between**2) / 7)
    assert found.scatter == pytest.approx(expected, rel=1e-9)
    assert found.statements == 7.0
    assert PreparedBed().after_repeats(zetas, [[k] for k in range(6)]) == PreparedBed()


def test_zeta_that_falls_with_the_condition_is_no_scatter_of_a_prepared_bed():
    """Three runs that agree against three that halve: a nat or two if free, dozens if prepared."""
    fall, still = float(np.var(np.log([0.9, 0.75, 0.6, 0.45]), ddof=1)), 1e-4

    def loss(bed):
        return bed.evidence(still, 3) - bed.evidence(fall, 3)

    assert loss(PreparedBed()) > 10
    assert loss(PreparedBed()) > 2 * loss(FreeBed())
