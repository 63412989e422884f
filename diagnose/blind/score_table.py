"""A score as tables for the terminal."""

from collections.abc import Iterator

from rich.table import Table

from diagnose.blind.share import Share


def _text(share: dict | None) -> str:
    return "" if share is None else str(Share(share["hits"], share["of"]))


def tables(score: dict) -> Iterator[Table]:
    """The tables of a score: kinds, confusions, calibration, and shrinkage where it is known."""
    yield _kinds(score)
    yield _confusions(score)
    yield _calibration(score["calibration"], "calibration of the weights")
    yield _calibration(score["calibration_without_faint"], "the same without faint sets")
    if score["shrinkage"]:
        yield _shrinkage(score)


def _kinds(score: dict) -> Table:
    table = Table(title="answers by kind of set, share with its 90 % interval")
    columns = {
        "first": "right first",
        "in_group": "in group",
        "confidently_wrong": "sure and wrong",
        "missed": "missed",
        "called_unknown": "called unknown",
        "false_alarms": "false alarms",
        "recognised": "recognised",
        "both": "both",
        "at_least_one": "at least one",
    }
    shown = [name for name in columns if any(name in row for row in score["kinds"].values())]
    table.add_column("kind", no_wrap=True)
    table.add_column("sets", justify="right")
    table.add_column("group size", justify="right")
    for name in shown:
        table.add_column(columns[name], justify="right")
    for kind, row in score["kinds"].items():
        shares = (_text(row.get(name)) for name in shown)
        table.add_row(kind, str(row["sets"]), f"{row['mean_group_size']:.1f}", *shares)
    return table


def _confusions(score: dict) -> Table:
    table = Table("true", "answered", title="confusions")
    table.add_column("sets", justify="right")
    for truth, row in score["confusion"].items():
        for answered, count in row.items():
            if answered != truth:
                table.add_row(truth, answered, str(count))
    return table


def _calibration(rows: list[dict], title: str) -> Table:
    table = Table(title=title)
    for heading in ("weight", "mean", "number", "right"):
        table.add_column(heading, justify="right")
    for row in rows:
        mean = "-" if row["mean_weight"] is None else f"{row['mean_weight']:.2f}"
        number = str(row["right"]["of"])
        table.add_row(f"{row['from']:.1f}-{row['to']:.1f}", mean, number, _text(row["right"]))
    return table


def _shrinkage(score: dict) -> Table:
    table = Table("channel", title="shrinkage of the misfit on fresh runs")
    for heading in ("sets", "within 10 points of the promise", "in the promised interval"):
        table.add_column(heading, justify="right")
    for channel, row in score["shrinkage"].items():
        number = str(row["kept"]["of"])
        table.add_row(channel, number, _text(row["kept"]), _text(row["in_interval"]))
    return table
