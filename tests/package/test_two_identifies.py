"""This project beside the distribution `identify` of pre-commit: two packages of one name.

Whichever is installed last writes `identify/__init__.py`, and whichever is removed takes that file
along. Installation and removal are simulated with the wheel of this project and with a distribution
that has the modules of `identify` 2.6; an editable installation by the order of two folders on the
path. All programs run without `site`, so that nothing else that is installed here is found first.
"""

import os
import subprocess
import sys
import sysconfig
import zipfile
from collections.abc import Sequence
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DEPENDENCIES = sysconfig.get_path("purelib")
SHARED_FILE = "identify/__init__.py"

OTHER_FILES = {
    SHARED_FILE: "",
    "identify/cli.py": "from identify import identify\n",
    "identify/extensions.py": "EXTENSIONS = {'py': {'python', 'text'}}\n",
    "identify/identify.py": (
        "from identify import extensions, interpreters\n"
        "from identify.vendor import licenses\n\n"
        "def tags_from_filename(path): return extensions.EXTENSIONS[path.rpartition('.')[2]]\n"
    ),
    "identify/interpreters.py": "INTERPRETERS = {}\n",
    "identify/vendor/__init__.py": "",
    "identify/vendor/licenses.py": "LICENSES = ()\n",
}

OURS_WORKS = (
    "import drftjax, sys\n"
    "assert drftjax.fit.__module__ == 'identify.api', drftjax.fit\n"
    "import identify.cluster.worker, identify.cluster.evaluator\n"
    "print(drftjax.__file__, identify.cluster.__path__[0], sep='\\n')\n"
)
OTHER_WORKS = (
    "import identify.cli\n"
    "from identify import identify\n"
    "assert identify.tags_from_filename('wheel.py') == {'python', 'text'}\n"
)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """The wheel of this checkout."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    return next(folder.glob("*.whl"))


class Site:
    """A folder that distributions are installed into, as pip does it, file by file."""

    def __init__(self, folder: Path, wheel: Path):
        self.folder, self._wheel = folder, wheel

    def install_ours(self) -> None:
        with zipfile.ZipFile(self._wheel) as archive:
            archive.extractall(self.folder)

    def install_other(self) -> None:
        for name, text in OTHER_FILES.items():
            path = self.folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)

    def remove_ours(self) -> None:
        with zipfile.ZipFile(self._wheel) as archive:
            self._remove(archive.namelist())

    def remove_other(self) -> None:
        self._remove(OTHER_FILES)

    def _remove(self, names) -> None:
        for name in names:
            (self.folder / name).unlink(missing_ok=True)


@pytest.fixture
def site(tmp_path, wheel) -> Site:
    return Site(tmp_path / "site", wheel)


def program(path: Sequence[Path], arguments: Sequence[str], cwd: Path) -> str:
    """What a program prints that finds packages in these folders and then among the dependencies.

    It is started in `cwd`, which Python itself puts first for `-c` and `-m`, but not with `-P`.
    """
    folders = [*map(str, path), DEPENDENCIES]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(folders)}
    answer = subprocess.run(
        [sys.executable, "-S", *arguments],
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert answer.returncode == 0, answer.stderr
    return answer.stdout


def require_ours(path: Sequence[Path], cwd: Path, home: Path) -> None:
    """`drftjax.fit`, `identify.cluster` and `drft fit` work, and are those in the folder `home`."""
    found = program(path, ["-c", OURS_WORKS], cwd).splitlines()
    assert found == [str(home / "drftjax" / "__init__.py"), str(home / "identify" / "cluster")]
    # The program `drft` has its own folder first on its path, and not the current one.
    help_text = program(path, ["-P", "-m", "drftjax.commands.main", "fit", "--help"], cwd)
    assert "Usage: drft fit" in help_text


def require_other(path: Sequence[Path], cwd: Path) -> None:
    """`identify.identify` works, with what it imports."""
    program(path, ["-c", OTHER_WORKS], cwd)


@pytest.mark.parametrize("last", ["ours", "other"])
def test_both_work_in_whichever_order_they_are_installed(site, tmp_path, last):
    installs = {"ours": site.install_ours, "other": site.install_other}
    for each in sorted(installs, key=lambda name: name == last):
        installs[each]()
    # The other's file is empty, ours is not: the last one has written it.
    assert bool((site.folder / SHARED_FILE).read_text()) is (last == "ours")
    require_ours([site.folder], tmp_path, site.folder)
    require_other([site.folder], tmp_path)


@pytest.mark.parametrize("last", ["ours", "other"])
def test_ours_works_after_the_other_is_removed(site, tmp_path, last):
    site.install_other()
    site.install_ours()
    if last == "other":
        site.install_other()
    site.remove_other()
    assert not (site.folder / SHARED_FILE).exists()
    require_ours([site.folder], tmp_path, site.folder)


def test_the_other_works_after_ours_is_removed(site, tmp_path):
    site.install_ours()
    site.install_other()
    site.remove_ours()
    assert not (site.folder / SHARED_FILE).exists()
    require_other([site.folder], tmp_path)


@pytest.mark.parametrize("in_checkout", [False, True], ids=["elsewhere", "in the checkout"])
@pytest.mark.parametrize("first", ["checkout", "site"])
def test_both_work_where_ours_is_editable(site, tmp_path, first, in_checkout):
    site.install_other()
    path = [ROOT, site.folder] if first == "checkout" else [site.folder, ROOT]
    cwd = ROOT if in_checkout else tmp_path
    require_ours(path, cwd, ROOT)
    require_other(path, cwd)
