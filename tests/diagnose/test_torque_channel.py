"""Torque beside travel and sinkage: a channel that tells look-alikes apart."""

from diagnose.dataset import RigDataset
from diagnose.pipeline import diagnose
from drftjax.effects.catalogue import effect_class
from tests.helpers.rig_datasets import WITHOUT_NEXT_RUN
from tests.helpers.synthetic_runs import FAST, SLOW, coarse, recorded, setup_of

NAMES = ("wheel_radius", "travel_gain")
# Of what is believed without it; in truth, of a share of a few hundredths, a fifth is left.
HALF = 0.5
# Of a usual transducer, and of one that tells nothing: several times all that there is [N m].
TORQUE_NOISE, USELESS = 0.02, 20.0


def weight_of_travel_gain(torque_noise: float) -> float:
    """What is believed of it where in truth the wheel is larger."""
    runs = []
    for number, profile in enumerate((SLOW, SLOW, FAST)):
        setup = setup_of(profile)
        setup.effects = [{"name": "wheel_radius", "excess": 0.008}]
        channels = ("x", "z", "torque")
        runs.append(recorded(setup, number, channels=channels, force_noise=torque_noise))
    dataset = RigDataset.of([coarse(f"run {number}", run) for number, run in enumerate(runs)])
    found = diagnose(dataset, [*map(effect_class, NAMES)], settings=WITHOUT_NEXT_RUN)
    assert found.verdict == ("wheel_radius",)
    return found.weights.get("travel_gain", 0.0)


def test_torque_tells_a_larger_wheel_from_a_reading_of_travel_that_is_too_long():
    assert weight_of_travel_gain(TORQUE_NOISE) < HALF * weight_of_travel_gain(USELESS)
