"""`drft hils`: run a rig in the loop, over a serial port or virtually. One module a subcommand."""

import typer

from drftjax.commands.options import CommandGroup
from hils.commands.conform import EXAMPLES as CONFORM_EXAMPLES
from hils.commands.conform import conform
from hils.commands.paper import EXAMPLES as PAPER_EXAMPLES
from hils.commands.paper import paper
from hils.commands.ports import EXAMPLES as PORTS_EXAMPLES
from hils.commands.ports import ports
from hils.commands.replay import EXAMPLES as REPLAY_EXAMPLES
from hils.commands.replay import replay
from hils.commands.rig import EXAMPLES as RIG_EXAMPLES
from hils.commands.rig import rig
from hils.commands.run import EXAMPLES as RUN_EXAMPLES
from hils.commands.run import run
from hils.commands.stop import EXAMPLES as STOP_EXAMPLES
from hils.commands.stop import stop

app = typer.Typer(
    name="hils",
    cls=CommandGroup,
    help="Run a single-wheel rig in the loop over a serial port, or a virtual one.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


app.command(epilog=CONFORM_EXAMPLES)(conform)


app.command(epilog=PAPER_EXAMPLES)(paper)


app.command(epilog=PORTS_EXAMPLES)(ports)


app.command(epilog=REPLAY_EXAMPLES)(replay)


app.command(epilog=RIG_EXAMPLES)(rig)


app.command(epilog=RUN_EXAMPLES)(run)


app.command(epilog=STOP_EXAMPLES)(stop)


@app.callback()
def hils() -> None:
    """Run a single-wheel rig in the loop over a serial port, or a virtual one."""
