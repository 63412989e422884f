"""Survey of an HDF5 file: its contents, and the reasons not to read it.

A file is surveyed before any value is read: links, external storage, virtual datasets, foreign
types and sizes beyond a limit are found from headers alone.
"""

import re
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from math import prod
from pathlib import Path
from typing import Any, Final, cast

import h5py
import numpy as np
from numpy.typing import NDArray

from drftjax.common.errors import read_failure
from drftjax.common.structured_files import HDF5
from drftjax.common.text import replace_unprintable
from drftjax.runlog import recording_lock
from drftjax.runlog.content import Attribute, Content, Dataset, Found, Group, Level, Violation
from drftjax.runlog.hdf5.checksum import checksum_matches
from drftjax.runlog.hdf5.examination import examine, identify
from drftjax.runlog.schema import COLUMNS, MANDATORY_GROUPS, SCHEMA, SCHEMA_VERSION

SIZE_LIMIT: Final = 512 * 2**20
"""Most bytes that a file's datasets may declare together."""


OBJECT_LIMIT: Final = 2000
"""Most objects in a file, and most rows of an attribute."""


BUILT_IN_FILTERS: Final = 255
"""HDF5 numbers its own filters up to here; others need a plug-in, which is code."""


# What h5py raises when the library finds damage, from place to place.
_LIBRARY_ERRORS: Final = (OSError, RuntimeError, ValueError, KeyError, TypeError, MemoryError)


_AT_WORK: Final = "is still being recorded; it can be read when the run has ended"


_NO_HDF5: Final = "is not an HDF5 file"


_NOT_READ: Final = ("CLASS", "NAME", "DIMENSION_LIST", "REFERENCE_LIST", "DIMENSION_LABELS")


def survey(
    path: Path, schema: str, version: int, find: Callable[[Content], Iterable[Found]]
) -> tuple[Content | None, list[Violation]]:
    """Survey a file.

    Args:
        path: The file.
        schema: Schema that its attributes must name.
        version: Newest version of that schema that is read.
        find: Finds violations of that schema.

    Returns:
        Contents, None where the file cannot be opened; and all violations.
    """
    refusal = _not_openable(path)
    if refusal is not None:
        return None, [Violation(str(path), "/", refusal)]
    try:
        with h5py.File(path, "r") as file:
            content, found = _Survey(file).content(schema, version)
    except _LIBRARY_ERRORS as error:
        return None, [Violation(str(path), "/", replace_unprintable(_open_failure(error)))]
    identity = list(identify(content, schema, version))
    return content, with_file_name(path, identity or [*found, *find(content)])


def survey_recording(path: Path) -> tuple[Content | None, list[Violation]]:
    """Committed rows of an interrupted recording, as contents of a run log; and violations."""
    refusal = _not_a_file(path)
    if refusal is None and recording_lock.is_held(path):
        refusal = _AT_WORK
    if refusal is None and not _signed(path):
        refusal = _NO_HDF5
    if refusal is not None:
        return None, [Violation(str(path), "/", refusal)]
    try:
        with h5py.File(path, "r", swmr=True) as file:
            if COMMITTED not in file:
                reason = f"is no recording: it has no dataset {COMMITTED}"
                return None, [Violation(str(path), "/", reason)]
            rows = committed_rows(file)
            content, found = _Survey(file, rows).content(SCHEMA, SCHEMA_VERSION)
    except _LIBRARY_ERRORS as error:
        return None, [Violation(str(path), "/", replace_unprintable(_open_failure(error)))]
    identity = list(identify(content, SCHEMA, SCHEMA_VERSION))
    content = _without_bookkeeping(content, rows)
    return content, with_file_name(path, identity or [*found, *examine(content)])


def with_file_name(path: Path, found: Iterable[Found]) -> list[Violation]:
    """Add the file's name to violations, and make them safe to print."""
    return [
        Violation(str(path), replace_unprintable(place), replace_unprintable(reason), level)
        for place, reason, level in found
    ]


def _without_bookkeeping(content: Content, rows: Mapping[str, int]) -> Content:
    """Contents without the datasets of a recorder and without groups that got no row."""
    attributes = {key: value for key, value in content.attributes.items() if key != "complete"}
    groups = {
        title: group
        for title, group in content.groups.items()
        if title in MANDATORY_GROUPS or rows.get(title, 1)
    }
    return Content(attributes, groups)


def _not_openable(path: Path) -> str | None:
    """Reason not to open a file as a finished run log; None where there is none."""
    refusal = _not_a_file(path)
    if refusal is not None:
        return refusal
    if path.name.endswith(recording_lock.PART):
        return _AT_WORK if recording_lock.is_held(path) else _cut_off(path)
    try:
        if checksum_matches(path) is False:
            return "is damaged: the checksum of the whole file does not hold"
        if not h5py.is_hdf5(str(path)):
            with path.open("rb"):
                return _NO_HDF5
    except OSError as error:
        return read_failure(path, error)
    return None


def _not_a_file(path: Path) -> str | None:
    """Reason why a path is no ordinary file with contents; None for such a file."""
    try:
        facts = path.stat()
    except OSError as error:
        return read_failure(path, error)
    if stat.S_ISDIR(facts.st_mode):
        return "is a folder, must be a file"
    if not stat.S_ISREG(facts.st_mode):
        return "is not an ordinary file"
    if facts.st_size == 0:
        return "is empty"
    return None


def _signed(path: Path) -> bool:
    """True where a file begins as HDF5 does; the library would ask for the locks of a recording."""
    try:
        with path.open("rb") as file:
            return file.read(len(HDF5)) == HDF5
    except OSError:
        return True  # opening it says what is wrong


def _cut_off(path: Path) -> str:
    """Clause that tells how to repair an interrupted recording."""
    return (
        "is a recording that was cut off; make an ordinary run log of its rows: "
        f"drft log repair {path}"
    )


def _open_failure(error: Exception) -> str:
    """Clause for an error of the HDF5 library."""
    text = str(error)
    if isinstance(error, MemoryError):
        return "is damaged: it asks for more memory than a reader is given"
    if "SWMR" in text or "already open for write" in text:
        return (
            "is still being recorded, or its recording was cut off; drft log repair makes an "
            "ordinary run log of what was"
        )
    if "unable to lock" in text:
        return "is open for writing in another program"
    if "truncated" in text or "eof" in text:
        return "is cut short: it ends before the data that it declares"
    return "is damaged: its HDF5 structure cannot be read"


class _Survey:
    """One pass over an open file: headers first, then the values of datasets without a hazard."""

    def __init__(self, file: h5py.File, rows: Mapping[str, int] | None = None):
        """Survey nothing yet.

        Args:
            file: An open file.
            rows: Number of rows to read by group, for a recording.
        """
        self.file = file
        self.rows = rows
        self.found: list[Found] = []
        self.seen: set[Any] = {_address(file)}
        self.members = 0
        self.declared = 0
        self.readable: dict[str, h5py.Dataset] = {}

    def content(self, schema: str, version: int) -> tuple[Content, list[Found]]:
        """Contents of the file, and violations found on the way."""
        root = Content(self._attributes("/", self.file))
        if any(identify(root, schema, version)):
            return root, []
        groups: dict[str, Group] = {}
        datasets = self._group("/", self.file, groups)
        if self.declared > SIZE_LIMIT:
            reason = f"declares {self.declared} bytes of data, more than {SIZE_LIMIT} are not read"
            self._refuse("/", reason)
        else:
            groups = {title: self._filled(title, group) for title, group in groups.items()}
        return Content(root.attributes, groups, datasets), self.found

    def _refuse(self, where: str, reason: str) -> None:
        """Note a violation for which the file is refused."""
        self.found.append((where, reason, Level.REFUSED))

    def _group(self, where: str, node: h5py.Group, groups: dict[str, Group]) -> dict[str, Dataset]:
        """Survey the members of a group; groups below it are added to `groups`."""
        datasets: dict[str, Dataset] = {}
        for name in map(str, node):
            place = f"{where.rstrip('/')}/{name}"
            self.members += 1
            if self.members == OBJECT_LIMIT:
                self._refuse(
                    "/", f"has more than {OBJECT_LIMIT} objects; the rest is not looked at"
                )
            if self.members >= OBJECT_LIMIT:
                break
            try:
                self._place(place, node, name, groups, datasets)
            except _LIBRARY_ERRORS as error:
                self._refuse(place, _open_failure(error))
        return datasets

    def _place(
        self,
        place: str,
        node: h5py.Group,
        name: str,
        groups: dict[str, Group],
        datasets: dict[str, Dataset],
    ) -> None:
        """Survey one member of a group."""
        member = self._member(place, node, name)
        if isinstance(member, h5py.Group):
            title = place[1:]
            attributes = self._attributes(place, member)
            groups[title] = Group({}, attributes)
            groups[title] = Group(self._group(place, member, groups), attributes)
        elif isinstance(member, h5py.Dataset):
            datasets[name] = self._dataset(place, member)

    def _member(self, place: str, node: h5py.Group, name: str) -> Any:
        """Object behind a plain link, seen for the first time; else None and a violation."""
        try:
            link = node.get(name, getlink=True)
        except TypeError:
            return self._refuse(place, "is a user-defined link; a run log has no links")
        if isinstance(link, h5py.ExternalLink):
            reason = f"is an external link to {link.filename}; a run log has no links"
            return self._refuse(place, reason)
        if isinstance(link, h5py.SoftLink):
            return self._refuse(place, f"is a soft link to {link.path}; a run log has no links")
        member = node[name]
        address = _address(member)
        if address in self.seen:
            return self._refuse(place, "is a second link to an object; a run log has no links")
        self.seen.add(address)
        if not isinstance(member, h5py.Group | h5py.Dataset):
            return self._refuse(place, "is neither a group nor a dataset")
        return member

    def _dataset(self, where: str, node: h5py.Dataset) -> Dataset:
        """Header of a dataset; its values are read later unless it has a hazard."""
        created = node.id.get_create_plist()
        chunked = created.get_layout() == h5py.h5d.CHUNKED
        filters = [created.get_filter(i)[0] for i in range(created.get_nfilters())]
        shape = node.shape if node.shape is not None else ()
        hazards = list(_hazards(node, created, filters))
        for reason in hazards:
            self._refuse(where, reason)
        if not hazards:
            rows = prod(shape)
            chunk = prod(node.chunks) if chunked and node.chunks else 0
            self.declared += max(rows, chunk) * node.id.get_type().get_size()
            self.readable[where] = node
        sealed = h5py.h5z.FILTER_FLETCHER32 in filters
        scale, scaled_by = _scales(node)
        attributes = self._attributes(where, node)
        return Dataset(None, shape, attributes, chunked, sealed, scale, scaled_by)

    def _filled(self, title: str, group: Group) -> Group:
        """Group with the values of its datasets."""
        datasets = {
            name: self._with_values(title, name, each) for name, each in group.datasets.items()
        }
        return Group(datasets, group.attributes)

    def _with_values(self, title: str, name: str, dataset: Dataset) -> Dataset:
        """Dataset with its values, of a recording the committed rows."""
        where = f"/{title}/{name}"
        if self.rows is None or title not in self.rows:
            return replace(dataset, values=self._values(where))
        values = self._values(where, self.rows[title])
        shape = dataset.shape if values is None else values.shape
        return replace(dataset, values=values, shape=shape)

    def _values(self, where: str, rows: int | None = None) -> NDArray[Any] | None:
        """Values of a dataset; None, and a violation, where they cannot be read."""
        node = self.readable.get(where)
        if node is None:
            return None
        try:
            if rows is not None:
                return committed_values(node, rows)
            if node.chunks is not None and not _all_chunks_stored(node):
                return self._refuse(where, "has rows that were never written")
            return np.asarray(node[()])
        except (OSError, RuntimeError, ValueError) as error:
            known = re.search("checksum|filter", str(error))
            what = "its checksum does not hold" if known else "its values cannot be read"
            self._refuse(where, f"is damaged: {what}")
            return None

    def _attributes(self, where: str, node: Any) -> dict[str, Attribute]:
        """Attributes of an object that are numbers or text; violations for others."""
        attributes: dict[str, Attribute] = {}
        for name in node.attrs:
            if name in _NOT_READ or name.startswith("_"):
                continue
            header = node.attrs.get_id(name)
            kind = header.get_type()
            if isinstance(kind, h5py.h5t.TypeStringID) and not kind.is_variable_str():
                reason = f"has the attribute {name} as fixed-length text; its length must vary"
                self.found.append((where, reason, Level.FORMAT))
            simple = h5py.h5t.TypeStringID | h5py.h5t.TypeIntegerID | h5py.h5t.TypeFloatID
            shape = header.shape
            if not isinstance(kind, simple) or len(shape or ()) > 1:
                reason = f"has the attribute {name}, which is neither number nor text"
                self.found.append((where, reason, Level.FORMAT))
            elif shape is None and not isinstance(kind, h5py.h5t.TypeStringID):
                reason = f"has the attribute {name} without a value"
                self.found.append((where, reason, Level.FORMAT))
            elif shape and prod(shape) * kind.get_size() > OBJECT_LIMIT * 8:
                self._refuse(where, f"has the attribute {name} with {shape[0]} rows")
            elif shape == () and kind.get_size() > OBJECT_LIMIT * 8:
                reason = f"has the attribute {name} of {kind.get_size()} bytes"
                self._refuse(where, f"{reason}, more than {OBJECT_LIMIT * 8} are not read")
            else:
                attributes[name] = _plain(node.attrs[name])
        return attributes


def _address(node: Any) -> Any:
    """Address of an object in the file; two links to one object have the same."""
    return cast(Any, h5py).h5o.get_info(node.id).addr


def _hazards(node: h5py.Dataset, created: Any, filters: list[int]) -> Iterator[str]:
    """Reasons not to read the values of a dataset."""
    if created.get_external_count():
        other = created.get_external(0)[0].decode(errors="replace")
        yield f"keeps its data in another file, {other}; a run log holds its own data"
    if created.get_layout() == h5py.h5d.VIRTUAL:
        yield "is a virtual dataset; a run log holds its own data"
    kind = node.id.get_type()
    if isinstance(kind, h5py.h5t.TypeCompoundID):
        yield "has a compound type; it must be plain numbers"
    elif isinstance(kind, h5py.h5t.TypeStringID):
        length = "variable" if kind.is_variable_str() else "fixed"
        yield f"holds text of {length} length; it must be plain numbers"
    elif not isinstance(kind, h5py.h5t.TypeIntegerID | h5py.h5t.TypeFloatID):
        yield f"has the type {type(kind).__name__}; it must be plain numbers"
    if node.shape is None:
        yield "has no values at all"
    foreign = [each for each in filters if each > BUILT_IN_FILTERS]
    if foreign:
        yield f"is packed by filter {foreign[0]}, which needs a plug-in"


def _all_chunks_stored(node: h5py.Dataset) -> bool:
    """True where every chunk is stored with all filters: no fill values, no lost checksum."""
    sides = cast(tuple[int, ...], node.chunks)
    wanted = prod(-(-extent // side) for extent, side in zip(node.shape, sides, strict=True))
    masks: list[int] = []
    node.id.chunk_iter(lambda chunk: masks.append(chunk.filter_mask))
    return len(masks) == wanted and not any(masks)


def _scales(node: h5py.Dataset) -> tuple[bool, tuple[str, ...]]:
    """True for a dimension scale, and the paths of the scales of a dataset's rows."""
    try:
        if h5py.h5ds.is_scale(node.id):
            return True, ()
        if not node.shape:
            return False, ()
        return False, tuple(str(each.name) for each in node.dims[0].values())
    except (OSError, RuntimeError, ValueError, KeyError, TypeError):
        return False, ()


def _plain(value: Any) -> Attribute:
    """Attribute as Python text, numbers, or a list of them; bytes are text."""
    if isinstance(value, h5py.Empty):
        return ""
    if isinstance(value, bytes | np.bytes_):
        return bytes(value).decode("utf-8", "replace").replace("\0", "\ufffd")
    if isinstance(value, str):
        return value.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
    if isinstance(value, np.ndarray):
        items = [_plain(each) for each in value]
        return cast(Attribute, items[0] if len(items) == 1 else items)
    return value.item() if isinstance(value, np.generic) else value


COMMITTED: Final = "n_committed"


GROUPS: Final = tuple(COLUMNS)
"""Groups whose rows /n_committed counts, in its order."""


def committed_rows(file: h5py.File) -> dict[str, int]:
    """Number of committed rows by group.

    Raises:
        KeyError: the file is not a recording.
    """
    counts = np.asarray(cast(h5py.Dataset, file[COMMITTED])[()])
    return {title: int(rows) for title, rows in zip(GROUPS, counts, strict=False) if title in file}


def committed_values(node: h5py.Dataset, rows: int) -> NDArray[Any]:
    """First rows of a dataset.

    If the recorder is killed while it rewrites the last chunk, the checksum of that chunk fails.
    The rows that were committed before are the same in the old and in the new chunk.

    Raises:
        OSError: they cannot be read.
    """
    if node.shape[0] < rows:
        raise OSError(f"{node.shape[0]} rows of {rows} are there")
    try:
        return np.asarray(node[:rows])
    except OSError:
        side = cast(tuple[int, ...], node.chunks)[0]
        start = (rows - 1) // side * side
        _, chunk = node.id.read_direct_chunk((start,))
        last = np.frombuffer(chunk, node.dtype, rows - start)
        return np.concatenate([np.asarray(node[:start]), last])
