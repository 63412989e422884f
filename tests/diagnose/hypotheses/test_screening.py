"""The search: large strengths that no straight line leads to, and several forms of one effect."""

from types import SimpleNamespace
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diagnose.evaluation.model_reader import read_model_file
from diagnose.hypotheses.hypothesis import top_ranked
from diagnose.hypotheses.refinement import relinearize
from diagnose.hypotheses.screening import Screening, screen_effects
from diagnose.model.augmented_model import FreeField
from diagnose.pipeline import diagnose
from diagnose.report.model_writer import model_toml
from diagnose.run_pool import RunPool
from drftjax.effects.catalogue import reported_names
from drftjax.effects.drive import Backlash, SpeedGain, SpeedHarmonics, SpeedLag, SpeedRipple
from drftjax.effects.rig import HorizontalCoulomb
from drftjax.effects.sensor import SinkageGain
from drftjax.effects.surface import SurfaceBump, SurfaceProfile
from drftjax.effects.terrain import TerrainVariation, TerrainWave
from tests.helpers.rig_datasets import WITHOUT_NEXT_RUN, dataset_with

# A step of 2 ms at 0.3 rad/s.
ONE_STEP = 0.6e-3
# The runs' own noise is 20 um, and plates and steps leave a part of it more [m].
LEFT = 30e-6
# No close call, a tenth for all else together; and, of three short runs, less than half for it.
SURE, LIKELIER = 0.9, 0.5
# Three of a fit's own standard errors: of a wave's height 3e-4 and its length 1.4e-4 m; of a
# scale's error of 0.06 6e-4; of a bump's height 17 um, its place 0.35 mm and its width 0.31 mm; of
# a harmonic's order 0.007, and of each share of the speed up to 5e-4.
WAVE, LENGTH, GAIN = 0.006, 0.0027, 0.029
RISE, CENTRE, WIDTH = 0.026, 1.05e-3, 0.019
ORDER, SHARE = 0.0023, 1.6e-3
# Of the largest derivative: the last step, which follows the derivatives, moves the wheel by less
# than its noise, and where a grouser enters the sand that shows.
LAST_STEP = 0.02


def test_a_large_play_is_found_though_no_derivative_at_zero_shows_the_way(pool):
    # The wheel starts 0.9 s late at 0.5 rad/s: x is behind by 30 mm, a thousand times its noise.
    found = screen_effects(
        dataset_with({"name": "backlash", "play": 0.22}), (Backlash, SpeedLag), pool
    )
    best = found.singles[0]
    assert best.names == ("backlash",)
    assert best.coordinates[0] * best.model.free[0].scale == pytest.approx(0.22, abs=ONE_STEP)
    x = found.regressors.dataset.channels.index("x")
    for residual in best.residual:
        assert np.sqrt(np.mean(residual[x] ** 2)) < LEFT


def test_another_form_of_an_effect_goes_by_its_name(tmp_path):
    wave = {"name": "terrain_wave", "cosine": 0.0, "sine": 0.15, "length": 0.15}
    effects = TerrainVariation, TerrainWave
    found = diagnose(dataset_with(wave), effects, settings=WITHOUT_NEXT_RUN)
    assert found.chosen.names == ("terrain_wave",)
    assert found.verdict == ("terrain_variation",)
    assert found.weights["terrain_variation"] > SURE
    assert "terrain_wave" not in found.weights
    numbers = found.parameters["terrain_variation"]
    assert numbers["length"].value == pytest.approx(0.15, rel=LENGTH)
    assert numbers["sine"].value == pytest.approx(0.15, rel=WAVE)
    # The model file holds the form itself, whose numbers the other does not have.
    model = tmp_path / "model.toml"
    model.write_text(model_toml(found))
    (wave,) = read_model_file(model).effects
    assert isinstance(wave, TerrainWave)
    assert wave.length == numbers["length"].value


def test_a_bump_goes_by_the_name_of_the_surface(pool):
    bump = {"name": "surface_bump", "rise": 0.002, "centre": 0.25, "width": 0.05}
    found = screen_effects(dataset_with(bump), (SurfaceProfile, SurfaceBump), pool)
    best = found.singles[0]
    # Numbers without a condition rest on these.
    for known, exact in zip(
        best.columns, relinearize(found.regressors, best, pool).columns, strict=True
    ):
        np.testing.assert_allclose(known, exact, atol=LAST_STEP * np.abs(exact).max())
    assert best.names == ("surface_bump",)
    assert reported_names(best.names) == ("surface_profile",)
    rise, centre, width = map(FreeField.value, best.model.free, best.coordinates)
    assert rise == pytest.approx(0.002, rel=RISE)
    assert centre == pytest.approx(0.25, abs=CENTRE)
    assert width == pytest.approx(0.05, rel=WIDTH)


def test_a_ripple_that_is_no_pure_sine_goes_by_its_name_and_numbers(pool):
    given = {"cosine": 0.1, "sine": 0.0, "cosine2": 0.0, "sine2": 0.04, "order": 9.0}
    dataset = dataset_with({"name": "speed_harmonics", **given})
    singles = screen_effects(dataset, (SpeedRipple, SpeedHarmonics, SpeedGain), pool).singles
    best = singles[0]
    assert best.names == ("speed_harmonics",)
    assert reported_names(best.names) == ("speed_ripple",)
    numbers = dict(zip(given, map(FreeField.value, best.model.free, best.coordinates), strict=True))
    assert numbers["order"] == pytest.approx(9.0, rel=ORDER)
    for name in ("cosine", "sine", "cosine2", "sine2"):
        assert numbers[name] == pytest.approx(given[name], abs=SHARE)
    # Both forms are one explanation, and take no other's place.
    assert {each.names for each in singles[:2]} == {("speed_harmonics",), ("speed_ripple",)}
    assert top_ranked(singles, 1) == [best]
    assert top_ranked(singles, 2) == list(singles)


def test_a_scale_that_read_the_static_sinkage_wrongly_too_is_found():
    # z starts where the scale says; a wheel that lies deeper or less deep travels otherwise.
    gain = {"name": "sinkage_gain", "gain": 0.06}
    dataset = dataset_with(gain, scale=1.06)
    found = diagnose(dataset, (SinkageGain, HorizontalCoulomb), settings=WITHOUT_NEXT_RUN)
    assert found.verdict == ("sinkage_gain",)
    assert found.weights["sinkage_gain"] > LIKELIER
    assert found.parameters["sinkage_gain"]["gain"].value == pytest.approx(0.06, rel=GAIN)


@pytest.mark.parametrize("double", [True, False])
def test_items_side_by_side_go_over_runs_themselves_in_the_same_precision(double):
    runs, items = range(5), range(20)
    with jax.enable_x64(double), RunPool() as pool:
        found = pool.map_outer(
            lambda item: pool.map(lambda run: jnp.asarray(float(item * run)), runs), items
        )
    assert [[float(each) for each in row] for row in found] == [
        [i * r for r in runs] for i in items
    ]
    kinds = {each.dtype.name for row in found for each in row}
    assert kinds == {"float64" if double else "float32"}


class _ToGain(Screening):
    """A screening in which a model that leaves noise alone has a log score of 100."""

    def best_score(self) -> float:
        return 100.0


@pytest.mark.parametrize(
    ("scores", "goes_on"),
    [
        # A pair that gains next to nothing: the third effect may show what it hides.
        ((40, 41), True),
        # Two more effects must gain 8 each together, or the last one alone.
        ((40, 41, 55), True),
        ((40, 49, 50), False),
        ((40, 41, 45), False),
        ((40, 55, 57, 60), False),
        ((40, 60, 61), True),
        ((40, 60, 61, 62), False),
        # A size of which nothing could be simulated says nothing.
        ((40, None, 57), True),
        ((40, None, 54), False),
    ],
)
def test_one_effect_that_gains_little_does_not_end_the_search(scores, goes_on):
    screening = _ToGain(cast(Any, None), cast(Any, None))
    by_size: Any = [[SimpleNamespace(score=each)] if each else [] for each in scores]
    assert screening.still_gains(by_size) == goes_on
