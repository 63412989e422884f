"""The package, its root command and its lock, seen from outside as a user sees them."""

import ast
import os
import re
import subprocess
import sys
import tomllib
from importlib.metadata import version
from itertools import chain
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

import drftjax

ROOT = Path(__file__).resolve().parents[2]
DRFT = [sys.executable, "-m", "drftjax.commands.main"]
SLOW_PACKAGES = ("jax", "equinox", "optimistix", "matplotlib", "h5py", "numpy", "dask")

SPEAKING_PLUGIN = """
import typer
app = typer.Typer()

@app.command()
def whatever(times: int = 1):
    '''Say hello to the sand.'''
    print("hello sand " * times)
"""

GROUP_PLUGIN = """
import typer
app = typer.Typer()

@app.command()
def rake(): print("raked")

@app.command()
def water(): print("watered")
"""

FAILING_PLUGIN = """
import typer
app = typer.Typer()

@app.command()
def fail(how: str):
    from drftjax.common.errors import InputError
    if how == "input":
        raise InputError("the wheel radius is 150 m, not below 2 m, in rig.toml")
    if how == "interrupt":
        raise KeyboardInterrupt
    if how == "swallowed":
        import gc, signal
        # Ignored where a shell started the tests in the background.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        def collecting(phase, info):
            gc.callbacks.remove(collecting)
            signal.raise_signal(signal.SIGINT)
        gc.callbacks.append(collecting)
        gc.collect()
        import time
        time.sleep(30)
        print("went on as if nothing had been")
    if how == "full":
        raise OSError(28, "No space left on device", "run.h5")
    if how == "bug":
        raise ZeroDivisionError("a defect of the program")
    for _ in range(100_000):
        print("a line that nobody reads")
"""


@pytest.fixture
def drft(tmp_path):
    """Run `drft` in a process of its own, with a user's package that adds subcommands."""

    def install(**plugins: str) -> None:
        metadata = tmp_path / "sandbox-1.2.dist-info"
        metadata.mkdir()
        (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: sandbox\nVersion: 1.2\n")
        lines = [f"{name} = sandbox_{name}:app" for name in plugins]
        (metadata / "entry_points.txt").write_text("[drft.commands]\n" + "\n".join(lines) + "\n")
        for name, source in plugins.items():
            (tmp_path / f"sandbox_{name}.py").write_text(source)

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        environment = os.environ | {"PYTHONPATH": str(tmp_path), "COLUMNS": "100"}
        return subprocess.run(
            [*DRFT, *arguments], env=environment, capture_output=True, text=True, check=False
        )

    run.install = install
    return run


def test_version_is_the_installed_one(drft):
    assert drftjax.__version__ == version("drftjax")
    assert drft("--version").stdout == f"drft {drftjax.__version__}\n"


def test_help_imports_nothing_slow():
    code = (
        "import sys; from drftjax.commands.main import main\n"
        "sys.argv = ['drft', '--help']\n"
        "try: main()\n"
        f"finally: print('loaded:', [name for name in {SLOW_PACKAGES} if name in sys.modules])"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert answer.returncode == 0
    assert "Usage: drft" in answer.stdout
    assert "loaded: []" in answer.stdout


@pytest.mark.parametrize("group", [(), ("log",), ("hils",), ("blind",)])
def test_help_cuts_no_summary_short(group):
    environment = os.environ | {"COLUMNS": "80"}
    answer = subprocess.run(
        [*DRFT, *group, "--help"], env=environment, capture_output=True, text=True, check=True
    )
    commands = answer.stdout.split("Commands:")[1].splitlines()
    assert len(commands) > 3
    assert max(map(len, commands)) <= 80
    assert not any(line.endswith("...") for line in commands)


def test_importing_the_package_does_not_import_jax():
    code = "import sys, drftjax; dir(drftjax); sys.exit('jax' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_every_public_name_is_there():
    for name in drftjax.__all__:
        assert getattr(drftjax, name) is not None
    assert set(drftjax.__all__) <= set(dir(drftjax))
    with pytest.raises(AttributeError, match="no attribute 'Wheeel'"):
        drftjax.Wheeel  # noqa: B018


def test_type_checkers_see_the_same_public_names():
    tree = ast.parse(Path(drftjax.__file__).with_suffix(".pyi").read_text())
    imported = {
        alias.asname: statement.module
        for statement in tree.body
        if isinstance(statement, ast.ImportFrom)
        for alias in statement.names
    }
    assert imported == drftjax._HOMES


def test_subcommands_that_ship_all_load(drft):
    answer = drft("--help")
    for name in ("log", "simulate", "fit"):
        assert re.search(rf"^  {name} ", answer.stdout, re.MULTILINE)
    assert "Does not load" not in answer.stdout


def test_app_with_one_command_is_the_subcommand_itself(drft):
    drft.install(greet=SPEAKING_PLUGIN)
    assert "Say hello to the sand." in drft("--help").stdout
    assert drft("greet", "--times", "2").stdout == "hello sand hello sand \n"
    assert "--install-completion" not in drft("greet", "--help").stdout


def test_app_with_several_commands_is_a_group(drft):
    drft.install(garden=GROUP_PLUGIN)
    assert drft("garden", "rake").stdout == "raked\n"


@pytest.mark.parametrize(
    "source", ["import package_that_is_absent", "app = 3", "import sys; sys.exit('no display')"]
)
def test_broken_plugin_is_named_and_harms_nothing_else(drft, source):
    drft.install(broken=source, greet=SPEAKING_PLUGIN)
    listing = drft("--help")
    assert listing.returncode == 0
    assert re.search(r"^  broken +Does not load \(\w+\)", listing.stdout, re.MULTILINE)
    assert drft("greet").stdout == "hello sand \n"

    refusal = drft("broken", "file.h5", "--option")
    assert refusal.returncode == 2
    assert refusal.stderr.startswith("drft: the subcommand 'broken' (sandbox 1.2: sandbox_broken:")
    assert refusal.stderr.count("\n") == 1


def test_typo_shows_the_nearest_names(drft):
    answer = drft("simulat")
    assert answer.returncode == 2
    assert "Did you mean 'simulate'?" in answer.stderr


@pytest.mark.parametrize(
    ("how", "code", "said"),
    [
        ("input", 2, "drft: the wheel radius is 150 m, not below 2 m, in rig.toml\n"),
        ("interrupt", 130, "drft: interrupted\n"),
        ("swallowed", 130, "drft: interrupted\n"),
        ("full", 2, "drft: run.h5: No space left on device\n"),
    ],
)
def test_what_a_user_can_mend_is_one_sentence(drft, how, code, said):
    drft.install(fail=FAILING_PLUGIN)
    answer = drft("fail", how)
    assert (answer.returncode, answer.stderr) == (code, said)


def test_defect_keeps_its_traceback(drft):
    drft.install(fail=FAILING_PLUGIN)
    answer = drft("fail", "bug")
    assert answer.returncode == 1
    assert "Traceback" in answer.stderr


def test_reader_that_leaves_early_is_no_error(drft, tmp_path):
    drft.install(fail=FAILING_PLUGIN)
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    with subprocess.Popen(
        [*DRFT, "fail", "pipe"], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as program:
        program.stdout.readline()
        program.stdout.close()
        assert program.stderr.read() == b""


def test_unwritable_cache_folder_stops_no_program(tmp_path):
    blocked = tmp_path / "cache"
    blocked.write_text("a file where a folder should be")
    code = (
        "from drftjax.common.jax_config import configure_jax\n"
        "configure_jax(precision='float32', devices=3)\n"
        "import jax, jax.numpy as jnp\n"
        "assert jnp.ones(1).dtype == jnp.float32\n"
        "assert len(jax.devices('cpu')) == 3\n"
        "configure_jax(devices=4)\n"
        "assert jnp.ones(1).dtype == jnp.float64\n"
    )
    environment = os.environ | {"XDG_CACHE_HOME": str(blocked)}
    del environment["JAX_COMPILATION_CACHE_DIR"]
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)


def test_lock_has_hashes_and_no_addresses():
    lock = (ROOT / "requirements.lock").read_text()
    assert "://" not in lock
    entries = re.split(r"^(?=[a-z0-9])", lock, flags=re.MULTILINE)[1:]
    assert entries
    assert all("==" in entry and "--hash=sha256:" in entry for entry in entries)


def test_lock_holds_what_every_direct_dependency_asks_for():
    locked = dict(
        re.findall(r"^([a-z0-9-]+)==([^ ]+)", (ROOT / "requirements.lock").read_text(), re.M)
    )
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    for extra, requirements in ({"": project["dependencies"]} | extras).items():
        for requirement in map(Requirement, requirements):
            version = Version(locked[requirement.name])
            assert version in requirement.specifier, requirement
            # A release 0.x may break what the one before had; the tools of the project are locked.
            if version.major == 0 and extra not in ("dev", "docs"):
                following = Version(f"0.{version.minor + 1}")
                assert following not in requirement.specifier, requirement


def test_lock_names_every_direct_dependency():
    locked = set(re.findall(r"^([a-z0-9-]+)==", (ROOT / "requirements.lock").read_text(), re.M))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"].values()
    for requirement in chain(project["dependencies"], *extras):
        assert re.match(r"[\w-]+", requirement)[0] in locked


def test_layers_hold():
    answer = subprocess.run(
        [Path(sys.executable).with_name("lint-imports"), "--no-cache"],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert answer.returncode == 0, answer.stdout + answer.stderr
