"""TDMS files of LabVIEW, read by npTDMS."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from drftjax.common.errors import InputError
from drftjax.runlog.importers.layout import Layout
from drftjax.runlog.importers.readers.packages import required_package, unreadable
from drftjax.runlog.importers.table import Cells, Table, named_tables

TIME: Final = "time"
"""Heading of the times that a waveform's start and increment make."""


def read_tdms(path: Path, layout: Layout) -> list[Table]:
    """Read the groups of a TDMS file, each a table of its channels.

    A waveform has no times of its own; its table gets a column `time`, in seconds from the earliest
    start in the file. Channels of other lengths or increments are a table of their own, named
    "group/channel". Of a file that was cut off, what is there is read.

    Args:
        path: The file.
        layout: Not used: a TDMS file has no lines.

    Raises:
        InputError: the file cannot be read, or holds no channel.
    """
    del layout
    nptdms = required_package("nptdms", "npTDMS", path)
    try:
        file = nptdms.TdmsFile.read(path)
        channels = [each for group in file.groups() for each in group.channels() if len(each) > 0]
        starts = [
            start
            for each in channels
            if (start := each.properties.get("wf_start_time")) is not None
        ]
        zero = min(map(np.datetime64, starts), default=None)
        tables: dict[str, dict[str, Cells]] = {}
        axes: dict[str, Any] = {}
        units: dict[str, str] = {}
        for each in channels:
            axis = _axis(each, zero)
            name = each.group_name
            if axes.setdefault(name, axis) != axis:
                name = f"{each.group_name}/{each.name}"
                axes[name] = axis
            columns = tables.setdefault(name, {})
            _, increment, start = axis
            if increment is not None and TIME not in columns:
                columns[TIME] = start + increment * np.arange(len(each))
            columns[each.name] = _cells(each, units)
    except Exception as error:
        raise unreadable(path, "a TDMS file", error) from None
    if not tables:
        raise InputError(f"{path}: has no channel with values")
    if len(tables) == 1:
        tables = {"": next(iter(tables.values()))}
    return named_tables(path, tables, "sample", units={**units, TIME: "s"})


def _axis(channel: Any, zero: Any) -> tuple[int, float | None, float]:
    """Length, increment and start of a channel [s]; no increment where it is no waveform."""
    own = channel.properties
    increment = own.get("wf_increment")
    if not increment:
        return len(channel), None, 0.0
    start = float(own.get("wf_start_offset", 0.0))
    if zero is not None and own.get("wf_start_time") is not None:
        since = np.datetime64(own["wf_start_time"]) - zero
        start += float(since / np.timedelta64(1, "ns")) * 1e-9
    return len(channel), float(increment), start


def _cells(channel: Any, units: dict[str, str]) -> Cells:
    """Values of a channel; its unit is added to the units."""
    values = channel[:]
    if values.dtype.kind == "M":
        units[channel.name] = "ns"
        return values.astype("datetime64[ns]").astype(np.int64)
    unit = channel.properties.get("unit_string") or channel.properties.get("NI_UnitDescription")
    if isinstance(unit, str) and unit.strip():
        units[channel.name] = unit
    return values if values.dtype.kind in "biuf" else [str(each) for each in values]
