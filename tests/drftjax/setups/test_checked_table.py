"""Set-ups built in Python: impossible entries are refused, arrays and dictionaries taken."""

import copy

import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.effects.rig import VerticalLoad
from drftjax.physics.terrain import ConstantZeta, Terrain
from drftjax.setups.setup import (
    CommandSetUp,
    IntegratorSetUp,
    RigSetUp,
    SetUp,
    StartSetUp,
    WheelSetUp,
    read_setup,
)
from drftjax.setups.setup_toml import setup_toml
from drftjax.setups.terrain_setup import DynamicTerrain

COMMAND = {"time": [0, 1], "omega": [0, 1]}


@pytest.mark.parametrize(
    ("build", "said"),
    [
        (lambda: WheelSetUp(radius=150), "wheel radius is 150, must lie between 0.005 and 2"),
        (lambda: WheelSetUp(radius="big"), "wheel.radius: expected a number, got text"),
        (lambda: WheelSetUp(shape="round"), "wheel.shape is 'round', must be one of 'grouser'"),
        (lambda: WheelSetUp(grouser_count=2.5), "wheel.grouser_count: expected a whole number"),
        (lambda: WheelSetUp(shape="outline"), "needs points, or outline = a CSV file"),
        (lambda: DynamicTerrain(zeta=-0.8), "zeta is -0.8, must lie between 0 and 1000"),
        (lambda: DynamicTerrain(zeta=np.nan), "zeta is nan"),
        (lambda: DynamicTerrain(bisector="round"), "terrain.bisector is 'round'"),
        (lambda: Terrain(-0.8), "zeta is -0.8, must lie between 0 and 1000"),
        (lambda: RigSetUp(mass_z=0), "mass_z is 0, must lie between 0.001"),
        (lambda: StartSetUp(sinkage=17.6), "start sinkage is 17.6, .* are these mm"),
        (lambda: CommandSetUp([0, 0], [1, 1]), "command.time must increase"),
        (lambda: CommandSetUp([0, 1], [1, 1000]), "are these deg/s"),
        (lambda: IntegratorSetUp(step=1.0), "integrator step is 1"),
        (lambda: SetUp(command=3), "command: expected a table of entries, got a whole number"),
        (lambda: SetUp(command=COMMAND, wheel={"radus": 1}), "did you mean 'radius'"),
        (lambda: SetUp(command=COMMAND, terrain={"law": "x"}), "terrain.law is 'x', must be"),
        (lambda: SetUp(command=COMMAND, rig={"carriage": "driven"}), "needs vx in m/s"),
        (lambda: SetUp(command=COMMAND, start={"sinkage": 0.16}), "between -0.15 and 0.15 m"),
        (lambda: SetUp(command=COMMAND, effects=3), "effects: expected a list"),
        (lambda: SetUp(command=COMMAND, title="a\0b"), r"title holds the character '\\x00'"),
    ],
)
def test_mistakes_are_refused_where_they_are_made(build, said):
    with pytest.raises(InputError, match=said) as caught:
        build()
    assert "\n" not in str(caught.value)


def test_arrays_dictionaries_and_tables_make_the_same_set_up():
    tables = SetUp(CommandSetUp([0.0, 1.0], [0.0, 1.0]), terrain=DynamicTerrain(zeta=0.5))
    given = {"time": np.array([0, 1]), "omega": np.linspace(0, 1, 2)}
    assert SetUp(given, terrain={"zeta": np.float64(0.5)}) == tables


def test_number_that_is_set_later_is_checked_by_the_trial():
    setup = SetUp(COMMAND)
    setup.rig.mass_z = -1
    with pytest.raises(InputError, match="mass_z is -1"):
        setup.trial()


def test_number_is_one_zeta_for_the_whole_run():
    assert isinstance(Terrain(0.5).zeta, ConstantZeta)
    assert float(Terrain(0.5).zeta.value) == 0.5
    assert Terrain(ConstantZeta(0.5)).zeta.value == Terrain(0.5).zeta.value


def test_effect_itself_is_built_and_written_as_its_entry(tmp_path):
    setup = SetUp(COMMAND, effects=[VerticalLoad(force=7.0)])
    setup.effects.append({"name": "drawbar", "force": 3.0})
    file = tmp_path / "rig.toml"
    file.write_text(setup_toml(setup))
    kept = [(type(e).__name__, float(e.force)) for e in setup.trial().simulator.effects]
    read = [(type(e).__name__, float(e.force)) for e in read_setup(file).trial().simulator.effects]
    assert kept == read == [("VerticalLoad", 7.0), ("Drawbar", 3.0)]


def test_copy_shares_nothing_and_is_checked_when_it_is_simulated():
    setup = SetUp(COMMAND)
    setup.rig.carriage = "driven"
    twin = copy.deepcopy(setup)
    twin.wheel.radius = 0.2
    assert setup.wheel.radius == 0.15
    with pytest.raises(InputError, match="needs vx in m/s"):
        twin.trial()
