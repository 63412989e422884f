"""Priors that the runs speak against."""

import numpy as np

from identify.optimum import Optimum

# A prior and the runs contradict each other where they lie so many of their errors apart; chance
# makes that once in 370 times.
CONTRADICT = 3.0
# Of a number of which the runs tell less than this share of what is known, they say nothing.
LEAST_SHARE = 1e-3


def contradicted(optimum: Optimum) -> list[str]:
    """Sentences on priors that lie far from what the runs alone would tell.

    With a prior of error p the value has the error v, and the runs alone e: 1/v² = 1/p² + 1/e².
    The value lies b errors p from the prior, so the runs alone b / sqrt(1 - v²/p²) errors
    sqrt(p² + e²).

    Args:
        optimum: Where the fit ended; in its unbounded coordinates all errors are straight.
    """
    size = len(optimum.ordered)
    variance = np.diag(optimum.covariance)[:size]
    slope = optimum.solution.belief_slope[:size]
    belief = optimum.solution.belief[:size]
    share = 1 - variance * slope**2
    known = (slope != 0) & (share > LEAST_SHARE)
    apart = np.abs(belief) / np.sqrt(np.where(known, share, 1.0))
    return [
        f"{label}: its prior and the runs contradict each other, by {far:.1f} of their errors; the "
        "value is a compromise that neither believes"
        for label, far, told in zip(optimum.labels, apart, known, strict=True)
        if told and far > CONTRADICT
    ]
