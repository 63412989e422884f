"""Tables of the topics of a robot's log."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from drftjax.runlog.importers.table import Cells, Table, named_tables

LOG_TIME: Final = "log_time"
"""Heading of the time at which a message was recorded [ns since 1970]."""

STAMP: Final = "header.stamp"
"""Heading of the time that a message itself states [ns since 1970]."""


def topic_tables(path: Path, topics: Mapping[str, Mapping[str, Cells]]) -> list[Table]:
    """Tables by topic; a sole one needs no name.

    Args:
        path: The file.
        topics: Cells by heading, by topic.
    """
    return named_tables(path, topics, "message", units={LOG_TIME: "ns", STAMP: "ns"})
