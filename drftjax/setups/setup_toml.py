"""Set-ups as TOML text."""

import json
from collections.abc import Iterable, Mapping

import msgspec

from drftjax.setups.setup import SetUp, as_in_file


def setup_toml(
    setup: SetUp, head: Iterable[str] = (), comments: Mapping[tuple[str, str], str] | None = None
) -> str:
    """A set-up as the text of its TOML file, which `drftjax.setups.setup.read_setup` reads back.

    Args:
        setup: Set-up to write.
        head: Lines of comment to begin with.
        comments: Comments behind numbers, by table and key; the effects' tables go by "effect 1",
            "effect 2" and so on.
    """
    document = msgspec.to_builtins(as_in_file(setup))
    effects = document.pop("effect")
    tables = {
        name: document.pop(name) for name in list(document) if isinstance(document[name], dict)
    }
    lines = [f"# {line}" for line in head]
    lines += [f"{name} = {_toml(value)}" for name, value in document.items()]
    titled = [(f"[{name}]", name, table) for name, table in tables.items()]
    titled += [("[[effect]]", f"effect {n}", each) for n, each in enumerate(effects, start=1)]
    for title, name, table in titled:
        lines += ["", title]
        for key, value in table.items():
            if value is not None:
                comment = (comments or {}).get((name, key))
                lines.append(f"{key} = {_toml(value)}" + (f"  # {comment}" if comment else ""))
    return "\n".join(lines) + "\n"


def _toml(value: object) -> str:
    """A value of a set-up as TOML writes it."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_toml(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    # Text and numbers are written alike in JSON and TOML, but for the letters beyond ASCII
    # that JSON may escape in pairs.
    return json.dumps(value, ensure_ascii=False)
