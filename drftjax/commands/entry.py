"""Entry point of `drft`: a stop of the runs first, all other commands by `drftjax.commands.main`.

`drft hils stop` must not wait for the command line's own packages, so that it is handed to
`hils.procedure.stop_runs` before they are imported. What that does not understand comes back.
"""

import sys
from importlib import import_module

STOP = ["hils", "stop"]

STOP_HOME = "hils.procedure.stop_runs"


def main() -> None:
    """Run `drft`."""
    if sys.argv[1:3] == STOP:
        # By its name: this package imports nothing of those that stand on it.
        code = import_module(STOP_HOME).stop_from_command_line(sys.argv[3:])
        if code is not None:
            sys.exit(code)
    from drftjax.commands.main import main as run

    run()


if __name__ == "__main__":
    main()
