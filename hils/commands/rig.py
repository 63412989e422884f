"""`drft hils rig`: a virtual rig at a pseudo-terminal, to run against and to try faults on."""

import secrets
import signal
import sys
import time
from pathlib import Path
from typing import Annotated

import typer

from drftjax.common.errors import InputError

EXAMPLES = """
Examples:

  drft hils rig --link /tmp/rig

  drft hils rig --setup data/virtual_rig.toml --faults faults.toml --seed 3

  drft hils rig --baud 115200 --latency 16

The first line printed is the port's name. Then, in another terminal:

  drft hils run --port /tmp/rig --profile data/paper.toml -o run.h5
"""


def rig(
    setup: Annotated[
        Path | None,
        typer.Option(help="The true rig and sand (TOML or JSON); the paper's where not given."),
    ] = None,
    faults: Annotated[
        Path | None, typer.Option(help="What shall go wrong, and when (TOML or JSON).")
    ] = None,
    seed: Annotated[int, typer.Option(help="Of noise and bed preparation.")] = 0,
    baud: Annotated[int, typer.Option(help="Pace of the bytes [bits a second]; 0 for none.")] = 0,
    latency: Annotated[
        float, typer.Option(help="Latency timer of the host's USB adapter [ms]; FTDI's is 16.")
    ] = 0.0,
    link: Annotated[
        Path | None, typer.Option(help="Make a symbolic link of this name to the port.")
    ] = None,
    socket: Annotated[
        int | None,
        typer.Option(help="Listen at this TCP port of this computer instead; 0 for any free one."),
    ] = None,
    seconds: Annotated[
        float, typer.Option(help="End after this time [s].", show_default="when interrupted")
    ] = float("inf"),
) -> None:
    """A virtual rig: sand, wheel, firmware and wire, for a host to plug in to."""
    if not 0 <= latency <= 255:
        raise InputError(f"--latency is {latency:g} ms, must lie between 0 and 255 ms")
    if baud != 0 and not 300 <= baud <= 12_000_000:
        raise InputError(f"--baud is {baud}, must be 0 or lie between 300 and 12000000")
    if seed < 0:
        raise InputError(f"--seed is {seed}, must be 0 or more")
    if not seconds > 0:
        raise InputError(f"--seconds is {seconds:g} s, must be above 0 s")
    if socket is not None and not 0 <= socket <= 65535:
        raise InputError(f"--socket is port {socket}, must lie between 0 and 65535")
    if link is not None and socket is not None:
        raise InputError("--link names a pseudo-terminal; it does not go with --socket")

    from drftjax.common.jax_config import configure_jax
    from hils.realtime import answer_at_once

    configure_jax()
    answer_at_once()
    from hils.rig_sim.config import VirtualSetUp, read_virtual_setup
    from hils.rig_sim.endpoints import PtyEnd, SocketEnd
    from hils.rig_sim.faults import FaultScript, read_faults
    from hils.rig_sim.rig import VirtualRig
    from hils.rig_sim.server import serve

    chosen = VirtualSetUp() if setup is None else read_virtual_setup(setup)
    script = FaultScript() if faults is None else read_faults(faults)
    end = PtyEnd(link) if socket is None else SocketEnd(socket)
    # The order to end is no reason for a traceback, and the link must go.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        physics = chosen.build()
        power, boots = time.monotonic(), secrets.randbits(31)
        line = baud, latency * 1e-3
        virtual = VirtualRig(chosen, physics, script, seed, *line, power, boots)
        print(end.name, flush=True)
        serve(virtual, end, lambda line: print(line, file=sys.stderr, flush=True), seconds)
    except KeyboardInterrupt:
        pass
    finally:
        end.unplug()
