"""Sets of runs before and after a change: on sand of another law, with small faults throughout."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from diagnose.blind.generation.effect_size import EffectSizeProbe
from diagnose.blind.generation.kinds.strengths import draw_target, part_of_size
from diagnose.blind.generation.random_mechanisms import (
    GROUSER_KINDS,
    draw_mechanism,
    effect_names,
    make_part,
)
from diagnose.blind.generation.random_rigs import DrawnRig, draw_rig, mechanism_for
from diagnose.blind.generation.recording import write_set
from diagnose.blind.generation.settings import GenerationRequest, GenerationSettings
from diagnose.blind.plant import plant
from diagnose.blind.plant.bed import PlantDepthHardening
from diagnose.blind.plant.plant import Part
from diagnose.blind.plant.rig import GRAVITY
from diagnose.blind.plant.run_plan import PlannedRun, draw_nine_runs
from diagnose.blind.plant.sand import PlantHeap

ZETA = "zeta"
# Effects that the sand of another law has already.
OF_THE_LAW = frozenset({"depth_hardening", "heap"})
FOLDERS = ("before", "now")


def changeable() -> list[str]:
    """Names of what may change between two groups of runs, `zeta` left out."""
    return [name for name in effect_names() if name not in OF_THE_LAW]


@dataclass(frozen=True)
class SandLaw:
    """Law of the sand of a set, beyond the rig's own coefficients.

    Attributes:
        depth_exponent: Exponent of the stress by depth [-].
        resistance: Resistance of the heap ahead at the reference sinkage [N].
        parts: Parts of the plant that make it so.
    """

    depth_exponent: float
    resistance: float
    parts: tuple[Part, ...]


def make_change(
    request: GenerationRequest,
    number: int,
    kinds: tuple[str, ...],
    random: np.random.Generator,
    settings: GenerationSettings,
) -> dict:
    """Draw a rig, its faults and what changes, write five runs before and five now; the label.

    Args:
        request: Seed and sizes.
        number: Number of the set, from zero.
        kinds: What changes: the name of an effect, `ZETA`, or nothing.
        random: Source of every choice.
        settings: Distribution of the rigs.

    Raises:
        InputError: The plant cannot run with what was drawn.
    """
    change = settings.change
    names = changeable()
    others = [name for name in names if name not in (*kinds, *GROUSER_KINDS)]
    faults = [str(each) for each in random.choice(others, change.faults, replace=False)]
    drawn = draw_rig(random, settings, needs_grousers=bool(GROUSER_KINDS & set(kinds)))
    drawn, law = _another_law(drawn, random, settings)
    nine = [run.on(drawn.rig) for run in draw_nine_runs(random, settings.random_runs)]
    runs = [nine[index] for index in change.runs]
    present, fault_labels = _faults(faults, drawn, law.parts, runs, random, settings)
    zetas, changed, label = [drawn.zeta, drawn.zeta], [], {}
    if kinds == (ZETA,):
        step = float(random.uniform(*change.zeta_change)) * float(random.choice([-1, 1]))
        zetas[1] *= 1 + step
        size = {"value": step, "unit": "-", "numbers": ["change"]}
        label = {"size": size, "floors": abs(step) / settings.zeta_scatter}
    elif kinds:
        mechanism = mechanism_for(draw_mechanism(kinds[0], random), drawn.rig)
        base = (*law.parts, *present)
        part, mechanism_label = part_of_size(
            mechanism, draw_target(request, random, 0.0), *_probe_on(base, drawn, runs, settings)
        )
        changed = [part]
        label = {
            "mechanisms": [mechanism_label],
            **{key: mechanism_label[key] for key in ("floors", "size") if key in mechanism_label},
        }
    logs = {}
    logger, resolution = drawn.logger(settings), drawn.resolution(settings)
    groups = plant.groups_of([*law.parts, *present, *changed], plant.COMMON_GROUPS)
    for folder, zeta, extra in zip(FOLDERS, zetas, ([], changed), strict=True):
        for letter, run in zip("abcde", runs, strict=True):
            zeta_of_run = zeta * float(np.exp(settings.zeta_scatter * random.standard_normal()))
            parts = [*law.parts, *present, *extra]
            motion = plant.run_plant(parts, run, zeta_of_run, groups, resolution, drawn.rig)
            logs[f"{folder}/run_{letter}"] = logger.record(motion, run, random)
    write_set(request.folder / request.name(number), logs)
    return {
        "effects": list(kinds),
        **drawn.document(),
        "law": {
            "depth_exponent": law.depth_exponent,
            "heap_newton": law.resistance,
        },
        "faults": fault_labels,
        **label,
    }


def _another_law(
    drawn: DrawnRig, random: np.random.Generator, settings: GenerationSettings
) -> tuple[DrawnRig, SandLaw]:
    """The rig on sand whose stress follows another law of depth and of angles, and a heap ahead."""
    change = settings.change
    factors = 1 + change.coefficient_spread * random.standard_normal(9)
    rig = dataclasses.replace(drawn.rig, stress_factors=tuple(map(float, factors)))
    exponent = float(random.uniform(*change.depth_exponent))
    resistance = float(random.uniform(*change.heap)) * rig.mass_z * GRAVITY
    # One at about the mean depth of the plates of a wheel at rest, so that zeta stays as it is.
    hardening = make_part(
        PlantDepthHardening, power=exponent - 1, reference=0.01 * rig.length_scale
    )
    heap = make_part(
        PlantHeap,
        force=resistance,
        sinkage=0.02 * rig.length_scale,
        power=random.uniform(1.6, 2.4),
        braking=random.uniform(0.5, 6.0),
        lift=random.uniform(0.1, 0.5),
    )
    law = SandLaw(exponent, resistance, (hardening, heap))
    return dataclasses.replace(drawn, rig=rig), law


def _faults(
    names: list[str],
    drawn: DrawnRig,
    law: tuple[Part, ...],
    runs: list[PlannedRun],
    random: np.random.Generator,
    settings: GenerationSettings,
) -> tuple[list[Part], list[dict]]:
    """Small faults that are there before and now, and what the label says of them."""
    low, high = settings.change.fault_floors
    probe_of, held = _probe_on(law, drawn, runs, settings)
    parts, labels = [], []
    for name in names:
        mechanism = mechanism_for(draw_mechanism(name, random), drawn.rig)
        target = float(np.exp(random.uniform(np.log(low), np.log(high))))
        part, label = part_of_size(mechanism, target, probe_of, held)
        parts.append(part)
        labels.append(label)
    return parts, labels


def _probe_on(
    base: tuple[Part, ...],
    drawn: DrawnRig,
    runs: list[PlannedRun],
    settings: GenerationSettings,
) -> tuple[Callable[[tuple[str, ...]], EffectSizeProbe], tuple[str, ...]]:
    """Probe by the groups that its program holds, with parts that are there in any case; theirs."""

    @cache
    def probe_of(groups: tuple[str, ...]) -> EffectSizeProbe:
        probed = [runs[index] for index in settings.change.probe_runs]
        sizes = settings.effect_size
        return EffectSizeProbe.of(
            probed, drawn.zeta, groups, sizes, settings.plant, drawn.rig, base
        )

    return probe_of, plant.groups_of(base, plant.COMMON_GROUPS)
