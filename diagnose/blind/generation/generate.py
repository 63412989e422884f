"""Making blind sets: what is wrong with each is drawn, its runs are made, its label is kept."""

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from diagnose.blind.answers.answer import UNFINISHED, configure_helper
from diagnose.blind.generation.effect_size import FLOORS, EffectSize, EffectSizeProbe
from diagnose.blind.generation.random_mechanisms import (
    CATALOGUE,
    STRANGERS,
    Mechanism,
    draw_mechanism,
    draw_unlisted,
    stage_of,
)
from diagnose.blind.generation.sealed_labels import seal
from diagnose.blind.plant import plant
from diagnose.blind.plant.plant import group_of
from diagnose.blind.plant.run_plan import (
    LETTERS,
    PRACTICE,
    TELLING,
    PlannedRun,
    draw_fresh_runs,
    draw_nine_runs,
)
from diagnose.blind.plant.sensors import PlantReading
from drftjax.common.errors import InputError
from drftjax.runlog.hdf5.api import write_run
from drftjax.runlog.record import Measured, RecordedCommand, RecordedSetup, RunLog

# Shares of mixed sets; what is left has one thing wrong.
SHARES = {"none": 0.12, "unknown": 0.12, "pair": 0.16}


SCATTER = 0.01


WHITE = {"x": 50e-6, "z": 20e-6}


# The part of the noise that lasts, as a share of the white part, and how long [s].
LASTING, LASTS = 1 / 3, 0.2


QUANTUM = 1e-6


# Sinkage before a run is read over this long [s], or as long as the wheel stands.
READ_OVER = 1.0


BELIEVED_ZETA = 0.7823


# Runs that strengths are found on: a slow one, a middling one with sharp ramps, and the fastest.
PROBED = (0, 5, 8)


REDRAWS = 5


PROTOCOLS = ("mixed", "practice", "random", "telling")


WRONG = ("mixed", "none", "one", "pair", "unknown")


@dataclass(frozen=True)
class GenerationRequest:
    """What sets are asked for.

    Attributes:
        folder: Where they go.
        sets: How many.
        seed: Settles every lot that is drawn.
        protocol: One of `PROTOCOLS`. "telling" has the rigs of "mixed", and records other runs of
            them: the nine of `diagnose.next_runs.recommended_runs`.
        faintest, strongest: Gaps [floors] that strengths are drawn between.
        wrong: What is wrong with the sets, one of `WRONG`: nothing, one effect, two, or one that
            the list of effects lacks; "mixed" has some of each.
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
            ("what is wrong", self.wrong, WRONG),
        ):
            if given not in known:
                raise InputError(f"{what} is {given!r}, must be one of {', '.join(known)}")
        if not 0 < self.faintest <= self.strongest:
            raise InputError(
                f"gaps from {self.faintest:g} to {self.strongest:g} floors were asked for; both "
                "must be over zero and in order"
            )

    def name(self, number: int) -> str:
        """The name of a set, from its number from zero."""
        return f"set_{number + 1:0{max(2, len(str(self.sets)))}d}"


def planned_faults(order: GenerationRequest) -> list[tuple[str, ...]]:
    """What is wrong with every set: kinds of mechanism, spread over all that there are."""
    random = np.random.default_rng([order.seed, 0])
    names = [name for stage in CATALOGUE.values() for name in stage]
    singles, strangers, pairs = _shuffled(names, random), _shuffled(list(STRANGERS), random), 0
    counts = {kind: round(order.sets * share) for kind, share in SHARES.items()}
    if order.wrong != "mixed":
        counts = {kind: order.sets if kind == order.wrong else 0 for kind in SHARES}
    drawn: list[tuple[str, ...]] = [()] * counts["none"]
    drawn += [(next(strangers),) for _ in range(counts["unknown"])]
    while pairs < counts["pair"]:
        first, second = (str(each) for each in random.choice(names, 2, replace=False))
        if stage_of(first) != stage_of(second):
            drawn.append((first, second))
            pairs += 1
    drawn += [(next(singles),) for _ in range(order.sets - len(drawn))]
    return [drawn[index] for index in random.permutation(order.sets)]


def _shuffled(names: list[str], random: np.random.Generator) -> Iterator[str]:
    while True:
        yield from (names[index] for index in random.permutation(len(names)))


def make(order: GenerationRequest, jobs: int = 1) -> Iterator[str]:
    """Make sets and seal their labels; gives the name of every set as it is done.

    Args:
        order: What is asked for.
        jobs: Processes to make them in; the sets are the same however many there are.

    Raises:
        InputError: where there are sets already.
    """
    folder = order.folder
    if folder.exists() and any(folder.iterdir()):
        raise InputError(f"{folder} is not empty; name a folder that is")
    folder.mkdir(parents=True, exist_ok=True)
    drawn = planned_faults(order)
    labels: dict[str, dict] = {}
    if jobs == 1:
        for number in _in_turn(drawn):
            labels[order.name(number)] = make_set(order, number, drawn[number])
            yield order.name(number)
    else:
        # A fresh process, as JAX's threads do not live through a fork.
        with ProcessPoolExecutor(jobs, get_context("spawn"), configure_helper, (set(),)) as pool:
            waiting = {
                pool.submit(make_set, order, number, drawn[number]): number
                for number in _in_turn(drawn)
            }
            for done in as_completed(waiting):
                labels[order.name(waiting[done])] = done.result()
                yield order.name(waiting[done])
    seal(folder, dict(sorted(labels.items())))


def _in_turn(drawn: list[tuple[str, ...]]) -> list[int]:
    """Sets in an order that puts those of like programs beside each other."""
    return sorted(range(len(drawn)), key=lambda number: drawn[number])


def make_set(order: GenerationRequest, number: int, kinds: tuple[str, ...]) -> dict:
    """Make one set; gives its label.

    Args:
        order: What is asked for.
        number: Which set, from zero: with the order's seed it settles every lot of the set.
        kinds: What is wrong with it.
    """
    random = np.random.default_rng([order.seed, 1, number])
    for _ in range(REDRAWS):
        try:
            return _made(order, number, kinds, random)
        except InputError:  # it digs in or leaves its rail: another form may not
            continue
    raise InputError(f"no form of {' and '.join(kinds) or 'nothing'} lets the plant run")


def _made(
    order: GenerationRequest, number: int, kinds: tuple[str, ...], random: np.random.Generator
) -> dict:
    practice = order.protocol == "practice" or (
        order.protocol in ("mixed", "telling") and random.random() < 0.5
    )
    profiles = PRACTICE if practice else draw_nine_runs(random)
    telling = order.protocol == "telling"
    fresh = draw_fresh_runs(random)
    zeta = float(random.uniform(0.65, 0.95))
    mechanisms = [
        draw_unlisted(kind, random) if kind in STRANGERS else draw_mechanism(kind, random)
        for kind in kinds
    ]
    targets = [
        float(np.exp(random.uniform(np.log(order.faintest), np.log(order.strongest))))
        for _ in mechanisms
    ]
    label = {
        "effects": [each.name for each in mechanisms],
        "protocol": "telling" if telling else "practice" if practice else "random",
        "zeta": zeta,
    }
    parts = []
    if mechanisms:
        parts, told = _strengthened(mechanisms, targets, profiles, zeta)
        label |= told
    nine = TELLING if telling else profiles
    runs = {f"run_{letter}": each for letter, each in zip(LETTERS, nine, strict=True)}
    runs |= {f"fresh/fresh_{letter}": each for letter, each in zip("abc", fresh, strict=True)}
    logs = {}
    for name, profile in runs.items():
        own = zeta * float(np.exp(SCATTER * random.standard_normal()))
        true = plant.run_plant(parts, profile, own)
        logs[name] = as_run_log(true, profile, random)
    _write_set(order.folder / order.name(number), logs)
    return label


def _write_set(home: Path, logs: dict[str, RunLog]) -> None:
    """Write a set's runs beside, and give the folder its name when all are there."""
    home.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=UNFINISHED, dir=home.parent) as scratch:
        draft = Path(scratch) / home.name
        (draft / "fresh").mkdir(parents=True)
        for name, log in logs.items():
            write_run(draft / f"{name}.h5", log)
        draft.rename(home)


def _strengthened(
    mechanisms: list[Mechanism], targets: list[float], profiles: tuple[PlannedRun, ...], zeta: float
) -> tuple[list[plant.Part], dict]:
    """The mechanisms at strengths that show as much as is wanted, and what labels say of it."""
    probed = tuple(profiles[index] for index in PROBED)
    parts, told, probe = [], [], None
    for mechanism, target in zip(mechanisms, targets, strict=True):
        group = group_of(mechanism.build(mechanism.typical))
        probe = EffectSizeProbe.of(probed, zeta, () if group is None else (group,))
        strength, gap = probe.strength(mechanism, target)
        parts.append(mechanism.build(strength))
        told.append(
            {
                "name": mechanism.name,
                "kind": mechanism.kind,
                "strength": strength,
                "form": mechanism.form,
                "wanted_floors": target,
                **_told(gap),
            }
        )
    if len(parts) == 1:
        return parts, {"mechanisms": told, **{k: told[0][k] for k in ("floors", "gap")}}
    probe = EffectSizeProbe.of(probed, zeta, plant.groups_of(parts))
    return parts, {"mechanisms": told, **_told(probe.gap(parts))}


def _told(gap: EffectSize) -> dict:
    millimetres = {name: 1e3 * value for name, value in asdict(gap).items()}
    return {
        "floors": gap.floors,
        "gap": {
            name: {
                "whole_mm": millimetres[name],
                "left_mm": millimetres[f"{name}_left"],
                "floors": millimetres[f"{name}_left"] / (1e3 * floor),
            }
            for name, floor in FLOORS.items()
        },
    }


def add_noise(random: np.random.Generator, rows: int, white: float) -> np.ndarray:
    """White noise of this size, and a part of it more that lasts; rows 10 ms apart."""
    kept = np.exp(-plant.ROW / LASTS)
    shocks = LASTING * white * np.sqrt(1 - kept**2) * random.standard_normal(rows)
    lasting = np.empty(rows)
    value = LASTING * white * random.standard_normal()
    for index, shock in enumerate(shocks):
        value = kept * value + shock
        lasting[index] = value
    return lasting + white * random.standard_normal(rows)


def as_run_log(true: PlantReading, profile: PlannedRun, random: np.random.Generator) -> RunLog:
    """A run as its rig writes it down: with noise, in whole micrometres, and what is believed."""

    def read(name: str) -> np.ndarray:
        noisy = getattr(true, name) + add_noise(random, len(true.time), WHITE[name])
        return np.round(noisy / QUANTUM) * QUANTUM

    x, z = read("x"), read("z")
    wheel = plant.nominal_wheel()
    setup = RecordedSetup(
        wheel_radius=float(wheel.radius),
        wheel_width=float(wheel.width),
        grouser_count=wheel.grouser_count,
        grouser_height=float(wheel.grouser_height),
        grouser_thickness=float(wheel.grouser_thickness),
        mass_x=13.902,
        mass_z=profile.mass,
        gravity=9.81,
        bulk_density=1490.0,
        sinkage_static=float(-z[true.time < min(READ_OVER, profile.rest)].mean()),
        scaling_factor_initial=BELIEVED_ZETA,
    )
    command = RecordedCommand(time=true.time, omega=profile.omega(true.time))
    measured = Measured(time=true.time, x=x, z=z)
    return RunLog(
        setup=setup,
        command=command,
        measured=measured,
        source="virtual rig",
        title="single-wheel run",
    )
