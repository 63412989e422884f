"""Every module imports on a system without the modules that only Unix has."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

# In a process of its own: imports every module of ours while its own import statements find
# none of the modules that only Unix has; other packages may, as they differ by system.
IMPORT_ALL = """
import builtins, importlib, sys
from pathlib import Path

UNIX = {"fcntl", "resource", "termios", "pty", "tty"}
OURS = {"drftjax", "identify", "hils", "diagnose"}
original = builtins.__import__

def without_unix(name, globals=None, locals=None, fromlist=(), level=0):
    importer = (globals or {}).get("__name__", "")
    if name in UNIX and importer.partition(".")[0] in OURS:
        raise ModuleNotFoundError(f"{importer} imports {name}")
    return original(name, globals, locals, fromlist, level)

builtins.__import__ = without_unix
for package in sorted(OURS):
    names = sorted(
        ".".join(path.with_suffix("").parts).removesuffix(".__init__")
        for path in Path(package).rglob("*.py")
    )
    assert len(names) > 30, names
    for name in names:
        try:
            importlib.import_module(name)
        except ModuleNotFoundError as error:
            print(f"{name}: {error}")
"""


def test_imports_without_unix_modules():
    answer = subprocess.run(
        [sys.executable, "-c", IMPORT_ALL],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout == ""
