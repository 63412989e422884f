"""`drft fit`: recorded runs in; values with errors, tables, files and a figure out."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from drftjax.common.text import value_with_error
from drftjax.recorded.prepared_run import names_of
from drftjax.runlog.hdf5.api import read_result, read_run, write_run
from drftjax.runlog.record import Measured, RecordedCommand
from drftjax.setups.fitted_model import FIT_SCHEMA, read_model
from identify.commands.fit import _stem
from tests.helpers.drft_command import Answer
from tests.helpers.synthetic_runs import SLOW, recorded, setup_of

# A fitted run simulated again has rows at other times; lines between them miss it by this [m].
INTERPOLATION = 2e-6
# Means and roots summed in another order.
ROUNDING = 1e-12
# Times and speeds written as decimals of a double, and read again.
WRITTEN = 1e-15

PAPER = Path(__file__).parents[3] / "data" / "paper.toml"
# Markup, to whoever takes a name for it.
BRACKETS = "sand [bold]x[red] $\\sum"


@pytest.fixture(scope="session")
def folder(tmp_path_factory) -> Path:
    """Two runs to be fitted, of which one has a name with brackets, and files that cannot be."""
    folder = tmp_path_factory.mktemp("runs")
    first = recorded(setup_of(SLOW, 0.74), 1)
    second = recorded(setup_of(SLOW, 0.78), 2)
    # A log of sinkage alone is compared by its sinkage alone.
    second = dataclasses.replace(
        second, measured=Measured(time=second.measured.time, z=second.measured.z)
    )
    write_run(folder / "first.h5", first)
    write_run(folder / f"{BRACKETS}.h5", second)
    standing = RecordedCommand(time=[0.0, 1.5], omega=[0.0, 0.0])
    write_run(folder / "standing.h5", dataclasses.replace(first, command=standing))
    plain = dataclasses.replace(first.setup, grouser_count=0)
    write_run(folder / "plain.h5", dataclasses.replace(first, setup=plain))
    unweighed = dataclasses.replace(first.setup, mass_z=None)
    write_run(folder / "unweighed.h5", dataclasses.replace(first, setup=unweighed))
    whole = (folder / "first.h5").read_bytes()
    (folder / "damaged.h5").write_bytes(whole[: len(whole) // 2])
    (folder / "empty.h5").write_bytes(b"")
    return folder


BAD = {
    "standing": "never moves the wheel",
    "unweighed": "lacks mass_z",
    "damaged": "damaged",
    "empty": "is empty",
    "gone": "no such file",
}


@pytest.fixture(scope="session")
def good(folder) -> tuple[Path, Path]:
    return folder / "first.h5", folder / f"{BRACKETS}.h5"


@dataclasses.dataclass(frozen=True)
class Fitted:
    answer: Answer
    stem: Path
    names: tuple[str, str]

    @property
    def document(self) -> dict:
        return json.loads(self.stem.with_name(self.stem.name + ".json").read_text())

    @property
    def hdf5(self) -> Path:
        return self.stem.with_name(self.stem.name + ".h5")


_KEPT: dict[Path, Fitted] = {}


@pytest.fixture
def fitted(drft, folder, good) -> Fitted:
    """One fit by the command line, with everything that may go wrong beside it."""
    if folder not in _KEPT:
        stem = folder / "new" / "fit.v2"
        bad = [folder / f"{name}.h5" for name in BAD]
        # So short a step leaves no error for the fit to take off, which `drft simulate` leaves in.
        options = ("-o", stem, "--step", 1e-3, "--plot", folder / "new" / "fit.pdf")
        answer = drft("fit", *good, *bad, folder / "plain.h5", *options)
        _KEPT[folder] = Fitted(answer, stem, (good[0].stem, good[1].stem))
    return _KEPT[folder]


def test_bad_files_are_named_and_do_not_stop_the_others(fitted, folder):
    assert fitted.answer.code == 0, fitted.answer
    assert fitted.answer.err == ""
    for name, why in BAD.items():
        lines = [line for line in fitted.answer.out.splitlines() if f"{name}.h5" in line]
        assert len(lines) == 1
        assert lines[0].startswith("left out: ")
        assert why in lines[0]
    assert "left out: plain: it has another kind of wheel" in fitted.answer.out
    assert set(fitted.document["failures"]) == {*BAD, "plain"}


def test_the_fit_is_drawn_where_it_was_asked_for(fitted):
    picture = fitted.stem.with_name("fit.pdf")
    assert f"figure written to {picture}" in fitted.answer.out
    assert picture.read_bytes().startswith(b"%PDF")


def test_names_with_brackets_are_printed_as_they_are(fitted):
    for name in fitted.names:
        assert f"│ {name}" in fitted.answer.out
        assert name in [run["name"] for run in fitted.document["runs"]]


def test_table_and_document_give_the_same_numbers(fitted):
    document = fitted.document
    assert document["schema"] == FIT_SCHEMA
    assert document["schema_version"] == 1
    assert document["status"] in ("converged", "stalled")
    for run in document["runs"]:
        before, after = 1e3 * run["rmse_before"]["z"], 1e3 * run["rmse_after"]["z"]
        assert f"{before:.3f} → {after:.3f}" in fitted.answer.out
        assert after < before
        zeta = run["values"]["terrain.zeta"]
        assert value_with_error(zeta["value"], zeta["error"]) in fitted.answer.out
    pooled = document["rmse_before"]["z"], document["rmse_after"]["z"]
    assert f"{1e3 * pooled[0]:.3f} → {1e3 * pooled[1]:.3f}" in fitted.answer.out
    shared = document["shared"]["terrain.inertial_coefficient"]
    told = value_with_error(shared["value"], shared["error"])
    assert f"lambda = {told}" in fitted.answer.out


def test_document_holds_the_covariance_of_all_values(fitted):
    document = fitted.document
    covariance = np.array(document["covariance"]["values"])
    errors = {"lambda": document["shared"]["terrain.inertial_coefficient"]["error"]}
    for run in document["runs"]:
        errors[f"zeta of {run['name']}"] = run["values"]["terrain.zeta"]["error"]
    assert document["covariance"]["of"] == [*errors]
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), [*errors.values()])
    np.testing.assert_allclose(covariance, covariance.T)


def test_root_mean_squares_are_those_of_the_arrays(fitted):
    document, result = fitted.document, read_result(fitted.hdf5, FIT_SCHEMA)
    powers = {kind: {"x": [], "z": []} for kind in ("before", "after")}
    for run in document["runs"]:
        group = result[run["name"]]
        counts = group["counts"].astype(bool)
        for kind, channels in powers.items():
            for channel in run[f"rmse_{kind}"]:
                left = group[f"{channel}_{kind}"] - group[f"{channel}_recorded"]
                rms = np.sqrt(np.mean(left[counts] ** 2))
                assert run[f"rmse_{kind}"][channel] == pytest.approx(rms, rel=ROUNDING)
                channels[channel].append(left[counts] ** 2)
    for kind, channels in powers.items():
        for channel, parts in channels.items():
            rms = np.sqrt(np.concatenate(parts).mean())
            assert document[f"rmse_{kind}"][channel] == pytest.approx(rms, rel=ROUNDING)


def test_each_run_is_compared_by_what_it_recorded(fitted, good):
    first, second = fitted.document["runs"]
    assert list(first["rmse_after"]) == ["x", "z"]
    assert list(second["rmse_after"]) == ["z"]
    result = read_result(fitted.hdf5, FIT_SCHEMA)
    assert "x_recorded" not in result[second["name"]].datasets
    for path, run in zip(good, (first, second), strict=True):
        measured = read_run(path).measured
        group = result[run["name"]]
        np.testing.assert_allclose(group["time"], measured.time, rtol=0, atol=WRITTEN)
        np.testing.assert_array_equal(group["z_recorded"], measured.z)


def test_both_files_hold_the_same_values_and_models(fitted):
    document, result = fitted.document, read_result(fitted.hdf5, FIT_SCHEMA)
    shared = document["shared"]["terrain.inertial_coefficient"]
    for key in ("value", "error"):
        assert result.attributes[f"terrain.inertial_coefficient_{key}"] == shared[key]
    for run in document["runs"]:
        own = run["values"]["terrain.zeta"]
        group = result[run["name"]]
        assert group.attributes["terrain.zeta_value"] == own["value"]
        assert group.attributes["terrain.zeta_error"] == own["error"]
        assert run["setup"]["terrain"]["zeta"] == own["value"]
        assert run["setup"]["terrain"]["inertial_coefficient"] == shared["value"]
        text = fitted.stem.with_name(fitted.stem.name + ".json")
        from_text, from_binary = (read_model(each, run["name"]) for each in (text, fitted.hdf5))
        for section in ("wheel", "terrain", "rig", "start", "integrator"):
            assert getattr(from_text, section) == getattr(from_binary, section)
        times = np.linspace(0, 1.5, 400)
        assert np.interp(times, from_text.command.time, from_text.command.omega) == pytest.approx(
            np.interp(times, from_binary.command.time, from_binary.command.omega), abs=WRITTEN
        )


@pytest.mark.parametrize("ending", [".json", ".h5"])
def test_fitted_model_simulates_what_the_fit_predicted(drft, fitted, tmp_path, ending):
    result = read_result(fitted.hdf5, FIT_SCHEMA)
    source = fitted.stem.with_name(fitted.stem.name + ending)
    for name in fitted.names:
        log = tmp_path / "again.h5"
        answer = drft("simulate", "--from", source, "--run", name, "-o", log, "--rate", "200")
        assert answer.code == 0, answer
        again, group = read_run(log).measured, result[name]
        z = np.interp(group["time"], again.time, again.z)
        moving = group["time"] > 0.3
        np.testing.assert_allclose(z[moving], group["z_after"][moving], rtol=0, atol=INTERPOLATION)


def test_result_of_two_runs_asks_which(drft, fitted):
    refusal = drft("simulate", "--from", fitted.hdf5).refusal
    assert "holds 2 runs; name one by --run: " in refusal
    refusal = drft("simulate", "--from", fitted.hdf5, "--run", "frist").refusal
    assert "holds no run 'frist'; did you mean first" in refusal


def test_figure_is_written_beside(fitted):
    assert fitted.stem.with_name("fit.v2.png").read_bytes().startswith(b"\x89PNG")
    *_, line, drawn = fitted.answer.out.strip().splitlines()
    stem = str(fitted.stem)
    assert line == f"written: {stem}.json, {stem}.h5, {stem}.png, {stem}.html"
    assert drawn.startswith("figure written to ")


# Refusals ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", BAD)
def test_single_bad_file_is_refused_by_its_reason(drft, folder, name):
    refusal = drft("fit", folder / f"{name}.h5").refusal
    assert str(folder / f"{name}.h5") in refusal
    assert BAD[name] in refusal


def test_all_bad_files_are_listed_and_refused(drft, folder, tmp_path):
    bad = [folder / f"{name}.h5" for name in BAD]
    answer = drft("fit", *bad, "-o", tmp_path / "fit")
    assert answer.refusal == f"none of the {len(bad)} files can be used"
    assert answer.out.count("left out: ") == len(bad)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--own", "zeto"], "there is no parameter 'zeto'; did you mean zeta"),
        (["--share", "rig.mass"], "there is no parameter 'rig.mass'; did you mean rig.mass_"),
        (["--own", "zeta", "--share", "zeta"], "terrain.zeta is asked for twice"),
        (["--own", "zeta", "--own", "terrain.zeta"], "terrain.zeta is asked for twice"),
        (["--start-zeta", "-1"], "--start-zeta is -1, must be over 0"),
        (["--start-zeta", "nan"], "--start-zeta is nan, must be over 0"),
        (["--start-zeta", "0"], "--start-zeta is 0, must be over 0"),
        (["--starts", "0"], "is 0, must lie between 1 and 1000 (--starts)"),
        (["--bootstrap", "-1"], "is -1, must lie between 20 and 100000 (--bootstrap)"),
        (["--parameters", PAPER], "holds no [[parameter]]; a fit's parameters are a list of them"),
        (["--step", "0"], "integrator step is 0, must lie between"),
        (["--step", "nan"], "integrator step is nan, must lie between"),
        (["-o", "."], "is a folder; name the result too"),
    ],
)
def test_options_that_cannot_be_are_refused(drft, good, arguments, said):
    assert said in drft("fit", good[0], *arguments).refusal


def test_plain_wheel_has_no_grousers_to_fit(drft, folder):
    refusal = drft("fit", folder / "plain.h5", "--own", "wheel.grouser_height").refusal
    assert "this set-up has no wheel.grouser_height to fit" in refusal


def test_no_files_are_a_usage_error(drft):
    answer = drft("fit")
    assert answer.code == 2
    assert "Missing argument" in answer.err


# Names ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("paths", "names"),
    [
        (["a.h5", "b.h5"], ["a", "b"]),
        (["day1/a.h5", "day2/a.h5", "day2/b.h5"], ["day1_a", "day2_a", "b"]),
        (["a.h5", "a.h5"], ["a", "a_2"]),
        (["x/day/a.h5", "y/day/a.h5"], ["day_a", "day_a_2"]),
        (["day/a.h5", "z/a.h5", "day_a.h5"], ["day_a", "z_a", "day_a_2"]),
        (["/a.h5", "day/a.h5"], ["_a", "day_a"]),
    ],
)
def test_every_run_has_a_name_of_its_own(paths, names):
    assert names_of([Path(each) for each in paths]) == names


@pytest.mark.parametrize(
    ("given", "stem"),
    [("out/fit", "out/fit"), ("fit.json", "fit"), ("fit.h5", "fit"), ("fit_0.5", "fit_0.5")],
)
def test_stem_keeps_its_dots(given, stem):
    assert _stem(Path(given)) == Path(stem)
