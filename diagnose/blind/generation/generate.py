"""Make blind sets: draw the mechanisms of each, simulate its runs, seal its label."""

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from diagnose.blind.answers.answer import UNFINISHED, configure_helper
from diagnose.blind.generation.effect_size import (
    DEFAULT_EFFECT_SIZE,
    EffectSizeProbe,
    EffectSizeSettings,
)
from diagnose.blind.generation.random_mechanisms import (
    CATALOGUE,
    UNLISTED,
    Mechanism,
    draw_mechanism,
    draw_unlisted,
    stage_of,
)
from diagnose.blind.generation.sealed_labels import seal
from diagnose.blind.plant import plant
from diagnose.blind.plant.plant import DEFAULT_PLANT, Part, PlantSettings, group_of
from diagnose.blind.plant.run_plan import (
    DEFAULT_RANDOM_RUNS,
    PRACTICE_RUNS,
    RECOMMENDED_RUNS,
    RUN_LETTERS,
    PlannedRun,
    RandomRunSettings,
    draw_fresh_runs,
    draw_nine_runs,
)
from diagnose.blind.plant.sensors import PlantReading
from drftjax.common.errors import InputError
from drftjax.runlog.hdf5.api import write_run
from drftjax.runlog.record import Measured, RecordedCommand, RecordedSetup, RunLog

PROTOCOLS = ("mixed", "practice", "random", "telling")
FAULT_KINDS = ("mixed", "none", "one", "pair", "unknown")


@dataclass(frozen=True)
class NoiseSettings:
    """Noise and resolution of the recorded positions.

    Attributes:
        white_x, white_z: Standard deviation of the white part [m].
        correlated_share: Standard deviation of the correlated part, relative to the white one [-].
        correlation_time: Time constant of the correlated part [s].
        resolution: Resolution of the readings [m].
    """

    white_x: float = 50e-6
    white_z: float = 20e-6
    correlated_share: float = 1 / 3
    correlation_time: float = 0.2
    resolution: float = 1e-6

    def white(self, channel: str) -> float:
        """Standard deviation of the white part in "x" or "z" [m]."""
        return {"x": self.white_x, "z": self.white_z}[channel]


DEFAULT_NOISE = NoiseSettings()


@dataclass(frozen=True)
class GenerationSettings:
    """Distribution of the rigs of blind sets, and how they are recorded.

    Attributes:
        none_share, unknown_share, pair_share: Shares of mixed sets with no mechanism, with one
            outside the catalogue and with two; the others have one of the catalogue.
        practice_share: Probability of the practice runs in the "mixed" protocol.
        zeta: Least and greatest scaling factor of a rig [-].
        zeta_scatter: Standard deviation of log zeta between the runs of a rig [-].
        believed_zeta: Initial scaling factor in every run log [-].
        static_reading_time: Time over which the sinkage before a run is averaged, or as long as the
            wheel stands [s].
        probe_runs: Indices of the runs that strengths are found on: a slow one, a middling one with
            steep ramps, and the fastest.
        redraws: Most forms drawn for a set whose plant cannot run.
        noise: Noise of the recorded positions.
        effect_size: Search for the strength of a mechanism.
        plant: Resolution and limits of the plant.
        random_runs: Ranges of the random runs.
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
    redraws: int = 5
    noise: NoiseSettings = DEFAULT_NOISE
    effect_size: EffectSizeSettings = DEFAULT_EFFECT_SIZE
    plant: PlantSettings = DEFAULT_PLANT
    random_runs: RandomRunSettings = DEFAULT_RANDOM_RUNS


DEFAULT_GENERATION = GenerationSettings()


@dataclass(frozen=True)
class GenerationRequest:
    """Request for a folder of sets.

    Attributes:
        folder: Folder to write them into.
        sets: Number of sets.
        seed: Seed of every random choice.
        protocol: One of `PROTOCOLS`. "telling" has the rigs of "mixed", and records other runs of
            them: the nine of `diagnose.next_runs.recommended_runs`.
        faintest, strongest: Range of the sizes of mechanisms [noise floors].
        wrong: Kind of fault of the sets, one of `FAULT_KINDS`: none, one effect, two, or one
            outside the catalogue; "mixed" has some of each.

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

    def __post_init__(self):
        if self.sets < 1:
            raise InputError(f"{self.sets} sets were asked for, must be one or more")
        for what, given, known in (
            ("the protocol", self.protocol, PROTOCOLS),
            ("what is wrong", self.wrong, FAULT_KINDS),
        ):
            if given not in known:
                raise InputError(f"{what} is {given!r}, must be one of {', '.join(known)}")
        if not 0 < self.faintest <= self.strongest:
            raise InputError(
                f"gaps from {self.faintest:g} to {self.strongest:g} floors were asked for; both "
                "must be over zero and in order"
            )

    def name(self, number: int) -> str:
        """Name of the set with this number, from zero."""
        return f"set_{number + 1:0{max(2, len(str(self.sets)))}d}"


def planned_faults(
    request: GenerationRequest, settings: GenerationSettings = DEFAULT_GENERATION
) -> list[tuple[str, ...]]:
    """Draw the mechanisms of every set, such that all kinds come up equally often.

    Returns:
        Kinds of mechanism of each set.
    """
    random = np.random.default_rng([request.seed, 0])
    names = [name for stage in CATALOGUE.values() for name in stage]
    singles, unlisted = _shuffled(names, random), _shuffled(list(UNLISTED), random)
    shares = {
        "none": settings.none_share,
        "unknown": settings.unknown_share,
        "pair": settings.pair_share,
    }
    counts = {kind: round(request.sets * share) for kind, share in shares.items()}
    if request.wrong != "mixed":
        counts = {kind: request.sets if kind == request.wrong else 0 for kind in shares}
    drawn: list[tuple[str, ...]] = [()] * counts["none"]
    drawn += [(next(unlisted),) for _ in range(counts["unknown"])]
    drawn += _draw_pairs(names, counts["pair"], random)
    drawn += [(next(singles),) for _ in range(request.sets - len(drawn))]
    return [drawn[index] for index in random.permutation(request.sets)]


def _draw_pairs(names: list[str], count: int, random: np.random.Generator) -> list[tuple[str, ...]]:
    """Pairs of effects that act in different stages."""
    pairs: list[tuple[str, ...]] = []
    while len(pairs) < count:
        first, second = (str(each) for each in random.choice(names, 2, replace=False))
        if stage_of(first) != stage_of(second):
            pairs.append((first, second))
    return pairs


def _shuffled(names: list[str], random: np.random.Generator) -> Iterator[str]:
    """All names in random order, again and again."""
    while True:
        yield from (names[index] for index in random.permutation(len(names)))


def make_sets(
    request: GenerationRequest, jobs: int = 1, settings: GenerationSettings = DEFAULT_GENERATION
) -> Iterator[str]:
    """Make sets and seal their labels.

    Args:
        request: Number and kind of the sets.
        jobs: Number of processes; the sets do not depend on it.
        settings: Distribution of the rigs.

    Yields:
        The name of every set when it is complete.

    Raises:
        InputError: The folder is not empty.
    """
    folder = request.folder
    if folder.exists() and any(folder.iterdir()):
        raise InputError(f"{folder} is not empty; name a folder that is")
    folder.mkdir(parents=True, exist_ok=True)
    faults = planned_faults(request, settings)
    # Sets whose runs share a program are made one after the other.
    numbers = sorted(range(request.sets), key=lambda number: faults[number])
    labels: dict[str, dict] = {}
    if jobs == 1:
        for number in numbers:
            labels[request.name(number)] = make_set(request, number, faults[number], settings)
            yield request.name(number)
    else:
        # A fresh process each, as the threads of JAX do not survive a fork.
        with ProcessPoolExecutor(jobs, get_context("spawn"), configure_helper, (set(),)) as pool:
            waiting = {
                pool.submit(make_set, request, number, faults[number], settings): number
                for number in numbers
            }
            for done in as_completed(waiting):
                labels[request.name(waiting[done])] = done.result()
                yield request.name(waiting[done])
    seal(folder, dict(sorted(labels.items())))


def make_set(
    request: GenerationRequest,
    number: int,
    kinds: tuple[str, ...],
    settings: GenerationSettings = DEFAULT_GENERATION,
) -> dict:
    """Make one set.

    Args:
        request: Seed, protocol and sizes.
        number: Number of the set, from zero; with the seed it decides every random choice.
        kinds: Kinds of its mechanisms.
        settings: Distribution of the rigs.

    Returns:
        Its label.

    Raises:
        InputError: The plant cannot run with any of the forms drawn.
    """
    random = np.random.default_rng([request.seed, 1, number])
    for _ in range(settings.redraws):
        try:
            return _try_to_make(request, number, kinds, random, settings)
        except InputError:  # the wheel digs in or leaves its rail: another form may not
            continue
    raise InputError(f"no form of {' and '.join(kinds) or 'nothing'} lets the plant run")


def _try_to_make(
    request: GenerationRequest,
    number: int,
    kinds: tuple[str, ...],
    random: np.random.Generator,
    settings: GenerationSettings,
) -> dict:
    # "telling" draws all that "mixed" does, so that both have the same rigs.
    practice = request.protocol == "practice" or (
        request.protocol in ("mixed", "telling") and random.random() < settings.practice_share
    )
    nine = PRACTICE_RUNS if practice else draw_nine_runs(random, settings.random_runs)
    fresh = draw_fresh_runs(random, settings.random_runs)
    zeta = float(random.uniform(*settings.zeta))
    mechanisms = [
        draw_unlisted(kind, random) if kind in UNLISTED else draw_mechanism(kind, random)
        for kind in kinds
    ]
    targets = [
        float(np.exp(random.uniform(np.log(request.faintest), np.log(request.strongest))))
        for _ in mechanisms
    ]
    parts, sizes = _with_strengths(mechanisms, targets, nine, zeta, settings)
    protocol = "practice" if practice else "random"
    if request.protocol == "telling":
        protocol, nine = "telling", RECOMMENDED_RUNS
    runs = {f"run_{letter}": run for letter, run in zip(RUN_LETTERS, nine, strict=True)}
    runs |= {f"fresh/fresh_{letter}": run for letter, run in zip("abc", fresh, strict=True)}
    logs = {}
    for name, run in runs.items():
        zeta_of_run = zeta * float(np.exp(settings.zeta_scatter * random.standard_normal()))
        motion = plant.run_plant(parts, run, zeta_of_run, settings=settings.plant)
        logs[name] = as_run_log(motion, run, random, settings)
    _write_set(request.folder / request.name(number), logs)
    effects = [each.name for each in mechanisms]
    return {"effects": effects, "protocol": protocol, "zeta": zeta, **sizes}


def _write_set(folder: Path, logs: dict[str, RunLog]) -> None:
    """Write the runs of a set beside its folder, and give that its name when all are there."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=UNFINISHED, dir=folder.parent) as scratch:
        draft = Path(scratch) / folder.name
        (draft / "fresh").mkdir(parents=True)
        for name, log in logs.items():
            write_run(draft / f"{name}.h5", log)
        draft.rename(folder)


def _with_strengths(
    mechanisms: list[Mechanism],
    targets: list[float],
    nine: tuple[PlannedRun, ...],
    zeta: float,
    settings: GenerationSettings,
) -> tuple[list[Part], dict]:
    """Mechanisms at the strengths of the wanted sizes [noise floors], and the label's part on them.

    For two mechanisms, the label also has the size of both together.
    """
    if not mechanisms:
        return [], {}
    runs = tuple(nine[index] for index in settings.probe_runs)

    def probe_of(groups: tuple[str, ...]) -> EffectSizeProbe:
        return EffectSizeProbe.of(runs, zeta, groups, settings.effect_size, settings.plant)

    parts, labels = [], []
    for mechanism, target in zip(mechanisms, targets, strict=True):
        group = group_of(mechanism.build(mechanism.typical_strength))
        probe = probe_of(() if group is None else (group,))
        strength, size = probe.find_strength(mechanism, target)
        parts.append(mechanism.build(strength))
        labels.append(
            {
                "name": mechanism.name,
                "kind": mechanism.kind,
                "strength": strength,
                "form": mechanism.form,
                "wanted_floors": target,
                **size.document(),
            }
        )
    if len(parts) == 1:
        return parts, {"mechanisms": labels, **{k: labels[0][k] for k in ("floors", "gap")}}
    together = probe_of(plant.groups_of(parts)).size(parts)
    return parts, {"mechanisms": labels, **together.document()}


def add_noise(
    random: np.random.Generator,
    rows: int,
    white: float,
    settings: NoiseSettings = DEFAULT_NOISE,
    interval: float = DEFAULT_PLANT.row_interval,
) -> np.ndarray:
    """Draw white noise plus correlated noise (AR(1)).

    Args:
        random: Source of the noise.
        rows: Number of rows.
        white: Standard deviation of the white part, in the unit of the result.
        settings: Size and time constant of the correlated part.
        interval: Interval of the rows [s].

    Returns:
        Noise, shape (rows,).
    """
    kept = np.exp(-interval / settings.correlation_time)
    spread = settings.correlated_share * white
    shocks = spread * np.sqrt(1 - kept**2) * random.standard_normal(rows)
    correlated = np.empty(rows)
    value = spread * random.standard_normal()
    for index, shock in enumerate(shocks):
        value = kept * value + shock
        correlated[index] = value
    return correlated + white * random.standard_normal(rows)


def as_run_log(
    motion: PlantReading,
    planned: PlannedRun,
    random: np.random.Generator,
    settings: GenerationSettings = DEFAULT_GENERATION,
) -> RunLog:
    """Record a run as its rig does: with noise, in whole micrometres, and the believed set-up."""
    noise = settings.noise

    def record(channel: str) -> np.ndarray:
        white, rows = noise.white(channel), len(motion.time)
        added = add_noise(random, rows, white, noise, settings.plant.row_interval)
        return np.round((getattr(motion, channel) + added) / noise.resolution) * noise.resolution

    x, z = record("x"), record("z")
    wheel = plant.nominal_wheel(settings.plant.plate_size)
    at_rest = motion.time < min(settings.static_reading_time, planned.rest)
    setup = RecordedSetup(
        wheel_radius=float(wheel.radius),
        wheel_width=float(wheel.width),
        grouser_count=wheel.grouser_count,
        grouser_height=float(wheel.grouser_height),
        grouser_thickness=float(wheel.grouser_thickness),
        mass_x=13.902,
        mass_z=planned.mass,
        gravity=9.81,
        bulk_density=1490.0,
        sinkage_static=float(-z[at_rest].mean()),
        scaling_factor_initial=settings.believed_zeta,
    )
    command = RecordedCommand(time=motion.time, omega=planned.omega(motion.time))
    measured = Measured(time=motion.time, x=x, z=z)
    return RunLog(
        setup=setup,
        command=command,
        measured=measured,
        source="virtual rig",
        title="single-wheel run",
    )
