"""Sets of a sweep over slip: a driven carriage, steady runs, forces and torque."""

import numpy as np

from diagnose.blind.generation.effect_size import EffectSizeProbe
from diagnose.blind.generation.kinds.strengths import draw_target, part_of_size
from diagnose.blind.generation.random_mechanisms import GROUSER_KINDS, draw_mechanism
from diagnose.blind.generation.random_rigs import draw_rig, mechanism_for
from diagnose.blind.generation.recording import write_set
from diagnose.blind.generation.settings import GenerationRequest, GenerationSettings
from diagnose.blind.plant import plant
from diagnose.blind.plant.run_plan import draw_sweep


def make_sweep(
    request: GenerationRequest,
    number: int,
    kinds: tuple[str, ...],
    random: np.random.Generator,
    settings: GenerationSettings,
) -> dict:
    """Draw a rig with a driven carriage, write its runs, and return the label.

    Args:
        request: Seed and sizes.
        number: Number of the set, from zero.
        kinds: Name of its effect, or nothing.
        random: Source of every choice.
        settings: Distribution of the rigs.

    Raises:
        InputError: The plant cannot run with what was drawn.
    """
    needs_grousers = bool(GROUSER_KINDS & set(kinds))
    drawn = draw_rig(random, settings, needs_grousers, is_driven=True)
    runs = draw_sweep(random, drawn.rig, settings.sweep)
    parts, label = [], {}

    def probe_of(groups: tuple[str, ...]) -> EffectSizeProbe:
        # Every slip once, and the faster runs.
        once = [run for name, run in runs.items() if not name.endswith("b")]
        return EffectSizeProbe.of(
            once,
            drawn.zeta,
            groups,
            settings.effect_size,
            settings.plant,
            drawn.rig,
            zeta_scatter=settings.zeta_scatter,
        )

    for kind in kinds:
        mechanism = mechanism_for(draw_mechanism(kind, random), drawn.rig)
        target = draw_target(request, random, 0.0)
        part, mechanism_label = part_of_size(mechanism, target, probe_of, plant.COMMON_GROUPS)
        parts.append(part)
        label = {
            "mechanisms": [mechanism_label],
            **{key: mechanism_label[key] for key in ("floors", "gap")},
        }
    logger, resolution = drawn.logger(settings), drawn.resolution(settings)
    groups = plant.groups_of(parts, plant.COMMON_GROUPS)
    logs = {}
    for name, run in runs.items():
        zeta = drawn.zeta * float(np.exp(settings.zeta_scatter * random.standard_normal()))
        motion = plant.run_plant(parts, run, zeta, groups, resolution, drawn.rig)
        logs[name] = logger.record(motion, run, random)
    write_set(request.folder / request.name(number), logs)
    return {"effects": list(kinds), **drawn.document(), **label}
