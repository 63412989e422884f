"""Tables of a set-up that refuse impossible entries when they are built."""

import copy
from functools import cache
from typing import Any, ClassVar, Self

import jax.core as jax_core
import msgspec

from drftjax.common.errors import InputError
from drftjax.common.structured_files import explain


class CheckedTable(msgspec.Struct, forbid_unknown_fields=True):
    """A table whose entries have their types and possible values.

    Arrays become lists, and tables may be given as dictionaries. A number that JAX traces passes,
    as it has no value yet. Entries that are set later are checked when a trial is built.

    Attributes:
        place: Name of the table in a set-up file, for error messages; "" for the whole file.
    """

    place: ClassVar[str] = ""

    def __post_init__(self) -> None:
        for name, kind in _types(type(self)):
            given = getattr(self, name)
            if not _is_traced(given):
                setattr(self, name, self._converted(name, given, kind))
        self.check()

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """A copy that is not checked again: entries that belong together are set one by one."""
        other = copy.copy(self)
        for name in self.__struct_fields__:
            setattr(other, name, copy.deepcopy(getattr(self, name), memo))
        return other

    def check(self) -> None:
        """Refuse values that cannot be.

        Raises:
            InputError: names the entry, what was given and what must hold.
        """

    def _converted(self, name: str, given: Any, kind: Any) -> Any:
        """An entry in the type that it must have."""
        try:
            return msgspec.convert(_plain(given), kind)
        except msgspec.ValidationError as problem:
            if isinstance(problem.__cause__, InputError):
                raise problem.__cause__ from None
            raise InputError(self._explained(name, str(problem))) from None

    def _explained(self, name: str, problem: str) -> str:
        """A sentence on an entry of the wrong type, as of one in a file."""
        inside = " - at `$"
        where = f"{inside}.{name}"
        at = problem.replace(inside, where) if inside in problem else f"{problem}{where}`"
        sentence = explain(at, type(self))
        return f"{self.place}.{sentence}" if self.place and sentence.startswith(name) else sentence


@cache
def _types(table: type[msgspec.Struct]) -> tuple[tuple[str, Any], ...]:
    return tuple((each.name, each.type) for each in msgspec.structs.fields(table))


def _plain(value: Any) -> Any:
    """Arrays inside dictionaries and lists as lists and numbers."""
    if isinstance(value, dict):
        return {name: _plain(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return value.tolist() if hasattr(value, "tolist") else value


def _is_traced(value: Any) -> bool:
    return isinstance(value, jax_core.Tracer)
