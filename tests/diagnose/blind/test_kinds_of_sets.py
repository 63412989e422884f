"""Sets of several effects, of a change and of a sweep: what is drawn, recorded and labelled."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from diagnose.blind.generation.generate import make_set, planned_faults
from diagnose.blind.generation.kinds import change, single
from diagnose.blind.generation.kinds.strengths import SAME_NUMBERS, comparable_size
from diagnose.blind.generation.random_mechanisms import UNLISTED, effect_names
from diagnose.blind.generation.settings import (
    DEFAULT_GENERATION,
    ChangeSetSettings,
    GenerationRequest,
    RigSettings,
    SeveralSetSettings,
)
from diagnose.blind.generation.true_budget import true_budget
from diagnose.blind.plant.machine import PlantEccentricity
from diagnose.blind.plant.run_plan import PlannedRun, SweepSettings
from diagnose.blind.plant.sensors import PlantSinkageDrift, PlantTravelGain
from drftjax.common.errors import InputError
from drftjax.effects.catalogue import effect_class, strengths
from drftjax.runlog.hdf5.api import read_run

# Shares are of gaps of a tenth of a millimetre and more, beside plates that leave a hundredth.
SHARES = 0.05
# Noise and the wheel's vertical motion leave this share of the mean force.
MEAN_FORCE = 0.02

SHORT = PlannedRun.held(12.0, 1.0, 1.0, 1.0, rest=0.5, end=0.5)
SETTINGS = replace(
    DEFAULT_GENERATION,
    rigs=RigSettings(share=0.0),
    sweep=SweepSettings(slips=(0.0, 0.3), fast_slips=(0.15,), settling=0.5, logged=1.0),
    several=SeveralSetSettings(budget_runs=(0,)),
    change=ChangeSetSettings(faults=1, probe_runs=(1,)),
)


@pytest.fixture
def short(monkeypatch):
    """Runs of four seconds in place of all that a set may have."""
    for module in (single, change):
        monkeypatch.setattr(module, "draw_nine_runs", lambda random, settings: (SHORT,) * 9)
    monkeypatch.setattr(single, "PRACTICE_RUNS", (SHORT,) * 9)
    monkeypatch.setattr(single, "draw_fresh_runs", lambda random, settings: (SHORT,) * 3)


def test_each_kind_draws_what_its_rigs_show(tmp_path):
    drawn = {
        kind: planned_faults(GenerationRequest(tmp_path, 100, 3, kind=kind))
        for kind in ("several", "change", "sweep")
    }
    assert Counter(map(len, drawn["several"])).keys() == {3, 4}
    assert all(len(set(each)) == len(each) for each in drawn["several"])
    counts = Counter(drawn["change"])
    assert (counts[()], counts[("zeta",)]) == (20, 15)
    assert not {"heap", "depth_hardening"} & {name for each in drawn["change"] for name in each}
    assert Counter(drawn["sweep"])[()] == 12
    for kind, each in drawn.items():
        names = {name for faults in each for name in faults} - {"zeta"}
        assert names <= set(effect_names(is_driven=kind == "sweep"))
        assert not names & set(UNLISTED)
    nothing = planned_faults(GenerationRequest(tmp_path, 10, 3, wrong="none", kind="change"))
    assert nothing == [()] * 10


def test_a_kind_or_fault_that_there_is_not_is_refused_in_one_sentence(tmp_path):
    for given, said in (
        ({"kind": "other"}, "the kind of the sets is 'other', must be one of single, several"),
        ({"kind": "several", "wrong": "pair"}, "what is wrong is 'pair'; sets of the kind several"),
        ({"kind": "sweep", "wrong": "unknown"}, "must be one of mixed, none, one in sets"),
        ({"kind": "change", "protocol": "telling"}, "have one protocol; leave it out"),
    ):
        with pytest.raises(InputError, match=said):
            GenerationRequest(tmp_path, 4, 3, **given)


def test_a_set_of_a_change_has_the_same_commands_before_and_now(short, tmp_path):
    labels = []
    for folder in (tmp_path / "one", tmp_path / "two"):
        request = GenerationRequest(folder, 20, 4, kind="change")
        labels.append(make_set(request, 2, ("zeta",), SETTINGS))
    label = labels[0]
    assert labels[1] == label
    one, two = (sorted((tmp_path / name).rglob("*.h5")) for name in ("one", "two"))
    assert [each.read_bytes() for each in one] == [each.read_bytes() for each in two]
    folder = tmp_path / "one" / "set_03"
    runs = {n: [read_run(folder / n / f"run_{c}.h5") for c in "abcde"] for n in ("before", "now")}
    assert len(list(folder.rglob("*.h5"))) == 10
    for before, now in zip(runs["before"], runs["now"], strict=True):
        assert np.array_equal(before.command.omega, now.command.omega)
    assert (label["kind"], label["effects"], label["size"]["numbers"]) == (
        "change",
        ["zeta"],
        ["change"],
    )
    assert 0.04 <= abs(label["size"]["value"]) <= 0.2
    assert 0.85 <= label["law"]["depth_exponent"] <= 1.35
    assert len(label["faults"]) == 1
    # Sand that bears more lifts the wheel.
    mean = {n: np.mean([r.setup.sinkage_static for r in each]) for n, each in runs.items()}
    assert (mean["now"] < mean["before"]) == (label["size"]["value"] > 0)


def test_a_sweep_is_logged_while_it_is_steady_with_all_channels(tmp_path):
    request = GenerationRequest(tmp_path, 20, 4, kind="sweep", faintest=3.0)
    label = make_set(request, 0, ("force_gain",), SETTINGS)
    assert (label["kind"], label["effects"]) == ("sweep", ["force_gain"])
    assert label["rig"]["is_driven"]
    folder = tmp_path / "set_01"
    names = sorted(each.stem for each in folder.glob("*.h5"))
    assert names == ["fast15", "slip00a", "slip00b", "slip30a", "slip30b"]
    run = read_run(folder / "slip30a.h5")
    measured, command = run.measured, run.command
    assert set(measured.channels()) == {"x", "z", "fx", "fz", "torque"}
    assert measured.time[0] == pytest.approx(2.5)
    assert measured.time[-1] == pytest.approx(3.5)
    assert command.vx is not None
    slip = 1 - command.vx[-1] / (run.setup.wheel_radius * command.omega[-1])
    assert slip == pytest.approx(0.3)
    # The sand carries the wheel, which the sensor reads too large or too small by its gain.
    gain = label["mechanisms"][0]["strength"]
    weight = run.setup.mass_z * run.setup.gravity
    assert measured.fz is not None
    assert measured.fz.mean() == pytest.approx((1 + gain) * weight, rel=MEAN_FORCE)


def test_a_set_of_several_says_each_size_and_the_budget(short, tmp_path):
    kinds = ("travel_gain", "sinkage_drift", "speed_gain")
    request = GenerationRequest(tmp_path, 20, 4, kind="several")
    label = make_set(request, 0, kinds, SETTINGS)
    assert (label["kind"], label["effects"]) == ("several", list(kinds))
    assert all(each["floors"] >= 3 for each in label["mechanisms"])
    budget = label["budget"]
    assert budget["runs"] == ["run_a"]
    for channel in budget["channels"].values():
        assert sum(each["share"] for each in channel["effects"].values()) == pytest.approx(1)
    # A gain of the travel and a drift of the sinkage show in one channel each.
    assert budget["channels"]["z"]["effects"]["travel_gain"]["share"] == pytest.approx(0, abs=1e-9)
    assert len(list((tmp_path / "set_01").rglob("*.h5"))) == 12


def test_the_budget_shares_a_gap_out_by_channel():
    parts = {"travel_gain": PlantTravelGain(0.05), "sinkage_drift": PlantSinkageDrift(2e-4)}
    budget = true_budget(parts, [(SHORT, 0.8)])["channels"]
    assert budget["x"]["effects"]["travel_gain"]["share"] == pytest.approx(1, abs=SHARES)
    assert budget["z"]["effects"]["sinkage_drift"]["share"] == pytest.approx(1, abs=SHARES)
    for channel, effect in (("x", "travel_gain"), ("z", "sinkage_drift")):
        alone = budget[channel]["effects"][effect]
        # The zeta that matches a mean sinkage with a drift in it moves x a little, too.
        assert alone["without"] < SHARES * budget[channel]["before"]
        assert alone["alone"] == pytest.approx(budget[channel]["before"], rel=SHARES)


def test_sizes_are_compared_in_numbers_that_the_effects_have():
    for name, numbers in SAME_NUMBERS.items():
        assert set(numbers) <= set(strengths(effect_class(name)))
    size = comparable_size("eccentricity", PlantEccentricity(0.002))["size"]
    assert size == {"value": 0.002, "unit": "m", "numbers": ["along", "up"]}
    assert comparable_size("terrain_variation", PlantEccentricity(0.002)) == {}
