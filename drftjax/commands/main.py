"""The root command `drft`.

Its subcommands are the entry points of the group `drft.commands`, so an installed package adds
its own beside those that ship here:

    [project.entry-points."drft.commands"]
    sweep = "my_package.sweep:app"      # a typer.Typer

An app with one command and no callback becomes `drft sweep` itself; one with several becomes a
group. `drft --help` imports every app to show its first line, so an app imports JAX and other
slow packages inside its functions.
"""

import gc
import os
import signal
import sys
import threading
from collections import defaultdict
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Annotated, Any

import typer
from typer.core import TyperCommand
from typer.main import get_command

import drftjax
from drftjax.commands.options import CommandGroup
from drftjax.commands.printing import say
from drftjax.common.errors import InputError
from drftjax.common.jax_config import ALLOCATIONS_BETWEEN_COLLECTIONS

GROUP = "drft.commands"


INTERRUPT_REPEAT_DELAY = 0.05
"""Time until a lost interrupt is raised again [s]: long enough for the garbage collection to end,
inside which it would be lost once more."""

INTERRUPTED = 128 + 2  # exit code by which shells report a program that Ctrl-C ended


class PluginGroup(CommandGroup):
    """Group whose subcommands are the entry points of installed packages, loaded on use."""

    def __init__(self, **attributes: Any):
        super().__init__(**attributes)
        # The names alone, to list and to suggest from.
        self.commands = dict.fromkeys(sorted(_plugins()))  # pyright: ignore[reportAttributeAccessIssue]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Load the command of that name; None where there is none."""
        points = _plugins().get(cmd_name)
        return _load(cmd_name, points) if points else None


def subcommand(name: str) -> Any:
    """Command of an installed entry point by its name.

    Raises:
        KeyError: there is none of this name.
    """
    return _load(name, _plugins()[name])


@cache
def _plugins() -> dict[str, tuple[EntryPoint, ...]]:
    """Entry points of the subcommands by name."""
    found = defaultdict(list)
    for point in entry_points(group=GROUP):
        found[point.name].append(point)
    return {name: tuple(points) for name, points in found.items()}


@cache
def _load(name: str, points: tuple[EntryPoint, ...]) -> Any:
    """Command of an entry point, or one that says why it does not load."""
    try:
        if len(points) != 1:
            raise TypeError("several packages give it")
        app = points[0].load()
        if not isinstance(app, typer.Typer):
            raise TypeError(f"it must be a typer.Typer, not {type(app).__name__}")
        command = get_command(app)
    except (Exception, SystemExit) as error:
        return _broken(name, points, error)
    command.name = name
    # Shell completion belongs to the root alone.
    command.params = [
        parameter
        for parameter in command.params
        if parameter.name not in ("install_completion", "show_completion")
    ]
    return command


def _broken(name: str, points: tuple[EntryPoint, ...], error: BaseException) -> TyperCommand:
    """Command that refuses to run because its entry point does not load."""
    origin = ", ".join(map(_origin, points))
    reason = " ".join(f"{type(error).__name__}: {error}".split())

    def refuse():
        """Name the entry point and its error."""
        raise InputError(f"the subcommand {name!r} ({origin}) does not load: {reason}")

    return TyperCommand(
        name,
        callback=refuse,
        short_help=f"Does not load ({type(error).__name__}): run it to see why.",
        add_help_option=False,
        context_settings={"ignore_unknown_options": True, "allow_extra_args": True},
    )


def _origin(point: EntryPoint) -> str:
    """Package and place of an entry point, in words."""
    package = f"{point.dist.name} {point.dist.version}: " if point.dist else ""
    return f"{package}{point.value}"


def _show_version(wanted: bool) -> None:
    """Print the version and exit."""
    if wanted:
        typer.echo(f"drft {drftjax.__version__}")
        raise typer.Exit


app = typer.Typer(
    name="drft",
    cls=PluginGroup,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback()
def root(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Rover wheels on sand by dynamic resistive force theory."""


def main() -> None:
    """Run `drft`; an error that the user can correct is one sentence on stderr and exit code 2."""
    sys.unraisablehook = _lost
    gc.set_threshold(ALLOCATIONS_BETWEEN_COLLECTIONS)
    try:
        code = _run()
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader (`| head`) has left; what is still buffered has nowhere to go.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 1
    sys.exit(code)


def _lost(error: "sys.UnraisableHookArgs") -> None:
    """Interrupt once more where Python dropped a Ctrl-C, as it does inside garbage collection.

    A command that has a handler of its own has noted the first.
    """
    if not issubclass(error.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(error)
    elif signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        # To that thread itself, so that a wait ends early too.
        main_thread = threading.main_thread().ident
        again = threading.Timer(
            INTERRUPT_REPEAT_DELAY, signal.pthread_kill, (main_thread, signal.SIGINT)
        )
        again.daemon = True  # a program that ends by itself is not kept, nor interrupted
        again.start()


def _run() -> int | str | None:
    """Run the command line, and return the exit code."""
    try:
        get_command(app)(prog_name="drft")
    except SystemExit as end:  # typer ends every command so, Ctrl-C with 130
        if end.code == INTERRUPTED:
            print("drft: interrupted", file=sys.stderr)
        return end.code
    except InputError as error:
        return _refuse(str(error))
    except BrokenPipeError:
        raise
    except OSError as error:  # a full disk, a folder without permission, a missing file
        return _refuse(_os_sentence(error))
    return 0


def _refuse(sentence: str) -> int:
    """Print a refusal, and return its exit code."""
    say(f"drft: {sentence}", error=True)
    return 2


def _os_sentence(error: OSError) -> str:
    """Error of the operating system in words, with its file."""
    if error.strerror and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return error.strerror or str(error)


if __name__ == "__main__":
    main()
