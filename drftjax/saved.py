"""Models as files: fitted set-ups read back, and a simulated run as a run log."""

import math
from difflib import get_close_matches
from pathlib import Path

import equinox as eqx
import msgspec
import numpy as np

from drftjax import __version__
from drftjax.errors import InputError
from drftjax.runlog import record
from drftjax.runlog.content import printable
from drftjax.runlog.files import HDF5_ENDINGS
from drftjax.runlog.hdf5 import read_result
from drftjax.runlog.result import FIT_SCHEMA, ResultGroup
from drftjax.setup import CommandSetUp, SetUp, read_setup
from drftjax.structfile import read_document, to_structure
from drftjax.trial import ROW_INTERVAL, Trial, check_output


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
        run: Which run's model; may be left out where there is one only.

    Raises:
        InputError: names the file and what must hold.
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
    return {each.name: each.setup for each in to_structure(document, FittedRuns, path).runs}


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
            fitted[name] = to_structure({**rest, "command": command}, SetUp, path)
        except (KeyError, TypeError, msgspec.DecodeError):
            raise InputError(f"{path}: the group {name} holds no set-up of a fitted run") from None
    return fitted


def model_group(
    setup: SetUp, datasets: dict[str, tuple[np.ndarray, str]], attributes: dict[str, float]
) -> ResultGroup:
    """A fitted run as an HDF5 group: its set-up and command, with datasets of the caller's."""
    rest = msgspec.to_builtins(setup)
    command = rest.pop("command")
    radians = setup.command.build()
    columns = {"command_time": (radians.time, "s"), "command_omega": (radians.omega, "rad/s")}
    if command["vx"] is not None:
        columns["command_vx"] = (np.asarray(command["vx"]), "m/s")
    return ResultGroup(
        columns | datasets, {"setup": msgspec.json.encode(rest).decode(), **attributes}
    )


def thinned(command: CommandSetUp) -> CommandSetUp:
    """The same profile without the knots that lie on a straight line between their neighbours."""
    time = np.asarray(command.time)
    channels = [np.asarray(c) for c in (command.omega, command.vx) if c is not None]
    kept = [0]
    for knot in range(1, len(time) - 1):
        if any(_bends(time, values, kept[-1], knot) for values in channels):
            kept.append(knot)
    kept.append(len(time) - 1)

    def at(values: list[float]) -> list[float]:
        return [values[knot] for knot in kept]

    vx = None if command.vx is None else at(command.vx)
    return CommandSetUp(at(command.time), at(command.omega), vx, command.omega_unit)


def _bends(time: np.ndarray, values: np.ndarray, last: int, knot: int) -> bool:
    """Whether the line from `last` to the knot after this one misses this one."""
    after = knot + 1
    slope = (values[after] - values[last]) / (time[after] - time[last])
    line = values[last] + slope * (time[knot] - time[last])
    # Rounding of a profile written in decimals, not a change anyone commanded.
    return bool(abs(values[knot] - line) > 1e-9 * max(1.0, float(np.abs(values).max())))


def _held_until(end: float, command: CommandSetUp) -> CommandSetUp:
    """The same profile with its last value held to `end` [s]."""
    vx = None if command.vx is None else [*command.vx, command.vx[-1]]
    time, omega = [*command.time, float(end)], [*command.omega, command.omega[-1]]
    return CommandSetUp(time, omega, vx, command.omega_unit)


_run = eqx.filter_jit(Trial.run)
# Of times of rows, written in decimals [s].
ROUNDING = 1e-9


def simulated_run(
    setup: SetUp, interval: float = ROW_INTERVAL, at: np.ndarray | None = None
) -> record.RunLog:
    """Simulate a set-up and give the run as a run log, forces and torque included.

    Args:
        setup: What is simulated.
        interval: Time between rows [s]; rounded to whole steps.
        at: Times of the rows [s] in place of that, met by interpolation; past the command's end
            its last value holds.

    Raises:
        InputError: where the set-up cannot be, or the run leaves what the model covers.
    """
    if at is not None and len(at) > 1:
        interval = min(interval, float(np.median(np.diff(at))))
    command = setup.command.build()
    end = command.time[-1] + ROUNDING
    held = setup
    if at is not None and len(at) and at[-1] > end:
        held = msgspec.structs.replace(setup, command=_held_until(at[-1], setup.command))
    lasts = held.command.time[-1] - held.command.time[0]
    if interval > lasts + ROUNDING:
        raise InputError(
            f"rows {interval:g} s apart are farther than the command lasts ({lasts:g} s); ask for "
            "more rows a second"
        )
    trial = held.trial(interval)
    output = _run(trial)
    check_output(output, trial.simulator)
    time = np.asarray(output.time) + command.time[0]
    rows = time[time <= end] if at is None else at
    measured = {
        name: np.interp(rows, time, np.asarray(getattr(output, name))) for name in record.CHANNELS
    }
    return record.RunLog(
        setup=believed(setup, setup.start.sinkage, float(output.zeta[0])),
        command=command,
        measured=record.Measured(time=rows, **measured),
        source="simulated",
        title=setup.title,
        software="drftjax",
        software_version=__version__,
    )


def believed(setup: SetUp, sinkage: float, zeta: float) -> record.Setup:
    """A set-up as a run log has it, with the sinkage at rest [m] and zeta at the start [-].

    Args:
        setup: What is believed of the rig.
        sinkage: H at rest [m].
        zeta: At the start; NaN of a wheel that hangs in the air, where nothing tells it, and
            nothing carries it either [-].
    """
    in_the_air = math.isnan(zeta)
    wheel = setup.wheel
    grousers = wheel.shape == "grouser"
    return record.Setup(
        wheel_radius=wheel.radius,
        # A run log has no place for an outline: without a width nothing takes it for a plain rim.
        wheel_width=None if wheel.shape == "outline" else wheel.width,
        grouser_count=wheel.grouser_count if grousers else 0,
        grouser_height=wheel.grouser_height * wheel.grouser_fraction if grousers else None,
        grouser_thickness=wheel.grouser_thickness if grousers else None,
        mass_x=setup.rig.mass_x,
        mass_z=setup.rig.mass_z,
        gravity=setup.rig.gravity,
        bulk_density=setup.terrain.bulk_density,
        sinkage_static=None if in_the_air else sinkage,
        scaling_factor_initial=None if in_the_air else zeta,
    )


def summary(run: record.RunLog) -> str:
    """A run in one sentence: duration, deepest and final sinkage, and travel."""
    measured = run.measured
    lasts = measured.time[-1] - measured.time[0]
    assert measured.x is not None
    assert measured.z is not None
    return (
        f"{printable(run.title)}: {lasts:.4g} s, "
        f"deepest sinkage {-measured.z.min() * 1e3:.2f} mm, "
        f"final sinkage {-measured.z[-1] * 1e3:.2f} mm, "
        f"travel {measured.x[-1] - measured.x[0]:.4f} m"
    )
