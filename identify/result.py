"""What a fit found: values with errors, residuals by run and channel, and the models as files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import msgspec
import numpy as np
from jaxtyping import Array, Float
from rich.markup import escape
from rich.table import Table

from drftjax import __version__
from drftjax.errors import InputError
from drftjax.runlog.content import printable
from drftjax.runlog.hdf5 import write_result
from drftjax.runlog.layout import UNITS
from drftjax.runlog.replace import make_folder, replace_file
from drftjax.saved import FIT_SCHEMA, model_group, thinned
from drftjax.setup import RigSetUp, SetUp, WheelSetUp
from drftjax.structfile import as_json
from identify.parameter import Parameter, typical
from identify.quantity import of_zeta
from identify.stem import files_of
from identify.summary import summary_html, summary_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from identify.bootstrap import Bootstrap
    from identify.multistart import Starts
    from identify.optimum import Optimum
    from identify.profile import Profile
    from identify.zeta_path import ZetaPath

# Reports show lengths in mm.
SHOWN = {
    "x": ("mm", 1e3),
    "z": ("mm", 1e3),
    "fx": ("N", 1.0),
    "fz": ("N", 1.0),
    "torque": ("N m", 1.0),
}


# A standard error of so much of the value, or more, tells little but the order of size; one of so
# many times the value leaves nothing worth a place in a table.
UNTOLD = 0.5
NOTHING_TOLD = 100.0


@dataclass(frozen=True)
class Value:
    """A fitted number.

    Attributes:
        value, error: The number and its standard error, in `unit`.
        unit: "-" for none.
        label: Its short name in reports.
        at_bound: Whether the fit ended at a bound of it, where its error means nothing.
    """

    value: float
    error: float
    unit: str
    label: str
    at_bound: bool = False

    @property
    def size(self) -> float:
        """What the error is held against: the value, or what it typically changes by if more."""
        return max(abs(self.value), typical(self.label))

    @property
    def told(self) -> bool:
        """Whether the runs tell more than its order of size."""
        return self.error <= UNTOLD * self.size

    def cell(self) -> str:
        """Value and error, as a table shows them."""
        if self.at_bound:
            return f"{self.value:.5g}, at a bound"
        if not self.error < NOTHING_TOLD * self.size:
            return "not told"
        return f"{self.value:.5g} ± {self.error:.2g}"

    def __str__(self) -> str:
        unit = "" if self.unit == "-" else f" {self.unit}"
        if self.at_bound:
            return f"{self.label} = {self.value:.5g}{unit}, at a bound"
        return f"{self.label} = {self.value:.5g} ± {self.error:.2g}{unit}"


def values_of(
    parameters: Sequence[Parameter], coordinates: Float[Array, " parameters"], errors: np.ndarray
) -> dict[str, Value]:
    """Values and standard errors by name; an error is carried over by the bijector's slope.

    Args:
        parameters: What was fitted.
        coordinates, errors: Of each, and its standard error, shape (parameters,).
    """
    found = {}
    for each, at, error in zip(parameters, coordinates, errors, strict=True):
        found[each.quantity.name] = Value(
            value=float(each.bijector.value(at)),
            error=float(abs(each.bijector.slope(at)) * error),
            unit=each.quantity.unit,
            label=each.quantity.label,
            at_bound=each.at_bound(float(at), float(error)),
        )
    return found


@dataclass(frozen=True, eq=False)
class RunFit:
    """One run of a fit.

    Attributes:
        name: The run, as reports call it.
        setup: Its set-up with the fitted values put in.
        values: Its own fitted values, by name.
        time: Recorded times [s], shape (samples,).
        counts: True for the samples that were compared, shape (samples,).
        channels: Names of the channels compared.
        recorded: What was recorded [m, N, N m], shape (channels, samples).
        before, after: What was simulated before and after the fit, like `recorded`.
        status: How the run ended: "converged"; "at a bound", where one of its values has run into
            one; "stalled", where more was to gain; "diverged", where it could no longer be
            simulated and was put aside, so that it does not bear on the others.
        path: zeta(t), where that was fitted.
        believed: Its wheel and rig before the fit, where these are kept.
    """

    name: str
    setup: SetUp
    values: Mapping[str, Value]
    time: np.ndarray
    counts: np.ndarray
    channels: tuple[str, ...]
    recorded: np.ndarray
    before: np.ndarray
    after: np.ndarray
    status: str = "converged"
    path: Any = None  # a ZetaPath; decoders of results evaluate annotations, and need none of it
    believed: tuple[WheelSetUp, RigSetUp] | None = None

    @property
    def has_own_zeta(self) -> bool:
        """Whether its zeta was fitted to it alone."""
        return self.path is not None or any(map(of_zeta, self.values))

    @property
    def residuals(self) -> dict[str, np.ndarray]:
        """Simulated minus recorded after the fit, by channel [m, N, N m]."""
        return dict(zip(self.channels, self.after - self.recorded, strict=True))

    @property
    def predictions(self) -> dict[str, np.ndarray]:
        """What was simulated after the fit, by channel [m, N, N m]."""
        return dict(zip(self.channels, self.after, strict=True))

    def rmse(self, fitted: bool = True) -> dict[str, float]:
        """Root mean square of simulated minus recorded where compared, by channel [m, N, N m]."""
        left = (self.after if fitted else self.before) - self.recorded
        errors = np.sqrt(np.mean(left[:, self.counts] ** 2, axis=1))
        return dict(zip(self.channels, errors.tolist(), strict=True))


@dataclass(frozen=True, eq=False)
class FitResult:
    """A fit of many runs.

    Attributes:
        shared: Values shared by all runs, by name.
        runs: Each run's own values, residuals and fitted set-up.
        status: How the solver ended: "converged", "stalled" or "out of steps".
        steps: Steps of the last solve.
        failures: Runs that were left out, and why.
        findings: What the numbers mean, in sentences.
        labels: A name for each value: shared ones, then each run's own.
        covariance: Of the values, in their units squared, ordered as `labels`.
        starts: What became of several starting points, where there were any.
        profiles: Profiles asked for.
        bootstraps: Bootstraps asked for.
        optimum: What `profile` and `bootstrap` go on from.
    """

    shared: Mapping[str, Value]
    runs: list[RunFit]
    status: str
    steps: int
    failures: Mapping[str, str]
    findings: list[str] = field(default_factory=list)
    labels: tuple[str, ...] = ()
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    starts: "Starts | None" = None
    profiles: tuple["Profile", ...] = ()
    bootstraps: tuple["Bootstrap", ...] = ()
    optimum: "Optimum | None" = field(default=None, repr=False)

    def with_failures(self, more: Mapping[str, str]) -> "FitResult":
        """The same with further runs named as left out."""
        return replace(self, failures={**more, **self.failures})

    @property
    def values(self) -> dict[str, Value]:
        """Every fitted value by its label: "lambda", "zeta of slow_a"."""
        every = [*self.shared.values(), *(v for run in self.runs for v in run.values.values())]
        return dict(zip(self.labels, every, strict=True)) if self.labels else {}

    @property
    def residuals(self) -> dict[str, dict[str, np.ndarray]]:
        """Simulated minus recorded by run and channel [m, N, N m]."""
        return {run.name: run.residuals for run in self.runs}

    @property
    def predictions(self) -> dict[str, dict[str, np.ndarray]]:
        """Simulated channels by run and channel [m, N, N m]."""
        return {run.name: run.predictions for run in self.runs}

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels that any run compares."""
        return tuple(c for c in SHOWN if any(c in run.channels for run in self.runs))

    def rmse(self, fitted: bool = True) -> dict[str, float]:
        """Root mean square over all samples of all runs, by channel [m, N, N m]."""
        pooled = {}
        for channel in self.channels:
            runs = [run for run in self.runs if channel in run.channels]
            runs = [run for run in runs if run.status != "diverged"] or runs
            power = sum(run.rmse(fitted)[channel] ** 2 * run.counts.sum() for run in runs)
            pooled[channel] = float(np.sqrt(power / sum(run.counts.sum() for run in runs)))
        return pooled

    def table(self) -> Table:
        """RMSE before and after, by run and channel, with each run's own values."""
        channels = self.channels
        table = Table(title="simulated minus recorded, RMSE before → after the fit")
        # Names fold in a narrow terminal: cut off, zeta.stand and zeta.steady would look alike.
        table.add_column("run", overflow="fold")
        table.add_column("status", overflow="fold")
        own = list(self.runs[0].values)
        for name in own:
            label = self.runs[0].values[name].label
            table.add_column(label, justify="right", overflow="fold")
        for channel in channels:
            heading = escape(f"{channel} [{SHOWN[channel][0]}]")
            table.add_column(heading, justify="right", overflow="fold")

        def cells(before: dict[str, float], after: dict[str, float]) -> list[str]:
            return [
                f"{before[c] * SHOWN[c][1]:.3f} → {after[c] * SHOWN[c][1]:.3f}"
                if c in before
                else "-"
                for c in channels
            ]

        for run in self.runs:
            values = [run.values[n].cell() for n in own]
            compared = cells(run.rmse(False), run.rmse())
            table.add_row(escape(printable(run.name)), run.status, *values, *compared)
        table.add_section()
        table.add_row("all runs", "", *[""] * len(own), *cells(self.rmse(False), self.rmse()))
        return table

    def document(self) -> dict:
        """The result as plain values, in the layout of the JSON file."""
        return {
            "schema": FIT_SCHEMA,
            "schema_version": 1,
            "software": f"drftjax {__version__}",
            "status": self.status,
            "steps": self.steps,
            "shared": msgspec.to_builtins(self.shared),
            "covariance": {"of": list(self.labels), "values": self.covariance.tolist()},
            "starts": msgspec.to_builtins(self.starts),
            "profiles": [
                {
                    "label": each.label,
                    "unit": each.unit,
                    "level": each.level,
                    "low": each.low,
                    "high": each.high,
                    "value": each.value.tolist(),
                    "rise": each.rise.tolist(),
                }
                for each in self.profiles
            ],
            "bootstraps": [
                {
                    "over": each.over,
                    "refit": each.refit,
                    "draws": len(each.draws),
                    "level": each.level,
                    "intervals": {
                        name: {"low": low, "high": high, "error": error}
                        for name, low, high, error in zip(
                            each.labels,
                            each.low.tolist(),
                            each.high.tolist(),
                            each.error.tolist(),
                            strict=True,
                        )
                    },
                }
                for each in self.bootstraps
            ],
            "rmse_before": self.rmse(False),
            "rmse_after": self.rmse(),
            "failures": dict(self.failures),
            "findings": self.findings,
            "runs": [
                {
                    "name": run.name,
                    "status": run.status,
                    "values": msgspec.to_builtins(run.values),
                    "zeta_path": _path(run.path),
                    "rmse_before": run.rmse(False),
                    "rmse_after": run.rmse(),
                    "setup": msgspec.to_builtins(_slim(run.setup)),
                }
                for run in self.runs
            ],
        }

    def plot(self) -> "Figure":
        """Recorded and simulated channels of each run as a figure."""
        from identify.figure import plot_fit

        return plot_fit(self)

    def profile(self, name: str, **options: Any) -> "FitResult":
        """The same with the profile likelihood of a value; see `identify.profile.profiles`."""
        from identify.profile import profiles

        with jax.enable_x64(True):
            found = profiles(self._settled(), name, **options)
        return replace(self, profiles=(*self.profiles, *found))

    def bootstrap(self, count: int, **options: Any) -> "FitResult":
        """The same with intervals and bands of `count` draws; see `identify.bootstrap`."""
        from identify.bootstrap import bootstrap

        with jax.enable_x64(True):
            found = bootstrap(self._settled(), count, **options)
        return replace(self, bootstraps=tuple(found))

    def _settled(self) -> "Optimum":
        if self.optimum is None:
            raise InputError("this result holds no solved fit to go on from")
        return self.optimum

    @property
    def bands(self) -> Mapping[str, Mapping[str, tuple[np.ndarray, np.ndarray]]]:
        """Where readings are expected, by run and channel [m, N, N m]; needs a bootstrap."""
        return self.bootstraps[0].bands if self.bootstraps else {}

    def sentences(self) -> list[str]:
        """What stands under the table: shared values, findings, and what was left out."""
        told = [str(value) for value in self.shared.values()]
        told += [str(self.starts)] if self.starts else []
        told += [str(profile) for profile in self.profiles]
        told += [sentence for each in self.bootstraps for sentence in each.sentences()]
        told += self.findings
        told += [f"left out: {name}: {why}" for name, why in self.failures.items()]
        if self.status != "converged":
            told.append(f"the solver is {self.status} after {self.steps} steps")
        return told

    def summary(self, width: int = 110) -> str:
        """Table and findings as text, so many columns wide."""
        return summary_text([self.table(), *self.sentences()], width)

    def _repr_html_(self) -> str:
        return summary_html([self.table(), *self.sentences()])

    def write(self, stem: Path) -> list[Path]:
        """Write `stem`.json and `stem`.h5, from which `drft simulate --from` reads models back.

        The HDF5 file also holds every run's recorded and simulated channels.

        Raises:
            InputError: where they cannot be written.
        """
        text, binary, _ = result_files(stem)
        make_folder(stem.parent)
        replace_file(text, as_json(self.document()))
        groups = {run.name: _group(run, self.bands.get(run.name, {})) for run in self.runs}
        numbers = {
            f"{n}_{k}": getattr(v, k) for n, v in self.shared.items() for k in ("value", "error")
        }
        write_result(binary, FIT_SCHEMA, {"status": self.status, **numbers}, groups)
        return [text, binary]


def result_files(stem: Path) -> tuple[Path, Path, Path]:
    """`stem`.json, `stem`.h5 and `stem`.png: a fit's values, its channels and its figure."""
    text, binary, picture = files_of(stem, (".json", ".h5", ".png"))
    return text, binary, picture


def _path(path: "ZetaPath | None") -> dict | None:
    if path is None:
        return None
    columns = {name: getattr(path, name).tolist() for name in ("time", "value", "error", "told")}
    return columns | {"weight": path.weight}


def _slim(setup: SetUp) -> SetUp:
    return msgspec.structs.replace(setup, command=thinned(setup.command))


def _group(run: RunFit, bands: Mapping[str, tuple[np.ndarray, np.ndarray]]):
    datasets = {"time": (run.time, "s"), "counts": (run.counts, "1")}
    for index, channel in enumerate(run.channels):
        for kind in ("recorded", "before", "after"):
            datasets[f"{channel}_{kind}"] = (getattr(run, kind)[index], UNITS["measured"][channel])
        for kind, values in zip(("low", "high"), bands.get(channel, ()), strict=False):
            datasets[f"{channel}_{kind}"] = (values, UNITS["measured"][channel])
    if run.path is not None:
        datasets["zeta_time"] = (run.path.time, "s")
        datasets["zeta"] = (run.path.value, "1")
        datasets["zeta_error"] = (run.path.error, "1")
    numbers = {f"{n}_{k}": getattr(v, k) for n, v in run.values.items() for k in ("value", "error")}
    return model_group(run.setup, datasets, numbers)
