"""Stress laws of set-up files: their own numbers, and laws that installed packages add."""

import json
import os
import subprocess
import sys

import msgspec
import pytest

from drftjax.common.errors import InputError
from drftjax.physics.stress import QuasiStatic
from drftjax.runlog.hdf5.api import read_run
from drftjax.runlog.result_file import FIT_SCHEMA
from drftjax.setups.fitted_model import read_model
from drftjax.setups.setup import CommandSetUp, SetUp, read_setup
from drftjax.setups.setup_toml import setup_toml
from drftjax.setups.simulated_run import simulated_run, with_believed_values
from drftjax.setups.terrain_setup import GROUP, QuasiStaticTerrain, stress_laws
from tests.helpers.fake_package import write_package

COMMAND = "[command]\ntime = [0, 0.2]\nomega = [0, 0.5]\n"

SOURCE = """
from drftjax.physics.stress import QuasiStatic
from drftjax.setups.terrain_setup import AbstractTerrainSetUp, DynamicTerrain


class Firm(AbstractTerrainSetUp, tag="firm"):
    firmness: float = 2.0

    def stress_law(self):
        generic = self.stress_coefficients().values
        return QuasiStatic(type(self.stress_coefficients())(self.firmness * generic))


class Empty(AbstractTerrainSetUp, tag="empty"):
    pass
"""


def written(folder, terrain: str, name: str = "rig.toml"):
    path = folder / name
    path.write_text(f"[terrain]\n{terrain}\n{COMMAND}")
    return path


def test_a_law_without_rate_keeps_no_number_of_the_other(tmp_path):
    setup = read_setup(written(tmp_path, "law = 'quasi-static'\nzeta = 0.6"))
    assert isinstance(setup.trial().simulator.terrain.law, QuasiStatic)
    table = msgspec.to_builtins(setup)["terrain"]
    assert table == {"law": "quasi-static", "zeta": 0.6, "coefficients": "generic"}
    again = tmp_path / "again.toml"
    again.write_text(setup_toml(setup))
    assert read_setup(again) == setup


def test_numbers_of_another_law_are_not_used(drft, tmp_path):
    given = read_setup(written(tmp_path, "law = 'quasi-static'\nbulk_density = 1500"))
    assert given == read_setup(written(tmp_path, "law = 'quasi-static'"))
    inertial = drft("simulate", written(tmp_path, "law = 'quasi-static'"), "--lambda", "1").refusal
    assert "'quasi-static' has no inertial_coefficient; it has zeta, coefficients" in inertial


@pytest.mark.parametrize("law", ["dynamic", "quasi-static"])
def test_a_program_s_set_up_of_old_reads_though_it_holds_all_numbers(tmp_path, law):
    """Results held the dynamic law's numbers beside any law, which did not use them."""
    setup = read_setup(written(tmp_path, f"law = '{law}'\nzeta = 0.6"))
    old = msgspec.to_builtins(setup)
    old["terrain"] |= {"inertial_coefficient": 1.1, "bulk_density": 1490, "height_decrease": 1.0}
    fit = {"schema": FIT_SCHEMA, "schema_version": 1, "runs": [{"name": "old", "setup": old}]}
    (tmp_path / "fit.json").write_text(json.dumps(fit))
    assert read_model(tmp_path / "fit.json", "old") == setup


def test_an_unknown_law_is_refused_with_the_nearest_one(tmp_path):
    said = "terrain.law is 'static', must be one of 'dynamic', 'quasi-static'; did you mean 'quasi"
    with pytest.raises(InputError, match=said):
        read_setup(written(tmp_path, "law = 'static'"))


def test_an_unknown_integrator_is_refused_with_the_nearest_one():
    setup = SetUp(command=CommandSetUp([0, 1], [0, 1]))
    setup.integrator.method = "implicid"
    said = "integrator.method is 'implicid', must be .*; did you mean 'implicit'"
    with pytest.raises(InputError, match=said):
        setup.trial()


def test_a_run_log_of_a_law_without_density_says_none():
    setup = SetUp(command=CommandSetUp([0, 1], [0, 1]), terrain=QuasiStaticTerrain())
    assert with_believed_values(setup, 0.01, 0.7).bulk_density is None


def ask(home, *arguments: object) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-m", "drftjax.commands.main", *map(str, arguments)],
        env=os.environ | {"PYTHONPATH": str(home), "COLUMNS": "200"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_a_packages_law_is_simulated_by_its_name(tmp_path):
    home = write_package(tmp_path, GROUP, {"firm": "extra:Firm"}, SOURCE)
    run = tmp_path / "run.h5"
    setup = written(tmp_path, "law = 'firm'\nfirmness = 2.0")
    answer = ask(home, "simulate", setup, "-o", run)
    assert answer.returncode == 0, answer.stderr
    firm = read_run(run).measured.z[-1]
    # A firmness of one is the project's own law.
    own = simulated_run(read_setup(written(tmp_path, "law = 'quasi-static'"))).measured.z[-1]
    assert firm > own + 1e-3  # a millimetre
    # Without the package its law is one name too many.
    with pytest.raises(InputError, match="law is 'firm', must be one of"):
        read_setup(written(tmp_path, "law = 'firm'"))


@pytest.mark.parametrize(
    ("name", "point", "said"),
    [
        ("firm", "extra:Absent", "the stress law 'firm' of extra:Absent fails: "),
        ("firm", "pathlib:Path", "'firm' of pathlib:Path is no stress law class"),
        ("firm", "extra:Empty", "extra:Empty has the tag 'empty', must be 'firm'"),
        ("empty", "extra:Empty", "lacks stress_law, which every stress law has"),
        ("dynamic", "extra:DynamicTerrain", "'dynamic' of extra:DynamicTerrain is there already"),
    ],
)
def test_a_package_that_adds_no_law_is_named(tmp_path, monkeypatch, name, point, said):
    monkeypatch.syspath_prepend(str(write_package(tmp_path, GROUP, {name: point}, SOURCE)))
    try:
        with pytest.raises(InputError, match=said):
            stress_laws()
    finally:
        sys.modules.pop("extra", None)
