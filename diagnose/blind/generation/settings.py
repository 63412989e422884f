"""Requests for folders of blind sets, and the distributions that their rigs are drawn from."""

from dataclasses import dataclass
from pathlib import Path

from diagnose.blind.generation.effect_size import DEFAULT_EFFECT_SIZE, EffectSizeSettings
from diagnose.blind.plant.plant import DEFAULT_PLANT, PlantSettings
from diagnose.blind.plant.run_plan import (
    DEFAULT_RANDOM_RUNS,
    DEFAULT_SWEEP,
    RandomRunSettings,
    Range,
    SweepSettings,
)
from drftjax.common.errors import InputError

SINGLE, SEVERAL, CHANGE, SWEEP = KINDS = ("single", "several", "change", "sweep")
PROTOCOLS = ("mixed", "practice", "random", "telling")
FAULT_KINDS = ("mixed", "none", "one", "pair", "unknown")
# What may be wrong with sets of the other kinds.
CHANGE_FAULTS = ("mixed", "none", "one")

MOST_SETS = 100_000  # of one folder, whose names have six figures at most


@dataclass(frozen=True)
class NoiseSettings:
    """Noise and resolution of the recorded channels.

    Attributes:
        white_x, white_z: Standard deviation of the white part [m].
        white_force: The same of both forces, over the standard load [-].
        white_torque: The same of the torque, over the standard load times the radius [-].
        correlated_share: Standard deviation of the correlated part, relative to the white one [-].
        correlation_time: Time constant of the correlated part [s].
        resolution: Resolution of positions [m]; a thousandth of it in forces and torques [N, N m].
    """

    white_x: float = 50e-6
    white_z: float = 20e-6
    white_force: float = 1.5e-3
    white_torque: float = 1.5e-3
    correlated_share: float = 1 / 3
    correlation_time: float = 0.2
    resolution: float = 1e-6

    def white(self, channel: str) -> float:
        """Standard deviation of the white part in "x" or "z" [m]."""
        return {"x": self.white_x, "z": self.white_z}[channel]


DEFAULT_NOISE = NoiseSettings()


@dataclass(frozen=True)
class RigSettings:
    """Distribution of the rigs that are not the default one.

    Attributes:
        share: Probability of another rig [-].
        smooth_share: Probability of a wheel without grousers among them [-].
        radius: Least and greatest rim radius [m]; drawn evenly in the logarithm, as the mass.
        mass: Least and greatest vertical mass [kg].
        width: Least and greatest width over the radius [-].
        mass_x: Least and greatest horizontal mass over the vertical one [-].
        grouser_counts: Numbers of grousers; few, as each needs programs of its own.
        grouser_height, grouser_thickness: Least and greatest size of a grouser over the radius [-].
        sinkage: Least and greatest sinkage at rest over the radius [-]: the default rig's is 0.11.
        zeta: Least and greatest zeta of sand that carries a wheel so [-]; others are drawn again.
        sampling: Sampling rates of the logger [Hz]; that of the default rig is 100.
        draws: Most rigs drawn.
    """

    share: float = 0.5
    smooth_share: float = 0.3
    radius: Range = (0.040, 0.300)
    mass: Range = (1.0, 60.0)
    width: Range = (0.5, 1.2)
    mass_x: Range = (0.5, 1.5)
    grouser_counts: tuple[int, ...] = (8, 12, 20)
    grouser_height: Range = (0.05, 0.15)
    grouser_thickness: Range = (0.02, 0.08)
    sinkage: Range = (0.07, 0.13)
    zeta: Range = (0.25, 3.0)
    sampling: tuple[float, ...] = (20.0, 25.0, 50.0, 125.0, 200.0, 250.0, 500.0)
    draws: int = 200


DEFAULT_RIGS = RigSettings()


@dataclass(frozen=True)
class SeveralSetSettings:
    """Distribution of sets with several effects at once.

    Attributes:
        effects: Least and greatest number of effects.
        least_floors: Size that each effect has at least [noise floors].
        budget_runs: Indices of the runs that the budget is computed on: all nine, as a diagnosis
            has them, since shares differ from run to run.
    """

    effects: tuple[int, int] = (3, 4)
    least_floors: float = 3.0
    budget_runs: tuple[int, ...] = tuple(range(9))


@dataclass(frozen=True)
class ChangeSetSettings:
    """Distribution of sets in which one thing changes.

    Attributes:
        none_share, zeta_share: Shares of mixed sets in which nothing changes, and in which the
            strength of the sand does.
        depth_exponent: Least and greatest exponent of the stress by depth [-].
        coefficient_spread: Standard deviation of the relative error of each coefficient of the
            stress per depth [-].
        heap: Least and greatest resistance of the heap ahead over the standard load [-].
        faults: Number of small faults in every run.
        fault_floors: Least and greatest size of each [noise floors].
        zeta_change: Least and greatest relative change of zeta [-].
        runs: Indices of the five runs among nine: one twice, a faster one, a light one, the
            fastest.
        probe_runs: Indices of those of the five that strengths are found on.
    """

    none_share: float = 0.2
    zeta_share: float = 0.15
    depth_exponent: Range = (0.85, 1.35)
    coefficient_spread: float = 0.15
    heap: Range = (0.005, 0.03)
    faults: int = 2
    fault_floors: Range = (0.7, 3.0)
    zeta_change: Range = (0.04, 0.2)
    runs: tuple[int, ...] = (0, 1, 3, 6, 8)
    probe_runs: tuple[int, ...] = (1, 2, 4)


@dataclass(frozen=True)
class GenerationSettings:
    """Distribution of the rigs of blind sets, and how they are recorded.

    Attributes:
        none_share, unknown_share, pair_share: Shares of mixed single sets with no mechanism, with
            one outside the catalogue and with two; the others have one of the catalogue. Sweeps
            take `none_share` too.
        practice_share: Probability of the practice runs in the "mixed" protocol.
        zeta: Least and greatest scaling factor of the default rig's sand [-].
        zeta_scatter: Standard deviation of log zeta between the runs of a rig [-].
        believed_zeta: Initial scaling factor in every run log [-].
        static_reading_time: Time over which the sinkage before a run is averaged, or as long as the
            wheel stands [s].
        probe_runs: Indices of the runs that strengths are found on: a slow one, a middling one with
            steep ramps, and the fastest.
        redraws: Most forms drawn for a set whose plant cannot run.
        noise: Noise of the recorded channels.
        effect_size: Search for the strength of a mechanism.
        plant: Resolution and limits of the plant.
        random_runs: Ranges of the random runs.
        rigs: Other rigs.
        several, change: Sets of these kinds.
        sweep: Runs of a sweep.
    """

    none_share: float = 0.12
    unknown_share: float = 0.12
    pair_share: float = 0.16
    practice_share: float = 0.5
    zeta: tuple[float, float] = (0.65, 0.95)
    zeta_scatter: float = 0.01
    believed_zeta: float = 0.7823
    static_reading_time: float = 1.0
    probe_runs: tuple[int, ...] = (0, 5, 8)
    redraws: int = 8
    noise: NoiseSettings = DEFAULT_NOISE
    effect_size: EffectSizeSettings = DEFAULT_EFFECT_SIZE
    plant: PlantSettings = DEFAULT_PLANT
    random_runs: RandomRunSettings = DEFAULT_RANDOM_RUNS
    rigs: RigSettings = DEFAULT_RIGS
    several: SeveralSetSettings = SeveralSetSettings()
    change: ChangeSetSettings = ChangeSetSettings()
    sweep: SweepSettings = DEFAULT_SWEEP


DEFAULT_GENERATION = GenerationSettings()


@dataclass(frozen=True)
class GenerationRequest:
    """Request for a folder of sets.

    Attributes:
        folder: Folder to write them into.
        sets: Number of sets.
        seed: Seed of every random choice.
        protocol: One of `PROTOCOLS`. "telling" has the rigs of "mixed", and records other runs of
            them: the nine of `diagnose.next_runs.recommended_runs`. Single and several sets have a
            choice.
        faintest, strongest: Range of the sizes of mechanisms [noise floors].
        wrong: Kind of fault of the sets, one of `FAULT_KINDS`: none, one effect, two, or one
            outside the catalogue; "mixed" has some of each. Changes and sweeps know none and one.
        kind: One of `KINDS`: a rig with one effect, two or none; with three or four; runs before
            and after a change; a driven carriage at several slips.

    Raises:
        InputError: A value is none of those, or out of range.
    """

    folder: Path
    sets: int
    seed: int
    protocol: str = "mixed"
    faintest: float = 0.5
    strongest: float = 30.0
    wrong: str = "mixed"
    kind: str = SINGLE

    def __post_init__(self):
        if not 1 <= self.sets <= MOST_SETS:
            raise InputError(f"{self.sets} sets were asked for, must be 1 to {MOST_SETS}")
        for what, given, known in (
            ("the kind of the sets", self.kind, KINDS),
            ("the protocol", self.protocol, PROTOCOLS),
            ("what is wrong", self.wrong, FAULT_KINDS),
        ):
            if given not in known:
                raise InputError(f"{what} is {given!r}, must be one of {', '.join(known)}")
        if self.kind == SEVERAL and self.wrong != "mixed":
            raise InputError(
                f"what is wrong is {self.wrong!r}; sets of the kind several have three or four "
                "effects, leave it out"
            )
        if self.kind in (CHANGE, SWEEP):
            if self.wrong not in CHANGE_FAULTS:
                raise InputError(
                    f"what is wrong is {self.wrong!r}, must be one of {', '.join(CHANGE_FAULTS)} "
                    f"in sets of the kind {self.kind}"
                )
            if self.protocol != "mixed":
                raise InputError(f"sets of the kind {self.kind} have one protocol; leave it out")
        if not 0 < self.faintest <= self.strongest:
            raise InputError(
                f"gaps from {self.faintest:g} to {self.strongest:g} floors were asked for; both "
                "must be over zero and in order"
            )

    def name(self, number: int) -> str:
        """Name of the set with this number, from zero."""
        return f"set_{number + 1:0{max(2, len(str(self.sets)))}d}"
