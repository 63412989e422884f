"""Draws of a posterior as an ArviZ netCDF file, and their numbers as plain values."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from drftjax import __version__
from drftjax.common.errors import InputError
from drftjax.common.output_files import make_folder, replace_file
from drftjax.common.text import replace_unprintable
from drftjax.runlog.result_file import POSTERIOR_SCHEMA
from identify.uncertainty.markov_chains import ChainStatistics
from identify.uncertainty.posterior import ParameterPosterior, import_arviz, require_extra

if TYPE_CHECKING:
    from xarray import Dataset


def posterior_document(posterior: ParameterPosterior) -> dict:
    """Return settings, course and numbers of a posterior, in the layout of the JSON file."""
    chains, draws, _ = posterior.draws.shape
    columns = {
        "mean": posterior.mean,
        "error": posterior.error,
        "low": posterior.low,
        "high": posterior.high,
        "rhat": posterior.rhat,
        "effective_samples": posterior.effective,
    }
    return {
        "adjusted": posterior.settings.adjusted,
        "chains": chains,
        "draws": draws,
        "warmup": posterior.settings.warmup,
        "seed": posterior.settings.seed,
        "step": posterior.step,
        "divergences": posterior.divergences,
        "level": posterior.settings.level,
        "values": {
            label: {name: float(column[k]) for name, column in columns.items()}
            for k, label in enumerate(posterior.labels)
        },
    }


def write_posterior(posterior: ParameterPosterior, path: Path) -> None:
    """Write the draws as an ArviZ `InferenceData` in netCDF; `arviz.from_netcdf` reads it.

    Group `posterior` holds each parameter by chain and draw, and by run where it is each run's own;
    `sample_stats` the course of the chains.

    Args:
        posterior: The draws.
        path: Final name; an existing file is replaced.

    Raises:
        InputError: where the extra is not installed, or the file cannot be written.
    """
    require_extra()
    arviz = import_arviz()
    about = {"schema": POSTERIOR_SCHEMA, "schema_version": 1, "software": f"drftjax {__version__}"}
    groups = {"posterior": _draws(posterior), "sample_stats": _course(posterior.statistics)}
    make_folder(path.parent)
    try:
        with TemporaryDirectory(prefix="drft-") as folder:
            draft = Path(folder) / "posterior.nc"
            arviz.InferenceData(attrs=about, **groups).to_netcdf(str(draft))
            data = draft.read_bytes()
    except OSError as error:
        reason = (error.strerror or "the draft of it failed").lower()
        raise InputError(f"{path} cannot be written: {reason}") from error
    replace_file(path, data)


def _draws(posterior: ParameterPosterior) -> "Dataset":
    """Return the draws by parameter, and by run where it is each run's own."""
    from xarray import Dataset

    places: dict[str, list[int]] = {}
    for place, (name, _) in enumerate(posterior.parameters):
        places.setdefault(name, []).append(place)
    settings, runs = posterior.settings, {}
    columns = {}
    for name, of_name in places.items():
        owners = [posterior.parameters[place][1] for place in of_name]
        unit = posterior.units[of_name[0]]
        about = {"units": "1" if unit == "-" else unit}
        if owners == [None]:
            columns[name] = (("chain", "draw"), posterior.draws[..., of_name[0]], about)
        else:
            runs = {"run": [replace_unprintable(str(owner)) for owner in owners]}
            columns[name] = (("chain", "draw", "run"), posterior.draws[..., of_name], about)
    about = {
        "inference_library": "blackjax",
        "tuning_steps": settings.warmup,
        "likelihood": "adjusted" if settings.adjusted else "white",
    }
    return Dataset(columns, _coordinates(posterior.draws) | runs, about)


def _course(statistics: ChainStatistics) -> "Dataset":
    """Return the course of the chains, by the names that ArviZ knows."""
    from xarray import Dataset

    columns = {name: (("chain", "draw"), values) for name, values in vars(statistics).items()}
    return Dataset(columns, _coordinates(statistics.energy))


def _coordinates(values: np.ndarray) -> dict[str, np.ndarray]:
    return {"chain": np.arange(values.shape[0]), "draw": np.arange(values.shape[1])}
