"""Decision numbers of zeta(t): its prior, its noise and the steps that find it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class ZetaPathSettings:
    """Numbers that decide how zeta(t) of a run is found.

    Attributes:
        weights: Lowest and highest decimal logarithm of the weight of squared second differences,
            and how many weights are tried: from knots that scatter by a factor e^10 to a straight
            line for as long as any run.
        level_spread: Standard deviation of the prior of log zeta itself: a factor e^5, so it
            hardly bears on the path.
        noise_rounds: Rounds of expectation-maximisation for the noise at each weight; more change
            no standard error by a percent, as the evidence is flat in the noise near its best.
        weight_gain: Log evidence by which another weight must be more probable than the one of the
            step before; otherwise steps could alternate between two that are as good.
        longest_step: Longest step of log zeta that the linearisation is trusted for.
        max_steps: Gauss-Newton steps, at most.
        small_step: Steps end where no knot moves by so much of its standard error.
        small_gain: They also end where the log probability changes by less than this.
        small_promise: They also end where the evidence grows no more and the predicted gain is less
            than this share of the misfit, half a percent of the residual: below that the noise
            changes with the corners of the run.
        kept_promise: Part of what its slope promises that a step must keep [-].
        roughness: Rise of the negative log probability up to which a step counts all the same.
        max_rejections: Rejected steps in a row, each half as long, after which the rest of the gain
            lies under the simulation's resolution: stops make the misfit rough.
        first_weight: Weight of the second differences on the first step: almost a straight line.
        close_step: Travel and the noise's correlation are fitted only once a step is shorter than
            this, in standard errors,
        close_gain: or lowers the misfit by less than this share of it.
        travel_correlation: Largest correlation of travel's noise from one sample to the next:
            travel sums up slip, so almost all of an error stays.
        unidentified_error: Standard error of log zeta by a knot's own samples, all other knots
            known, above which the knot is not identified: zeta within a factor e. Neither is a knot
            where the wheel stands: the derivative there is that of sinking further, but stronger
            sand would leave the wheel where it is.
        contradiction_ratio: RMS residual of travel over that of sinkage from which on no zeta(t)
            explains both.
    """

    weights: tuple[float, float, int] = (-2.0, 10.0, 25)
    level_spread: float = 5.0
    noise_rounds: int = 15
    weight_gain: float = 0.5
    longest_step: float = 0.3
    max_steps: int = 25
    small_step: float = 0.3
    small_gain: float = 0.5
    small_promise: float = 0.01
    kept_promise: float = 1e-4
    roughness: float = 1.0
    max_rejections: int = 3
    first_weight: float = 1e7
    close_step: float = 1.0
    close_gain: float = 0.1
    travel_correlation: float = 0.9999
    unidentified_error: float = 1.0
    contradiction_ratio: float = 20.0

    @property
    def weight_grid(self) -> Float[np.ndarray, " weights"]:
        """Weights of the squared second differences that are tried, increasing."""
        return np.logspace(*self.weights)


ZETA_PATH_SETTINGS = ZetaPathSettings()
