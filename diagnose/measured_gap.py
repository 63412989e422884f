"""The gap between recorded and simulated runs, without effects and with those of a verdict."""

from dataclasses import dataclass

import numpy as np

from diagnose.gap.cross_validation import HeldOutPrediction
from diagnose.gap.selected_effects import SelectedEffects
from diagnose.gap.zeta_matching import MatchedRun, residuals_of


@dataclass(frozen=True, eq=False)
class ReferenceRuns:
    """Every run by the reference model.

    Attributes:
        prediction: Each with the zeta that suits all channels.
        matches: Each at its matched zeta.
        discretization: Error of its plates and width at rest by channel [m, N, N m].
    """

    prediction: HeldOutPrediction
    matches: list[MatchedRun]
    discretization: dict[str, float]


@dataclass(frozen=True, eq=False)
class MeasuredGap:
    """The gap without and with the chosen hypothesis, on held-out runs at matched zeta.

    Attributes:
        reference: The reference model.
        floors: Noise floor of each channel [m, N, N m].
        notes: Sentences on the floors and on runs that do not go with the others.
        selected: The chosen hypothesis's effects, and the gap with them.
        prediction: Held-out runs by the chosen hypothesis.
    """

    reference: ReferenceRuns
    floors: dict[str, float]
    notes: list[str]
    selected: SelectedEffects
    prediction: HeldOutPrediction

    @property
    def before(self) -> list[np.ndarray]:
        """By run, residual of the reference model [m, N, N m], shape (channels, samples)."""
        return residuals_of(self.reference.matches)
