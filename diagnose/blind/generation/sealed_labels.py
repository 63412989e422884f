"""Labels out of sight: packed so that nobody reads them by accident, bound by a salted hash."""

import base64
import hashlib
import json
import secrets
import zlib
from pathlib import Path

from drftjax.common.errors import InputError
from drftjax.common.output_files import replace_file

SEALED, HASH, PLAIN = "labels.sealed", "labels.sha256", "labels.json"


SCHEMA = "drft-blind-labels"


def digest(salt: str, text: str) -> str:
    """The salted hash that is published beside the sets."""
    return hashlib.sha256((salt + text).encode()).hexdigest()


def seal(folder: Path, labels: dict) -> None:
    """Write labels sealed, and their hash, into a folder of sets."""
    text = json.dumps(labels, sort_keys=True)
    salt = secrets.token_hex(16)
    document = {"schema": SCHEMA, "schema_version": 1, "salt": salt, "labels": text}
    packed = base64.b85encode(zlib.compress(json.dumps(document).encode(), 9))
    replace_file(folder / SEALED, packed + b"\n")
    replace_file(folder / HASH, f"{digest(salt, text)}\n".encode())


def open_labels(folder: Path) -> dict[str, dict]:
    """Labels of a folder of sets, each with at least its `effects`: sealed ones, or plain ones.

    Raises:
        InputError: where there are none, or they are not those that were sealed.
    """
    if (folder / SEALED).exists():
        return _opened(folder)
    plain = folder / PLAIN
    if not plain.exists():
        raise InputError(f"{folder} holds neither {SEALED} nor {PLAIN}; there is nothing to open")
    try:
        labels = json.loads(plain.read_text())
        names = {name: list(map(str, effects)) for name, effects in labels.items()}
    except (ValueError, AttributeError, TypeError):
        raise InputError(f"{plain}: must be a table of effects' names by set") from None
    return {name: {"effects": [e for e in each if e != "none"]} for name, each in names.items()}


def _opened(folder: Path) -> dict[str, dict]:
    path = folder / SEALED
    try:
        document = json.loads(zlib.decompress(base64.b85decode(path.read_bytes().strip())))
        schema, salt, text = (str(document[each]) for each in ("schema", "salt", "labels"))
    except (ValueError, KeyError, TypeError, zlib.error):
        raise InputError(f"{path}: is damaged, it cannot be opened") from None
    if schema != SCHEMA:
        raise InputError(f"{path}: its schema is {schema!r}, must be {SCHEMA!r}")
    stated = folder / HASH
    if not stated.exists():
        raise InputError(f"{folder} lacks {HASH}, without which {SEALED} cannot be trusted")
    if stated.read_text().strip() != digest(salt, text):
        raise InputError(f"{path}: is not what was sealed; its hash differs from {stated.name}")
    return json.loads(text)
