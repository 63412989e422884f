"""Command lines that results record, checked before they are run again.

A result's file may come from anywhere, so its command is data: only subcommands that make results
are known, each argument must be one that the subcommand has, the files that it would write are
replaced, and no shell sees it.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import typer

from drftjax.common.errors import InputError
from drftjax.common.text import replace_unprintable
from drftjax.results.provenance import Provenance, input_digests


@dataclass(frozen=True)
class ResultCommand:
    """Subcommand of `drft` that makes a result.

    Attributes:
        schemas: Of the JSON files that it may write.
        inputs: Parameters that name files that it reads.
        output: Parameter that names the result.
        file: Name of the JSON file in the folder that `output` names; empty where it names the
            file itself.
    """

    schemas: tuple[str, ...]
    inputs: tuple[str, ...]
    output: str = "output"
    file: str = ""

    def result(self, stem: Path) -> tuple[Path, Path]:
        """The output to ask for, and the JSON file that is then written.

        Args:
            stem: Stem of the result's files, or the folder for them.
        """
        if self.file:
            return stem, stem / self.file
        name = stem if stem.suffix.lower() == ".json" else stem.with_name(stem.name + ".json")
        return name, name

    def stem(self, result: Path) -> Path:
        """Stem, or folder, by which a result's JSON file was asked for."""
        return result.absolute().parent if self.file else result.with_suffix("")


RESULT_COMMANDS: Final[Mapping[str, ResultCommand]] = MappingProxyType(
    {
        "fit": ResultCommand(("drft-fit",), ("runs", "parameters", "model")),
        "crosscheck": ResultCommand(("drft-crosscheck",), ("runs",)),
        "design": ResultCommand(("drft-design", "drft-screening"), ("setup", "like")),
        "diagnose": ResultCommand(("drft-diagnosis",), ("runs", "against"), file="diagnosis.json"),
        "evaluate": ResultCommand(("drft-evaluation",), ("runs", "model")),
    }
)
"""Subcommands whose results can be made again, by their names."""

PICTURE: Final = "picture"
"""Parameter of these that names a figure. A result made again has none: a file's command must not
replace a file."""


@dataclass(frozen=True)
class RecordedCommandLine:
    """A checked command line of a result.

    Attributes:
        name: The subcommand.
        kind: What it makes.
        parameters: Values that were given, by the parameter's name; without the output.
        options: Long name of each of them, with its dashes; "" for an argument.
    """

    name: str
    kind: ResultCommand
    parameters: Mapping[str, Any]
    options: Mapping[str, str]

    @property
    def inputs(self) -> list[Path]:
        """Files and folders that it reads, as they were given."""
        found: list[Path] = []
        for name in self.kind.inputs:
            value = self.parameters.get(name)
            found += value if isinstance(value, list | tuple) else [value] if value else []
        return found

    def arguments(self, output: Path, output_option: str) -> list[str]:
        """Arguments of `drft` that make the result at another place.

        Args:
            output: Where.
            output_option: The option for it, with its dashes.
        """
        before, after = [self.name], []
        for name, value in self.parameters.items():
            option = self.options[name]
            values = value if isinstance(value, list) else [value]
            if not option:
                after += map(str, values)
                continue
            for each in values:
                if isinstance(each, bool):
                    before.append(option)
                elif isinstance(each, tuple):
                    before += [option, *map(str, each)]
                else:
                    before.append(f"{option}={each}")
        return [*before, f"{output_option}={output}", "--", *after]


def parse_recorded(
    given: Sequence[str], schema: str, command: Any, result: Path
) -> tuple[RecordedCommandLine, str]:
    """Check a recorded command line.

    Args:
        given: The arguments, the subcommand first.
        schema: Of the file that holds them.
        command: Typer's command of that subcommand.
        result: The file, for the error message.

    Returns:
        The command, and its option for the output.

    Raises:
        InputError: an argument is none of the subcommand's, or it would do more than read the
            inputs and write the result.
    """
    name, *arguments = given
    kind = RESULT_COMMANDS[name]
    refused = f"{result}: the recorded command"
    if schema not in kind.schemas:
        raise InputError(f"{refused} is drft {name}, which makes no {schema}")
    if not all(map(_is_passable, arguments)) or {"--help", "-h"} & {*arguments}:
        raise InputError(f"{refused} is none that makes a result: {_quoted(given)}")
    try:
        context = command.make_context(name, list(arguments))
    except typer.TyperException as problem:
        reason = problem.format_message().rstrip(".")
        raise InputError(
            f"{refused} is none that drft {name} has: {reason[:1].lower()}{reason[1:]} in "
            f"{_quoted(given)}"
        ) from None
    parameters, options, output_option = {}, {}, ""
    for each in command.params:
        value = context.params.get(each.name)
        long = max(each.opts, key=len) if each.param_type_name == "option" else ""
        if each.name == kind.output:
            output_option = long
        elif each.name == PICTURE:
            continue
        elif context.get_parameter_source(each.name).name == "COMMANDLINE":
            if value is False:
                long = max(each.secondary_opts, key=len)
            parameters[each.name], options[each.name] = value, long
    for each, value in parameters.items():
        if isinstance(value, Path) and each not in kind.inputs:
            raise InputError(f"{refused} names a file by {options[each]}, which is no input")
    cluster = str(parameters.get("cluster", "local"))
    if cluster.partition(":")[0] != "local":
        raise InputError(
            f"{refused} connects to {cluster}; a command from a file must not: give it by hand"
        )
    return RecordedCommandLine(name, kind, parameters, options), output_option


def require_known_command(given: Sequence[str] | None, result: Path) -> str:
    """Subcommand of a recorded command line, one of `RESULT_COMMANDS`.

    Args:
        given: The arguments; None where Python made the result.
        result: The file that holds them, for the error message.

    Raises:
        InputError: for another subcommand, or none.
    """
    if given is None:
        raise InputError(
            f"{result}: was made from Python and names no command; call the same functions again"
        )
    if not given or given[0] not in RESULT_COMMANDS:
        known = ", ".join(RESULT_COMMANDS)
        raise InputError(
            f"{result}: the recorded command is {_quoted(given)}, must be one of {known}"
        )
    return given[0]


def _is_passable(text: str) -> bool:
    """True for a text that can be handed to a process: no NUL, and no half of a character."""
    return not any(each == "\0" or "\ud800" <= each <= "\udfff" for each in text)


def _quoted(arguments: Sequence[str]) -> str:
    """A command line for reading, control characters as escapes."""
    return " ".join(each if each.isalnum() else repr(each) for each in ("drft", *arguments))


@dataclass(frozen=True)
class FoundInputs:
    """Inputs of a recorded command as they are now.

    Attributes:
        base: Folder in which its relative paths were found.
        changes: Sentences on files that are not what they were.
    """

    base: Path
    changes: tuple[str, ...]


def find_inputs(command: RecordedCommandLine, provenance: Provenance, result: Path) -> FoundInputs:
    """Find the inputs: from the current directory, from the result's folder, or from one above it.

    The first folder wins from which all inputs are the recorded ones; else the first from which all
    are there.

    Args:
        command: The recorded command.
        provenance: Of the result, with the inputs' SHA-256.
        result: The result's file.

    Raises:
        InputError: from no folder are all inputs there; names the missing ones.
    """
    recorded = {each.name: each.sha256 for each in provenance.inputs}
    places = dict.fromkeys([Path.cwd(), *result.absolute().parents])
    found: FoundInputs | None = None
    lacking: list[list[str]] = []
    for base in places:
        now = input_digests(command.inputs, base)
        lacking.append(_missing(recorded, now))
        if lacking[-1]:
            continue
        changes = tuple(map(replace_unprintable, _changes(recorded, now)))
        if not changes:
            return FoundInputs(base, ())
        found = found or FoundInputs(base, changes)
    if found is None:
        missing = min(lacking, key=len)
        named = replace_unprintable(", ".join(missing))
        are = "is missing; it must lie" if len(missing) == 1 else "are missing; they must lie"
        raise InputError(
            f"{result}: {named} {are} where the paths lead from the current directory, from the "
            "result's folder or from one above it"
        )
    return found


def _missing(recorded: Mapping[str, str | None], now: Mapping[str, str | None]) -> list[str]:
    """Names of inputs that could be read and now cannot, or that the record does not know of."""
    lost = [name for name, digest in recorded.items() if digest and not now.get(name)]
    return lost + [name for name, digest in now.items() if not digest and name not in recorded]


def _changes(recorded: Mapping[str, str | None], now: Mapping[str, str | None]) -> list[str]:
    """Sentences on inputs that are not the recorded ones."""
    sentences = []
    for name, digest in now.items():
        if name not in recorded:
            sentences.append(f"{name} is new")
        elif digest != recorded[name]:
            was, is_now = ((each or "unreadable")[:12] for each in (recorded[name], digest))
            sentences.append(f"{name} has changed: its SHA-256 was {was}..., is {is_now}...")
    return sentences


def relative_to_base(path: Path, base: Path) -> Path:
    """Path from a folder, as the command's other paths are; of the whole where there is none."""
    try:
        return Path(os.path.relpath(path.resolve(), base.resolve()))
    except ValueError:  # another drive
        return path.absolute()
