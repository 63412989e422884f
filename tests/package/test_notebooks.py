"""Every notebook runs from top to bottom, in a copy, and shows what is stored in it."""

import re
from itertools import zip_longest

import nbformat
import pytest

from tests.helpers.notebooks import FOLDER, NOTEBOOKS, NotebookRun, copy_of, errors, run_notebooks
from tests.helpers.notebooks import printed as printed_by

# Numbers are stored as one processor printed them. Another one rounds sums otherwise; where a
# tuner or a solver decides by a threshold, that shows in the third digit.
SHARE = 0.02
# And the last digit that is printed may be rounded to either side.
LAST_DIGITS = 1.5

# All files with their pictures: what a clone of the repository can bear.
MOST_BYTES = 1.5e6

NUMBER = re.compile(r"[-+]?\d+(?:\.(\d+))?(?:e[-+]?\d+)?")
MEASURED = FOLDER / "9_measured.ipynb"


@pytest.fixture(scope="module")
def ran(tmp_path_factory) -> dict[str, NotebookRun]:
    """The notebooks with their new outputs, and, last, one that lacks the measured data."""
    copies = copy_of(tmp_path_factory.mktemp("all"), NOTEBOOKS, measured=True)
    copies += copy_of(tmp_path_factory.mktemp("none"), [MEASURED], measured=False)
    names = [*(path.stem for path in NOTEBOOKS), "without data"]
    return dict(zip(names, run_notebooks(copies), strict=True))


def differences(stored: str, found: str) -> list[str]:
    """Numbers of two texts that differ by more than the tolerance, and words that differ."""
    if NUMBER.sub("#", stored).split() != NUMBER.sub("#", found).split():
        return [f"{stored!r} is now {found!r}"]
    told = []
    for old, new in zip(NUMBER.finditer(stored), NUMBER.finditer(found), strict=True):
        before, after = float(old.group()), float(new.group())
        last = 10.0 ** -len(old.group(1) or "")
        if not abs(after - before) <= max(SHARE * abs(before), LAST_DIGITS * last):
            told.append(f"{old.group()} is now {new.group()}")
    return told


def test_there_are_notebooks():
    assert len(NOTEBOOKS) == 9


@pytest.mark.parametrize("name", [*(path.stem for path in NOTEBOOKS), "without data"])
def test_notebook_runs(ran, name):
    assert not errors(ran[name].notebook)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_stored_outputs_are_those_of_the_cells(ran, path):
    if path == MEASURED and not (FOLDER.parent.parent / "shared" / "measured").is_dir():
        pytest.skip("there is no folder ../shared with measured data beside the repository")
    stored = nbformat.read(path, as_version=4)
    nbformat.validate(stored)
    texts = zip_longest(printed_by(stored), printed_by(ran[path.stem].notebook), fillvalue="")
    assert not [each for old, new in texts for each in differences(old, new)]
    assert pictures(stored) == pictures(ran[path.stem].notebook) > 0


def pictures(notebook: nbformat.NotebookNode) -> int:
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    return sum(any(k.startswith("image/") for k in each.get("data", {})) for each in outputs)


def test_notebook_tells_which_data_are_missing(ran):
    found = printed_by(ran["without data"].notebook)
    assert len(found) == 1
    lines = found[0].splitlines()
    assert [line.split()[:2] for line in lines] == [
        ["no", "all_smooth_data.csv"],
        ["no", "BM1_120.h5"],
    ]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_results_show_themselves_once(path):
    # A result shows itself once: its table is not printed beside.
    for cell in nbformat.read(path, as_version=4).cells:
        assert sum("text/html" in each.get("data", {}) for each in cell.get("outputs", [])) <= 1


def test_notebooks_are_small_and_hold_no_path_of_a_machine():
    assert sum(path.stat().st_size for path in NOTEBOOKS) < MOST_BYTES
    texts = {path.stem: path.read_text(encoding="utf-8") for path in NOTEBOOKS}
    places = (str(FOLDER.parent), "/tmp/")
    assert not [name for name, text in texts.items() if any(each in text for each in places)]


@pytest.mark.parametrize(
    ("found", "told"),
    [
        ("z 0.1234 mm, 12 runs", []),
        ("z 0.1250 mm, 12 runs", []),
        ("z 0.1300 mm, 12 runs", ["0.1234 is now 0.1300"]),
        ("z 0.1234 mm, 15 runs", ["12 is now 15"]),
        ("x 0.1234 mm, 12 runs", ["'z 0.1234 mm, 12 runs' is now 'x 0.1234 mm, 12 runs'"]),
    ],
)
def test_a_stored_number_that_is_wrong_is_found(found, told):
    assert differences("z 0.1234 mm, 12 runs", found) == told
