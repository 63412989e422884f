"""MCAP files, read by mcap; messages in JSON, or of ROS 2."""

import json
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


def read_mcap(path: Path, layout: Layout) -> list[Table]:
    """Read the topics of an MCAP file, each a table of its messages' numbers and texts.

    Every table has a column `log_time` in nanoseconds since 1970.

    Args:
        path: The file.
        layout: Not used: an MCAP file has no lines.

    Raises:
        InputError: the file cannot be read, or no topic is in JSON or of ROS 2.
    """
    del layout
    reading = required_package("mcap.reader", "mcap", path)
    ros = required_package("mcap_ros2.decoder", "mcap-ros2-support", path)
    topics: dict[str, list[dict[str, Any]]] = {}
    others: set[str] = set()
    factory = ros.DecoderFactory()
    decoders: dict[int, Any] = {}
    try:
        with path.open("rb") as file:
            for schema, channel, message in reading.make_reader(file).iter_messages():
                decode = decoders.get(channel.id)
                if decode is None:
                    decode = factory.decoder_for(channel.message_encoding, schema)
                    if decode is None and channel.message_encoding == "json":
                        decode = json.loads
                    decoders[channel.id] = decode or False
                if not decode:
                    others.add(f"{channel.topic} ({channel.message_encoding or 'no encoding'})")
                    continue
                fields = dict(message_fields("", decode(message.data)))
                topics.setdefault(channel.topic, []).append({LOG_TIME: message.log_time, **fields})
    except Exception as error:
        raise unreadable(path, "an MCAP file of JSON or ROS 2 messages", error) from None
    if not topics:
        found = f"; its topics are {', '.join(sorted(others))}" if others else ""
        raise InputError(f"{path}: has no messages in JSON or of ROS 2{found}")
    return topic_tables(path, {name: message_columns(rows) for name, rows in topics.items()})
