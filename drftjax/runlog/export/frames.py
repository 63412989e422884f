"""A run as an xarray dataset or a pandas table, where these packages are installed."""

from typing import TYPE_CHECKING

from drftjax.common.packages import optional_package
from drftjax.runlog.export.channels import one_table
from drftjax.runlog.record import RunLog

if TYPE_CHECKING:
    import pandas
    import xarray


def as_dataset(run: RunLog, derived: bool) -> "xarray.Dataset":
    """Channels of a run on the times of its measurements, with the numbers of its set-up.

    Args:
        run: The run.
        derived: True to add the derived channels.

    Raises:
        InputError: xarray is not installed, or no channel can be derived.
    """
    xarray = optional_package("xarray", "to_xarray")
    columns = {
        name: ("time", each.values, {"units": each.unit})
        for name, each in one_table(run, derived).items()
    }
    attributes = {"title": run.title, "source": run.source, **run.setup.known()}
    return xarray.Dataset(columns, attrs=attributes).set_coords("time")


def as_data_frame(run: RunLog, derived: bool) -> "pandas.DataFrame":
    """As `as_dataset`, as a table whose index is the time [s].

    Raises:
        InputError: pandas is not installed, or no channel can be derived.
    """
    pandas = optional_package("pandas", "to_dataframe")
    columns = {name: each.values for name, each in one_table(run, derived).items()}
    return pandas.DataFrame(columns).set_index("time")
