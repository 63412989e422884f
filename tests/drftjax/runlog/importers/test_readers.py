"""Files of other programs, each written here by a library of its own format."""

import json
import sys

import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.runlog.importers.mapped_runs import import_table
from drftjax.runlog.importers.readers import matlab

# Reading is a product of a value and a factor: a few roundings of a double.
ROUNDING = 1e-14
# Stamps of nanoseconds since 1970, counted from the first: one product.
CLOCK = 1e-9

TIME = 0.01 * np.arange(50)
OMEGA = np.linspace(0.0, 30.0, 50)
TRAVEL = np.linspace(0.0, 120.0, 50)
SINKAGE = 17.0 + np.sin(TIME)
EPOCH = 1_732_340_000_123_456_789
NANOSECONDS = EPOCH + (10_000_000 * np.arange(50))

MAPPING = """
rows = "samples"
title = "{file}"
[time]
column = "TIME"
zero_at_first_row = true
[command]
omega = { column = "OMEGA", unit = "deg/s" }
[measured]
x = { column = "TRAVEL", unit = "mm" }
z = { column = "SINKAGE", unit = "mm", sign = -1 }
[setup]
wheel_radius = "150 mm"
"""


@pytest.fixture
def read(tmp_path):
    """Import a file by the mapping with these columns; the only run."""

    def made(name: str, more: str = "", **columns: str):
        text = MAPPING
        for word, heading in columns.items():
            text = text.replace(f'"{word}"', json.dumps(heading))
        (tmp_path / "map.toml").write_text(more + text)
        (run,) = import_table(tmp_path / name, tmp_path / "map.toml")
        return run

    return made


def assert_whole(run) -> None:
    np.testing.assert_allclose(run.measured.time, TIME, rtol=0, atol=CLOCK)
    np.testing.assert_allclose(run.command.time, TIME, rtol=0, atol=CLOCK)
    np.testing.assert_allclose(run.command.omega, np.deg2rad(OMEGA), rtol=ROUNDING)
    np.testing.assert_allclose(run.measured.x, TRAVEL * 1e-3, rtol=ROUNDING)
    np.testing.assert_allclose(run.measured.z, -SINKAGE * 1e-3, rtol=ROUNDING)


NAMES = {"TIME": "t", "OMEGA": "w", "TRAVEL": "x", "SINKAGE": "depth"}


def test_a_sheet_of_a_workbook_is_read_with_its_dates(read, tmp_path):
    import datetime

    import openpyxl

    book = openpyxl.Workbook()
    book.active.title = "notes"
    book.active.append(["our rig", None, "2026"])
    sheet = book.create_sheet("run 3")
    sheet.append(["logger of ours"])
    sheet.append(["t", "w", "x\nlaser", "depth", None])
    sheet.append(["date", "deg/s", "mm", "mm"])
    start = datetime.datetime(2026, 3, 1, 10, 0)
    for t, w, x, z in zip(TIME, OMEGA, TRAVEL, SINKAGE, strict=True):
        sheet.append([start + datetime.timedelta(seconds=t), w, x, z])
    sheet.append(["End of file"])
    book.save(tmp_path / "book.xlsx")
    layout = 'sheet = "run 3"\nskip_lines = 1\nskip_below = 1\nend_at = "End"\n'
    (tmp_path / "map.toml").write_text("")
    assert_whole(read("book.xlsx", layout, **NAMES | {"TRAVEL": "x laser"}))
    with pytest.raises(InputError, match=r"no sheet 'run 4'; did you mean 'run 3'"):
        read("book.xlsx", layout.replace("run 3", "run 4"), **NAMES)
    with pytest.raises(InputError, match=r"book\.xlsx, row 54: t is 'End of file'"):
        read("book.xlsx", layout.replace('end_at = "End"', ""), **NAMES | {"TRAVEL": "x laser"})


@pytest.fixture
def mat(tmp_path):
    from scipy.io import savemat

    log = {"t": TIME, "w": OMEGA, "xz": np.stack([TRAVEL, SINKAGE], axis=1), "radius": 0.15}
    savemat(tmp_path / "run.mat", {"log": log, "slow": np.arange(7.0), "who": "us"})
    return {"TIME": "log.t", "OMEGA": "log.w", "TRAVEL": "log.xz(:,1)", "SINKAGE": "log.xz(:,2)"}


def test_variables_of_a_mat_file_are_named_as_matlab_writes_them(read, mat, tmp_path):
    assert_whole(read("run.mat", **mat))
    with pytest.raises(InputError, match=r"times 'log\.t' are in .* table of 50 rows, not .* 7"):
        read("run.mat", **mat | {"SINKAGE": "slow"})
    with pytest.raises(InputError, match=r"decimal in the mapping is for text and workbooks"):
        read("run.mat", 'decimal = ","\n', **mat)
    radius = MAPPING.replace('"150 mm"', '{ column = "log.radius" }')
    for word, heading in mat.items():
        radius = radius.replace(word, heading)
    (tmp_path / "radius.toml").write_text(radius)
    (run,) = import_table(tmp_path / "run.mat", tmp_path / "radius.toml")
    assert run.setup.wheel_radius == 0.15


@pytest.mark.parametrize(
    ("child", "reason"),
    [
        ("import os; os.abort()", "cannot be read as a MAT file; it is damaged"),
        ("import time; time.sleep(60)", "could not be read in 0.5 s; is it damaged"),
    ],
)
def test_a_mat_file_that_brings_its_library_down_is_refused(read, mat, monkeypatch, child, reason):
    monkeypatch.setattr(matlab, "_READ", child)
    monkeypatch.setattr(matlab, "TIME_LIMIT", 0.5)
    with pytest.raises(InputError, match=reason):
        read("run.mat", **mat)


def test_a_mat_file_of_the_newer_format_is_read_through_hdf5(read, tmp_path):
    import h5py

    # As MATLAB 7.3 lays it out: a block of text first, arrays with their axes reversed.
    with h5py.File(tmp_path / "new.mat", "w", userblock_size=512) as file:
        log = file.create_group("log")
        log.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, values in zip("twxz", (TIME, OMEGA, TRAVEL, SINKAGE), strict=True):
            log[name] = values.reshape(1, -1)
            log[name].attrs["MATLAB_class"] = np.bytes_("double")
        file["#refs#/a"] = [1.0, 2.0]
    with (tmp_path / "new.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512))
    assert_whole(read("new.mat", TIME="log.t", OMEGA="log.w", TRAVEL="log.x", SINKAGE="log.z"))


def test_a_parquet_file_brings_its_stamps_and_units(read, tmp_path):
    import pyarrow
    import pyarrow.parquet

    fields = [
        pyarrow.field("t", pyarrow.timestamp("ns", tz="UTC")),
        pyarrow.field("w", pyarrow.float64()),
        pyarrow.field("x", pyarrow.float64(), metadata={"unit": "mm"}),
        pyarrow.field("depth", pyarrow.float64()),
    ]
    table = pyarrow.table([NANOSECONDS, OMEGA, TRAVEL, SINKAGE], schema=pyarrow.schema(fields))
    pyarrow.parquet.write_table(table, tmp_path / "run.parquet")
    assert_whole(read("run.parquet", **NAMES))
    text = (tmp_path / "map.toml").read_text()
    (tmp_path / "map.toml").write_text(text.replace('"x", unit = "mm"', '"x"'))
    (run,) = import_table(tmp_path / "run.parquet", tmp_path / "map.toml")
    np.testing.assert_allclose(run.measured.x, TRAVEL * 1e-3, rtol=ROUNDING)


def test_waveforms_of_a_tdms_file_keep_their_start_and_rate(read, tmp_path):
    from nptdms import ChannelObject, TdmsWriter

    # The force logger of another group starts 0.1 s later and reads at half the rate.
    start = np.datetime64("2026-03-01T10:00:00", "us")
    waves = [
        ChannelObject("drive", name, values, {"wf_increment": 0.01, "wf_start_time": start})
        for name, values in (("w", OMEGA), ("x", TRAVEL))
    ]
    late = {"wf_increment": 0.02, "wf_start_time": start + np.timedelta64(100_000, "us")}
    slow = ChannelObject("height", "depth", SINKAGE[10::2], {**late, "unit_string": "mm"})
    with TdmsWriter(tmp_path / "run.tdms") as writer:
        writer.write_segment([*waves, slow])
    run = read("run.tdms", TIME="time", OMEGA="w", TRAVEL="drive.x", SINKAGE="depth")
    np.testing.assert_allclose(run.measured.time, TIME[10::2], rtol=0, atol=CLOCK)
    np.testing.assert_allclose(run.measured.x, TRAVEL[10::2] * 1e-3, rtol=CLOCK)
    np.testing.assert_allclose(run.measured.z, -SINKAGE[10::2] * 1e-3, rtol=ROUNDING)
    np.testing.assert_allclose(run.command.time, TIME, rtol=0, atol=CLOCK)


def test_topics_of_an_mcap_file_are_tables(read, tmp_path):
    from mcap.writer import Writer

    with (tmp_path / "run.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        drive, height = (writer.register_channel(t, "json", schema) for t in ("/drive", "/height"))
        for stamp, w, x, z in zip(NANOSECONDS.tolist(), OMEGA, TRAVEL, SINKAGE, strict=True):
            wheel = {"wheel": {"speed": [0.0, w]}, "travel": x, "state": "ok"}
            for channel, message in ((drive, wheel), (height, {"depth": z})):
                data = json.dumps(message).encode()
                writer.add_message(channel, stamp, data, stamp)
        writer.finish()
    columns = {"TIME": "log_time", "OMEGA": "wheel.speed[1]", "SINKAGE": "/height.depth"}
    assert_whole(read("run.mcap", TRAVEL="/drive.travel", **columns))
    with pytest.raises(InputError, match=r"the tables /drive, /height; group_by is possible with"):
        read("run.mcap", 'group_by = ["state"]\n', TRAVEL="/drive.travel", **columns)


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_a_bag_of_ros_2_is_read_without_ros(read, tmp_path, storage):
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    bag = tmp_path / "bag"
    with Writer(bag, version=9, storage_plugin=StoragePlugin[storage]) as writer:
        kind = "sensor_msgs/msg/JointState"
        joints = writer.add_connection("/joints", kind, typestore=store)
        for stamp, w, x, z in zip(NANOSECONDS.tolist(), OMEGA, TRAVEL, SINKAGE, strict=True):
            time = kinds["builtin_interfaces/msg/Time"](*divmod(stamp, 1_000_000_000))
            header = kinds["std_msgs/msg/Header"](time, "rig")
            message = kinds[kind](header, ["x", "z"], np.array([x, z]), np.array([w]), np.zeros(0))
            # The recorder is late by a little that changes; the message's own stamp is not.
            late = stamp + int(1e6 * np.random.default_rng(stamp % 1000).random())
            writer.write(joints, late, store.serialize_cdr(message, kind))
    columns = {"TRAVEL": "position[0]", "SINKAGE": "position[1]", "TIME": "header.stamp"}
    assert_whole(read("bag", OMEGA="velocity[0]", **columns))
    if storage == "MCAP":
        (file,) = bag.glob("*.mcap")
        file.rename(tmp_path / "bare.mcap")
        assert_whole(read("bare.mcap", OMEGA="velocity[0]", **columns))


@pytest.mark.parametrize("suffix", ["xlsx", "mat", "parquet", "tdms", "mcap", "bag"])
def test_a_file_of_another_kind_is_refused_in_one_sentence(read, tmp_path, suffix):
    (tmp_path / f"run.{suffix}").write_bytes(b"t,w,x,depth\n0,0,0,0\n" * 20)
    with pytest.raises(InputError, match=rf"run\.{suffix}: cannot be read as a") as caught:
        read(f"run.{suffix}", **NAMES)
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match=r"none\..*: there is no such file"):
        read(f"none.{suffix}", **NAMES)


@pytest.mark.parametrize(
    ("suffix", "module", "distribution"),
    [
        ("xlsx", "openpyxl", "openpyxl"),
        ("parquet", "pyarrow.parquet", "pyarrow"),
        ("tdms", "nptdms", "npTDMS"),
        ("mcap", "mcap.reader", "mcap"),
        ("bag", "rosbags.highlevel", "rosbags"),
    ],
)
def test_a_missing_package_is_named_with_its_extra(
    read, tmp_path, monkeypatch, suffix, module, distribution
):
    monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / f"run.{suffix}").write_bytes(b"")
    wanted = rf"run\.{suffix}: reading \.{suffix} needs {distribution}: pip install 'drftjax\[form"
    with pytest.raises(InputError, match=wanted):
        read(f"run.{suffix}", **NAMES)


def test_a_bag_of_ros_1_is_read_by_the_same_mapping(read, tmp_path):
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    kinds, kind = store.types, "sensor_msgs/msg/JointState"
    with Writer(tmp_path / "run.bag") as writer:
        joints = writer.add_connection("/joints", kind, typestore=store)
        for at, stamp in enumerate(NANOSECONDS.tolist()):
            time = kinds["builtin_interfaces/msg/Time"](*divmod(stamp, 1_000_000_000))
            header = kinds["std_msgs/msg/Header"](at, time, "rig")
            position = np.array([TRAVEL[at], SINKAGE[at]])
            speed = np.array([OMEGA[at]])
            message = kinds[kind](header, ["x", "z"], position, speed, np.zeros(0))
            writer.write(joints, stamp, store.serialize_ros1(message, kind))
    columns = {"TRAVEL": "position[0]", "SINKAGE": "position[1]", "TIME": "header.stamp"}
    assert_whole(read("run.bag", OMEGA="velocity[0]", **columns))


def test_stamps_of_tdms_and_gaps_of_parquet_are_read(read, tmp_path):
    import pyarrow
    import pyarrow.parquet
    from nptdms import ChannelObject, TdmsWriter

    stamps = NANOSECONDS.astype("datetime64[ns]")
    columns = {"t": stamps.astype("datetime64[us]"), "w": OMEGA, "x": TRAVEL, "depth": SINKAGE}
    with TdmsWriter(tmp_path / "run.tdms") as writer:
        writer.write_segment([ChannelObject("log", name, each) for name, each in columns.items()])
    run = read("run.tdms", **NAMES)
    # A stamp of a TDMS file has microseconds here.
    np.testing.assert_allclose(run.measured.time, TIME, rtol=0, atol=1e-6)
    np.testing.assert_allclose(run.measured.z, -SINKAGE * 1e-3, rtol=ROUNDING)

    gaps = [None if at % 3 else each for at, each in enumerate(SINKAGE.tolist())]
    whole = {"t": NANOSECONDS, "w": OMEGA, "x": pyarrow.array(TRAVEL), "depth": gaps}
    late = [None if gap is None else each for gap, each in zip(gaps, stamps, strict=True)]
    whole["t2"] = pyarrow.array(late, pyarrow.timestamp("ns"))
    pyarrow.parquet.write_table(pyarrow.table(whole), tmp_path / "run.parquet")
    text = (tmp_path / "map.toml").read_text().replace('"depth", ', '"depth", time = "t2", ')
    assert "t2" in text
    text = text.replace('column = "t"', 'column = "t"\nunit = "ns"')
    text = text.replace('time = "t2"', 'time = { column = "t2", zero_at_first_row = true }')
    (tmp_path / "gaps.toml").write_text(text)
    (run,) = import_table(tmp_path / "run.parquet", tmp_path / "gaps.toml")
    np.testing.assert_allclose(run.measured.time, TIME[::3], rtol=0, atol=CLOCK)
    np.testing.assert_allclose(run.measured.z, -SINKAGE[::3] * 1e-3, rtol=ROUNDING)


def test_a_tdms_file_that_was_cut_off_is_read_as_far_as_it_goes(read, tmp_path, capfd):
    from nptdms import ChannelObject, TdmsWriter

    columns = {"t": TIME, "w": OMEGA, "x": TRAVEL, "depth": SINKAGE}
    for rows in (slice(0, 30), slice(30, 50)):
        with TdmsWriter(tmp_path / "run.tdms", mode="w" if rows.start == 0 else "a") as writer:
            parts = [ChannelObject("log", name, each[rows]) for name, each in columns.items()]
            writer.write_segment(parts)
    data = (tmp_path / "run.tdms").read_bytes()
    # Less than the second segment's first channel is lost.
    (tmp_path / "run.tdms").write_bytes(data[: -(4 * 20 * 8)])
    run = read("run.tdms", **NAMES)
    np.testing.assert_allclose(run.measured.time, TIME[:30], rtol=0, atol=CLOCK)
    assert capfd.readouterr().err == ""


def test_a_folder_that_is_no_bag_is_refused(read, tmp_path):
    (tmp_path / "runs").mkdir()
    with pytest.raises(InputError, match=r"runs: .* its folder must hold metadata\.yaml, too"):
        read("runs", **NAMES)
