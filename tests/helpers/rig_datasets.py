"""A case for a diagnosis: three short runs of one virtual rig, two of one command."""

from diagnose.dataset import (
    DEFAULT_DATASET,
    DatasetSettings,
    RigDataset,
    in_short_steps,
    without_step_errors,
)
from diagnose.run_pool import RunPool
from diagnose.selection.verdict import VerdictSettings
from diagnose.settings import DiagnosisSettings
from drftjax.runlog.record import RunLog
from drftjax.setups.setup import read_setup
from drftjax.simulation.statics import sinkage_under_load
from tests.helpers.synthetic_runs import coarse, recorded, setup_of

# No run is proposed that would tell the verdict from its rivals: simulating the runs to choose from
# takes a third of a diagnosis, and only tests of the proposal ask for it.
WITHOUT_NEXT_RUN = DiagnosisSettings(verdict=VerdictSettings(max_competing=0))

# A standing wheel tells friction from a pull, and a lag from a filter: tests of how sets are found
# keep that.
WITH_REST = DatasetSettings(with_first_rest=True)

# Slow and fast, long enough that what grows with travel shows.
PROFILES = (
    ([0.0, 0.3, 1.3, 5.0], [0.0, 0.0, 0.5, 0.5]),
    ([0.0, 0.3, 1.3, 5.0], [0.0, 0.0, 0.5, 0.5]),
    ([0.0, 0.3, 1.3, 4.0], [0.0, 0.0, 0.9, 0.9]),
)


# Wheel speed [rad/s], mass on the wheel [kg] and zeta: two repeats, two other conditions.
CONDITIONS = ((0.8, 18.8, 0.75), (0.8, 18.8, 0.757), (1.2, 18.8, 0.746), (0.8, 26.0, 0.752))


def run_with(
    effect: dict,
    speed: float,
    mass: float,
    zeta: float,
    seed: int,
    noise: float = 10e-6,
    deeper: float = 1.0,
) -> RunLog:
    """A run of a rig with an effect, whose wheel stands at first and slows down at last.

    Args:
        effect: As an entry of a set-up file.
        speed: Of the wheel [rad/s].
        mass: On it [kg].
        zeta: Scaling factor [-].
        seed: Of the noise.
        noise: Standard deviation of x and z [m].
        deeper: Sinkage of the standing wheel over what its load asks for [-].
    """
    setup = setup_of(([0.0, 0.25, 1.25, 3.5, 4.25], [0.0, 0.0, speed, speed, 0.3 * speed]), zeta)
    setup.rig.mass_z = mass
    # The plates with which a run log is simulated again.
    setup.wheel.plate_size = read_setup("data/paper.toml").wheel.plate_size
    setup.effects = [effect]
    setup.start.sinkage = deeper * float(sinkage_under_load(setup.trial().simulator, zeta))
    return recorded(setup, seed=seed, noise=noise)


def dataset_with(
    *effects: dict, scale: float = 1.0, settings: DatasetSettings = DEFAULT_DATASET
) -> RigDataset:
    """Runs of a rig with these effects, as entries of a set-up file.

    They are simulated in short steps. The wheel stands at rest where its sinkage reads `scale`
    times what it is.
    """
    found = []
    for number, (profile, zeta) in enumerate(zip(PROFILES, (0.75, 0.757, 0.745), strict=True)):
        setup = setup_of(profile, zeta)
        setup.effects = list(effects)
        setup.start.sinkage *= scale
        found.append(coarse(f"run {number}", recorded(setup, seed=number, rate=100.0)))
    with RunPool() as pool:
        return without_step_errors(in_short_steps(RigDataset.of(found, settings)), pool)
