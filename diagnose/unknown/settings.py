"""Numbers of the search for an unlisted mechanism."""

from dataclasses import dataclass


@dataclass(frozen=True)
class UnknownEffectSettings:
    """Disturbances, curves over state variables, and thresholds.

    Attributes:
        knot_spacing: Time between the knots of a disturbance [s].
        tied_evidence: Disturbances whose log evidences differ by less than this [-] are equally
            good: the one that depends best on one variable is chosen.
        curve_size: Believed size of a curve's values over the level of the disturbance [-].
        curve_bends: Believed sizes of its bends over that level [-]; the one counts that predicts
            the held-out conditions best.
        curves: Number of knots of a curve, and how far it may change from end to end, in levels: a
            coarse one that may go far, also where no other run has been, and a fine one that is
            kept to the disturbance's own size.
        more_knots: Number of knots over variables that tell places or moments, as patches and waves
            need more.
        outer_percent: Percentage of a variable's values beyond the outermost knots on either side.
        min_explained: A disturbance depends on a variable that explains this share of it [-].
        max_variables: Variables over which curves are simulated at most, the best first, as the
            linear response tells little of how a curve goes on in held-out runs.
        refinement_steps: Simulations by which a curve is fitted.
        min_mode: Modes of a curve are left out where they are believed to be this much smaller than
            the largest [-].
        max_floors: A curve explains the runs where no more of the gap remains than `unknown` is
            taken to leave, or than so many noise floors in each channel.
        min_return: A curve over the travel may be a matter of places where the lesser of its rise
            and fall is this share of the larger one [-]. What only rises or falls, or does so at
            first, may as well be a matter of wear, of turning or of time.
        leap_from: It may also be one where it leaps, past this share of the bed [-],
        min_leap: within two steps of its knots, by this share of all its rises and falls [-].
        rival_ratio: Such a curve is preferred to one over the wheel's turning unless that leaves
            less by this factor [-], as travel and turning are nearly one where slip is constant; a
            curve over any other variable must leave more by this factor.
        time_ratio: A curve over time must leave so many times more of the disturbance unexplained
            [-]: runs of one profile do not distinguish places from moments.
    """

    knot_spacing: float = 0.5
    tied_evidence: float = 10.0
    curve_size: float = 5.0
    curve_bends: tuple[float, ...] = (1.5, 0.3, 0.06, 0.012)
    curves: tuple[tuple[int, float], ...] = ((6, 10.0), (12, 1.0))
    more_knots: tuple[tuple[str, int], ...] = (
        ("travel", 16),
        ("turning", 16),
        ("time", 16),
        ("wheel angle", 12),
    )
    outer_percent: float = 1.0
    min_explained: float = 0.5
    max_variables: int = 3
    refinement_steps: int = 6
    min_mode: float = 0.003
    max_floors: float = 1.2
    min_return: float = 0.2
    leap_from: float = 0.25
    min_leap: float = 0.5
    rival_ratio: float = 1.25
    time_ratio: float = 2.0

    @property
    def max_frequency(self) -> float:
        """Highest frequency that a disturbance with such knots can have [Hz]."""
        return 1 / (2 * self.knot_spacing)


DEFAULT_UNKNOWN_EFFECT = UnknownEffectSettings()
