"""An effect that no list has: its signal, what it follows, and the correction offered for it."""

import dataclasses
import json
from pathlib import Path
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest

from diagnose.dataset import RigDataset
from diagnose.evaluation.evaluate import prediction_on
from diagnose.evaluation.model_reader import read_model_file
from diagnose.gap.selected_effects import SelectedEffects, best_selection
from diagnose.localization.localization import localization_sentence
from diagnose.pipeline import diagnose
from diagnose.report.model_writer import model_toml
from diagnose.report.page import page, write
from diagnose.report.text import paragraphs
from diagnose.result import Diagnosis
from diagnose.rig_runs import gather_runs
from drftjax.effects.base import AbstractZetaFactor, EffectInfo, Memory, StepContext, strength
from drftjax.effects.catalogue import catalogue
from drftjax.effects.correction import Curve
from drftjax.effects.serialization import entry_of
from drftjax.runlog.hdf5.api import read_run, write_run
from tests.helpers.drft_command import Drft
from tests.helpers.rig_datasets import CONDITIONS, run_with

# log zeta at 30 mm of sinkage over that at the surface.
RISE, DEPTH = 0.1, 0.03
# The curve's rise from its first knot to its last is found within this share; six straight pieces
# stand for a square, and runs leave the outermost knots to few samples.
RISE_ERR = 0.15
# Another condition, as `CONDITIONS` are.
FRESH = (1.0, 22.0, 0.754)
# A promise is kept within this.
KEPT = 0.1
# All but a tenth: of what a signal follows, of a gap, of what a stage has a part in.
NEARLY_ALL = 0.9
# The mean zeta of runs that scatter by half a per cent is not quite a run's own: 0.1 mm [m].
MEAN_ZETA = 0.1e-3


class Packing(AbstractZetaFactor):
    """zeta rises with the square of the sinkage."""

    about: ClassVar = EffectInfo(
        "packing", "terrain", "ζ = ζ exp(rise H²)", "sand that packs with depth"
    )
    rise: float = strength("-", 0.1, "log zeta gained at 30 mm")

    def begin(self) -> Memory:
        return ()

    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        return ()

    def factor(self, moment: StepContext, memory: Memory):
        return jnp.exp(self.rise * (moment.position[1] / DEPTH) ** 2)


@pytest.fixture(scope="module")
def packing():
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(catalogue(), "packing", Packing)
        yield


def written(folder: Path, name: str, speed: float, mass: float, zeta: float, seed: int) -> Path:
    """A run of a rig whose sand packs, as its log."""
    run = run_with({"name": "packing", "rise": RISE}, speed, mass, zeta, seed)
    write_run(folder / f"{name}.h5", run)
    return folder / f"{name}.h5"


@pytest.fixture(scope="module")
def found(packing, tmp_path_factory) -> Diagnosis:
    folder = tmp_path_factory.mktemp("packing")
    for number, each in enumerate(CONDITIONS):
        written(folder, f"run_{number}", *each, seed=number)
    return diagnose(RigDataset.of(gather_runs([folder]).runs), ())


@pytest.fixture(scope="module")
def files(found, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("diagnosed")
    write(found, folder)
    return folder


def leaving(found: Diagnosis, share: float) -> SelectedEffects:
    """As the correction, but such a share of the gap is left with it."""
    gap = {c: dataclasses.replace(g, after=share * g.before) for c, g in found.gap.items()}
    return dataclasses.replace(found.selected, gap=gap)


def test_the_simplest_signal_is_a_zeta_that_follows_the_sinkage(found):
    assert found.verdict == ("unknown",)
    assert found.unknown_effect.disturbance.name == "zeta"
    (first, share), *_ = found.unknown_effect.dependence
    assert first == "sinkage"
    assert share > NEARLY_ALL
    assert any("one of zeta" in note and "it follows sinkage" in note for note in found.notes)


def test_the_correction_is_the_curve_of_the_rig(found):
    effect = found.correction.effect
    assert (effect.stage, effect.variable) == ("zeta", "sinkage")
    knots, values = np.asarray(effect.knots), np.asarray(effect.values())
    truth = RISE * (knots / DEPTH) ** 2
    # A level is zeta's own, of every run.
    assert values[-1] - values[0] == pytest.approx(truth[-1] - truth[0], rel=RISE_ERR)
    steps = np.diff(values) / np.diff(knots)
    # It bends: the square of a sinkage from 25 to 36 mm is steeper by a third at its end.
    assert steps[-1] > 1.3 * steps[0]


def test_it_closes_the_gap_of_runs_left_out(found):
    z = found.gap["z"]
    assert z.before > 3 * z.floor
    assert z.shrinkage > NEARLY_ALL
    (said,) = [each for each in paragraphs(found) if each.startswith("Offered in its place: ")]
    assert "a correction of zeta over sinkage" in said
    assert "on held-out runs" in said


def test_the_json_holds_it_as_documented(found, files):
    document = json.loads((files / "diagnosis.json").read_text())["correction"]
    keys = {"stage", "variable", "unit", "knots", "values", "explained", "gap"}
    assert set(document) == keys
    assert (document["stage"], document["variable"], document["unit"]) == ("zeta", "sinkage", "-")
    assert len(document["knots"]) == len(document["values"])
    assert document["gap"]["z"]["shrinkage"] > NEARLY_ALL


def test_the_page_shows_the_signal_against_the_variables(files):
    text = (files / "report.html").read_text()
    assert "The simplest unknown signal against each state variable" in text
    assert "a correction of zeta over sinkage" in text
    assert "<th>sinkage [m]</th><th>zeta [-]</th>" in text


def test_the_model_file_simulates_and_closes_the_gap_of_a_fresh_run(
    found, files, packing, monkeypatch, capsys, tmp_path
):
    drft = Drft(monkeypatch, capsys)
    (effect,) = read_model_file(files / "model.toml").effects
    assert isinstance(effect, Curve)
    assert entry_of(effect) == entry_of(found.correction.effect)
    assert drft("simulate", files / "model.toml", "-o", tmp_path / "again.h5").code == 0
    again = read_run(tmp_path / "again.h5").measured
    first = found.dataset.recording(0)[found.dataset.channels.index("z")]
    then = np.interp(found.dataset.logged_time(0), again.time, again.z)
    assert np.abs(then - first).max() < MEAN_ZETA
    fresh = written(tmp_path, "fresh", *FRESH, seed=9)
    report = tmp_path / "evaluation.json"
    answer = drft("evaluate", fresh, "--model", files / "model.toml", "--json", report)
    assert answer.code == 0, answer
    assert "after: with correction" in answer.out
    z = json.loads(report.read_text())["gap"]["z"]
    assert z["after"] < (1 - NEARLY_ALL) * z["before"]


def test_the_model_file_says_what_the_curve_leaves(found, files):
    head = (files / "model.toml").read_text()
    assert "No effect that is known explains these runs. A curve fitted to them changes" in head
    z = found.gap["z"]
    assert f"z from {z.before / z.floor:.1f} to {z.after / z.floor:.1f}" in head


def test_what_does_not_help_is_not_offered_and_the_page_says_so(found):
    useless = leaving(found, 1.0)
    reference = dataclasses.replace(useless, effects=())
    assert best_selection([useless], reference) is reference
    tried = dataclasses.replace(found.unknown_effect.best_correction, selection=useless)
    signal = dataclasses.replace(found.unknown_effect, best_correction=tried)
    (_, said) = signal.sentences(offered=False)
    left = f"{useless.before:.1f} of {useless.before:.1f} noise floors are left"
    assert "over sinkage was tried and is not offered: " + left in said
    other = dataclasses.replace(found, selected=reference, unknown_effect=signal)
    assert other.document()["correction"] is None
    assert "is not offered" in page(other)
    assert "Nothing tried in its place shrinks the gap" in " ".join(paragraphs(other))
    assert "shrinks the gap of these runs: this is the reference model" in model_toml(other)


def test_what_leaves_least_is_added_be_it_known_or_a_curve(found):
    tried = [leaving(found, share) for share in (0.5, 0.2, 0.89)]
    reference = dataclasses.replace(leaving(found, 1.0), effects=())
    assert best_selection(tried, reference) is tried[1]
    # A tenth of the gap at least.
    assert best_selection([leaving(found, 0.91)], reference) is reference


def test_what_makes_a_channel_worse_is_not_added(found):
    """Most of the gap is in z: what is won there may outweigh what is lost in x, and must not."""
    reference = dataclasses.replace(leaving(found, 1.0), effects=())
    best = leaving(found, 0.2)
    x = best.gap["x"]
    pays = {**best.gap, "x": dataclasses.replace(x, after=2 * max(x.before, x.floor))}
    costly = dataclasses.replace(best, gap=pays)
    # Else it would be left out for that.
    assert costly.remaining < 0.9 * costly.before
    assert best_selection([costly], reference) is reference
    assert best_selection([best, costly], reference) is best


def test_promise_is_of_what_the_model_file_holds(found, files, packing, tmp_path):
    document = json.loads((files / "diagnosis.json").read_text())
    assert document["gap"] == document["correction"]["gap"]
    fresh = prediction_on(found, [written(tmp_path, "fresh", *FRESH, seed=9)])
    assert fresh["z"].shrinkage == pytest.approx(document["gap"]["z"]["shrinkage"], abs=KEPT)


def test_what_follows_nothing_is_said_to(found):
    nothing = dataclasses.replace(
        found.unknown_effect, dependence=[("travel", 0.2)], best_correction=None
    )
    (said,) = nothing.sentences(offered=False)
    assert "it follows none of the variables known" in said
    fast = dataclasses.replace(nothing, fast_share=0.8)
    assert fast.sentences(offered=False)[1].startswith("80% of the gap is faster than such")


def test_slow_gap_is_not_too_fast_for_a_signal(found):
    by_hertz = {each.label: each.share for each in found.localization if each.axis == "frequency"}
    over = by_hertz["1 to 3 Hz"] + by_hertz["3 to 10 Hz"] + by_hertz["over 10 Hz"]
    assert found.unknown_effect.fast_share == pytest.approx(over)
    assert 0 < over < 0.5


def test_shares_of_stages_have_intervals_from_drawing_runs_anew(found):
    stages = {each.label.split(":")[0]: each for each in found.localization if each.axis == "stage"}
    for each in stages.values():
        low, high = each.interval
        assert 0 <= low <= each.share <= high <= 1
    low, high = stages["zeta"].interval
    assert NEARLY_ALL < low < high
    # A reading of x has nothing to do with it, and the runs say so.
    assert stages["reading x"].interval[1] < 1 - NEARLY_ALL
    assert "stage" not in localization_sentence(found.localization)
