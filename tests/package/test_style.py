"""Rules of the source that no linter knows: names, first lines of docstrings, sizes, folders.

CONTRIBUTING.md states them with their reasons.
"""

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("drftjax", "identify", "hils", "diagnose")
SOURCES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
TESTS = sorted((ROOT / "tests").rglob("*.py"))

INTERROGATIVES = {"what", "whether", "how", "where", "when", "which"}
MAX_LINES = 500
MAX_MODULES = 12
# One file for each group of a run log's contents, and one for each stage of the simulation step.
MAX_MODULES_OF = {"drftjax/runlog": 14, "drftjax/effects": 14}
# The modules of the distribution `identify`, which pre-commit brings along.
TAKEN_IN_IDENTIFY = {"cli", "extensions", "identify", "interpreters", "vendor"}

Definition = ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def place(path: Path) -> str:
    """A path from the root of the repository, with slashes."""
    return path.relative_to(ROOT).as_posix()


def public_definitions(body: list[ast.stmt]) -> Iterator[Definition]:
    """Public classes and functions of a module, and those of its public classes."""
    for node in body:
        if isinstance(node, Definition) and not node.name.startswith("_"):
            yield node
            if isinstance(node, ast.ClassDef):
                yield from public_definitions(node.body)


def documented(path: Path) -> Iterator[tuple[int, str]]:
    """The line and the docstring of a module and of each of its public definitions."""
    module = ast.parse(path.read_text(encoding="utf-8"))
    for node in (module, *public_definitions(module.body)):
        if docstring := ast.get_docstring(node):
            yield node.body[0].lineno, docstring


def bound_names(path: Path) -> set[str]:
    """The names that the statements of a module bind, but for those inside blocks."""
    names = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Import | ast.ImportFrom):
            names |= {alias.asname or alias.name for alias in node.names}
        elif isinstance(node, Definition):
            names.add(node.name)
        else:
            stored = (each for each in ast.walk(node) if isinstance(each, ast.Name))
            names |= {each.id for each in stored if isinstance(each.ctx, ast.Store)}
    return names


def imported_modules(statement: ast.Import | ast.ImportFrom) -> list[str]:
    """The modules that a statement imports or imports from, as they are written there."""
    if isinstance(statement, ast.Import):
        return [alias.name for alias in statement.names]
    return ["." * statement.level + (statement.module or "")]


def test_the_sources_are_found():
    assert {place(path).split("/")[0] for path in SOURCES} == set(PACKAGES)
    assert Path(__file__) in TESTS


def test_no_public_docstring_begins_with_an_interrogative():
    found = [
        f"{place(path)}:{line}: {docstring.splitlines()[0]}"
        for path in SOURCES
        for line, docstring in documented(path)
        if docstring.split()[0].strip(".,:;").lower() in INTERROGATIVES
    ]
    assert not found, f"{len(found)} docstrings begin with an interrogative:\n" + "\n".join(found)


def test_no_public_class_name_stands_twice():
    places = defaultdict(list)
    for path in SOURCES:
        module = ast.parse(path.read_text(encoding="utf-8"))
        for node in public_definitions(module.body):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(f"{place(path)}:{node.lineno}")
    twice = [f"{name}: {', '.join(at)}" for name, at in sorted(places.items()) if len(at) > 1]
    assert not twice, "\n".join(twice)


def test_no_folder_is_too_full():
    modules = defaultdict(int)
    for path in SOURCES:
        modules[place(path.parent)] += path.name != "__init__.py"
    full = {
        folder: count
        for folder, count in modules.items()
        if count > MAX_MODULES_OF.get(folder, MAX_MODULES)
    }
    assert not full


def test_no_file_is_too_long():
    lengths = {place(path): len(path.read_text().splitlines()) for path in (*SOURCES, *TESTS)}
    assert not {path: length for path, length in lengths.items() if length > MAX_LINES}


def test_identify_shares_no_module_with_the_other_distribution_of_that_name():
    inside = {path.relative_to(ROOT / "identify") for path in (ROOT / "identify").rglob("*")}
    taken = {path.as_posix() for path in inside if path.stem in TAKEN_IN_IDENTIFY}
    assert not taken


def test_identify_defines_no_name():
    # Of two files of this name one is lost; the path is a help that both do without.
    assert bound_names(ROOT / "identify" / "__init__.py") == {"extend_path", "__path__"}


@pytest.mark.parametrize("package", PACKAGES)
def test_tests_lie_where_what_they_test_lies(package):
    tests = {
        path.parent.relative_to(ROOT / "tests")
        for path in TESTS
        if place(path).startswith(f"tests/{package}/")
    }
    assert tests
    assert not [folder.as_posix() for folder in tests if not (ROOT / folder).is_dir()]


def test_no_folder_of_tests_is_a_package_but_the_studies():
    # `tests/drftjax` must never be taken for `drftjax`.
    packages = [place(path) for path in TESTS if path.name == "__init__.py"]
    assert packages == ["tests/studies/__init__.py"]


def test_modules_of_tests_are_imported_by_their_whole_name():
    short = {path.stem for path in TESTS} - {"__init__", "conftest"}
    found = [
        f"{place(path)}:{node.lineno}: {name}"
        for path in TESTS
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in imported_modules(node)
        if name.startswith(".") or name in short
    ]
    assert not found, "\n".join(found)
