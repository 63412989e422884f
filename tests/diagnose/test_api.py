"""`drftjax.diagnose` and `drftjax.evaluate`: runs in; a verdict, summaries and figures out."""

import dataclasses
import subprocess
import sys
from typing import ClassVar

import jax
import numpy as np
import pytest
from jaxtyping import Array, Float
from matplotlib.figure import Figure

import drftjax
from diagnose import api as interface
from diagnose.gap.cross_validation import at_mean_sinkage
from diagnose.report.model_writer import model_toml
from diagnose.report.text import run_rows
from drftjax.common.errors import InputError, RunError
from drftjax.effects.base import EffectInfo, MemorylessSurface, strength
from drftjax.effects.sensor import SinkageDrift, TravelGain
from drftjax.effects.surface import SurfaceSlope
from drftjax.recorded.matched_zeta import ZetaMatchSettings
from drftjax.runlog.hdf5.api import write_run
from drftjax.setups.from_run import setup_from_run
from drftjax.setups.setup import read_setup
from drftjax.setups.terrain_setup import ZetaKnots
from tests.helpers.rig_datasets import PROFILES, WITHOUT_NEXT_RUN
from tests.helpers.synthetic_runs import recorded, setup_of

SLOPE = 0.02
BRACKETS = "sand [bold]x"
# 20 um of noise, and half as much for the effect's numbers [m].
LEFT = 30e-6
# What the fit makes of a slope over half a metre of a few runs, each to 20 um: some per mille.
TOLD = 0.005
# The tuner's dead band is 0.1 mm, and a speeding wheel is met late [m].
TUNED = 0.3e-3
# Programs compiled apart sum in another order, which a search's steps carry on.
ROUNDING = 1e-6
# A scale that drifts so fast reads 0.2 m by the end of a run of five seconds, more than the 150 mm
# that plates reach to, and less by the end of one of four [m/s].
DRIFT = 0.06
# The table has four places.
ROUNDED = 5.1e-5


class Tilt(MemorylessSurface):
    """A slope by a name that no catalogue has."""

    about: ClassVar = EffectInfo("tilt", "terrain", "h = slope x", "the bed is tilted")
    slope: Float[Array, ""] = strength("-", 0.01, "rise of the surface along x")

    def height(self, axle, ahead, memory):
        return self.slope * (axle + ahead)


class Shifted(Tilt):
    """Acts where its strength is zero: no effect."""

    about: ClassVar = EffectInfo("shifted", "terrain", "h = 1 mm + slope x", "the bed lies higher")

    def height(self, axle, ahead, memory):
        return 1e-3 + super().height(axle, ahead, memory)


class Namesake(Tilt):
    """An effect by the name of one of the list."""

    about: ClassVar = EffectInfo("surface_slope", "terrain", "h = slope x", "the bed is tilted")


@pytest.fixture(scope="module")
def runs():
    """Three runs on a slope, by name."""
    found = {}
    for number, (profile, zeta) in enumerate(zip(PROFILES, (0.75, 0.757, 0.745), strict=True)):
        setup = setup_of(profile, zeta)
        # The plates with which a run log is simulated again.
        setup.wheel.plate_size = read_setup("data/paper.toml").wheel.plate_size
        setup.effects = [{"name": "surface_slope", "slope": SLOPE}]
        found[f"{BRACKETS}{number}"] = recorded(setup, seed=number, rate=100.0)
    return found


@pytest.fixture(scope="module")
def found(runs):
    """In a program of single precision."""
    with jax.enable_x64(False):
        return drftjax.diagnose(runs, ["surface_slope", TravelGain])


def test_importing_diagnose_leaves_jax_alone():
    code = "import sys, drftjax; assert 'jax' not in sys.modules; drftjax.diagnose; import jax"
    subprocess.run([sys.executable, "-c", code], check=True)
    with pytest.raises(AttributeError, match="diagnos_"):
        _ = drftjax.diagnos_


def test_the_answer_is_in_double_precision_whatever_the_program_around_it(found, runs):
    effects = "surface_slope", TravelGain
    double = drftjax.diagnose(list(runs.values()), effects, settings=WITHOUT_NEXT_RUN)
    assert found.verdict == double.verdict == ("surface_slope",)
    for channel, gap in double.gap.items():
        assert found.gap[channel].before == pytest.approx(gap.before, rel=ROUNDING)
        assert found.gap[channel].after == pytest.approx(gap.after, rel=ROUNDING)


def test_an_effect_of_the_users_own_is_told_as_any_other(runs):
    # Installed nowhere.
    found = drftjax.diagnose(runs, [Tilt], settings=WITHOUT_NEXT_RUN)
    assert found.verdict == ("tilt",)
    assert found.summary().startswith("These runs show tilt (the bed is tilted)")


def test_an_effect_that_is_not_null_at_zero_or_takes_a_name_is_refused(runs):
    with pytest.raises(InputError, match=r"'shifted' .*acts where all its strengths are zero"):
        drftjax.diagnose(runs, [Shifted])
    with pytest.raises(InputError, match=r"'surface_slope' .*has the name of another"):
        drftjax.diagnose(runs, [Namesake])


def test_the_zeta_of_the_run_table_meets_each_runs_mean_sinkage(found):
    dataset, z = found.dataset, found.dataset.channels.index("z")
    for number, row in enumerate(run_rows(found)):
        zeta = float(row[3])
        each, near = found.selected.matches[number], dataset.runs[number].setup.terrain.zeta
        assert each.matched
        assert zeta == pytest.approx(near * np.exp(each.log_zeta), abs=ROUNDED)
        assert abs(each.residual[z].mean()) < ZetaMatchSettings().max_miss


def test_it_tells_and_shows_itself(found):
    text = found.summary()
    assert text.startswith("These runs show surface_slope")
    assert "noise floor" in text
    assert f"{BRACKETS}0" in text
    page = found._repr_html_()
    assert "surface_slope" in page
    assert f"{BRACKETS}0" in page
    assert isinstance(found.plot(), Figure)


def test_a_model_file_and_the_diagnosis_itself_are_one_model(found, runs, tmp_path):
    written = found.write(tmp_path / "out")
    assert [each.name for each in written] == ["diagnosis.json", "model.toml", "report.html"]
    path = tmp_path / "fresh.h5"
    write_run(path, runs[f"{BRACKETS}1"])
    by_file = drftjax.evaluate(path, tmp_path / "out" / "model.toml")
    with jax.enable_x64(False):
        by_itself = drftjax.evaluate([runs[f"{BRACKETS}1"]], found)
    for channel, gap in by_file.gap.items():
        assert by_itself.gap[channel].after == pytest.approx(gap.after, rel=ROUNDING)
    assert by_file.gap["z"].after < LEFT < by_file.gap["z"].before
    (effect,) = by_file.effects
    assert effect.slope == pytest.approx(SLOPE, rel=TOLD)
    assert "with surface_slope" in by_file.summary()
    assert "surface_slope" in by_file._repr_html_()


def test_the_tuner_hides_what_an_effect_with_its_numbers_explains(runs):
    with jax.enable_x64(False):
        evaluated = drftjax.evaluate(runs, [SurfaceSlope(slope=SLOPE)])
        # Fast enough a tuner that its slew limit does not show.
        tuned = evaluated.tuned(zeta_step=5e-3)
    assert evaluated.gap["z"].after < LEFT < evaluated.gap["z"].before
    for before, after in tuned:
        assert max(before.sinkage, after.sinkage) < TUNED
        assert before.range > 5 * after.range
        assert before.time.shape == before.zeta.shape
        assert np.ptp(before.zeta) == before.range
    # The longest of the runs lasts 5 s: the one tick is before the wheel sets off.
    with pytest.raises(InputError, match="no tick falls where the wheel moves"):
        evaluated.tuned(tick=5.0)


def test_files_that_cannot_be_used_are_in_the_notes(runs, tmp_path):
    write_run(tmp_path / "good.h5", next(iter(runs.values())))
    (tmp_path / "bad.h5").write_text("not a run log")
    found = drftjax.evaluate((tmp_path,), [])
    assert [each.name for each in found.dataset.runs] == ["good"]
    assert any(note.startswith("Left out: ") and "bad.h5" in note for note in found.notes)


def test_runs_without_sinkage_are_left_out_and_alone_refused(runs):
    kept, lacking = list(runs)[:2]
    blind = dataclasses.replace(runs[lacking].measured, z=None)
    given = {kept: runs[kept], lacking: dataclasses.replace(runs[lacking], measured=blind)}
    found = drftjax.evaluate(given, [])
    assert [each.name for each in found.dataset.runs] == [kept]
    assert f"Left out: {lacking}: has no z, so its sinkage is not known" in found.notes
    with pytest.raises(InputError, match="has no z"):
        drftjax.evaluate([given[lacking]], [])


def test_runs_that_no_zeta_follows_are_left_out_and_all_of_them_refused(runs, monkeypatch):
    """Whichever the search finds first."""
    lost = set(list(runs)[:2])

    @dataclasses.dataclass(frozen=True)
    class Found:
        names: list[str]
        notes: list[str]
        drive: object = None

    def search(dataset, effects, report, settings):
        names = [each.name for each in dataset.runs]
        for name in names:
            if name in lost:
                raise RunError(name, "no zeta lets the reference model follow its sinkage")
        return Found(names, ["A note."])

    monkeypatch.setattr(interface, "diagnose_dataset", search)
    told = []
    found = interface.diagnose_gathered(
        interface.gather_inputs(runs), (SurfaceSlope,), lambda stage: None, told.append
    )
    assert found.names == [name for name in runs if name not in lost]
    assert [each.removeprefix("left out: ") for each in told] == [
        each.removeprefix("Left out: ") for each in found.notes[1:]
    ]
    assert len(told) == 2
    lost |= set(runs)
    with pytest.raises(RunError, match="no zeta"):
        interface.diagnose_gathered(
            interface.gather_inputs(runs), (SurfaceSlope,), lambda stage: None, told.append
        )


def test_a_run_log_that_cannot_be_used_is_left_out(runs):
    name = next(iter(runs))
    measured = runs[name].measured
    given = {
        name: runs[name],
        "torque alone": dataclasses.replace(
            runs[name], measured=dataclasses.replace(measured, x=None, z=None, torque=measured.z)
        ),
        "downward": dataclasses.replace(
            runs[name], measured=dataclasses.replace(measured, z=-measured.z)
        ),
    }
    found = interface.gather_inputs(given)
    assert [each.name for each in found.runs] == [name]
    assert found.skipped["torque alone"].startswith("torque alone: nothing to compare")
    assert found.skipped["downward"].startswith("downward: measured z stands")
    with pytest.raises(InputError, match=r"torque alone: nothing to compare.*; downward: measured"):
        interface.gather_inputs({key: given[key] for key in ("torque alone", "downward")})


def test_a_set_up_that_somebody_wrote_is_not_replaced(found, tmp_path):
    (tmp_path / "model.toml").write_text("title = 'mine'\n")
    with pytest.raises(InputError, match="no earlier result"):
        found.write(tmp_path)
    assert [each.name for each in tmp_path.iterdir()] == ["model.toml"]


def test_a_zeta_that_changes_in_time_is_refused(runs):
    run = next(iter(runs.values()))
    setup = setup_from_run(run)
    setup.terrain.zeta = ZetaKnots([0.0, 2.0], [0.75, 0.76])
    with pytest.raises(InputError, match="changes in time"):
        drftjax.evaluate([(setup, run)], [])


@pytest.mark.parametrize(
    ("slope", "why"),
    [
        (1e7, r"0: by the model with the effects its z reaches [\d.e+]+ mm, must"),
        (1e200, r"0: its simulation by the model with the effects diverges"),
    ],
)
def test_a_model_that_throws_the_wheel_away_is_refused_by_run(runs, slope, why):
    name = next(iter(runs))
    with pytest.raises(InputError, match=why):
        drftjax.evaluate({name: runs[name]}, [SurfaceSlope(slope=slope)])


def test_a_run_that_the_model_throws_away_is_left_out_and_the_others_are_told(runs):
    *longer, shortest = runs
    found = drftjax.evaluate(runs, [SinkageDrift(rate=DRIFT)])
    assert [each.name for each in found.dataset.runs] == [shortest]
    assert len(found.before) == len(found.after) == 1
    said = [note for note in found.notes if note.startswith("Left out: ")]
    for name, why in zip(longer, said, strict=True):
        assert f"{name}: by the model with the effects its z reaches" in why


def test_a_run_whose_sinkage_no_zeta_meets_is_told(runs):
    name = next(iter(runs))
    deeper = dataclasses.replace(runs[name].measured, z=runs[name].measured.z - 0.1)
    found = drftjax.evaluate({name: dataclasses.replace(runs[name], measured=deeper)}, [])
    assert not found.before[0].matched
    said = f"{name}: no zeta was found at which the reference model matches its mean sinkage"
    assert [note for note in found.notes if note.startswith(said)]
    assert not any("with the effects" in note for note in found.notes)
    assert all(each.matched for each in drftjax.evaluate(runs, []).before)


def test_a_diagnosis_tells_the_runs_whose_sinkage_no_zeta_meets(runs, monkeypatch):
    def not_one(prediction, pool):
        found = at_mean_sinkage(prediction, pool)
        return [dataclasses.replace(each, matched=False) for each in found]

    monkeypatch.setattr("diagnose.pipeline.at_mean_sinkage", not_one)
    effects = "surface_slope", TravelGain
    found = drftjax.diagnose(runs, effects, settings=WITHOUT_NEXT_RUN)
    for name in runs:
        for model in ("the reference model", "the model with the effects"):
            said = f"{name}: no zeta was found at which {model} matches its mean sinkage"
            assert [note for note in found.notes if note.startswith(said)]


def test_effects_of_the_set_up_itself_are_told_in_the_model_file(found, monkeypatch):
    own = [{"name": "drawbar", "force": 3.0}]
    assert "had effects" not in model_toml(found)
    monkeypatch.setattr(found.dataset.runs[0].setup, "effects", own)
    assert "had effects, which are not in this file: drawbar." in model_toml(found)


def test_bad_input_is_one_sentence(runs):
    with pytest.raises(InputError, match="surface_slope"):
        drftjax.diagnose(runs, ["surface_slop"])
    with pytest.raises(InputError, match="no effect is named"):
        drftjax.diagnose(runs, [])
    with pytest.raises(InputError, match="a run is a file"):
        drftjax.evaluate(np.zeros(3), [])
    with pytest.raises(InputError, match="no run"):
        drftjax.diagnose({})
    with pytest.raises(InputError, match="names, or classes"):
        drftjax.diagnose(runs, [3])  # pyright: ignore[reportArgumentType]
    for model in (["surface_slope"], None):
        with pytest.raises(InputError, match="effects with their numbers"):
            drftjax.evaluate(runs, model)  # pyright: ignore[reportArgumentType]


def test_an_effect_that_the_wheel_cannot_have_is_no_candidate(runs):
    """A smooth wheel has no grousers to be shorter."""
    smooth = {}
    for name, log in runs.items():
        setup = setup_from_run(log)
        setup.wheel.shape = "plain"
        smooth[name] = setup, log
    effects = "grouser_height", "surface_slope"
    found = drftjax.diagnose(smooth, effects, settings=WITHOUT_NEXT_RUN)
    assert "surface_slope" in found.weights
    assert "grouser_height" not in found.weights
    with pytest.raises(InputError, match="none of the effects: grouser_height needs a wheel with"):
        drftjax.diagnose(smooth, ["grouser_height"])
