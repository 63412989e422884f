"""What the loop hands over is in the file, bit for bit."""

import math
import os
import re
import signal
from pathlib import Path

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

from drftjax.commands.log import app
from drftjax.common.errors import InputError
from drftjax.runlog.check import check_file
from drftjax.runlog.hdf5.api import read_run
from drftjax.runlog.hdf5.checksum import checksum_matches
from drftjax.runlog.recording_lock import part_path
from drftjax.runlog.repair import repair
from drftjax.runlog.schema import UNITS
from hils.events import EVENT_MEANINGS, FLAG_MEANINGS, Event, TickFlag
from hils.recording.recorder import Recorder
from hils.recording.row_stream import Kind, OnlineRow, RowStream, pack_end, pack_head, row_packer
from hils.recording.sanitize import RowSanitizer
from tests.helpers.recording_host import (
    await_outcome,
    committed,
    example_head,
    hand_over,
    recorded,
    wrong_rows,
)


@pytest.fixture
def path(tmp_path) -> Path:
    return tmp_path / "run.h5"


# Rows on their way -------------------------------------------------------------------------------


def test_a_stream_cut_anywhere_gives_the_same_rows():
    head = example_head()
    rows = [
        (Kind.COMMAND, (0.0, 0.1 + 0.2, -1e-300)),
        (Kind.MEASURED, (1 / 3, 5e-324, math.pi)),
        (Kind.EVENTS, (2.0, 41.0, 2.0**53)),
        (Kind.COMMAND, (1.0, 2.0, 3.0)),
    ]
    data = pack_head(head) + b"".join(row_packer(k, head).pack(k, *row) for k, row in rows)
    data += pack_end("beendet: zuviel Schlupf")
    for size in (1, 7, 64, len(data)):
        stream, found = RowStream(), []
        for start in range(0, len(data), size):
            for kind, block in stream.feed(data[start : start + size]).items():
                found += [(kind, tuple(row)) for row in block]
        assert stream.head == head
        assert stream.end_reason == "beendet: zuviel Schlupf"
        assert sorted(found) == sorted(rows)


def test_a_tick_that_is_not_finite_is_flagged_and_keeps_its_place():
    tick = np.ones((3, len(OnlineRow._fields)))
    flags = OnlineRow._fields.index("flags")
    tick[:, 0] = [0.0, 0.1, 0.2]
    tick[1, 3], tick[1, flags] = np.inf, TickFlag.FRESH | TickFlag.LATE
    kept, told = RowSanitizer().sanitize(Kind.ONLINE, tick)
    assert kept[1, 3] == 0.0
    assert kept[1, flags] == TickFlag.FRESH | TickFlag.LATE | TickFlag.NOT_FINITE
    np.testing.assert_array_equal(kept[[0, 2]], tick[[0, 2]])
    assert len(told) == 0


@pytest.mark.parametrize("kind", [Kind.COMMAND, Kind.MEASURED])
def test_a_command_or_a_reading_that_is_not_finite_is_left_out_and_told(kind):
    rows = np.array([[0.0, 1.0, 2.0], [0.1, np.nan, 2.0], [0.2, 1.0, 2.0]])
    kept, told = RowSanitizer().sanitize(kind, rows)
    np.testing.assert_array_equal(kept, rows[[0, 2]])
    assert told.tolist() == [[0.1, float(Event.ROW_NOT_FINITE), float(kind)]]


def test_times_that_do_not_increase_move_up_by_the_least_there_is():
    sound = RowSanitizer()
    first, _ = sound.sanitize(Kind.MEASURED, np.array([[0.5, 1.0], [0.5, 2.0], [0.4, 3.0]]))
    again, _ = sound.sanitize(Kind.MEASURED, np.array([[0.5, 4.0], [0.6, 5.0]]))
    times = np.concatenate([first, again])[:, 0]
    assert (np.diff(times) > 0).all()
    # By three units in the last place in all.
    np.testing.assert_allclose(times, [0.5, 0.5, 0.5, 0.5, 0.6], rtol=0, atol=4 * np.spacing(0.5))
    events, _ = sound.sanitize(Kind.EVENTS, np.array([[0.5, 1.0, 0.0], [0.4, 2.0, 0.0]]))
    assert events[:, 0].tolist() == [0.5, 0.5]


def test_a_tick_has_a_number_for_each_channel_of_the_format():
    assert OnlineRow._fields == tuple(UNITS["online"])


def test_whole_numbers_of_a_tick_are_kept_within_their_types():
    tick = np.full((1, len(OnlineRow._fields)), 2.0**32 + 300.4)
    kept, _ = RowSanitizer().sanitize(Kind.ONLINE, tick)
    row = OnlineRow(*kept[0])
    assert (row.tuned, row.flags, row.seq_sent, row.seq_received) == (44, 300, 300, 300)
    assert {row.fz_sim, row.late, row.rig_time} == {2.0**32 + 300.4}


def test_every_event_and_flag_has_one_number_and_one_word():
    for table in (EVENT_MEANINGS, FLAG_MEANINGS):
        assert len(set(table.values())) == len(table)
    assert all(mask.bit_count() == 1 and mask < 2**32 for mask in FLAG_MEANINGS)
    assert len(EVENT_MEANINGS) == len(Event.__members__)


def test_the_page_lists_every_event_and_flag():
    page = (Path(__file__).resolve().parents[3] / "docs" / "runlog.md").read_text()
    for each in Event:
        assert f"| {int(each)} | `{each.name.lower()}` |" in page
    for each in TickFlag:
        assert f"| {int(each).bit_length() - 1} | `{str(each.name).lower()}` |" in page


def test_the_page_lists_every_channel():
    page = (Path(__file__).resolve().parents[3] / "docs" / "runlog.md").read_text()
    outline = page.partition("/command ")[2].partition("source is ")[0]
    for channels in UNITS.values():
        for name in channels:
            assert re.search(rf"\b{name}\b", outline), name


# A run -------------------------------------------------------------------------------------------


def test_a_closed_recording_is_an_ordinary_run_log_bit_for_bit(path):
    recorder = recorded(path, 700)
    recorder.event(0.2, Event.OVERRUN, 3.5e-4)
    recorder.event(0.2, Event.RIG_RESET, 2**32 - 1)
    assert recorder.alive
    assert recorder.close("completed") == path
    run = read_run(path)
    assert wrong_rows(run) == 0
    assert run.online.time.size == run.measured.time.size == run.command.time.size == 700
    assert run.events.code.tolist() == [Event.OVERRUN, Event.RIG_RESET]
    assert run.events.arg.tolist() == [3.5e-4, 2**32 - 1]
    assert (run.events.meanings, run.online.meanings) == (EVENT_MEANINGS, FLAG_MEANINGS)
    head = example_head()
    assert (run.setup, run.title, run.notes) == (head.setup, head.title, head.notes)
    assert (run.online.tick, run.online.loop) == (head.online.tick, head.online.loop)
    assert run.end_reason == "completed"
    assert check_file(path) == []
    assert checksum_matches(path)
    assert list(path.parent.iterdir()) == [path]
    with h5py.File(path) as file:
        assert file.attrs["complete"] == 1
        assert file["online/flags"].attrs["flag_masks"][0] == TickFlag.FRESH


def test_a_free_run_has_no_ticks_and_no_carriage_speed(path):
    recorder = Recorder(path, example_head(driven=False, online=None))
    recorder.command(0.0, 0.5)
    recorder.measured(0.1, 0.2, -0.01)
    assert recorder.close("completed") == path
    run = read_run(path)
    assert run.online is None
    assert run.command.vx is None
    assert run.events is None


def test_a_head_may_come_later_than_the_recorder(path):
    recorder = Recorder(path)
    recorder.begin(example_head())
    for number in range(10):
        hand_over(recorder, number)
    recorder.close("completed")
    assert wrong_rows(read_run(path)) == 0


@pytest.mark.parametrize("begun", [False, True])
def test_a_recording_without_a_reading_leaves_no_file(path, begun):
    recorder = Recorder(path, example_head() if begun else None)
    assert recorder.close("the rig did not answer") is None
    assert list(path.parent.iterdir()) == []


def test_a_second_close_does_nothing(path):
    recorder = recorded(path, 3)
    assert recorder.close("completed") == recorder.close("again") == path
    hand_over(recorder, 4)
    assert read_run(path).end_reason == "completed"


def test_a_reader_sees_the_committed_rows_while_the_run_goes_on(path):
    recorder = recorded(path, 600)
    await_outcome(lambda: committed(part_path(path)) == 600)
    with h5py.File(part_path(path), "r", swmr=True) as file:
        assert file.attrs["complete"] == 0
        np.testing.assert_array_equal(file["measured/x"][()], np.arange(600) / 70)
    for number in range(600, 700):
        hand_over(recorder, number)
    await_outcome(lambda: committed(part_path(path)) == 700)
    recorder.close("completed")


def test_the_commands_say_that_a_file_is_being_recorded_or_was_cut_off(path):
    recorder, part = recorded(path, 5), part_path(path)
    await_outcome(lambda: committed(part) == 5)
    checked = CliRunner().invoke(app, ["check", str(part)])
    assert checked.exit_code == 2
    assert f"{part}: is still being recorded" in checked.stdout
    with pytest.raises(InputError, match="still being recorded"):
        repair(part)
    os.kill(recorder.pid, signal.SIGKILL)
    with pytest.raises(InputError, match=f"SIGKILL; .* drft log repair {part}"):
        recorder.close("completed")
    checked = CliRunner().invoke(app, ["check", str(part)])
    assert f"{part}: is a recording that was cut off" in checked.stdout
    assert f"drft log repair {part}" in checked.stdout
    mended = CliRunner().invoke(app, ["repair", str(part)])
    assert mended.exit_code == 0
    assert f"wrote {path}: 5 commands, 5 readings, 5 ticks" in mended.stdout
    assert CliRunner().invoke(app, ["check", str(path)]).exit_code == 0


def test_what_stands_there_is_not_overwritten(path):
    recorded(path, 3).close("completed")
    with pytest.raises(InputError, match="already there"):
        Recorder(path, example_head())
    part_path(path.with_name("other.h5")).write_bytes(b"rows")
    with pytest.raises(InputError, match="drft log repair"):
        Recorder(path.with_name("other.h5"), example_head())
    with pytest.raises(InputError, match="no folder"):
        Recorder(path.parent / "nowhere" / "run.h5", example_head())
    with pytest.raises(InputError, match=r"end in \.h5"):
        Recorder(path.with_suffix(".csv"), example_head())


def test_a_name_is_one_recorders_from_its_start_on(path):
    """Not from its first row on: an operator's questions lie between the two."""
    first = Recorder(path)
    with pytest.raises(InputError, match=f"{part_path(path)} is already there, a recording"):
        Recorder(path)
    first.begin(example_head())
    for number in range(10):
        hand_over(first, number)
    assert first.close("completed") == path
    assert wrong_rows(read_run(path)) == 0


def test_a_file_that_came_to_stand_there_meanwhile_is_kept_and_so_are_the_rows(path):
    recorder = recorded(path, 10)
    path.write_bytes(b"another run")
    said = f"rows until then are kept: drft log repair {path}.part -o ANOTHER.h5$"
    with pytest.raises(InputError, match=said):
        recorder.close("completed")
    assert path.read_bytes() == b"another run"
    _, run = repair(part_path(path), path.with_name("kept.h5"))
    assert wrong_rows(run) == 0
    assert {each.name for each in path.parent.iterdir()} == {"run.h5", "run.h5.part", "kept.h5"}


def test_a_recorder_killed_before_its_first_row_leaves_the_name_free(path):
    killed = Recorder(path)
    os.kill(killed.pid, signal.SIGKILL)
    with pytest.raises(InputError, match=r"was ended by SIGKILL$"):
        killed.close("not begun")
    assert part_path(path).stat().st_size == 0
    assert recorded(path, 3).close("completed") == path
