"""`drft bench`: its table, the program in plain NumPy, and what it refuses."""

import re

import jax
import numpy as np
import pytest

from drftjax.physics.command import command_at
from drftjax.physics.state import State
from drftjax.physics.stress import QuasiStatic
from drftjax.physics.terrain import Terrain
from drftjax.physics.wheel import GrouserWheel, PlainWheel
from drftjax.simulation.plain_numpy import simulate_in_numpy
from drftjax.simulation.rollout import simulate, step_times
from drftjax.simulation.simulator import Simulator

# Largest difference of z [m]. Of a standing wheel the two smooth rest by 0.1 mm/s and by less than
# a micrometre a second, so the wheel starts as deep as it stands by both; both steps, of 2 ms, are
# of first order.
SINKAGE = 5e-5
SINKING_AT_REST = 0.0337


@pytest.mark.parametrize("wheel", [GrouserWheel(), PlainWheel()], ids=["grousers", "plain"])
@pytest.mark.parametrize("speed", [0.5, -0.5])
def test_plain_numpy_rolls_as_the_simulator(wheel, speed):
    steps, dt = 1500, 2e-3
    times = step_times(steps, dt)
    commands = command_at(times, np.array([0.0, 1.0]), np.array([0.0, speed]))
    simulator = Simulator(wheel)
    output = simulate(simulator, State.at_rest(SINKING_AT_REST), commands, dt)[1]
    z, x = simulate_in_numpy(simulator, SINKING_AT_REST, np.asarray(commands.omega), dt)
    assert np.abs(z - np.asarray(output.z)).max() < SINKAGE
    assert abs(x[-1] - float(output.x[-1])) < 1e-3 * abs(float(output.x[-1]))


def test_plain_numpy_refuses_what_it_has_not():
    quasi_static = Simulator(terrain=Terrain(law=QuasiStatic()))
    with pytest.raises(ValueError, match="dynamic law, a constant zeta and no effects"):
        simulate_in_numpy(quasi_static, 0.02, np.zeros(1), 1e-3)


def test_table_has_a_row_for_each_program(drft):
    answer = drft("bench", "--runs", 2, "--repeats", 1)
    assert answer.code == 0, answer
    rows = re.findall(
        r"(drftjax|plain NumPy)\s+│\s+(\d+) │\s+([\d.]+) ms │\s+([\d.]+) s", answer.out
    )
    assert [(name, int(runs)) for name, runs, *_ in rows] == [
        ("drftjax", 1),
        ("drftjax", 2),
        ("plain NumPy", 1),
    ]
    assert f"{jax.device_count()} cores" in answer.out


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (("--runs", "1"), "--runs is 1, must be 2 to 100000"),
        (("--repeats", "0"), "--repeats is 0, must be 1 to 100"),
        (("--cpp", "nowhere.cpp"), "nowhere.cpp: there is no such file"),
    ],
)
def test_what_cannot_be_measured_is_refused(drft, given, sentence):
    assert drft("bench", *given).refusal == sentence


def test_source_that_is_no_program_is_refused(drft, tmp_path):
    source = tmp_path / "broken.cpp"
    source.write_text("this is no C++\n")
    refusal = drft("bench", "--runs", 2, "--cpp", source).refusal
    assert refusal.startswith(f"{source}: ")
    assert "g++" in refusal
