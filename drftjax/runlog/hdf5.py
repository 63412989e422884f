"""Run logs and result files on disk. The only module that talks to the HDF5 library.

A file is surveyed before anything is read: links, external storage, virtual datasets, foreign
types and sizes past a limit are found from headers alone. A file is written as an image in
memory and put in place whole, because the HDF5 library itself does not survive a full disk.
"""

import stat
from collections.abc import Iterator, Mapping
from dataclasses import replace
from math import prod
from pathlib import Path
from typing import Any, Final, cast

import h5py
import numpy as np
from numpy.typing import NDArray

from drftjax.runlog import layout
from drftjax.runlog.content import (
    Attribute,
    Content,
    Dataset,
    Found,
    Group,
    Level,
    Violation,
    printable,
)
from drftjax.runlog.record import RunLog
from drftjax.runlog.replace import replace_file
from drftjax.runlog.result import Columns, Result, result_content, result_from
from drftjax.runlog.seal import seal_holds, sealed

SIZE_LIMIT: Final = 512 * 2**20
"""Most bytes that a file's datasets may declare together."""
OBJECT_LIMIT: Final = 2000
"""Most objects in a file, and most rows of an attribute."""
ROWS_IN_CHUNK: Final = 16384
BUILT_IN_FILTERS: Final = 255
"""HDF5 numbers its own filters up to here; others need a plug-in, which is code."""

Name = str | Path
# What h5py raises when the library finds damage, from place to place.
_LIBRARY_ERRORS: Final = (OSError, RuntimeError, ValueError, KeyError, TypeError, MemoryError)
_NOT_READ: Final = ("CLASS", "NAME", "DIMENSION_LIST", "REFERENCE_LIST", "DIMENSION_LABELS")


def read_run(path: Name) -> RunLog:
    """Read a run log; an InputError names the file and the first reason to refuse it.

    Damage to HDF5's own metadata can hang or crash the library. For a file of unknown origin use
    `drftjax.runlog.check.read_run_guarded`.
    """
    content, violations = survey_run(path)
    return layout.run_from(content, violations)


def survey_run(path: Name) -> tuple[Content | None, list[Violation]]:
    """A file's contents and everything that is wrong with it as a run log."""
    return _survey(path, layout.SCHEMA, layout.SCHEMA_VERSION, layout.examine)


def write_run(path: Name, run: RunLog) -> None:
    """Write a run log whole or not at all; a file of that name is replaced."""
    replace_file(Path(path), sealed(_image(layout.to_content(run), layout.AXES)))


def write_result(
    path: Name,
    schema: str,
    attributes: Mapping[str, Attribute],
    groups: Mapping[str, Columns],
    version: int = 1,
) -> None:
    """Write a result file of another schema, with a run log's care.

    Args:
        path: Final name; what stood there is replaced.
        schema: Name of the kind of file, such as "drft-fit".
        attributes: Text, numbers and flat lists of either, on the root.
        groups: Datasets as (array, unit) by group and name; a `ResultGroup` adds attributes.
            Arrays of any rank; an infinite or absent number is allowed in a result.
        version: Version of that schema.
    """
    content = result_content(schema, version, attributes, groups)
    replace_file(Path(path), sealed(_image(content, {})))


def read_result(path: Name, schema: str, version: int = 1) -> Result:
    """Read a result file of this schema; an InputError names the file and the reason."""
    content, violations = _survey(path, schema, version, lambda _: ())
    return result_from(layout.accepted(content, violations))


# Writing ----------------------------------------------------------------------------------------


def _image(content: Content, axes: Mapping[str, str]) -> bytes:
    """The bytes of an HDF5 file; format 1.10, whose metadata carry checksums."""
    with h5py.File(
        "image", "w", driver="core", backing_store=False, libver=("v110", "v110")
    ) as file:
        _put_attributes(file, content.attributes)
        for title, group in content.groups.items():
            node = file.create_group(title)
            _put_attributes(node, group.attributes)
            for name, dataset in group.datasets.items():
                _put_dataset(node, name, dataset)
            if title in axes:
                _scale(node, axes[title])
        file.flush()
        return file.id.get_file_image()


def _put_dataset(node: h5py.Group, name: str, dataset: Dataset) -> None:
    values = np.atleast_1d(cast(NDArray[Any], dataset.values))
    rows = max(1, min(values.shape[0], ROWS_IN_CHUNK))
    # Little-endian by name, so that a file does not depend on the machine that wrote it.
    made = node.create_dataset(
        name,
        data=values.astype(values.dtype.newbyteorder("<")),
        chunks=(rows, *(max(1, extent) for extent in values.shape[1:])),
        shuffle=True,
        compression="gzip",
        fletcher32=True,
    )
    _put_attributes(made, dataset.attributes)


def _put_attributes(node: Any, attributes: Mapping[str, Attribute]) -> None:
    for name, value in attributes.items():
        if isinstance(value, list) and value and isinstance(value[0], str):
            node.attrs.create(name, value, dtype=h5py.string_dtype())
        else:
            node.attrs[name] = value


def _scale(node: h5py.Group, axis: str) -> None:
    scale = cast(h5py.Dataset, node[axis])
    scale.make_scale(axis)
    for name, each in node.items():
        if name != axis:
            each.dims[0].attach_scale(scale)


# Reading ----------------------------------------------------------------------------------------


def _survey(
    path: Name, schema: str, version: int, examine: Any
) -> tuple[Content | None, list[Violation]]:
    where = str(path)
    refusal = _not_openable(Path(path))
    if refusal is not None:
        return None, [Violation(where, "/", refusal)]
    try:
        with h5py.File(path, "r") as file:
            content, found = _Survey(file).content(schema, version)
    except _LIBRARY_ERRORS as error:
        return None, [Violation(where, "/", printable(_open_failure(error)))]
    identity = list(layout.identify(content, schema, version))
    found = identity or [*found, *examine(content)]
    return content, [
        Violation(where, printable(place), printable(reason), level)
        for place, reason, level in found
    ]


def _not_openable(path: Path) -> str | None:
    try:
        facts = path.stat()
    except OSError as error:
        return f"cannot be read: {(error.strerror or str(error)).lower()}"
    if stat.S_ISDIR(facts.st_mode):
        return "is a folder, it must be a file"
    if not stat.S_ISREG(facts.st_mode):
        return "is not an ordinary file"
    if facts.st_size == 0:
        return "is empty"
    if path.name.endswith(".part"):
        return "is still being recorded, or its recording was cut off; close or repair it first"
    try:
        if seal_holds(path) is False:
            return "is damaged: the checksum of the whole file does not hold"
        if not h5py.is_hdf5(str(path)):
            with path.open("rb"):
                return "is not an HDF5 file"
    except OSError as error:
        return f"cannot be read: {(error.strerror or str(error)).lower()}"
    return None


def _open_failure(error: Exception) -> str:
    text = str(error)
    if isinstance(error, MemoryError):
        return "is damaged: it asks for more memory than a reader is given"
    if "SWMR" in text or "already open for write" in text:
        return "is still being recorded, or its recording was cut off; close or repair it first"
    if "unable to lock" in text:
        return "is open for writing in another program"
    if "truncated" in text or "eof" in text:
        return "is cut short: it ends before the data that it declares"
    return f"is damaged: the HDF5 library says {' '.join(text.split())}"


class _Survey:
    """One pass over an open file: headers first, values only where nothing speaks against it."""

    def __init__(self, file: h5py.File):
        self.file = file
        self.found: list[Found] = []
        self.seen: set[Any] = {_address(file)}
        self.members = 0
        self.declared = 0
        self.readable: dict[str, h5py.Dataset] = {}

    def content(self, schema: str, version: int) -> tuple[Content, list[Found]]:
        root = Content(self._attributes("/", self.file))
        if any(layout.identify(root, schema, version)):
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
        self.found.append((where, reason, Level.REFUSED))

    def _group(self, where: str, node: h5py.Group, groups: dict[str, Group]) -> dict[str, Dataset]:
        """Survey a group's members; the groups below it are added to `groups`."""
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
        member = self._member(place, node, name)
        if isinstance(member, h5py.Group):
            title = place[1:]
            attributes = self._attributes(place, member)
            groups[title] = Group({}, attributes)
            groups[title] = Group(self._group(place, member, groups), attributes)
        elif isinstance(member, h5py.Dataset):
            datasets[name] = self._dataset(place, member)

    def _member(self, place: str, node: h5py.Group, name: str) -> Any:
        """The object behind a plain link, seen for the first time; None with a finding else."""
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
        datasets = {
            name: replace(each, values=self._values(f"/{title}/{name}"))
            for name, each in group.datasets.items()
        }
        return Group(datasets, group.attributes)

    def _values(self, where: str) -> NDArray[Any] | None:
        node = self.readable.get(where)
        if node is None:
            return None
        try:
            if node.chunks is not None and not _all_chunks_stored(node):
                return self._refuse(where, "has rows that were never written")
            return np.asarray(node[()])
        except (OSError, RuntimeError, ValueError) as error:
            text = " ".join(str(error).split())
            known = "checksum" in text or "filter" in text
            self._refuse(where, "is damaged: " + ("its checksum does not hold" if known else text))
            return None

    def _attributes(self, where: str, node: Any) -> dict[str, Attribute]:
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
            if not isinstance(kind, simple) or len(header.shape) > 1:
                reason = f"has the attribute {name}, which is neither number nor text"
                self.found.append((where, reason, Level.FORMAT))
            elif prod(header.shape) * kind.get_size() > OBJECT_LIMIT * 8:
                self._refuse(where, f"has the attribute {name} with {header.shape[0]} rows")
            else:
                attributes[name] = _plain(node.attrs[name])
        return attributes


def _address(node: Any) -> Any:
    """Where an object stands in the file: two links to it lead to one address."""
    return cast(Any, h5py).h5o.get_info(node.id).addr


def _hazards(node: h5py.Dataset, created: Any, filters: list[int]) -> Iterator[str]:
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
    """Every chunk is on disk with all its filters: no fill values, no skipped checksum."""
    sides = cast(tuple[int, ...], node.chunks)
    wanted = prod(-(-extent // side) for extent, side in zip(node.shape, sides, strict=True))
    masks: list[int] = []
    node.id.chunk_iter(lambda chunk: masks.append(chunk.filter_mask))
    return len(masks) == wanted and not any(masks)


def _scales(node: h5py.Dataset) -> tuple[bool, tuple[str, ...]]:
    """Whether it is a dimension scale, and which scales its rows have."""
    try:
        if h5py.h5ds.is_scale(node.id):
            return True, ()
        if not node.shape:
            return False, ()
        return False, tuple(str(each.name) for each in node.dims[0].values())
    except (OSError, RuntimeError, ValueError, KeyError, TypeError):
        return False, ()


def _plain(value: Any) -> Attribute:
    """An attribute as Python text, numbers, or a list of them; bytes are text."""
    if isinstance(value, h5py.Empty):
        return ""
    if isinstance(value, bytes | np.bytes_):
        return bytes(value).decode("utf-8", "replace")
    if isinstance(value, str):
        return value.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
    if isinstance(value, np.ndarray):
        items = [_plain(each) for each in value]
        return cast(Attribute, items[0] if len(items) == 1 else items)
    return value.item() if isinstance(value, np.generic) else value
