"""A case for a diagnosis: three short runs of one virtual rig, two of one command."""

from diagnose.case import Case
from tests.virtual_runs import coarse, recorded, setup_of

# Slow and fast, long enough that what grows with travel shows.
PROFILES = (
    ([0.0, 0.3, 1.3, 5.0], [0.0, 0.0, 0.5, 0.5]),
    ([0.0, 0.3, 1.3, 5.0], [0.0, 0.0, 0.5, 0.5]),
    ([0.0, 0.3, 1.3, 4.0], [0.0, 0.0, 0.9, 0.9]),
)


def case_with(*effects: dict, scale: float = 1.0) -> Case:
    """Runs of a rig with these effects, as entries of a set-up file.

    The wheel stands at rest where its sinkage reads `scale` times what it is.
    """
    found = []
    for number, (profile, zeta) in enumerate(zip(PROFILES, (0.75, 0.757, 0.745), strict=True)):
        setup = setup_of(profile, zeta)
        setup.effects = list(effects)
        setup.start.sinkage *= scale
        found.append(coarse(f"run {number}", recorded(setup, seed=number, rate=100.0)))
    return Case.of(found)
