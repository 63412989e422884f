"""Runs of a driven carriage: effects that can show there, and a diagnosis that finds two."""

import pytest

from diagnose.api import effects_among, possible_effects
from diagnose.dataset import RigDataset
from diagnose.pipeline import diagnose
from drftjax.common.errors import InputError
from drftjax.effects.catalogue import effect_class
from drftjax.recorded.prepared_run import PreparedRun
from tests.helpers.rig_datasets import WITHOUT_NEXT_RUN
from tests.helpers.synthetic_runs import coarse, recorded, setup_of

# Wheel speed over time, and the carriage's over the rim's: it slips, all but rolls, is braked.
TIME, OMEGA, RATIOS = [0.0, 0.3, 1.0, 2.5], [0.0, 0.0, 0.8, 0.8], (0.5, 0.9, 1.3)
RADIUS = 0.150
CHANNELS = ("z", "fx", "fz", "torque")
NOISE = 0.05  # of a usual transducer [N], [N m]
# Of a share of some hundredths, told by forces of some newtons to 0.05 N, a hundred times or more.
TOLD = 0.05
FORCES = {"force_offset", "force_gain", "force_crosstalk"}
TORQUE = {"torque_offset", "torque_friction", "torque_gain"}
LATE = {"channel_delay"}


def runs(*effects: dict, ratios=RATIOS, channels=CHANNELS) -> list[PreparedRun]:
    found = []
    for number, ratio in enumerate(ratios):
        setup = setup_of((TIME, OMEGA), vx=[RADIUS * ratio * omega for omega in OMEGA])
        setup.effects = list(effects)
        log = recorded(setup, number, channels=channels, force_noise=NOISE)
        found.append(coarse(f"run {number}", log))
    return found


def names(candidates: list[PreparedRun]) -> set[str]:
    return {each.about.name for each in possible_effects(candidates, effects_among(None))}


def test_effects_that_carriage_or_channels_cannot_show_are_no_candidates():
    free = [coarse("free", recorded(setup_of((TIME, OMEGA))))]
    own = names(free)
    assert not own & {"carriage_gain", *FORCES, *TORQUE, *LATE}
    # The scales of travel and sinkage, and what moves the wheel, show everywhere.
    assert {"sinkage_drift", "travel_gain", "cohesion", "speed_gain"} <= own
    read = [coarse("free", recorded(setup_of((TIME, OMEGA)), channels=("x", "z", "torque")))]
    assert names(read) == own | TORQUE | LATE
    for channels, added in (
        (("z", "fx"), FORCES),
        (("z", "torque"), TORQUE),
        (CHANNELS, FORCES | TORQUE),
    ):
        # The place of a driven carriage is not compared, so that it cannot be read late.
        expected = own - {"travel_delay"} | {"carriage_gain"} | added | LATE
        assert names(runs(ratios=RATIOS[:1], channels=channels)) == expected
    with pytest.raises(InputError, match="torque_gain shows in torque, and only x, z are compared"):
        possible_effects(free, [effect_class("torque_gain")])


def test_effects_that_are_no_usual_hypotheses_are_looked_for_where_they_are_named():
    rare = ["vertical_compliance", "sinkage_offset", "surface_undulation"]
    free = [coarse("free", recorded(setup_of((TIME, OMEGA))))]
    assert not names(free) & set(rare)
    assert {"slip_sinkage", "heap", "depth_power"} <= names(free)
    assert [each.about.name for each in possible_effects(free, effects_among(rare))] == rare


def test_the_name_of_an_effect_stands_for_its_forms_too():
    named = [each.about.name for each in effects_among(["channel_delay", "terrain_wave"])]
    assert named == ["channel_delay", "travel_delay", "sinkage_delay", "terrain_wave"]
    assert [each.about.name for each in effects_among("sinkage_delay")] == ["sinkage_delay"]


@pytest.mark.parametrize(
    ("effect", "numbers"),
    [
        ("carriage_gain", {"gain": 0.03}),
        ("force_gain", {"fx_gain": 0.1, "fz_gain": 0.05}),
        ("channel_delay", {"delay": 0.08}),
    ],
)
def test_what_a_driven_carriage_shows_is_told_apart(effect, numbers):
    candidates = [*map(effect_class, ("carriage_gain", "force_gain", "channel_delay"))]
    dataset = RigDataset.of(runs({"name": effect, **numbers}))
    found = diagnose(dataset, candidates, settings=WITHOUT_NEXT_RUN)
    assert found.verdict == (effect,)
    told = {field: each.value for field, each in found.parameters[effect].items()}
    assert told == pytest.approx(numbers, rel=TOLD)
