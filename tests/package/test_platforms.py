"""Everything but the recorder, the rig ends and the live view imports without Unix modules."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

# In a process of its own: imports every module of a package while its own import statements find
# none of the modules that only Unix has. Other packages have their own ways on other systems.
IMPORT_ALL = """
import builtins, importlib, sys
from pathlib import Path

UNIX = {"fcntl", "resource", "termios", "pty", "tty"}
OURS = {"drftjax", "identify", "hils", "diagnose"}
package, excepted = sys.argv[1], set(sys.argv[2:])
original = builtins.__import__

def without_unix(name, globals=None, locals=None, fromlist=(), level=0):
    importer = (globals or {}).get("__name__", "")
    if name in UNIX and importer.partition(".")[0] in OURS:
        raise ModuleNotFoundError(f"{importer} imports {name}")
    return original(name, globals, locals, fromlist, level)

builtins.__import__ = without_unix
root = Path(package)
names = sorted(
    ".".join(path.with_suffix("").parts).removesuffix(".__init__") for path in root.rglob("*.py")
)
assert len(names) > 30, names
missing = excepted - set(names)
assert not missing, f"no such module: {missing}"
for name in names:
    if name not in excepted:
        try:
            importlib.import_module(name)
        except ModuleNotFoundError as error:
            print(f"{name}: {error}")
"""

# The recorder and its pipe, the simulated rig's end of the line, and the terminal of the live view.
EXCEPTED = {
    "drftjax": (),
    "identify": (),
    "hils": (
        "hils.recording.recorder",
        "hils.recording.recorder_process",
        "hils.rig_sim.endpoints",
        "hils.monitor.terminal",
        "hils.monitor.view_process",
    ),
    "diagnose": (),
}


@pytest.mark.parametrize("package", EXCEPTED)
def test_imports_without_unix_modules(package):
    answer = subprocess.run(
        [sys.executable, "-c", IMPORT_ALL, package, *EXCEPTED[package]],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout == ""
