"""Numbers of effects as parameters of a fit."""

import numpy as np
import pytest

import drftjax
from drftjax.common.errors import InputError
from drftjax.effects.catalogue import catalogue
from drftjax.runlog.hdf5.api import write_run
from drftjax.setups.fitted_model import read_model
from drftjax.setups.setup import add_fitted_effects
from drftjax.setups.setup_toml import setup_toml
from identify.parameters.effect_quantities import effect_numbers
from identify.parameters.parameter import quantity
from tests.helpers.synthetic_runs import SLOW, recorded, setup_of

# Of independent draws of a Gaussian one in 400,000 lies outside.
FAR = 4.5
# One short run tells a pull to a twenty-fifth of itself, and the others better.
TOLD = 0.05
# What is written and read again.
ROUNDING = 1e-12


def made_with(*effects: dict, seed: int = 0):
    setup = setup_of(SLOW)
    setup.effects = list(effects)
    return recorded(setup, seed)


@pytest.fixture(scope="module")
def model():
    setup = setup_of(SLOW)
    setup.terrain.zeta = 0.7823
    return setup


@pytest.mark.parametrize(
    ("name", "truth"),
    [("drawbar.force", 6.0), ("speed_lag.lag", 0.08), ("travel_gain.gain", 0.05)],
)
def test_fit_finds_a_number_of_an_effect_of_each_kind(model, name, truth):
    """A force, a number of the drive that cannot be negative, and one of a sensor."""
    title, field = name.split(".")
    run = made_with({"name": title, field: truth})
    result = drftjax.fit(run, model, ["zeta", name])
    found = result.values[name]
    assert found.unit == quantity(name).unit
    assert abs(found.value - truth) < FAR * found.error
    assert found.error < TOLD * truth
    # The believed model is without it, and stays so.
    assert model.effects == []


def test_fitted_number_is_written_where_a_simulation_finds_it(model, tmp_path):
    run = made_with({"name": "drawbar", "force": 6.0})
    result = drftjax.fit(run, model, ["zeta", "drawbar.force"])
    text, *_ = result.write(tmp_path / "fit")
    (entry,) = read_model(text).effects
    assert entry["name"] == "drawbar"
    assert entry["force"] == pytest.approx(result.values["drawbar.force"].value, rel=ROUNDING)


def test_command_fits_a_number_of_an_effect_beside_those_of_a_model_file(drft, model, tmp_path):
    slope, drawbar = {"name": "surface_slope", "slope": 0.02}, {"name": "drawbar", "force": 6.0}
    write_run(tmp_path / "run.h5", made_with(slope, drawbar))
    model.effects = [slope]
    (tmp_path / "model.toml").write_text(setup_toml(model))
    model.effects = []
    given = ("--own", "zeta", "--share", "drawbar.force", "--model", tmp_path / "model.toml")
    answer = drft("fit", tmp_path / "run.h5", *given, "-o", tmp_path / "fit")
    assert answer.code == 0, answer.err
    assert "drawbar.force" in answer.out
    fitted = read_model(tmp_path / "fit.json")
    assert [each["name"] for each in fitted.effects] == ["surface_slope", "drawbar"]
    assert fitted.effects[1]["force"] == pytest.approx(6.0, rel=4 * TOLD)


def test_names_that_no_effect_has_are_refused_with_what_there_is():
    with pytest.raises(InputError, match=r"'drawbar' has no number 'forse'.* drawbar.force \[N\]"):
        quantity("drawbar.forse")
    with pytest.raises(InputError, match=r"did you mean drawbar\.force"):
        quantity("drawbr.force")


def test_every_number_of_the_catalogue_can_be_fitted():
    """Read from a trial that has its effect, and put there."""
    assert len(effect_numbers()) > len(catalogue())
    # A carriage has a gain where it is driven.
    setup = setup_of(SLOW, vx=[0.0] * len(SLOW[0]))
    add_fitted_effects(setup, ["zeta", *effect_numbers()])
    trial = setup.trial()
    for name in effect_numbers():
        each = quantity(name)
        value = each.read(trial)
        assert np.isfinite(each.bijector.coordinate(value)), name
        moved = each.write(trial, value + 0.01)
        assert float(each.read(moved)) == pytest.approx(float(value) + 0.01, rel=ROUNDING), name


def test_effect_that_is_not_there_is_told_to_be_small(model):
    """An error well under its typical size says something, though it is more than the value."""
    found = drftjax.fit(made_with(seed=3), model, ["zeta", "drawbar.force"])
    force = found.values["drawbar.force"]
    assert abs(force.value) < FAR * force.error < 5.0
    assert not any("drawbar.force cannot be identified" in said for said in found.findings)
