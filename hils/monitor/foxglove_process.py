"""Server of a run's ticks for Foxglove: a process that does nothing else.

It says one line on its standard output: "ready", or the reason why it cannot listen. Then it takes
a tick a line on its standard input, and ends with that. A viewer that is slow loses its oldest
ticks in here.
"""

import os
import re
import signal
import sys

import msgspec

from hils.monitor.tick_numbers import json_schema

TOPIC = "/drft"

_BLOCK = 2**16


def main() -> None:
    """Serve at the host and port of the arguments."""
    # Ctrl-C and Ctrl-\ are the control program's to answer.
    for kind in (signal.SIGINT, signal.SIGQUIT):
        signal.signal(kind, signal.SIG_IGN)
    import foxglove

    host, port = sys.argv[1], int(sys.argv[2])
    try:
        server = foxglove.start_server(name="drft", host=host, port=port)
    except Exception as error:
        print(_sentence(str(error)), flush=True)
        return
    channel = foxglove.Channel(TOPIC, schema=json_schema())
    print("ready", flush=True)
    rest = b""
    while data := os.read(sys.stdin.fileno(), _BLOCK):
        *lines, rest = (rest + data).split(b"\n")
        for line in lines:
            timestamp = msgspec.json.decode(line, type=dict[str, float])["timestamp"]
            channel.log(line, log_time=round(timestamp * 1e9))
    server.stop()


def _sentence(error: str) -> str:
    """Refusal of the library as a sentence of ours, by the system's error number in it."""
    number = re.search(r"os error (\d+)", error)
    cause = f": {os.strerror(int(number[1]))}" if number else ""
    return f"the server cannot listen there{cause}"
