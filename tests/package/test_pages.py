"""The pages: commands that the parser takes, links and a navigation that lead somewhere, a site."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from typer.main import get_command

from drftjax.commands.main import app

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
# Written from the help texts, with all forms of a command.
GENERATED = DOCS / "reference" / "commands.md"
# A run of a thousand steps on another processor, whose sums are of another order.
OF_PROCESSORS = 1e-5
# A step of 1e-3 in zeta across the corners of plates that touch; see docs/theory/integrator.md.
OF_DIFFERENCES = 1e-3
# Forward and reverse are the same algebra in another order.
OF_MODES = 1e-9
SHELL = {"|", ">", "2>", "&", "&&", ";"}


def commands(text: str) -> Iterator[list[str]]:
    """Words of each line of a code block that begins with drft, less what is the shell's."""
    fenced = re.findall(r"^```\w*\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    indented = re.findall(r"^    (.*\n)", text, re.MULTILINE)
    code = re.sub(r"\\\n\s*", " ", "".join(fenced + indented))
    for line in re.findall(r"^drft .*$", code, re.MULTILINE):
        words = shlex.split(line, comments=True)
        end = next((place for place, word in enumerate(words) if word in SHELL), len(words))
        if "..." not in words:  # the page leaves a part out
            yield words[1:end]


def parse(words: list[str]) -> None:
    """Parse a command line as `drft` does, without running it."""
    command, left = get_command(app), list(words)
    while left and hasattr(command, "commands") and not left[0].startswith("-"):
        name = left.pop(0)
        command = command.get_command(None, name)
        assert command is not None, f"there is no {name}"
    if left not in (["--help"], ["--version"]):
        command.make_context(command.name, left)


@pytest.mark.parametrize(
    "page", [ROOT / "README.md", *PAGES], ids=lambda page: page.relative_to(ROOT).as_posix()
)
def test_commands_of_a_page_are_commands_of_drft(page):
    if page == GENERATED:
        return
    failed = []
    for words in commands(page.read_text()):
        try:
            parse(words)
        except Exception as error:
            failed.append(f"drft {shlex.join(words)}: {error or error.__class__.__name__}")
    assert not failed, "\n".join(failed)


def test_parser_refuses_what_is_no_command():
    page = "    drft simulat x\n    drft fit\n    drft fit runs \\\n        --outptu out/fit\n"
    found = list(commands(page + "```\ndrft log chek x | tee log\n```\n"))
    assert len(found) == 4
    for words in found:
        with pytest.raises(Exception, match=r"(?i)there is no \w+|no such option|missing"):
            parse(words)


@pytest.mark.parametrize("page", ["README.md", "docs/start/tutorial.md"])
def test_data_that_a_start_page_names_is_there(page):
    named = re.findall(r"\bdata/[\w./*-]*\w", (ROOT / page).read_text())
    assert len(named) > 3
    assert all(list(ROOT.glob(path)) for path in named)


def navigation(entries: list) -> Iterator[str]:
    for entry in entries:
        (target,) = entry.values()
        yield from navigation(target) if isinstance(target, list) else [target]


def test_navigation_lists_every_page_once():
    # The site is built without a word where it does not.
    listed = list(navigation(yaml.safe_load((ROOT / "mkdocs.yml").read_text())["nav"]))
    assert sorted(listed) == sorted(page.relative_to(DOCS).as_posix() for page in PAGES)


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", "data/README.md"])
def test_links_outside_the_site_lead_to_files(name):
    page = ROOT / name
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text()):
        assert "://" in target or (page.parent / target).exists(), target


def test_site_is_whole_and_loads_nothing_from_the_network(tmp_path):
    shutil.copytree(DOCS, tmp_path / "docs")
    shutil.copy(ROOT / "mkdocs.yml", tmp_path)
    built = subprocess.run(
        [sys.executable, "-m", "zensical", "build", "--strict"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert built.returncode == 0, built.stdout + built.stderr
    pages = {page: page.read_text() for page in (tmp_path / "site").rglob("*.html")}
    assert len(pages) > len(PAGES)
    for page, text in pages.items():
        loaded = re.findall(r"<(?:script|img|iframe)[^>]*src=\"([^\"]+)", text)
        loaded += re.findall(r"<link[^>]*rel=\"(?:stylesheet|icon)\"[^>]*href=\"([^\"]+)", text)
        assert loaded
        assert not [each for each in loaded if re.match(r"(?:https?:)?//", each)], page
    # The index that the search reads where pages are opened from a folder.
    assert "Ten minutes with the example" in (tmp_path / "site" / "search.js").read_text()
    # Formulas need no program to be drawn.
    assert "<math" in pages[tmp_path / "site" / "theory" / "fit-method.html"]


def test_example_of_batches_prints_what_its_page_says():
    text = (DOCS / "guide" / "batches.md").read_text()
    code, said = re.search(r"```python\n(.*?)```.*?```\n(.*?)```", text, re.DOTALL).groups()
    # What the tests chose for JAX must not carry the reader's program.
    environment = {name: value for name, value in os.environ.items() if "JAX" not in name}
    answer = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True
    )
    assert answer.returncode == 0, answer.stderr
    shown, printed = (
        np.array(re.findall(r"-?\d+\.\d+", part), float) for part in (said, answer.stdout)
    )
    one_by_one, side_by_side, rest = np.split(printed, [10, 20])
    np.testing.assert_allclose([*one_by_one, *rest], shown, rtol=OF_PROCESSORS)
    np.testing.assert_allclose(side_by_side, one_by_one, rtol=OF_PROCESSORS)
    forward, difference, (reverse,) = np.split(rest, [2, 4])
    np.testing.assert_allclose(forward, difference, rtol=OF_DIFFERENCES)
    np.testing.assert_allclose(reverse, forward[0], rtol=OF_MODES)
