"""An effect of the list in a form that the list lacks: a curve over the place stands for it."""

import json
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest

from diagnose.dataset import RigDataset
from diagnose.evaluation.model_reader import read_model_file
from diagnose.gap.gap import Gap
from diagnose.gap.selected_effects import SelectedEffects
from diagnose.pipeline import diagnose
from diagnose.report.model_writer import model_toml
from diagnose.report.page import write
from diagnose.report.text import paragraphs, verdict
from diagnose.result import Diagnosis
from diagnose.rig_runs import gather_runs
from diagnose.selection.verdict import reassign_unknown, weight_by_name
from diagnose.unknown.correction_fit import Correction, equivalent_effect, match_listed_effect
from diagnose.unknown.settings import DEFAULT_UNKNOWN_EFFECT, UnknownEffectSettings
from drftjax.effects.base import EffectInfo, MemorylessZetaFactor, strength
from drftjax.effects.catalogue import catalogue
from drftjax.effects.correction import Curve, correction_class, with_values
from drftjax.effects.terrain import TerrainVariation
from drftjax.runlog.hdf5.api import write_run
from tests.helpers.rig_datasets import run_with
from tests.helpers.synthetic_runs import DEEPER

# A wave of the sand's strength along the bed [m], which no patch stands for.
LENGTH, SWING = 0.45, 0.05
# Wheel speed [rad/s], mass on the wheel [kg] and zeta: two repeats, two other conditions. No run
# goes much farther than the others: where only it has been, they tell no curve.
CONDITIONS = ((1.0, 18.8, 0.75), (1.0, 18.8, 0.757), (1.1, 18.8, 0.746), (1.1, 26.0, 0.752))
# All but a tenth; and of a curve's shape, whose knots stand for the bends between them, a fifth.
NEARLY_ALL, SHAPE = 0.9, 0.2
BUMP = (0.0, 0.05, 0.0, -0.02, 0.0)


class Furrows(MemorylessZetaFactor):
    """zeta goes up and down along the bed."""

    about: ClassVar = EffectInfo("furrows", "terrain", "ζ = ζ exp(swing sin 2πx/L)", "uneven sand")
    swing: float = strength("-", 0.1, "largest change of log zeta")

    def factor(self, moment, memory):
        return jnp.exp(self.swing * jnp.sin(2 * jnp.pi * moment.position[0] / LENGTH))


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> Diagnosis:
    """With the list's patch to choose from, and not its wave."""
    folder = tmp_path_factory.mktemp("furrows")
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(catalogue(), "furrows", Furrows)
        for number, (speed, mass, zeta) in enumerate(CONDITIONS):
            effect = {"name": "furrows", "swing": SWING}
            run = run_with(effect, speed, mass, zeta, seed=number, deeper=DEEPER)
            write_run(folder / f"run_{number}.h5", run)
    return diagnose(RigDataset.of(gather_runs([folder]).runs), (TerrainVariation,))


def test_a_zeta_that_goes_up_and_down_along_the_bed_is_a_variation_of_the_terrain(found):
    assert found.verdict == ("terrain_variation",)
    assert [list(group) for group in found.groups] == [["terrain_variation"]]
    assert found.weights["terrain_variation"] > NEARLY_ALL
    assert found.weights["unknown"] == 0
    assert sum(found.weights.values()) == pytest.approx(1)
    assert found.gap["z"].before > 10 * found.gap["z"].floor
    assert found.gap["z"].shrinkage > NEARLY_ALL
    assert any("what terrain_variation means, in another form" in note for note in found.notes)


def test_the_curve_follows_the_furrows(found):
    effect = found.correction.effect
    knots, values = np.asarray(effect.knots), np.asarray(effect.values())
    truth = SWING * np.sin(2 * np.pi * knots / LENGTH)
    # Its level is zeta's own.
    apart = (values - values.mean()) - (truth - truth.mean())
    assert np.sqrt(np.mean(apart**2)) < SHAPE * np.sqrt(np.mean((truth - truth.mean()) ** 2))


def test_what_is_written_holds_the_curve_and_names_the_effect(found, tmp_path):
    write(found, tmp_path)
    document = json.loads((tmp_path / "diagnosis.json").read_text())
    assert document["verdict"] == ["terrain_variation"]
    assert document["correction"]["variable"] == "travel"
    assert document["parameters"] == {}
    (effect,) = read_model_file(tmp_path / "model.toml").effects
    assert isinstance(effect, Curve)
    assert "These runs show terrain_variation, in another form" in model_toml(found)
    assert verdict(found).startswith("These runs show terrain_variation (")
    (said,) = [each for each in paragraphs(found) if each.startswith("With terrain_variation")]
    assert "while its curve was found" in said


def curve(stage: str, variable: str, values=BUMP, left: float = 1.0) -> Correction:
    """That leaves so many of twenty noise floors."""
    knots = np.linspace(0.0, 1.0, len(values)).tolist()
    effect = with_values(correction_class(stage, variable, knots), list(values))
    gap = {"z": Gap(20.0, left, 1.0, 1.0, (0.0, 1.0))}
    return Correction(effect, 1.0, SelectedEffects((effect,), np.zeros(1), [], gap))


def test_a_curve_means_an_effect_where_that_is_what_the_effect_is():
    assert equivalent_effect(curve("zeta", "travel")) == "terrain_variation"
    assert equivalent_effect(curve("height", "travel")) == "surface_profile"
    for stage, variable in (("zeta", "turning"), ("zeta", "time"), ("force_x", "travel")):
        assert equivalent_effect(curve(stage, variable)) is None


def test_it_must_explain_as_much_as_unknown_is_taken_to():
    assert equivalent_effect(curve("zeta", "travel", left=2.9)) == "terrain_variation"
    assert equivalent_effect(curve("zeta", "travel", left=3.1)) is None


def test_the_thresholds_of_a_place_can_be_varied():
    half = curve("zeta", "travel", left=8.0)
    assert equivalent_effect(half) is None
    assert equivalent_effect(half, UnknownEffectSettings(max_floors=8.0)) == "terrain_variation"
    falling = curve("zeta", "travel", (0.05, 0.03, 0.01, 0.0, -0.01))
    assert equivalent_effect(falling, UnknownEffectSettings(min_return=0.0)) is not None


def test_what_only_falls_may_be_wear():
    falling = (0.05, 0.03, 0.01, 0.0, -0.01)
    assert equivalent_effect(curve("zeta", "travel", falling)) is None
    back = (*falling[:-1], DEFAULT_UNKNOWN_EFFECT.min_return * 0.05 + 0.003)
    assert equivalent_effect(curve("zeta", "travel", back)) == "terrain_variation"


def test_a_leap_on_the_way_is_of_a_place_and_one_at_the_start_may_not_be():
    leap = (0.0, 0.001, 0.002, 0.003, 0.0, 0.05, 0.051, 0.052, 0.053)
    assert equivalent_effect(curve("zeta", "travel", leap)) == "terrain_variation"
    settling = (0.05, 0.01, 0.0, -0.001, -0.002, -0.003, -0.004, -0.005, -0.006)
    assert equivalent_effect(curve("zeta", "travel", settling)) is None


def test_it_must_be_told_from_curves_over_other_things():
    place, follows = curve("zeta", "travel"), {"travel": 0.95, "time": 0.5}
    found = match_listed_effect([place, curve("zeta", "vx", left=1.5)], follows)
    assert found is not None
    assert found.listed_effect == "terrain_variation"
    # Way and turning are one where slip is; anything else must leave clearly more.
    assert match_listed_effect([place, curve("zeta", "turning", left=0.9)], follows) is not None
    assert match_listed_effect([place, curve("zeta", "turning", left=0.7)], follows) is None
    assert match_listed_effect([place, curve("zeta", "vx", left=1.1)], follows) is None
    # Another curve over the way is no rival, whatever it looks like.
    wear = curve("zeta", "travel", (0.05, 0.03, 0.01, 0.0, -0.01), left=1.1)
    assert match_listed_effect([place, wear], follows) is not None
    # Runs of one profile do not tell places from moments.
    assert match_listed_effect([place], follows | {"time": 0.94}) is None
    assert match_listed_effect([curve("zeta", "turning")], follows) is None


def test_what_was_unknown_goes_to_the_effect():
    share = {("none",): 0.1, ("unknown",): 0.6, ("loosening",): 0.1, ("terrain_variation",): 0.2}
    moved = reassign_unknown(share, "terrain_variation")
    assert weight_by_name(moved)["terrain_variation"] == pytest.approx(0.8)
    assert moved["unknown",] == 0
    del share["terrain_variation",]
    assert reassign_unknown(share, "terrain_variation")["terrain_variation",] == 0.6
