"""Numbers by which a change is found, in one object."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.linear.bed import DEFAULT_BED, AbstractBed
from diagnose.linear.linear_fit import DEFAULT_LINEAR_FIT, Block, worth_by_block


@dataclass(frozen=True)
class DifferenceFitSettings:
    """Numbers by which effects are fitted to differences.

    Attributes:
        slow_worth: Independent statements in one bin of a slow part [-]. Far fewer than one: what
            a formula leaves of a true effect changes slowly, too.
        fast_worth: Independent statements in one sample of a fast part [-], likewise. A level says
            nothing here: each condition's zeta is free.
        bed: Scatter of zeta between runs, before these runs are seen.
        strength_prior: Width of the prior on a strength [typical sizes].
        shape_prior: Width of the prior on a shape's logarithm about where it starts [-].
        zeta_prior: Width of the prior on a common change of log zeta [-]: sand that was dug over
            or dried changes by a tenth, another sand may be of half the strength.
        law_factor_prior: Width of the prior on the factor by which a channel's response may be off
            [-]: laws whose coefficients and exponents differ as those of common sands do move x by
            a third more or less for the same change of sinkage.
        level_width: Width of the prior on a condition's log zeta, about that with which its runs
            without an effect were matched [-], over the root of its number of runs.
        linear_error: Share of a response that may be wrong for being linear, and for the sand's
            law being another [-].
        simulated_error: Share that may be wrong for the law alone, where a simulation gives the
            response [-].
        iterations: Reweightings of a fit.
    """

    slow_worth: float = 0.1
    fast_worth: float = 0.01
    bed: AbstractBed = DEFAULT_BED
    strength_prior: float = 5.0
    shape_prior: float = 0.7
    zeta_prior: float = 0.5
    law_factor_prior: float = 0.3
    level_width: float = 0.05
    linear_error: float = 0.15
    simulated_error: float = 0.05
    iterations: int = 10

    def model_errors(self, blocks: Sequence[Block]) -> np.ndarray:
        """Error in these blocks below which nothing is asked of a model, shape (blocks,)."""
        return DEFAULT_LINEAR_FIT.model_errors(blocks)

    def worth(self, blocks: Sequence[Block]) -> np.ndarray:
        """Independent statements in one value of these blocks [-], shape (blocks,)."""
        return worth_by_block(blocks, self.slow_worth, self.fast_worth, 0.0)


DEFAULT_DIFFERENCE_FIT = DifferenceFitSettings()
