"""`drft hils ports`: the serial ports that there are, and the rigs that answer at them."""

from typing import Annotated

import typer

from drftjax.commands.printing import say
from drftjax.common.errors import InputError
from hils.link.timing import USUAL_BAUD, watchdog_ms

LONGEST_PATIENCE = 60.0  # [s]


ASKED_TICK = 10_000  # [us]; any that every rig can take


EXAMPLES = """
Examples:

  drft hils ports

  drft hils ports /dev/ttyUSB0 socket://rig.local:5000 --baud 460800

HELLO moves nothing, but a rig that runs goes SAFE on it. A port that another program holds is left
alone. A board that restarts when its port is opened (Arduino) needs --patience 3.

An FTDI adapter keeps what it received for 16 ms, longer than a tick. Write into
/etc/udev/rules.d/99-ftdi.rules

  SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"

and plug it in again; latency_timer=1 is then its setting [ms].
"""


def ports(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="PORT", help="Devices or URLs; all serial ports where none."),
    ] = None,
    baud: Annotated[int, typer.Option(help="Baud rate to ask at.")] = USUAL_BAUD,
    hello: Annotated[
        bool, typer.Option("--hello/--no-hello", help="Ask each port whether a rig is there.")
    ] = True,
    patience: Annotated[
        float, typer.Option(help="Go on asking each port for so long [s], 60 at most.")
    ] = 0.0,
) -> None:
    """List serial ports, and which of them answer HELLO."""
    from drftjax.common.arrays import require_between
    from hils.link.ports import ListedPort, latency_timer, require_baud_rate
    from hils.link.ports import list_ports as listed

    require_baud_rate(baud)
    require_between("patience", patience, 0.0, LONGEST_PATIENCE, " s")
    found = [ListedPort(name, "") for name in names] if names else listed()
    if not found:
        say("there is no serial port")
    answered = not hello
    for port in found:
        say(": ".join(filter(None, port)))
        delay = latency_timer(port.name)
        if delay is not None and delay > 1:
            say(f"  its adapter waits {delay} ms with what it received; see --help")
        if hello:
            try:
                say(f"  {_asked(port.name, baud, patience)}")
                answered = True
            except InputError as error:
                say(f"  {error}")
    if names and not answered:
        raise typer.Exit(2)


def _asked(name: str, baud: int, patience: float) -> str:
    """Answer of a port to HELLO, as a sentence.

    Raises:
        InputError: it cannot be opened, or no rig answers.
    """
    from hils.clock import MonotonicClock
    from hils.link.messages import Hello
    from hils.link.port_link import PortLink
    from hils.link.ports import open_port
    from hils.procedure.session import Session

    clock = MonotonicClock()
    link = PortLink(open_port(name, baud), clock)
    try:
        session = Session(link, clock)
        ack = session.connect(Hello(ASKED_TICK, watchdog_ms(ASKED_TICK)), patience)
        session.bye()
    finally:
        link.close()
    return (
        f"rig {ack.rig_id}, {ack.state.name}, boot {ack.boot_id:08x}: "
        f"omega up to {ack.omega_max:.4g} rad/s, vx up to {ack.vx_max:.4g} m/s, "
        f"{abs(ack.z_scale) * 1e6:.4g} um a count in z and {abs(ack.x_scale) * 1e6:.4g} um in x"
    )
