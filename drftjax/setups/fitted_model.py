"""Fitted models: set-ups read from the results of fits, and written into them."""

from difflib import get_close_matches
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from drftjax.common.errors import InputError
from drftjax.common.structured_files import read_document, to_structure
from drftjax.runlog.files import HDF5_ENDINGS
from drftjax.runlog.hdf5.api import read_result
from drftjax.runlog.result_file import FIT_SCHEMA, ResultGroup
from drftjax.setups.setup import SetUp, as_in_file, read_setup
from drftjax.setups.terrain_setup import drop_unused_numbers


class FittedRun(msgspec.Struct):
    """One run of a fit's result, as far as a simulation needs it."""

    name: str
    setup: SetUp


class FittedRuns(msgspec.Struct):
    """A fit's result, as far as a simulation needs it."""

    schema: str
    schema_version: int
    runs: list[FittedRun]


def read_model(path: str | Path, run: str | None = None) -> SetUp:
    """A set-up from a fit's result, JSON or HDF5, or from a set-up file (TOML).

    Args:
        path: The result file.
        run: Name of the run whose model is read; none where the file holds one only.

    Raises:
        InputError: names the file, and the runs that it holds.
    """
    path = Path(path)
    if path.suffix == ".toml":
        if run is not None:
            raise InputError(f"{path} is one set-up and holds no runs; leave --run out")
        return read_setup(path)
    fitted = _from_hdf5(path) if path.suffix in HDF5_ENDINGS else _from_json(path)
    names = list(fitted)
    if not names:
        raise InputError(f"{path} holds no runs")
    if run is None and len(names) == 1:
        return fitted[names[0]]
    if run is None:
        raise InputError(f"{path} holds {len(names)} runs; name one by --run: {', '.join(names)}")
    if run not in fitted:
        near = get_close_matches(run, names, n=3, cutoff=0.3) or names
        raise InputError(f"{path} holds no run {run!r}; did you mean {' or '.join(near)}?")
    return fitted[run]


def _from_json(path: Path) -> dict[str, SetUp]:
    document = read_document(path)
    if document.get("schema") != FIT_SCHEMA:
        raise InputError(
            f"{path}: is not a fit's result; its schema must be {FIT_SCHEMA!r} (of a diagnosis "
            "give model.toml)"
        )
    if document.get("schema_version") != 1:
        raise InputError(
            f"{path}: schema_version {document.get('schema_version')} is not known here (1 is)"
        )
    if isinstance(runs := document.get("runs"), list):
        document = {**document, "runs": [_of_its_law(run) for run in runs]}
    return {each.name: each.setup for each in to_structure(document, FittedRuns, path).runs}


def _of_its_law(run: Any) -> Any:
    """A run's entry, its set-up without numbers of another stress law; anything else as it is."""
    if not isinstance(run, dict) or not isinstance(run.get("setup"), dict):
        return run
    return {**run, "setup": drop_unused_numbers(run["setup"])}


def _from_hdf5(path: Path) -> dict[str, SetUp]:
    result = read_result(path, FIT_SCHEMA)
    fitted = {}
    for name, group in result.groups.items():
        command = {
            column: group[f"command_{column}"].tolist()
            for column in ("time", "omega", "vx")
            if f"command_{column}" in group.datasets
        }
        try:
            rest = msgspec.json.decode(str(group.attributes["setup"]))
            table = drop_unused_numbers({**rest, "command": command})
            fitted[name] = to_structure(table, SetUp, path)
        except (KeyError, TypeError, msgspec.DecodeError):
            raise InputError(f"{path}: the group {name} holds no set-up of a fitted run") from None
    return fitted


def model_group(
    setup: SetUp, datasets: dict[str, tuple[np.ndarray, str]], attributes: dict[str, float]
) -> ResultGroup:
    """A fitted run as an HDF5 group.

    Args:
        setup: Fitted set-up, its command included.
        datasets: Further datasets, each with its unit.
        attributes: Further attributes.
    """
    rest = msgspec.to_builtins(as_in_file(setup))
    command = rest.pop("command")
    radians = setup.command.build()
    columns = {"command_time": (radians.time, "s"), "command_omega": (radians.omega, "rad/s")}
    if command["vx"] is not None:
        columns["command_vx"] = (np.asarray(command["vx"]), "m/s")
    return ResultGroup(
        columns | datasets, {"setup": msgspec.json.encode(rest).decode(), **attributes}
    )
