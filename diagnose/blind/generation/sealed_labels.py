"""Sealed labels: packed so that nobody reads them by accident, and fixed by a salted hash."""

import base64
import hashlib
import json
import secrets
import zlib
from pathlib import Path

from drftjax.common.errors import InputError, require_input_folder
from drftjax.common.output_files import replace_file

SEALED_FILE, HASH_FILE, PLAIN_FILE = "labels.sealed", "labels.sha256", "labels.json"

SCHEMA = "drft-blind-labels"


def digest(salt: str, text: str) -> str:
    """Salted SHA-256 of labels, published beside the sets."""
    return hashlib.sha256((salt + text).encode()).hexdigest()


def seal(folder: Path, labels: dict) -> None:
    """Write sealed labels and their hash into a folder of sets.

    Args:
        folder: Folder of the sets.
        labels: Label of each set, by its name.
    """
    text = json.dumps(labels, sort_keys=True)
    salt = secrets.token_hex(16)
    document = {"schema": SCHEMA, "schema_version": 1, "salt": salt, "labels": text}
    packed = base64.b85encode(zlib.compress(json.dumps(document).encode(), 9))
    replace_file(folder / SEALED_FILE, packed + b"\n")
    replace_file(folder / HASH_FILE, f"{digest(salt, text)}\n".encode())


def open_labels(folder: Path) -> dict[str, dict]:
    """Read the sealed labels of a folder of sets or, without those, the plain ones.

    Returns:
        Label of each set by its name, with at least its `effects`.

    Raises:
        InputError: There are no labels, or they are not the ones that were sealed.
    """
    require_input_folder(folder, "sets of runs")
    if (folder / SEALED_FILE).exists():
        return _unseal(folder)
    plain = folder / PLAIN_FILE
    if not plain.exists():
        raise InputError(
            f"{folder} holds neither {SEALED_FILE} nor {PLAIN_FILE}; there is nothing to open"
        )
    try:
        labels = json.loads(plain.read_text())
        names = {name: list(map(str, effects)) for name, effects in labels.items()}
    except (ValueError, AttributeError, TypeError):
        raise InputError(f"{plain}: must be a table of effects' names by set") from None
    return {name: {"effects": [e for e in each if e != "none"]} for name, each in names.items()}


def _unseal(folder: Path) -> dict[str, dict]:
    path = folder / SEALED_FILE
    try:
        document = json.loads(zlib.decompress(base64.b85decode(path.read_bytes().strip())))
        schema, salt, text = (str(document[each]) for each in ("schema", "salt", "labels"))
    except (ValueError, KeyError, TypeError, zlib.error):
        raise InputError(f"{path}: is damaged, it cannot be opened") from None
    if schema != SCHEMA:
        raise InputError(f"{path}: its schema is {schema!r}, must be {SCHEMA!r}")
    stated = folder / HASH_FILE
    if not stated.exists():
        raise InputError(
            f"{folder} lacks {HASH_FILE}, without which {SEALED_FILE} cannot be trusted"
        )
    if stated.read_text().strip() != digest(salt, text):
        raise InputError(f"{path}: is not what was sealed; its hash differs from {stated.name}")
    return json.loads(text)
