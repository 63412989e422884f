"""Which options a user has given, as against those that stand at their defaults."""

import typer

from drftjax.errors import InputError


def refuse_given(context: typer.Context, names: tuple[str, ...], why: str) -> None:
    """Refuse options that would be ignored.

    Args:
        context: Of the command.
        names: Of its arguments that are of no use here.
        why: What they need, or what there is instead.

    Raises:
        InputError: names the options that were given all the same.
    """
    given = [each for each in names if _on_command_line(context, each)]
    if given:
        options = ", ".join(f"--{each.replace('_', '-')}" for each in given)
        raise InputError(f"{options} would be ignored: {why}")


def _on_command_line(context: typer.Context, name: str) -> bool:
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"
