"""The stream of ticks: addresses, every tick at the other end, and nothing that reaches the loop.

The receivers are others' programs, or nothing but a socket and Python's own JSON.
"""

import asyncio
import contextlib
import json
import os
import re
import signal
import socket
import struct
import time
from collections import Counter
from pathlib import Path

import pytest
from tornado.websocket import websocket_connect

from drftjax.common.errors import InputError
from hils.control.stop_request import StopRequest
from hils.monitor import stream_address
from hils.monitor.stream_address import StreamKind, read_stream_address
from hils.monitor.tick_numbers import TICK_NUMBERS
from hils.monitor.tick_stream import FoxgloveLine, TickStream, UdpLine, open_stream
from hils.procedure.operator_prompts import UnattendedPrompts
from hils.procedure.procedure import Procedure, run
from hils.recording.sinks import InMemorySink
from hils.rig_sim.in_process import soft_rig
from tests.helpers.hils_runs import TICKS, loop_setup

PAGE = Path(__file__).resolve().parents[3] / "docs" / "guide" / "run-a-rig.md"
PATIENCE = 30.0  # of a busy machine [s]
NOBODY, NO_ROOM = "nobody listened there", "there was no room for it"


class Ear:
    """A UDP receiver that keeps every message; over the loopback they are there once sent."""

    def __init__(self, port: int = 0):
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", port))
        self._socket.setblocking(False)
        self.port, self.messages = self._socket.getsockname()[1], []

    @property
    def url(self) -> str:
        return f"udp://127.0.0.1:{self.port}"

    def take(self) -> None:
        """Take what has come; a socket has room for a hundred messages or so."""
        with contextlib.suppress(BlockingIOError):
            while True:
                self.messages.append(json.loads(self._socket.recv(4096)))

    def close(self) -> None:
        """Take what has come, and leave the port to nobody."""
        if self._socket.fileno() >= 0:
            self.take()
            self._socket.close()


class HeardSink(InMemorySink):
    """Keeps a run's rows, and lets the receiver take what was sent before each."""

    def __init__(self, ear: Ear):
        super().__init__()
        self._ear = ear

    def command(self, time, omega, vx=None):
        self._ear.take()
        super().command(time, omega, vx)


@pytest.fixture
def ear():
    made = Ear()
    yield made
    made.close()


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def streamed(ear: Ear, free: bool = False) -> tuple[InMemorySink, list[str]]:
    """A run in virtual time that is streamed; its rows, and what was said at the end."""
    _, link, clock = soft_rig()
    rows, said = HeardSink(ear), []
    with open_stream(read_stream_address(ear.url), said.append) as stream:
        assert stream is not None
        given = Procedure(loop=loop_setup(), countdown=0.3, free=free)
        prompts = UnattendedPrompts(quiet=True)
        report = run(given, link, clock, stream.rows(rows), prompts, StopRequest())
    assert report.completed, report.reason
    return rows, said


# Every tick at the other end ----------------------------------------------------------------------


def test_each_tick_arrives_with_the_numbers_that_are_recorded(ear):
    rows, said = streamed(ear)
    ear.close()
    assert len(ear.messages) == len(rows.ticks) >= TICKS
    assert said == [f"Stream to {ear.url}: {len(rows.ticks)} ticks sent."]
    commands = {round(time, 6): rest for time, *rest in rows.commands}
    readings, newest = iter(rows.readings), None
    for message, row in zip(ear.messages, rows.ticks, strict=True):
        assert set(message) <= set(TICK_NUMBERS)
        assert message["time"] == row.time
        assert message["zeta"] == row.zeta
        assert message["sinkage_simulated"] == -row.z_sim
        assert message["x_simulated"] == row.x_sim
        assert message["vx_simulated"] == row.vx_sim
        assert (message["fx"], message["fz"]) == (row.fx_sim, row.fz_sim)
        assert (message["flags"], message["age"], message["late"]) == (
            row.flags,
            row.age,
            row.late,
        )
        omega, vx = commands[round(row.time + 0.01, 6)]
        assert (message["omega_commanded"], message["vx_commanded"]) == (omega, vx)
        if row.flags & 1:  # a fresh reading: the next row of /measured
            newest = next(readings)
        assert message.get("sinkage_measured") == (None if newest is None else -newest[2])
        assert message.get("x_measured") == (None if newest is None else newest[1])
        assert message.get("omega_measured") == (None if newest is None else newest[3])
    # A turning wheel follows its commands, within a tick's slew.
    turning = [m for m in ear.messages if m["omega_commanded"] > 0.4]
    assert all(m["omega_measured"] == pytest.approx(m["omega_commanded"], 0.1) for m in turning)
    assert abs(ear.messages[-1]["timestamp"] - time.time()) < PATIENCE


def test_a_free_carriage_sends_what_it_has(ear):
    rows, _ = streamed(ear, free=True)
    ear.close()
    assert len(ear.messages) == len(rows.commands)
    assert [m["omega_commanded"] for m in ear.messages] == [each[1] for each in rows.commands]
    known = {"timestamp", "time", "sinkage_measured", "x_measured"}
    assert set(ear.messages[-1]) == known | {"omega_commanded", "omega_measured"}


def test_a_number_that_is_not_known_is_left_out(ear):
    stream = TickStream(UdpLine(read_stream_address(ear.url)))
    stream.send({"time": 1.0, "omega_measured": float("nan"), "fx": float("inf"), "flags": 3})
    ear.close()
    assert ear.messages == [{"time": 1.0, "flags": 3}]


# Nobody there, no room ----------------------------------------------------------------------------


def test_nobody_there_is_told_at_the_end_and_a_late_receiver_gets_every_tick():
    port = free_port()
    said: list[str] = []
    address = read_stream_address(f"udp://127.0.0.1:{port}")
    with open_stream(address, said.append) as stream:
        assert stream is not None
        for number in range(20):
            stream.send({"time": number})
        ear = Ear(port)
        for number in range(20, 40):
            stream.send({"time": number})
        ear.close()
    assert [each["time"] for each in ear.messages] == list(range(20, 40))
    # The refusal of a datagram is told by the next, so of the last before the ear likewise.
    assert stream.lost == Counter({NOBODY: 20})
    (sentence,) = said
    assert sentence.endswith(f"40 ticks sent, 20 not taken (20: {NOBODY}).")


@pytest.fixture
def foxglove():
    address = read_stream_address(f"foxglove://127.0.0.1:{free_port()}")
    line = FoxgloveLine(address)
    yield address, line
    line._process.kill()
    line.close()


def test_a_server_that_hangs_costs_ticks_and_no_time(foxglove):
    _, line = foxglove
    stream = TickStream(line)
    os.kill(line._process.pid, signal.SIGSTOP)
    begun = time.monotonic()
    for number in range(5000):
        stream.send({"time": number, "timestamp": 0.0})
    assert time.monotonic() - begun < PATIENCE  # it would wait for ever
    assert set(stream.lost) == {NO_ROOM}
    # What is not lost is in the pipe.
    assert 0 < stream.ticks - stream.lost[NO_ROOM] < 5000
    os.kill(line._process.pid, signal.SIGCONT)


def test_a_server_that_was_killed_costs_ticks_and_no_more(foxglove):
    _, line = foxglove
    stream = TickStream(line)
    line._process.kill()
    line._process.wait()
    for number in range(3):
        stream.send({"time": number})
    assert stream.lost == Counter({"the server had ended": 3})


# Foxglove -----------------------------------------------------------------------------------------


async def viewed(url: str, send, count: int) -> list[tuple[int, dict]]:
    """Messages that a viewer gets, with their times [ns], by the protocol of foxglove.sdk.v1."""
    socket = await websocket_connect(url, subprotocols=["foxglove.sdk.v1"])
    channel = None
    while channel is None:
        said = json.loads(await socket.read_message())
        if said["op"] == "advertise":
            (channel,) = said["channels"]
    assert (channel["topic"], channel["encoding"]) == ("/drft", "json")
    assert set(json.loads(channel["schema"])["properties"]) == set(TICK_NUMBERS)
    wish = {"op": "subscribe", "subscriptions": [{"id": 5, "channelId": channel["id"]}]}
    await socket.write_message(json.dumps(wish))
    await asyncio.sleep(0.5)  # the server has no answer to it
    send()
    found = []
    while len(found) < count:
        data = await socket.read_message()
        if isinstance(data, bytes) and data[0] == 1:
            number, when = struct.unpack_from("<IQ", data, 1)
            assert number == 5
            found.append((when, json.loads(data[13:])))
    socket.close()
    return found


def test_a_viewer_gets_every_tick_with_its_time(foxglove):
    address, line = foxglove
    stream, sent = TickStream(line), []

    def send() -> None:
        for number in range(200):
            sent.append({"timestamp": 1.7e9 + number * 0.01, "time": number * 0.01})
            stream.send(sent[-1])

    url = f"ws://127.0.0.1:{address.port}"
    found = asyncio.run(asyncio.wait_for(viewed(url, send, 200), PATIENCE))
    assert [message for _, message in found] == sent
    assert [when for when, _ in found] == [round(each["timestamp"] * 1e9) for each in sent]


def test_the_server_ends_with_the_stream(foxglove):
    _, line = foxglove
    line.close()
    assert line._process.poll() == 0
    line.close()


def test_a_port_that_is_taken_is_one_sentence():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        url = f"foxglove://127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(InputError) as refused:
            FoxgloveLine(read_stream_address(url))
    assert str(refused.value) == (
        f"--stream {url}: the server cannot listen there: Address already in use"
    )


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setattr(stream_address, "find_spec", lambda name: None)
    with pytest.raises(
        InputError, match=r"package foxglove-sdk: pip install 'drftjax\[foxglove\]'"
    ):
        read_stream_address("foxglove://127.0.0.1:8765")
    assert read_stream_address("udp://127.0.0.1:9870").kind is StreamKind.UDP


# Addresses ----------------------------------------------------------------------------------------

BAD = ["", "udp", "udp:/x", "udp://", "udp://:9870", "udp://127.0.0.1", "udp://127.0.0.1:0"]
BAD += ["udp://127.0.0.1:70000", "udp://127.0.0.1:x", "udp://127.0.0.1:-1", "tcp://127.0.0.1:9870"]
BAD += ["udp://127.0.0.1:9870/x", "udp://a@127.0.0.1:9870", "udp://[::1:9870", "127.0.0.1:9870"]


@pytest.mark.parametrize("url", BAD)
def test_an_address_that_is_none_is_one_sentence(url):
    with pytest.raises(InputError) as refused:
        read_stream_address(url)
    assert str(refused.value) == (
        f"--stream is {url!r}, must be udp://HOST:PORT or foxglove://HOST:PORT, the port from 1 to "
        "65535"
    )


def test_an_address_has_its_host_looked_up():
    found = read_stream_address("udp://127.0.0.1:9870/")
    assert (found.kind, found.host, found.port) == (StreamKind.UDP, "127.0.0.1", 9870)
    assert found.address == ("127.0.0.1", 9870)


@pytest.mark.parametrize("error", [socket.gaierror(-2, "x"), UnicodeError("label too long")])
def test_a_host_that_is_not_known_is_one_sentence(monkeypatch, error):
    def unknown(*given, **options):
        raise error

    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    with pytest.raises(InputError, match=r"--stream udp://rig\.lab:1: the host 'rig\.lab' is not"):
        read_stream_address("udp://rig.lab:1")


def test_the_page_has_every_number_and_its_unit():
    rows = re.findall(r"^\| `(\w+)` \| (\S+) \| (.+) \|$", PAGE.read_text(), re.MULTILINE)
    assert [row for row in rows if row[0] in TICK_NUMBERS] == [
        (name, each.unit, each.meaning) for name, each in TICK_NUMBERS.items()
    ]
