"""What a case's runs cannot say."""

import dataclasses

import pytest

from diagnose.checks.caveats import caveats
from diagnose.dataset import RigDataset
from tests.helpers.synthetic_runs import SLOW, coarse, recorded, setup_of

FORCES = ("fx", "fz", "torque")


def case_of(*channels: tuple[str, ...], driven: bool = False) -> RigDataset:
    vx = [0.0, 0.0, 0.06, 0.06] if driven else None
    runs = [recorded(setup_of(SLOW, vx=vx), channels=each) for each in channels]
    return RigDataset.of(
        [coarse(f"run {number}", run, carriage_forces=True) for number, run in enumerate(runs)]
    )


def of_channels(case: RigDataset) -> list[str]:
    return [note for note in caveats(case) if "condition" not in note and "One run" not in note]


@pytest.fixture(scope="module")
def driven() -> RigDataset:
    return case_of(("z", *FORCES), ("x", "z", "fx"), driven=True)


def test_the_way_of_a_driven_carriage_is_given_and_not_missed(driven):
    notes = of_channels(driven)
    assert notes[0].startswith("The carriage was driven: x is given")
    assert not [note for note in notes if "has x" in note or "x was" in note]


def test_a_run_that_lacks_what_others_have_is_named(driven):
    assert "run 1 lacks torque, which other runs have." in of_channels(driven)
    assert "run 1 lacks fz, which other runs have." in of_channels(driven)
    assert of_channels(case_of(("x", "z"), ("z",))) == [
        "run 1 lacks x, which other runs have; taken to start at x = 0, wherever that was."
    ]


def test_what_no_run_has_cannot_be_told():
    assert of_channels(case_of(("x", "z"), ("x", "z"))) == []
    (note,) = of_channels(case_of(("z",), ("z",)))
    assert note == "No run has x: effects that show in it cannot be told apart."
    (_, note) = of_channels(case_of(("z", "fx", "fz"), driven=True))
    assert note.startswith("No run has torque")


def test_how_forces_on_a_free_carriage_are_compared_is_said():
    (note,) = of_channels(case_of(("x", "z", "fx"), ("x", "z", "fx")))
    assert note.startswith("fx of the free carriage is compared less its inertia")
    (note,) = of_channels(case_of(("x", "z", "fx", "fz")))
    assert note.startswith("fx and fz of the free carriage are compared")


def test_what_was_recorded_and_is_not_compared_is_said():
    run = recorded(setup_of(SLOW), channels=("x", "z", "fx"))
    note = of_channels(RigDataset.of([coarse("run", run)]))
    assert note == ["fx was recorded and not compared."]
    looped = dataclasses.replace(coarse("run", run), made_in_loop=run)
    (note,) = of_channels(RigDataset.of([looped]))
    assert note == "fx was recorded and not compared: the loop drove the carriage."


def test_runs_of_one_condition_check_nothing_under_another():
    assert any("one command and load" in each for each in caveats(case_of(("x", "z"), ("x", "z"))))
    assert any("One run only" in each for each in caveats(case_of(("x", "z"))))
