"""Decision numbers of the solvers."""

from dataclasses import dataclass


@dataclass(frozen=True)
class SolverSettings:
    """Numbers of the Levenberg-Marquardt iteration over all runs together.

    Gains are in residual variances: the sum of squares over the mean square of a run's residuals.

    Attributes:
        small_gain: A step that gains less moves no parameter by a noticeable part of its standard
            error: the iteration has converged.
        max_rejections: Rejected steps in a row, each shorter than the last, after which the rest of
            the gain lies under the simulation's resolution: stops and landings make the sum of
            squares rough by as much.
        step_parts: Parts of the whole Gauss-Newton step that are tried where damping finds nothing:
            optimistix damps all coordinates alike, which hardly shortens a step in one that the
            runs determine well.
        max_failures: Steps in a row, each shorter than the last, at which a run cannot be simulated
            before it is put aside for the others' sake.
        held_gain: A run whose roughness keeps the others from gaining more than this is held where
            it is while they go on; they go back where all together lose by it.
        negligible: Share of the sum of squares that is not worth a warning.
        short_move: Change of a coordinate up to which a last step is taken unseen: a number that
            the runs hardly tell is promised a long one, which may lead anywhere.
        max_steps: Steps, at most.
    """

    small_gain: float = 0.1
    max_rejections: int = 3
    step_parts: tuple[float, ...] = (0.3, 0.1, 0.03)
    max_failures: int = 3
    held_gain: float = 1.0
    negligible: float = 0.01
    short_move: float = 0.05
    max_steps: int = 60


@dataclass(frozen=True)
class BatchedSolverSettings:
    """Numbers of the damped Gauss-Newton steps from many points side by side.

    Attributes:
        small_gain: As for `SolverSettings`.
        max_rejections: Shorter steps in a row that gain nothing, after which the rest of the gain
            lies under the simulation's resolution.
        first_damping: Damping of the first step, as a share of the information's diagonal.
        damping_factor: Each rejection multiplies the damping by this, each step divides it.
        longest_step: No coordinate moves by more in one step, so that a linearisation is not
            followed too far.
        max_steps: Steps, at most.
    """

    small_gain: float = 0.1
    max_rejections: int = 6
    first_damping: float = 1e-3
    damping_factor: float = 8.0
    longest_step: float = 0.3
    max_steps: int = 60


@dataclass(frozen=True)
class MultistartSettings:
    """Numbers of the starting points and of their comparison.

    Attributes:
        positive_range: Positive numbers start within a factor of e to this power either way.
        bounded_range: Bounded numbers start within this middle share of their bounds [-].
        typical_changes: Others start within so many of their typical changes.
        same_optimum: Two ends are the same optimum where their sums of squares differ by less than
            this share.
    """

    positive_range: float = 0.5
    bounded_range: float = 0.6
    typical_changes: float = 3.0
    same_optimum: float = 0.02


SOLVER_SETTINGS = SolverSettings()
BATCHED_SETTINGS = BatchedSolverSettings()
MULTISTART_SETTINGS = MultistartSettings()
