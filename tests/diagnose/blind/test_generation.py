"""Blind sets: the plant that makes them, and that lots are settled by their seed."""

import dataclasses

import numpy as np
import pytest

from diagnose.blind.answers.answer import runs_of
from diagnose.blind.generation import generate as make
from diagnose.blind.generation import random_mechanisms as recipe
from diagnose.blind.generation.effect_size import FLOORS, EffectSizeProbe
from diagnose.blind.generation.random_mechanisms import (
    CATALOGUE,
    STRANGERS,
    UNKNOWN,
    draw_mechanism,
    draw_unlisted,
)
from diagnose.blind.plant import plant
from diagnose.blind.plant.run_plan import PlannedRun, draw_fresh_runs, draw_nine_runs
from drftjax.common.errors import InputError
from drftjax.effects.catalogue import OURS, reported_name
from drftjax.runlog.hdf5.api import read_run, write_run
from drftjax.setups.setup import CommandSetUp, SetUp
from drftjax.setups.simulated_run import simulated_run

# Slow enough for steps of a millisecond.
SHORT = PlannedRun.held(12.0, 1.0, 1.0, 1.0, rest=0.5, end=0.5)
# Plates of 2.5 and 4 mm differ by about 0.1 mm in depth and 1 mm in travel over one such run.
PLATES_Z, PLATES_X = 2e-4, 2e-3
# A strength is found when its gap is within a third of what was asked for.
FOUND = 0.34
# Programs that differ by what does nothing round in the same places, or nearly.
NOTHING = 1e-12
# What half a per cent of zeta makes of the sinkage is in proportion, but for that share of itself.
BENT = 5e-3
# 200,000 numbers, of which a tenth lasts for some hundreds, tell their spread to a few per mille,
# and the product of two far apart to as much.
SPREAD, LASTING = 0.005, 0.003
# Readings of centimetres are whole micrometres, but for doubles that are rounded to 1e-17 m.
COUNTED = 1e-10


def test_plant_without_mechanisms_is_the_simulator_but_for_its_plates():
    run = plant.run_plant((), SHORT, 0.78)
    time = run.time
    setup = SetUp(command=CommandSetUp(time.tolist(), SHORT.omega(time).tolist()))
    setup.terrain.zeta = 0.78
    setup.start.sinkage = float(-run.z[0])
    setup.integrator.method = "held pace"
    setup.integrator.step = 1e-3
    plain = simulated_run(setup).measured
    assert plain.x is not None
    assert plain.z is not None
    assert np.abs(plain.z - run.z).max() < PLATES_Z
    assert np.abs(plain.x - run.x).max() < PLATES_X


def test_mechanisms_of_strength_zero_change_nothing():
    bare = plant.run_plant((), SHORT, 0.78, ())
    held = plant.run_plant((), SHORT, 0.78, ("sand", "rig"))
    np.testing.assert_allclose(held.z, bare.z, rtol=0, atol=NOTHING)
    np.testing.assert_allclose(held.x, bare.x, rtol=0, atol=NOTHING)


def test_every_effect_of_the_catalogue_can_be_drawn():
    ours = {reported_name(each.about.name): each.about.stage for each in OURS}
    drawable = {name: stage for stage, names in CATALOGUE.items() for name in names}
    assert drawable == ours


def test_eight_kinds_and_more_are_outside_the_catalogue():
    random = np.random.default_rng(0)
    assert len(STRANGERS) >= 8
    assert not set(STRANGERS) & {each.about.name for each in OURS}
    assert {draw_unlisted(kind, random).name for kind in STRANGERS} == {UNKNOWN}


def test_forms_are_drawn_anew():
    random = np.random.default_rng(0)
    forms = [draw_mechanism("loosening", random).form for _ in range(3)]
    assert len({form["decay"] for form in forms}) == 3


def test_a_strength_is_found_for_the_gap_that_is_wanted():
    probe = EffectSizeProbe.of([SHORT], 0.78, ())
    for name, floors in (("sinkage_gain", 4.0), ("speed_gain", 2.0)):
        _, gap = probe.strength(draw_mechanism(name, np.random.default_rng(1)), floors)
        assert gap.floors == pytest.approx(floors, rel=FOUND)


def test_what_zeta_explains_is_no_gap():
    probe = EffectSizeProbe.of([SHORT], 0.78, ())
    nudged = dataclasses.replace(probe, zeta=0.78 * 1.005)
    gap = nudged.gap([])
    assert gap.z > FLOORS["z"]
    assert gap.z_left < BENT * gap.z


def test_shares_of_kinds_are_those_that_are_wanted(tmp_path):
    drawn = make.planned_faults(make.GenerationRequest(tmp_path, 200, seed=3))
    assert sum(not each for each in drawn) == 24
    assert sum(bool(each) and each[0] in STRANGERS for each in drawn) == 24
    assert sum(len(each) == 2 for each in drawn) == 32
    named = {name for each in drawn for name in each}
    assert named >= {name for names in CATALOGUE.values() for name in names}


def test_sets_of_one_kind_are_all_of_it(tmp_path):
    drawn = {
        kind: make.planned_faults(make.GenerationRequest(tmp_path, 20, 3, wrong=kind))
        for kind in make.WRONG[1:]
    }
    assert [len(each) for each in drawn.values()] == [20] * 4
    assert not any(drawn["none"])
    assert all(len(each) == 1 and each[0] not in STRANGERS for each in drawn["one"])
    assert all(len({recipe.stage_of(name) for name in each}) == 2 for each in drawn["pair"])
    assert all(len(each) == 1 and each[0] in STRANGERS for each in drawn["unknown"])
    with pytest.raises(InputError, match="what is wrong is 'two', must be one of mixed, none,"):
        make.GenerationRequest(tmp_path, 20, 3, wrong="two")


def test_protocols_fit_the_rig():
    random = np.random.default_rng(0)
    for _ in range(50):
        for each in (*draw_nine_runs(random), *draw_fresh_runs(random)):
            # At the shortest half a second at rest, two ramps and a few seconds at one speed.
            assert 7.9 < each.duration <= plant.LONGEST
            assert each.duration / (plant.EVERY * each.steady_step() / 2) <= plant.ROWS


def test_noise_is_white_and_lasting():
    drawn = make.add_noise(np.random.default_rng(0), 200_000, 1.0)
    assert drawn.std() == pytest.approx(np.sqrt(1 + make.LASTING**2), rel=SPREAD)
    later = round(make.LASTS / plant.ROW)
    lasting = np.mean(drawn[later:] * drawn[:-later])
    assert lasting == pytest.approx(make.LASTING**2 * np.exp(-1), abs=LASTING)


@pytest.fixture
def short(monkeypatch):
    """Runs of four seconds in place of the practice's."""
    monkeypatch.setattr(make, "PRACTICE", (SHORT,) * 9)
    monkeypatch.setattr(make, "draw_nine_runs", lambda random: (SHORT,) * 9)
    monkeypatch.setattr(
        make, "TELLING", (dataclasses.replace(SHORT, speed=tuple(-v for v in SHORT.speed)),) * 9
    )
    monkeypatch.setattr(make, "draw_fresh_runs", lambda random: (SHORT,) * 3)


def test_sets_are_settled_by_their_seed(short, tmp_path):
    folders = [tmp_path / name for name in ("one", "two")]
    labels = []
    for folder in folders:
        order = make.GenerationRequest(folder, 20, seed=4, protocol="practice")
        labels.append(make.make_set(order, 7, ("travel_gain",)))
    assert labels[0] == labels[1]
    assert labels[0]["effects"] == ["travel_gain"]
    one, two = (sorted(folder.rglob("*.h5")) for folder in folders)
    assert [each.name for each in one] == [f"fresh_{each}.h5" for each in "abc"] + [
        f"run_{each}.h5" for each in "abcdefghi"
    ]
    assert [each.read_bytes() for each in one] == [each.read_bytes() for each in two]
    other = make.make_set(
        make.GenerationRequest(tmp_path / "three", 20, seed=5, protocol="practice"),
        7,
        ("travel_gain",),
    )
    assert other["zeta"] != labels[0]["zeta"]


def test_a_run_looks_like_a_rig_s(short, tmp_path):
    order = make.GenerationRequest(tmp_path, 20, seed=4, protocol="practice")
    assert make.make_set(order, 0, ())["effects"] == []
    run = read_run(tmp_path / "set_01" / "run_a.h5")
    assert (run.source, run.title, run.created) == ("virtual rig", "single-wheel run", None)
    assert set(run.measured.channels()) == {"x", "z"}
    assert np.diff(run.measured.time) == pytest.approx(0.01)
    assert run.measured.z is not None
    assert 1e6 * run.measured.z == pytest.approx(np.round(1e6 * run.measured.z), abs=COUNTED)
    assert run.setup.sinkage_static == pytest.approx(-run.measured.z[:50].mean())
    assert run.setup.scaling_factor_initial == make.BELIEVED_ZETA


def test_a_set_that_is_interrupted_is_none(short, tmp_path, monkeypatch):
    order = make.GenerationRequest(tmp_path, 20, seed=4, protocol="practice")
    written = []

    def interrupted(path, log):
        if len(written) == 3:
            raise KeyboardInterrupt
        written.append(path)
        write_run(path, log)

    monkeypatch.setattr(make, "write_run", interrupted)
    with pytest.raises(KeyboardInterrupt):
        make.make_set(order, 0, ())
    assert len(written) == 3
    assert not list(tmp_path.iterdir())


def test_a_set_on_its_way_is_not_answered(tmp_path):
    for name in ("set_01", ".set_02"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "run_a.h5").write_bytes(b"")
    assert list(runs_of(tmp_path)) == ["set_01"]


def test_telling_runs_are_of_the_same_rigs(short, tmp_path):
    labels = {}
    for protocol in ("mixed", "telling"):
        order = make.GenerationRequest(tmp_path / protocol, 20, seed=4, protocol=protocol)
        labels[protocol] = make.make_set(order, 7, ("travel_gain",))
        assert labels[protocol].pop("protocol") in (protocol, "practice", "random")
    assert labels["mixed"] == labels["telling"]
    forward, backward = (read_run(tmp_path / p / "set_08" / "run_a.h5") for p in labels)
    assert forward.measured.x[-1] > 0 > backward.measured.x[-1]
    fresh = [read_run(tmp_path / p / "set_08" / "fresh" / "fresh_a.h5") for p in labels]
    assert np.array_equal(fresh[0].command.omega, fresh[1].command.omega)
