"""The wheel: everything that an installed copy needs, and types that a type checker sees."""

import json
import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
UNREAD = (
    *("jax", "equinox", "optimistix", "lineax", "scipy", "matplotlib", "rich", "typer", "h5py"),
    *("arviz", "dask", "distributed", "ipykernel", "IPython", "prompt_toolkit", "xarray"),
)
PACKAGES = ("drftjax", "identify", "hils", "diagnose")
ANSWERS = sorted((ROOT / "data" / "blind").glob("*.json"))

PROGRAM = """
import drftjax
import diagnose.result
import hils.control.loop
from identify.parameters.parameter import own

reveal_type(drftjax.fit("run.h5"))
reveal_type(drftjax.Simulator)
reveal_type(drftjax.read_run("run.h5").measured.z)
reveal_type(diagnose.result.Diagnosis.summary)
reveal_type(hils.control.loop.TickLoop)
reveal_type(own("zeta"))
drftjax.fit(3.5)
drftjax.absent
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> zipfile.ZipFile:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (path,) = folder.glob("*.whl")
    return zipfile.ZipFile(path)


def data_in(wheel: zipfile.ZipFile) -> set[str]:
    """Data files of the wheel, relative to their folder."""
    home = "drftjax/_data/"
    return {each.removeprefix(home) for each in wheel.namelist() if each.startswith(home)}


def test_the_wheel_holds_modules_types_templates_and_data(wheel):
    held = set(wheel.namelist())
    for package in PACKAGES:
        assert f"{package}/py.typed" in held
        files = [each for each in (ROOT / package).rglob("*") if each.suffix in (".py", ".pyi")]
        assert files
        assert {each.relative_to(ROOT).as_posix() for each in files} <= held
    assert {"drftjax/__init__.pyi", "diagnose/report/templates/report.html"} <= held
    scripts = {"curves.js", "uplot/uPlot.iife.min.js", "uplot/LICENSE"}
    assert {f"drftjax/report_page/templates/{each}" for each in scripts} <= held
    for name in ("paper.toml", "runs/fast.h5", "import/cmu_intrusion.toml", "blind/demo/run_a.h5"):
        assert wheel.read(f"drftjax/_data/{name}") == (ROOT / "data" / name).read_bytes()
    assert data_in(wheel) == {
        each.relative_to(ROOT / "data").as_posix()
        for each in (ROOT / "data").rglob("*")
        if each.is_file() and each not in ANSWERS
    }
    strange = {each.partition("/")[0] for each in held if ".dist-info/" not in each} - {*PACKAGES}
    assert strange == set()


def test_the_wheel_holds_no_answers_of_blind_tests(wheel):
    assert len(ANSWERS) >= 3
    assert not data_in(wheel) & {f"blind/{each.name}" for each in ANSWERS}


def test_the_wheel_names_its_commands_and_licence(wheel):
    (info,) = {each.partition("/")[0] for each in wheel.namelist() if ".dist-info/" in each}
    points = wheel.read(f"{info}/entry_points.txt").decode()
    assert "drft = drftjax.commands.entry:main" in points
    metadata = wheel.read(f"{info}/METADATA").decode()
    assert "License-Expression: Apache-2.0" in metadata
    assert "Classifier: Typing :: Typed" in metadata
    assert f"{info}/licenses/LICENSE" in wheel.namelist()


@pytest.fixture(scope="module")
def outside(wheel, tmp_path_factory) -> Path:
    """Folder with a program, and an environment `env` in which the wheel is installed."""
    folder = tmp_path_factory.mktemp("outside")
    venv.create(folder / "env", with_pip=False)
    (site,) = (folder / "env").glob("lib/python*/site-packages")
    wheel.extractall(site)
    # The dependencies; plain lines of their own .pth files, such as the checkout's, do not count.
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    (folder / "program.py").write_text(PROGRAM)
    # mypy reads our own modules and NumPy's; the others would take it four fifths of its time.
    others = ",".join(f"{each}.*" for each in UNREAD)
    (folder / "mypy.ini").write_text(f"[mypy]\n[mypy-{others}]\nfollow_imports = skip\n")
    return folder


def test_mypy_sees_the_types_of_an_installed_wheel(outside):
    python = outside / "env" / "bin" / "python"
    answer = subprocess.run(
        [sys.executable, "-m", "mypy", "--python-executable", str(python), "program.py"],
        cwd=outside,
        env={name: value for name, value in os.environ.items() if name != "MYPYPATH"},
        capture_output=True,
        text=True,
    )
    revealed = [line.split('"')[1] for line in answer.stdout.splitlines() if "Revealed" in line]
    ends = [each.rpartition(" -> ")[2] for each in revealed]
    assert ends == [
        "identify.results.result.FitResult",
        "drftjax.simulation.simulator.Simulator",
        "numpy.ndarray[tuple[Any, ...], numpy.dtype[numpy.float64]] | None",
        "str",
        "hils.control.loop.TickLoop",
        "identify.parameters.parameter.Parameter",
    ], answer.stdout
    errors = [line for line in answer.stdout.splitlines() if ": error: " in line]
    assert sorted(each.split("[")[-1][:-1] for each in errors) == ["arg-type", "attr-defined"]


def test_pyright_sees_the_types_of_an_installed_wheel(outside):
    python = outside / "env" / "bin" / "python"
    answer = subprocess.run(
        [
            sys.executable,
            "-m",
            "pyright",
            "--pythonpath",
            str(python),
            "--outputjson",
            "program.py",
        ],
        cwd=outside,
        env=os.environ | {"PYRIGHT_PYTHON_IGNORE_WARNINGS": "1"},
        capture_output=True,
        text=True,
    )
    found = json.loads(answer.stdout)["generalDiagnostics"]
    revealed = [
        each["message"].split('"')[-2] for each in found if each["severity"] == "information"
    ]
    assert revealed == [
        "FitResult",
        "type[Simulator]",
        "ndarray[tuple[Any, ...], dtype[float64]] | None",
        "(self: Diagnosis, width: int = 110) -> str",
        "type[TickLoop]",
        "Parameter",
    ], answer.stdout
    errors = [each["rule"] for each in found if each["severity"] == "error"]
    assert sorted(errors) == ["reportArgumentType", "reportAttributeAccessIssue"], answer.stdout
