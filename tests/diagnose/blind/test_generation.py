"""Generation of blind sets: the plant, the random mechanisms, and that the seed decides all."""

import dataclasses

import numpy as np
import pytest

from diagnose.blind.answers.answer import runs_of
from diagnose.blind.generation import recording
from diagnose.blind.generation.effect_size import EffectSizeProbe
from diagnose.blind.generation.generate import make_set, planned_faults
from diagnose.blind.generation.kinds import single
from diagnose.blind.generation.random_mechanisms import (
    CATALOGUE,
    UNKNOWN,
    UNLISTED,
    draw_mechanism,
    draw_unlisted,
    stage_of,
)
from diagnose.blind.generation.recording import add_noise
from diagnose.blind.generation.settings import (
    DEFAULT_GENERATION,
    DEFAULT_NOISE,
    FAULT_KINDS,
    GenerationRequest,
    GenerationSettings,
    NoiseSettings,
    RigSettings,
)
from diagnose.blind.plant.plant import COMMON_GROUPS, DEFAULT_PLANT, run_plant
from diagnose.blind.plant.run_plan import PlannedRun, draw_fresh_runs, draw_nine_runs
from drftjax.common.errors import InputError
from drftjax.effects.catalogue import OURS, reported_name
from drftjax.effects.drive import CarriageGain
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
SPREAD, CORRELATED = 0.005, 0.003
# Readings of centimetres are whole micrometres, but for doubles that are rounded to 1e-17 m.
COUNTED = 1e-10


def test_plant_without_mechanisms_is_the_simulator_but_for_its_plates():
    run = run_plant((), SHORT, 0.78)
    time = run.time
    setup = SetUp(command=CommandSetUp(time.tolist(), SHORT.omega(time).tolist()))
    setup.terrain.zeta = 0.78
    setup.start.sinkage = float(-run.z[0])
    setup.integrator.step = 1e-3
    plain = simulated_run(setup).measured
    assert plain.x is not None
    assert plain.z is not None
    assert np.abs(plain.z - run.z).max() < PLATES_Z
    assert np.abs(plain.x - run.x).max() < PLATES_X


def test_mechanisms_of_strength_zero_change_nothing():
    bare = run_plant((), SHORT, 0.78, ())
    held = run_plant((), SHORT, 0.78, (*COMMON_GROUPS, "shadow"))
    np.testing.assert_allclose(held.z, bare.z, rtol=0, atol=NOTHING)
    np.testing.assert_allclose(held.x, bare.x, rtol=0, atol=NOTHING)


def test_every_effect_that_a_diagnosis_looks_for_can_be_drawn():
    """Of a free carriage whose travel and sinkage are read."""
    ours = {
        reported_name(each.about.name): each.about.stage
        for each in OURS
        if each.about.hypothesis and not each.about.channels and each is not CarriageGain
    }
    drawable = {name: stage for stage, names in CATALOGUE.items() for name in names}
    assert ours.items() <= drawable.items()


def test_eight_kinds_and_more_are_outside_the_catalogue():
    random = np.random.default_rng(0)
    assert len(UNLISTED) >= 8
    assert not set(UNLISTED) & {each.about.name for each in OURS}
    assert {draw_unlisted(kind, random).name for kind in UNLISTED} == {UNKNOWN}


def test_every_draw_has_a_form_of_its_own():
    random = np.random.default_rng(0)
    forms = [draw_mechanism("loosening", random).form for _ in range(3)]
    assert len({form["decay"] for form in forms}) == 3


def test_a_strength_is_found_for_the_gap_that_is_wanted():
    probe = EffectSizeProbe.of([SHORT], 0.78, ())
    for name, floors in (("sinkage_gain", 4.0), ("speed_gain", 2.0)):
        _, size = probe.find_strength(draw_mechanism(name, np.random.default_rng(1)), floors)
        assert size.floors == pytest.approx(floors, rel=FOUND)


def test_what_zeta_explains_is_no_gap():
    probe = EffectSizeProbe.of([SHORT], 0.78, ())
    nudged = dataclasses.replace(probe, zeta=0.78 * 1.005)
    size = nudged.size([])
    assert size.total["z"] > size.noise_floors["z"]
    assert size.beyond_zeta["z"] < BENT * size.total["z"]


def test_shares_of_kinds_are_those_that_are_wanted(tmp_path):
    drawn = planned_faults(GenerationRequest(tmp_path, 200, seed=3))
    assert sum(not each for each in drawn) == 24
    assert sum(bool(each) and each[0] in UNLISTED for each in drawn) == 24
    assert sum(len(each) == 2 for each in drawn) == 32
    named = {name for each in drawn for name in each}
    assert named >= {name for names in CATALOGUE.values() for name in names}


def test_sets_of_one_kind_are_all_of_it(tmp_path):
    drawn = {
        kind: planned_faults(GenerationRequest(tmp_path, 20, 3, wrong=kind))
        for kind in FAULT_KINDS[1:]
    }
    assert [len(each) for each in drawn.values()] == [20] * 4
    assert not any(drawn["none"])
    assert all(len(each) == 1 and each[0] not in UNLISTED for each in drawn["one"])
    assert all(len({stage_of(name) for name in each}) == 2 for each in drawn["pair"])
    assert all(len(each) == 1 and each[0] in UNLISTED for each in drawn["unknown"])
    with pytest.raises(InputError, match="what is wrong is 'two', must be one of mixed, none,"):
        GenerationRequest(tmp_path, 20, 3, wrong="two")


def test_protocols_fit_the_rig():
    random = np.random.default_rng(0)
    for _ in range(50):
        for each in (*draw_nine_runs(random), *draw_fresh_runs(random)):
            # At the shortest half a second at rest, two ramps and a few seconds at one speed.
            assert 7.9 < each.duration <= DEFAULT_PLANT.longest_run


def test_noise_has_a_white_and_a_correlated_part():
    drawn = add_noise(np.random.default_rng(0), 200_000, 1.0)
    share = DEFAULT_NOISE.correlated_share
    assert drawn.std() == pytest.approx(np.sqrt(1 + share**2), rel=SPREAD)
    later = round(DEFAULT_NOISE.correlation_time / DEFAULT_PLANT.row_interval)
    correlated = np.mean(drawn[later:] * drawn[:-later])
    assert correlated == pytest.approx(share**2 * np.exp(-1), abs=CORRELATED)


def test_settings_change_the_noise_and_the_shares_of_faults(tmp_path):
    white = NoiseSettings(correlated_share=0.0)
    drawn = add_noise(np.random.default_rng(0), 200_000, 1.0, white)
    assert drawn.std() == pytest.approx(1, rel=SPREAD)
    pairs = GenerationSettings(none_share=0.0, unknown_share=0.0, pair_share=1.0)
    faults = planned_faults(GenerationRequest(tmp_path, 20, seed=3), pairs)
    assert all(len(each) == 2 for each in faults)


# The rig that every figure of a run below is of.
ONE_RIG = GenerationSettings(rigs=RigSettings(share=0.0))


@pytest.fixture
def short(monkeypatch):
    """Runs of four seconds in place of all that a set may have."""
    backward = dataclasses.replace(SHORT, speed=tuple(-v for v in SHORT.speed))
    monkeypatch.setattr(single, "PRACTICE_RUNS", (SHORT,) * 9)
    monkeypatch.setattr(single, "RECOMMENDED_RUNS", (backward,) * 9)
    monkeypatch.setattr(single, "draw_nine_runs", lambda random, settings: (SHORT,) * 9)
    monkeypatch.setattr(single, "draw_fresh_runs", lambda random, settings: (SHORT,) * 3)


def test_sets_are_settled_by_their_seed(short, tmp_path):
    folders = [tmp_path / name for name in ("one", "two")]
    labels = []
    for folder in folders:
        request = GenerationRequest(folder, 20, seed=4, protocol="practice")
        labels.append(make_set(request, 7, ("travel_gain",), ONE_RIG))
    assert labels[0] == labels[1]
    assert labels[0]["effects"] == ["travel_gain"]
    one, two = (sorted(folder.rglob("*.h5")) for folder in folders)
    assert [each.name for each in one] == [f"fresh_{each}.h5" for each in "abc"] + [
        f"run_{each}.h5" for each in "abcdefghi"
    ]
    assert [each.read_bytes() for each in one] == [each.read_bytes() for each in two]
    other = make_set(
        GenerationRequest(tmp_path / "three", 20, seed=5, protocol="practice"),
        7,
        ("travel_gain",),
        ONE_RIG,
    )
    assert other["zeta"] != labels[0]["zeta"]


def test_a_run_looks_like_a_rig_s(short, tmp_path):
    request = GenerationRequest(tmp_path, 20, seed=4, protocol="practice")
    assert make_set(request, 0, (), ONE_RIG)["effects"] == []
    run = read_run(tmp_path / "set_01" / "run_a.h5")
    assert (run.source, run.title, run.created) == ("virtual rig", "single-wheel run", None)
    assert set(run.measured.channels()) == {"x", "z"}
    assert np.diff(run.measured.time) == pytest.approx(0.01)
    assert run.measured.z is not None
    assert 1e6 * run.measured.z == pytest.approx(np.round(1e6 * run.measured.z), abs=COUNTED)
    assert run.setup.sinkage_static == pytest.approx(-run.measured.z[:50].mean())
    assert run.setup.scaling_factor_initial == DEFAULT_GENERATION.believed_zeta


def test_a_set_that_is_interrupted_is_none(short, tmp_path, monkeypatch):
    request = GenerationRequest(tmp_path, 20, seed=4, protocol="practice")
    written = []

    def interrupted(path, log):
        if len(written) == 3:
            raise KeyboardInterrupt
        written.append(path)
        write_run(path, log)

    monkeypatch.setattr(recording, "write_run", interrupted)
    with pytest.raises(KeyboardInterrupt):
        make_set(request, 0, (), ONE_RIG)
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
        request = GenerationRequest(tmp_path / protocol, 20, seed=4, protocol=protocol)
        labels[protocol] = make_set(request, 7, ("travel_gain",), ONE_RIG)
        assert labels[protocol].pop("protocol") in (protocol, "practice", "random")
    assert labels["mixed"] == labels["telling"]
    forward, backward = (read_run(tmp_path / p / "set_08" / "run_a.h5") for p in labels)
    assert forward.measured.x[-1] > 0 > backward.measured.x[-1]
    fresh = [read_run(tmp_path / p / "set_08" / "fresh" / "fresh_a.h5") for p in labels]
    assert np.array_equal(fresh[0].command.omega, fresh[1].command.omega)
