"""Numbers of a set-up by name, and runs with other numbers."""

import jax
import pytest

from drftjax.common.errors import InputError
from drftjax.effects.rig import VerticalLoad
from drftjax.setups.api import simulate, trajectory
from drftjax.setups.numbers import with_numbers
from drftjax.setups.setup import SetUp

COARSE = {"shape": "plain", "plate_size": 0.02}


@pytest.fixture
def setup() -> SetUp:
    effects = [{"name": "drawbar", "force": 3.0}, VerticalLoad(force=7.0)]
    command = {"time": [0, 1], "omega": [0, 1]}
    return SetUp(command, wheel=COARSE, integrator={"step": 5e-3}, effects=effects)


def test_numbers_go_to_their_tables_and_the_given_set_up_stays(setup):
    names = {"zeta": 0.5, "rig.mass_z": 20, "lambda": 0.9, "drawbar.force": 4.0}
    changed = with_numbers(setup, names | {"vertical_load.force": 8.0})
    assert changed.terrain.zeta == 0.5
    assert changed.terrain.inertial_coefficient == 0.9
    assert changed.rig.mass_z == 20.0
    assert changed.effects[0]["force"] == 4.0
    assert float(changed.effects[1].force) == 8.0
    assert (setup.terrain.zeta, setup.rig.mass_z) == (0.7823, 18.837)
    assert setup.effects[0]["force"] == 3.0
    assert float(setup.effects[1].force) == 7.0


@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        ({"zeeta": 1}, "the number is 'zeeta', must be one of .* did you mean 'zeta'"),
        ({"rig.zeta": 1}, "the number is 'rig.zeta'"),
        ({"loosening.loss": 1}, "the number is 'loosening.loss'"),
        ({"zeta": -1}, "zeta is -1, must lie"),
        ({"zeta": "soft"}, "terrain.zeta: expected"),
    ],
)
def test_unknown_and_impossible_numbers_are_refused(setup, numbers, said):
    with pytest.raises(InputError, match=said):
        with_numbers(setup, numbers)


def test_traced_number_of_an_effect_has_a_derivative(setup):
    def final(force):
        return trajectory(setup, **{"drawbar.force": force}).x[-1]

    # A cable that pulls back shortens the way.
    assert float(jax.jacfwd(final)(3.0)) < 0


def test_radius_has_no_derivative_and_a_sentence_says_so(setup):
    with pytest.raises(InputError, match="radius decides the number of plates"):
        jax.grad(lambda radius: trajectory(setup, radius=radius).z[-1])(0.15)


@pytest.mark.parametrize("run", [simulate, trajectory])
def test_runs_that_the_model_does_not_cover_are_refused(run, setup):
    with pytest.raises(InputError, match="the sand is too soft"):
        run(setup, zeta=0.01)
    with pytest.raises(InputError, match="a int was given, must be a SetUp"):
        run(3)
    with pytest.raises(InputError, match=r"none\.toml: there is no such file"):
        run("none.toml")
