"""Tables at the width of a page."""

import io

import pytest
from rich.console import Console
from rich.table import Table

from drftjax.common.rich_text import WholeWordTable, summary_html

RUN = "run_of_a_day_with_wind.h5"
HEADINGS = ("run", "status", "zeta", "lambda", "rig.drawbar_load (N)", "x (mm)", "z (mm)", "fx (N)")


def filled(kind: type[Table], columns: int = len(HEADINGS)) -> Table:
    table = kind(*HEADINGS[:columns], title="errors of three runs", title_justify="left")
    for name in (RUN, "b.h5"):
        table.add_row(name, "converged", *["0.73374 ± 0.00035 (1.4)"] * (columns - 2))
    table.add_section()
    table.add_row("all runs", "-", *["12.3 → 0.4"] * (columns - 2), style="bold")
    return table


def printed(table: Table, width: int) -> str:
    console = Console(file=io.StringIO(), width=width, color_system=None)
    console.print(table)
    return console.file.getvalue()


def words(text: str) -> set[str]:
    return set(text.translate(dict.fromkeys(map(ord, "│┃"), " ")).split())


@pytest.mark.parametrize("columns", [2, 4, 6, 8])
@pytest.mark.parametrize("width", [60, 80, 120])
def test_no_word_is_broken_and_no_line_is_longer_than_the_page(width, columns):
    text = printed(filled(WholeWordTable, columns), width)
    assert all(len(line) <= width for line in text.splitlines())
    assert "…" not in text
    wanted = words(printed(filled(Table, columns), 1000))
    assert {each for each in wanted if each.isascii()} <= words(text)


def test_an_ordinary_table_would_break_them():
    assert RUN not in printed(filled(Table), 80)


def test_columns_without_a_place_stand_below_with_the_first_one():
    text = printed(filled(WholeWordTable), 80)
    assert text.count("errors of three runs") == 1
    assert text.count(RUN) > 1
    for heading in ("drawbar_load", "fx"):
        assert text.count(heading) == 1


def test_a_table_that_fits_is_as_it_was():
    assert printed(filled(WholeWordTable), 240) == printed(filled(Table), 240)


def test_a_word_wider_than_the_page_is_folded_not_cut():
    table = WholeWordTable("run", "x")
    table.add_row("a" * 50, "1")
    text = printed(table, 30)
    assert text.count("a") == 50
    assert all(len(line) <= 30 for line in text.splitlines())


def test_styles_of_rows_stay():
    assert "font-weight: bold" in summary_html([filled(WholeWordTable, 4)])
