"""Sets of one rig with an effect, two, none or one that is not listed, or with several at once."""

from collections.abc import Sequence
from functools import cache

import numpy as np

from diagnose.blind.generation.effect_size import EffectSizeProbe
from diagnose.blind.generation.kinds.strengths import draw_target, part_of_size
from diagnose.blind.generation.random_mechanisms import (
    GROUSER_KINDS,
    UNLISTED,
    Mechanism,
    draw_mechanism,
    draw_unlisted,
)
from diagnose.blind.generation.random_rigs import DrawnRig, draw_rig, mechanism_for
from diagnose.blind.generation.recording import write_set
from diagnose.blind.generation.settings import SEVERAL, GenerationRequest, GenerationSettings
from diagnose.blind.generation.true_budget import true_budget
from diagnose.blind.plant import plant
from diagnose.blind.plant.plant import Part
from diagnose.blind.plant.run_plan import (
    PRACTICE_RUNS,
    RECOMMENDED_RUNS,
    RUN_LETTERS,
    PlannedRun,
    draw_fresh_runs,
    draw_nine_runs,
)
from drftjax.common.errors import InputError


def make_one_rig(
    request: GenerationRequest,
    number: int,
    kinds: tuple[str, ...],
    random: np.random.Generator,
    settings: GenerationSettings,
) -> dict:
    """Draw a rig, its runs and its mechanisms, write the run logs, and return the label.

    Args:
        request: Seed, protocol and sizes.
        number: Number of the set, from zero.
        kinds: Kinds of its mechanisms.
        random: Source of every choice.
        settings: Distribution of the rigs.

    Raises:
        InputError: The plant cannot run with what was drawn, or an effect of several is too small.
    """
    # "telling" draws all that "mixed" does, so that both have the same rigs.
    practice = request.protocol == "practice" or (
        request.protocol in ("mixed", "telling") and random.random() < settings.practice_share
    )
    nine = PRACTICE_RUNS if practice else draw_nine_runs(random, settings.random_runs)
    fresh = draw_fresh_runs(random, settings.random_runs)
    drawn = draw_rig(random, settings, needs_grousers=bool(GROUSER_KINDS & set(kinds)))
    nine, fresh = (tuple(run.on(drawn.rig) for run in runs) for runs in (nine, fresh))
    mechanisms = [
        mechanism_for(
            draw_unlisted(kind, random) if kind in UNLISTED else draw_mechanism(kind, random),
            drawn.rig,
        )
        for kind in kinds
    ]
    least = settings.several.least_floors if request.kind == SEVERAL else 0.0
    targets = [draw_target(request, random, least) for _ in mechanisms]
    parts, label = _with_strengths(mechanisms, targets, nine, drawn, settings, least)
    protocol = "practice" if practice else "random"
    if request.protocol == "telling":
        protocol, nine = "telling", tuple(run.on(drawn.rig) for run in RECOMMENDED_RUNS)
    runs = {f"run_{letter}": run for letter, run in zip(RUN_LETTERS, nine, strict=True)}
    runs |= {f"fresh/fresh_{letter}": run for letter, run in zip("abc", fresh, strict=True)}
    zetas = [
        drawn.zeta * float(np.exp(settings.zeta_scatter * random.standard_normal())) for _ in runs
    ]
    groups = plant.groups_of(parts, _held(mechanisms))
    logger, resolution = drawn.logger(settings), drawn.resolution(settings)
    logs = {}
    for (name, run), zeta in zip(runs.items(), zetas, strict=True):
        motion = plant.run_plant(parts, run, zeta, groups, resolution, drawn.rig)
        logs[name] = logger.record(motion, run, random)
    if request.kind == SEVERAL:
        chosen = [(nine[each], zetas[each]) for each in settings.several.budget_runs]
        label["budget"] = true_budget(
            dict(zip(kinds, parts, strict=True)), chosen, settings.plant, drawn.rig
        )
        label["budget"]["runs"] = [f"run_{RUN_LETTERS[e]}" for e in settings.several.budget_runs]
    write_set(request.folder / request.name(number), logs)
    effects = [each.name for each in mechanisms]
    return {"effects": effects, "protocol": protocol, **drawn.document(), **label}


def _with_strengths(
    mechanisms: list[Mechanism],
    targets: list[float],
    nine: tuple[PlannedRun, ...],
    drawn: DrawnRig,
    settings: GenerationSettings,
    least: float,
) -> tuple[list[Part], dict]:
    """Mechanisms at the strengths of the wanted sizes [noise floors], and the label's part on them.

    For several mechanisms, the label also has the size of all together. None may be smaller than
    `least` noise floors.
    """
    if not mechanisms:
        return [], {}
    runs = tuple(nine[index] for index in settings.probe_runs)
    held = _held(mechanisms)

    @cache
    def probe_of(groups: tuple[str, ...]) -> EffectSizeProbe:
        return EffectSizeProbe.of(
            runs, drawn.zeta, groups, settings.effect_size, settings.plant, drawn.rig
        )

    parts, labels = [], []
    for mechanism, target in zip(mechanisms, targets, strict=True):
        part, label = part_of_size(mechanism, target, probe_of, held)
        if label["floors"] < least:
            raise InputError(f"{mechanism.kind} is smaller than {least:g} noise floors")
        parts.append(part)
        labels.append(label)
    if len(parts) == 1:
        return parts, {"mechanisms": labels, **{k: labels[0][k] for k in ("floors", "gap")}}
    together = probe_of(plant.groups_of(parts, held)).size(parts)
    return parts, {"mechanisms": labels, **together.document()}


def _held(mechanisms: Sequence[Mechanism]) -> tuple[str, ...]:
    """Groups that the program of a set holds, whether one of its mechanisms is in them or not."""
    return plant.COMMON_GROUPS if len(mechanisms) > 2 else ()
