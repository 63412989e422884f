r"""Scatter of zeta between the runs of one bed: what is known of it, and its evidence.

Log zeta of run r is $\mu + \epsilon_r$, a mean of the bed and a scatter that no two preparations
escape. Either somebody prepared the bed alike for every run, and zeta of a run is predicted by the
others' within that scatter; or nobody did, and each run has its own.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

Numeric = TypeVar("Numeric", float, np.ndarray)


def zeta_variance(log_zeta: np.ndarray) -> float:
    """Variance of log zeta over the runs [-]; 0 of one run. `log_zeta` has shape (runs,)."""
    return float(np.var(log_zeta, ddof=1)) if len(log_zeta) > 1 else 0.0


class AbstractBed(ABC):
    """Rule by which the zetas of several runs are judged together; has their `scatter` [-]."""

    scatter: float

    @abstractmethod
    def evidence(self, variance: float, contrasts: int, pardoned: float = 0.0) -> float:
        """Log evidence of the zetas of some runs.

        Args:
            variance: Mean square of log zeta's contrasts, such as its variance over runs [-].
            contrasts: Their number: runs less one of one mean, runs less conditions of a mean each.
            pardoned: Variance that is not held against a model, beyond the bed's scatter [-].
        """

    @abstractmethod
    def hold(self, variance: Numeric, contrasts: int) -> Numeric:
        """Weight of a squared distance of log zeta from its mean, in a reweighted fit [-].

        It is the derivative of the evidence by half the sum of squares, and one over the variance
        of a run's log zeta as the bed and the runs tell it. Arguments as for `evidence`, of any
        shape.
        """

    @abstractmethod
    def after_repeats(self, log_zeta: np.ndarray, groups: Sequence[Sequence[int]]) -> "AbstractBed":
        """The bed with what the zetas of repeats say of its scatter.

        Args:
            log_zeta: Of each run, over one reference for all [-], shape (runs,).
            groups: Runs of each condition, by index.
        """


@dataclass(frozen=True)
class PreparedBed(AbstractBed):
    r"""A bed prepared alike for every run: a run's zeta is predicted by the others'.

    The variance of the scatter has a scaled inverse chi-square distribution of $\nu$ statements
    about $\tau^2$; repeats of one condition add theirs. Then n contrasts of the zetas (of R runs,
    R - 1) have a multivariate Student-t distribution,

    $$\ln p = -\tfrac12 (\nu + n) \ln\big(1 + n V / (\nu \tau^2)\big),$$

    with V their mean square (Gelman et al. 2013, Bayesian Data Analysis, sections 2.6 and 3.2).
    Evidence is counted in runs, not in samples.

    Attributes:
        scatter: $\tau$ [-]. 1.2 % before any repeat: what test beds of dry sand are raked to.
        statements: $\nu$ [-]. Few: two repeats more outweigh a belief.
    """

    scatter: float = 0.012
    statements: float = 4.0

    def evidence(self, variance: float, contrasts: int, pardoned: float = 0.0) -> float:
        scale = self.statements * (self.scatter**2 + pardoned)
        worth = self.statements + contrasts
        return -0.5 * worth * float(np.log1p(contrasts * variance / scale))

    def hold(self, variance: Numeric, contrasts: int) -> Numeric:
        squares = self.statements * self.scatter**2 + contrasts * variance
        return (self.statements + contrasts) / squares

    def after_repeats(self, log_zeta: np.ndarray, groups: Sequence[Sequence[int]]) -> "PreparedBed":
        zetas = [np.asarray(log_zeta)[list(group)] for group in groups]
        squares = sum(float(((each - each.mean()) ** 2).sum()) for each in zetas)
        more = self.statements + sum(len(each) - 1 for each in zetas)
        variance = (self.statements * self.scatter**2 + squares) / more
        return PreparedBed(float(np.sqrt(variance)), float(more))


@dataclass(frozen=True)
class FreeBed(AbstractBed):
    r"""A bed that nobody prepared: each run has its own zeta, and that zetas agree tells little.

    $-\tfrac12 w (R - 1) \ln(V + \sigma^2)$.

    Attributes:
        scatter: $\sigma$, that sand shows in any case [-].
        worth: $w$, independent statements in one run's log zeta [-].
    """

    scatter: float = 0.012
    worth: float = 0.6

    def evidence(self, variance: float, contrasts: int, pardoned: float = 0.0) -> float:
        scatter = float(np.log(variance + self.scatter**2 + pardoned))
        return -0.5 * self.worth * contrasts * scatter

    def hold(self, variance: Numeric, contrasts: int) -> Numeric:
        return self.worth / (variance + self.scatter**2)

    def after_repeats(self, log_zeta: np.ndarray, groups: Sequence[Sequence[int]]) -> "FreeBed":
        return self


DEFAULT_BED = PreparedBed()

# By the name on the command line.
BEDS = {"prepared": DEFAULT_BED, "free": FreeBed()}
