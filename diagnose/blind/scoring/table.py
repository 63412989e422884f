"""Scores of answers as tables for the terminal."""

from collections.abc import Iterator

from diagnose.blind.scoring.proportion import Proportion
from drftjax.common.rich_text import WholeWordTable


def _text(share: dict | None) -> str:
    return "" if share is None else str(Proportion(share["hits"], share["of"]))


def tables(score: dict) -> Iterator[WholeWordTable]:
    """Tables of a score: kinds, confusions, calibration, and shrinkage if it was measured."""
    yield _kinds(score)
    if any(answered != truth for truth, row in score["confusion"].items() for answered in row):
        yield _confusions(score)
    yield _calibration(score["calibration"], "calibration of the weights")
    yield _calibration(score["calibration_without_faint"], "the same without faint sets")
    if score["shrinkage"]:
        yield _shrinkage(score)


def _kinds(score: dict) -> WholeWordTable:
    table = WholeWordTable("kind of set", title="answers by kind of set")
    table.add_column("sets", justify="right")
    table.add_column("what")
    table.add_column("share (90 % interval)", justify="right")
    words = {
        "first": "right at first place",
        "in_group": "in the group named",
        "both": "both named",
        "at_least_one": "at least one named",
        "recognised": "recognised",
        "unknown_told": "told, alone or beside names",
        "called_unknown": "called unknown",
        "missed": "called none",
        "false_alarms": "false alarms",
        "confidently_wrong": "sure of a wrong effect",
        "effects_offered": "effects named or in a group",
        "false_names": "names over 0.8 that are not there",
        "worse_channels": "channels made worse",
        "budget_shares": "shares within 10 points",
        "size": "size within 20 %",
    }
    for kind, row in score["kinds"].items():
        shown = [(words[name], _text(row[name])) for name in words if name in row]
        shown.insert(2, ("effects in the group", f"{row['mean_group_size']:.1f}"))
        for number, (what, share) in enumerate(shown):
            first = (kind, str(row["sets"])) if number == 0 else ("", "")
            table.add_row(*first, what, share, end_section=number == len(shown) - 1)
    return table


def _confusions(score: dict) -> WholeWordTable:
    table = WholeWordTable("true", "answered", title="confusions")
    table.add_column("sets", justify="right")
    for truth, row in score["confusion"].items():
        for answered, count in row.items():
            if answered != truth:
                table.add_row(truth, answered, str(count))
    return table


def _calibration(rows: list[dict], title: str) -> WholeWordTable:
    table = WholeWordTable(title=title)
    for heading in ("weight", "mean", "number", "right"):
        table.add_column(heading, justify="right")
    for row in rows:
        mean = "-" if row["mean_weight"] is None else f"{row['mean_weight']:.2f}"
        number = str(row["right"]["of"])
        table.add_row(f"{row['from']:.1f}-{row['to']:.1f}", mean, number, _text(row["right"]))
    return table


def _shrinkage(score: dict) -> WholeWordTable:
    table = WholeWordTable("channel", title="shrinkage of the misfit on fresh runs")
    headings = "sets", "within 10 points of the promise", "in the promised interval", "untried"
    for heading in headings:
        table.add_column(heading, justify="right")
    for channel, row in score["shrinkage"].items():
        number = str(row["kept"]["of"])
        shares = _text(row["kept"]), _text(row["in_interval"])
        table.add_row(channel, number, *shares, str(row["untried"]))
    return table
