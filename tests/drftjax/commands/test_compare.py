"""`drft compare`: several results side by side, with chi-square known by algebra."""

import json
import math
from pathlib import Path

import pytest
from scipy.stats import chi2

from drftjax.results.compared_files import SIDE_BY_SIDE_SETTINGS

# Sums in another order.
ROUNDING = 1e-12

MASS = "rig.mass_z"
LAMBDA = "terrain.inertial_coefficient"


def number(value: float | None, error: float | None, label: str, **more: object) -> dict:
    """A value as a fit's file holds it."""
    told = {"value": value, "error": error, "unit": "-", "label": label, "at_bound": False}
    return told | more


def fit(
    folder: Path,
    name: str,
    shared: dict[str, dict],
    own: list[dict[str, dict]] | None = None,
    logs: dict[str, str] | None = None,
    **more: object,
) -> Path:
    """A fit's file, as far as a comparison needs it.

    Args:
        folder: Folder of the file.
        name: Its name.
        shared: Shared values.
        own: Own values of each run.
        logs: SHA-256 of the run logs by name.
        more: Other entries.
    """
    origin = {
        "inputs": [{"name": log, "sha256": digest} for log, digest in (logs or {}).items()],
        "command": None,
        "versions": {},
        "machine": {
            "system": "Linux",
            "precision": "float64",
            "backend": "cpu",
            "devices": 1,
            "threads": 1,
        },
        "seed": None,
        "date": "2026-01-01T00:00:00+00:00",
    }
    runs = [
        {"name": f"run {at}", "status": "converged", "values": values, "zeta_path": None}
        for at, values in enumerate(own or [])
    ]
    document = {
        "schema": "drft-fit",
        "schema_version": 1,
        "status": "converged",
        "provenance": origin if logs else None,
        "shared": shared,
        "runs": runs,
    }
    path = folder / name
    path.write_text(json.dumps(document | more))
    return path


def compared(drft, *files: Path) -> tuple[dict, str]:
    """JSON of a comparison, and what was printed."""
    into = files[0].parent / "compared" / "both.json"
    answer = drft("compare", *files, "-o", into)
    assert answer.code == 0, answer
    return json.loads(into.read_text()), answer.out


@pytest.fixture
def three(tmp_path) -> list[Path]:
    """Three fits: errors of 1, 1 and 2, lambda that disagrees and a mass that agrees."""
    values = ((10.0, 5.0), (16.0, 5.5), (13.0, 6.0))
    errors = (1.0, 1.0, 2.0)
    return [
        fit(
            tmp_path,
            f"{name}.json",
            {LAMBDA: number(a, e, "lambda"), MASS: number(b, e, "mass_z", unit="kg")},
            logs={f"{name}.h5": name},
        )
        for name, (a, b), e in zip("abc", values, errors, strict=True)
    ]


def test_chi_square_is_that_of_the_algebra(drft, three):
    document, out = compared(drft, *three)
    first, second = document["quantities"]
    told = first["agreement"]
    # Weights 1, 1 and 1/4: the mean is (10 + 16 + 13 / 4) / (9 / 4) = 13.
    assert told["mean"] == pytest.approx(13, rel=ROUNDING)
    assert told["error"] == pytest.approx(2 / 3, rel=ROUNDING)
    assert told["chi_square"] == pytest.approx(9 + 9 + 0, rel=ROUNDING)
    assert told["freedom"] == 2
    assert told["ratio"] == pytest.approx(3, rel=ROUNDING)
    # With two degrees of freedom the tail is exp(-chi2 / 2).
    assert told["chance"] == pytest.approx(math.exp(-9), rel=ROUNDING)
    assert told["apart"] == [0, 1]
    assert told["errors_apart"] == pytest.approx(6 / math.sqrt(2), rel=ROUNDING)
    assert (first["disagrees"], second["disagrees"]) == (True, False)
    # (5 + 5.5 + 6 / 4) / (9 / 4) = 16 / 3
    squares = (1 / 3) ** 2 + (1 / 6) ** 2 + (2 / 3) ** 2 / 4
    assert second["agreement"]["chi_square"] == pytest.approx(squares, rel=ROUNDING)
    assert second["agreement"]["chance"] == pytest.approx(chi2.sf(squares, 2), rel=ROUNDING)
    assert "lambda disagrees: 10.0 ± 1.0 in " in out
    assert "lie 4.2 errors apart; over the files it scatters by 3 times what the errors" in out
    assert "mass_z agrees within its errors." in out
    assert "No run log is in two of them." in out
    row = next(line for line in out.splitlines() if "lambda" in line)
    assert "9.00" in row
    assert "0.00012" in row


def test_the_level_is_shared_out_over_the_parameters(drft, tmp_path):
    # Two values whose chance lies between the level and half of it.
    chance = 0.75 * SIDE_BY_SIDE_SETTINGS.chance
    apart = math.sqrt(2 * chi2.isf(chance, 1))
    shared = [{"rig.a": number(at, 1.0, "a")} for at in (0.0, apart)]
    alone = [fit(tmp_path, f"one{at}.json", each) for at, each in enumerate(shared)]
    assert compared(drft, *alone)[0]["quantities"][0]["disagrees"]
    beside = [each | {"rig.b": number(1.0, 1.0, "b")} for each in shared]
    pair = [fit(tmp_path, f"two{at}.json", each) for at, each in enumerate(beside)]
    assert not compared(drft, *pair)[0]["quantities"][0]["disagrees"]


def test_own_values_are_compared_by_their_mean(drft, tmp_path):
    # One error for all: by Paule and Mandel the mean is the plain one, the variance 2 - 1.
    own = [{"terrain.zeta": number(at, 1.0, "zeta")} for at in (1.0, 3.0)]
    other = [{"terrain.zeta": number(9.0, 1.0, "zeta")}]
    unsure = [
        {"terrain.zeta": number(5.0, None, "zeta")},
        {"terrain.zeta": number(0.3, 0.1, "zeta", at_bound=True)},
    ]
    files = [
        fit(tmp_path, "a.json", {}, own + unsure, {"a.h5": "a"}),
        fit(tmp_path, "b.json", {}, other, {"b.h5": "b"}),
    ]
    document, out = compared(drft, *files)
    (zeta,) = document["quantities"]
    first, second = zeta["values"]
    assert (first["value"], first["runs"]) == (pytest.approx(2.0), 2)
    assert first["scatter"] == pytest.approx(1.0)
    # Of two with a variance of 1 + 1 each.
    assert first["error"] == pytest.approx(1.0)
    assert (second["value"], second["error"], second["runs"]) == (9.0, 1.0, 1)
    assert zeta["agreement"]["chi_square"] == pytest.approx(49 / 2)
    assert "Record one run twice, with the sand prepared again, since zeta disagrees most" in out
    assert "2.0 ± 1.0 (mean of 2, scatter 1)" in out


def test_values_at_bounds_and_without_errors_are_shown_and_not_compared(drft, tmp_path):
    files = [
        fit(tmp_path, "a.json", {LAMBDA: number(1.0, 0.1, "lambda", at_bound=True)}),
        fit(tmp_path, "b.json", {LAMBDA: number(9.0, None, "lambda")}, status="stalled"),
    ]
    document, out = compared(drft, *files)
    (found,) = document["quantities"]
    assert found["agreement"] is None
    assert "1, at a bound" in out
    assert "lambda is not identified. The run that would identify it: drft design --like" in out
    assert f"{files[1]} ended as 'stalled'" in out


@pytest.mark.parametrize(
    ("value", "error"), [(1e200, 1.0), (0.0, 1e-200), (1.0, 1e200), (math.nan, 1.0), (1.0, 0.0)]
)
def test_numbers_without_squares_are_shown_and_not_compared(drft, tmp_path, value, error):
    odd = fit(tmp_path, "odd.json", {LAMBDA: number(value, error, "lambda")})
    own = [{LAMBDA: number(value, error, "lambda")}, {LAMBDA: number(1.0, 0.1, "lambda")}]
    usual = fit(tmp_path, "usual.json", {}, own)
    document, _ = compared(drft, odd, usual)
    (found,) = document["quantities"]
    assert found["agreement"] is None
    assert found["values"][1]["value"] == pytest.approx(1.0)


def test_common_run_logs_are_told(drft, tmp_path):
    shared = {LAMBDA: number(1.0, 0.1, "lambda")}
    logs = {"x.h5": "1", "y.h5": "2"}
    one = fit(tmp_path, "one.json", shared, logs=logs)
    same = fit(tmp_path, "same.json", shared, logs={"renamed.h5": "1", "y.h5": "2"})
    part = fit(tmp_path, "part.json", shared, logs={"x.h5": "1", "z.h5": "3"})
    old = fit(tmp_path, "old.json", shared)
    assert f"{one} and {same} are made from the same run logs." in compared(drft, one, same)[1]
    out = compared(drft, one, part)[1]
    assert f"{one} and {part} have x.h5 in common." in out
    assert "So their errors are not independent" in out
    out = compared(drft, one, old)[1]
    assert f"{old} names no run logs by their SHA-256" in out
    assert "not independent" not in out


def test_the_next_run_is_for_what_disagrees_or_is_known_worst(drft, three, tmp_path):
    out = compared(drft, *three)[1]
    assert "lambda disagrees most, and is known to 6.2 % at best" in out
    assert "drft design --like a.h5 --parameter lambda --nuisance rig.mass_z\n" in out
    shared = {LAMBDA: number(1.0, 0.1, "lambda"), "pull.force": number(2.0, 1.0, "pull.force")}
    logs = [{"a b.h5": "1"}, {"c.h5": "2"}]
    pair = [fit(tmp_path, f"{at}.json", shared, logs=each) for at, each in enumerate(logs)]
    out = compared(drft, *pair)[1]
    assert "pull.force is known to 50 % at best, worse than the others." in out
    assert "drft design MODEL.toml --parameter pull.force\n" in out
    lone = [
        fit(tmp_path, f"{at}.json", {LAMBDA: shared[LAMBDA]}, logs=each)
        for at, each in enumerate(logs)
    ]
    assert "drft design --like 'a b.h5' --parameter lambda\n" in compared(drft, *lone)[1]


def test_a_parameter_of_one_fit_only_is_told(drft, tmp_path):
    one = fit(tmp_path, "a.json", {LAMBDA: number(1.0, 0.1, "lambda")})
    other = fit(tmp_path, "b.json", {MASS: number(1.0, 0.1, "mass_z")})
    out = compared(drft, one, other)[1]
    assert f"Only {one} fits lambda." in out
    assert f"Only {other} fits mass_z." in out


# Diagnoses ----------------------------------------------------------------------------------------


def diagnosis(folder: Path, name: str, verdict: str, size: float, **more: object) -> Path:
    """A diagnosis's file of one effect whose number has an error of 1."""
    document = {
        "schema": "drft-diagnosis",
        "schema_version": 1,
        "verdict": [verdict],
        "weights": {"none": 0.06, "brake": 0.04} | {verdict: 0.9},
        "groups": [],
        "parameters": {verdict: {"force": {"value": size, "error": 1.0, "unit": "N"}}},
        "next_run": {},
    }
    path = folder / name
    path.write_text(json.dumps(document | more))
    return path


ADVICE = {
    "tells": ["drawbar", "none"],
    "run": {
        "run": "at twice the speed",
        "channel": "x",
        "difference": 3.0,
        "unit": "mm",
        "floors": 5.0,
    },
    "channel": None,
}


def test_diagnoses_that_agree(drft, tmp_path):
    files = [diagnosis(tmp_path, f"{size}.json", "drawbar", size) for size in (10.0, 11.0)]
    document, out = compared(drft, *files)
    assert document["kind"] == "drft-diagnosis"
    assert document["weights"] == {"drawbar": [0.9, 0.9], "none": [0.06, 0.06]}
    (force,) = document["quantities"]
    assert force["agreement"]["chi_square"] == pytest.approx(1 / 2)
    assert "All name drawbar." in out
    assert "drawbar.force agrees within its errors." in out
    assert document["next"] == []


def test_a_diagnosis_of_either_layout_is_read_and_of_a_later_one_refused(drft, tmp_path):
    old = diagnosis(tmp_path, "old.json", "drawbar", 10.0)
    new = diagnosis(tmp_path, "new.json", "drawbar", 11.0, schema_version=2, budget={})
    assert compared(drft, old, new)[1].count("All name drawbar.") == 1
    later = diagnosis(tmp_path, "later.json", "drawbar", 11.0, schema_version=3)
    refused = drft("compare", old, later)
    assert refused.code == 2
    assert f"{later}: schema_version 3 is not known here (1 and 2 are)" in refused.err


def test_diagnoses_that_differ(drft, tmp_path):
    one = diagnosis(tmp_path, "a.json", "drawbar", 10.0, next_run=ADVICE)
    other = diagnosis(tmp_path, "b.json", "none", 0.0, parameters={}, groups=[["none", "drawbar"]])
    more = diagnosis(tmp_path, "c.json", "drawbar", 20.0)
    document, out = compared(drft, one, other, more)
    assert document["weights"] == {"none": [0.06, 0.9, 0.06], "drawbar": [0.9, None, 0.9]}
    assert f"{one} names drawbar; {other} names the reference model; {more} names drawbar." in out
    assert f"The runs of {other} cannot tell drawbar from what it names" in out
    assert "drawbar.force disagrees: 10.0 ± 1.0 N in" in out
    assert "lie 7.1 errors apart" in out
    sentence = (
        "To tell drawbar from the reference model: run at twice the speed, where x differs by 3 mm "
        "(5.0 noise floors)."
    )
    assert document["next"][0] == f"{one}: {sentence}"
    assert "weighs these verdicts against each other" in document["next"][1]


# Refusals -----------------------------------------------------------------------------------------


def test_results_that_cannot_be_compared_are_refused(drft, tmp_path, three):
    found = diagnosis(tmp_path, "found.json", "none", 0.0)
    text, other, broken = (tmp_path / name for name in ("text.json", "other.json", "broken.json"))
    text.write_text("no JSON")
    other.write_text('{"schema": "drft-design"}')
    broken.write_text('{"schema": "drft-fit", "schema_version": 1, "status": "converged"}')
    newer = fit(tmp_path, "newer.json", {}, schema_version=2)
    one = three[0]
    for arguments, said in (
        ([one, found], f"{one} is a fit and {found} a diagnosis; compare results of one kind"),
        ([one], f"{one} is one result; name two or more"),
        ([one, one], f"{one} is named twice"),
        ([one, text], f"{text}: is not JSON"),
        ([one, other], f"{other}: is a drft-design, must be the JSON file of a fit or of a diag"),
        ([one, broken], f"{broken}: the entry 'shared' is missing"),
        ([one, newer], f"{newer}: schema_version 2 is not known here"),
        ([one, tmp_path / "run.h5"], "run.h5: a result's file must end in .json"),
        ([one, tmp_path / "none.json"], "none.json: there is no such file"),
        ([*three, "-o", tmp_path / "a.txt"], "the file of --output must end in .json"),
        ([*three, "-o", one], f"{one} is read here and would be replaced"),
    ):
        assert said in drft("compare", *arguments).refusal
