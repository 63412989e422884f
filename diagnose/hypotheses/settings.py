"""Numbers by which effects are screened."""

from dataclasses import dataclass

from diagnose.dataset import DEFAULT_INITIAL_ZETA, InitialZetaSettings
from diagnose.hypotheses.exchange import DEFAULT_EXCHANGE, ExchangeSettings
from diagnose.hypotheses.joint_additions import DEFAULT_JOINT, JointSettings
from diagnose.hypotheses.large_strengths import (
    DEFAULT_LARGE_STRENGTHS,
    LargeStrengthSettings,
)
from diagnose.hypotheses.linear_ranking import DEFAULT_RANKINGS, Ranking
from diagnose.hypotheses.refinement import DEFAULT_REFINEMENT, RefinementSettings
from diagnose.hypotheses.set_candidates import (
    DEFAULT_LARGER_SETS,
    DEFAULT_PAIRS,
    SetScreeningSettings,
)
from diagnose.linear.linear_fit import DEFAULT_LINEAR_FIT, LinearFitSettings
from diagnose.model.linearized_run import DEFAULT_LINEARIZATION, LinearizationSettings


@dataclass(frozen=True)
class ScreeningSettings:
    """Numbers by which effects are screened.

    Attributes:
        min_simulated: Number of effects, ranked by the linear score, that are refined by simulation
            at least, even where no linear fit gains anything: linear fits may order effects, not
            decide.
        max_simulated: The same, at most. Where the reference model is far off linear fits do not
            order effects either, and all that gain are simulated.
        min_linear_gain: Beyond `min_simulated` an effect is simulated where a linear fit with it
            gains more log score than this over one without [-].
        rankings: Linear fits rank effects once by each of these, which take turns.
        reference_simulations: Simulations by which the reference model's zetas are refined.
        first_simulations: Simulations of each single effect before the leading ones go on.
        max_continued: Leading hypotheses that go on.
        max_rounds: Times that derivatives are computed again, at most.
        simulations_per_round: Simulations with each, at most.
        min_round_gain: A further round is made while the last one gained this much log score [-].
        hopeless_deficit: A hypothesis that is this far behind the best in log score, by a linear
            fit about it or after as much as the last round gained once more, gets none [-].
        far_from_floor: The reference model is far off where it misses a block, levels apart, by
            more than this many model errors [-]: there strengths far from zero are tried one by
            one, too.
        far_from_scatter: Likewise where the runs' zeta scatters by more than this many times the
            bed's scatter [-].
        pair_floor: Pairs are looked for where the best single effect leaves more than this many
            model errors in the slow part of a channel, or in a level [-].
        max_effects: Effects in one hypothesis at most.
        min_set_gain: A further effect is looked for while the last ones gained this much log score
            each [-]: about twice what an effect of one number costs in a weight, whose evidence
            counts half as much.
        min_set_share: The same while it gained this share of what was left to gain [-]. Effects
            that the rig has take a gap away in few steps; what is outside the list is nibbled at.
        patience: Effects that are added, one after another, without such a gain before the search
            ends.
        max_exchanges: Times that effects are exchanged for look-alikes, at most.
        max_leading: Leading explanations of each size that get exact derivatives at the end.
        initial_zeta: Numbers of the search for the zeta where all is linearised.
        linearization: Numbers of the linearisation.
        linear_fit: Weights of linear fits, and of the log score.
        refinement: Numbers of the refinement by simulation.
        large_strengths: Numbers by which strengths far from zero are gone on from.
        pairs: Numbers of the choice of pairs.
        larger_sets: The same of sets of three effects and more.
        joint: Numbers of the choice of two effects at once.
        exchange: Numbers of the choice of look-alikes.
    """

    min_simulated: int = 6
    max_simulated: int = 16
    min_linear_gain: float = 1.5
    rankings: tuple[Ranking, ...] = DEFAULT_RANKINGS
    reference_simulations: int = 3
    first_simulations: int = 2
    max_continued: int = 3
    max_rounds: int = 6
    simulations_per_round: int = 5
    min_round_gain: float = 3.0
    hopeless_deficit: float = 100.0
    far_from_floor: float = 30.0
    far_from_scatter: float = 10.0
    pair_floor: float = 1.5
    max_effects: int = 6
    min_set_gain: float = 8.0
    min_set_share: float = 0.02
    patience: int = 2
    max_exchanges: int = 3
    max_leading: int = 4
    initial_zeta: InitialZetaSettings = DEFAULT_INITIAL_ZETA
    linearization: LinearizationSettings = DEFAULT_LINEARIZATION
    linear_fit: LinearFitSettings = DEFAULT_LINEAR_FIT
    refinement: RefinementSettings = DEFAULT_REFINEMENT
    large_strengths: LargeStrengthSettings = DEFAULT_LARGE_STRENGTHS
    pairs: SetScreeningSettings = DEFAULT_PAIRS
    larger_sets: SetScreeningSettings = DEFAULT_LARGER_SETS
    joint: JointSettings = DEFAULT_JOINT
    exchange: ExchangeSettings = DEFAULT_EXCHANGE


DEFAULT_SCREENING = ScreeningSettings()
