"""Bags of ROS 2 and ROS 1, read by rosbags without an installation of ROS."""

from pathlib import Path
from typing import Any

from drftjax.common.errors import InputError
from drftjax.runlog.importers.layout import Layout
from drftjax.runlog.importers.readers.messages import (
    LOG_TIME,
    message_columns,
    message_fields,
    topic_tables,
)
from drftjax.runlog.importers.readers.packages import required_package, unreadable
from drftjax.runlog.importers.table import Table


def read_ros_bag(path: Path, layout: Layout) -> list[Table]:
    """Read the topics of a bag, each a table of its messages' numbers and texts.

    Every table has a column `log_time` in nanoseconds since 1970. Topics of a type that neither the
    bag nor ROS 2 defines are skipped.

    Args:
        path: Folder of a ROS 2 bag, its .db3, or the .bag of ROS 1.
        layout: Not used: a bag has no lines.

    Raises:
        InputError: the bag cannot be read, or has no messages of a known type.
    """
    del layout
    highlevel = required_package("rosbags.highlevel", "rosbags", path)
    typesys = required_package("rosbags.typesys", "rosbags", path)
    folder = path.parent if path.suffix.lower() == ".db3" else path
    if path.suffix.lower() != ".bag" and not (folder / "metadata.yaml").is_file():
        raise InputError(
            f"{path}: cannot be read as a bag of ROS 2: its folder must hold metadata.yaml, too"
        )
    topics: dict[str, list[dict[str, Any]]] = {}
    unknown: set[str] = set()
    try:
        store = typesys.get_typestore(typesys.Stores.LATEST)
        with highlevel.AnyReader([folder], default_typestore=store) as reader:
            for connection, time, data in reader.messages():
                if connection.msgtype not in reader.typestore.fielddefs:
                    unknown.add(f"{connection.topic} ({connection.msgtype})")
                    continue
                message = reader.deserialize(data, connection.msgtype)
                fields = dict(message_fields("", message))
                topics.setdefault(connection.topic, []).append({LOG_TIME: time, **fields})
    except Exception as error:
        raise unreadable(path, "a bag of ROS", error) from None
    if not topics:
        found = f"; its topics are {', '.join(sorted(unknown))}" if unknown else ""
        raise InputError(f"{path}: has no messages of a known type{found}")
    return topic_tables(path, {name: message_columns(rows) for name, rows in topics.items()})
