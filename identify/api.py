"""`drftjax.fit`: recorded runs in, fitted numbers out, in one call."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import jax

from drftjax.common.errors import InputError
from drftjax.recorded.observation import require_channels
from drftjax.recorded.prepared_run import Run, prepare_runs
from drftjax.results.provenance import library_provenance
from drftjax.runlog.record import CHANNELS
from drftjax.setups.setup import SetUp
from identify.design.required_speed import add_required_speeds
from identify.fit_constant import FIT_SETTINGS, WHITE, FitSettings, Progress
from identify.fit_constant import fit as fit_prepared
from identify.fit_path import fit_paths
from identify.fit_path_jointly import JOINT_FIT_SETTINGS, JointFitSettings
from identify.parameters.parameter import Parameter, parameter, require_once
from identify.parameters.phase_zeta import zeta_phases
from identify.results.result import FitResult
from identify.solver.multistart import DRAWS_SEED
from identify.uncertainty.markov_chains import PosteriorSettings
from identify.uncertainty.noise_model import AbstractNoise
from identify.uncertainty.posterior import require_extra
from identify.zeta_path.smoother import KNOT_SPACING

# Parameters that are each run's own by default: preparation of the sand, and start of the run.
EACH_RUNS_OWN = ("terrain.zeta", "start")


# Parameters that are fitted by default.
USUAL = ("zeta", "lambda")


# Kinds of zeta.
ZETAS = ("constant", "phases", "path")


def fit(
    runs: Run | Sequence[Run] | Mapping[str, Run],
    model: SetUp | None = None,
    parameters: str | Parameter | Sequence[str | Parameter] | None = None,
    *,
    zeta: str = "constant",
    knots: float = KNOT_SPACING,
    noise: AbstractNoise = WHITE,
    starts: int = 1,
    keep_rest: bool = False,
    compare: str | Sequence[str] = CHANNELS,
    progress: Progress | None = None,
    settings: FitSettings = FIT_SETTINGS,
    path_settings: JointFitSettings = JOINT_FIT_SETTINGS,
    posterior: PosteriorSettings | None = None,
) -> FitResult:
    """Fit numbers of the simulator to recorded runs, as `drft fit` does.

        result = drftjax.fit(["a.h5", "b.h5"], parameters=["zeta", "rig.mass_z"])
        print(result.summary())

    Computes in double precision whatever the program around it uses.

    Args:
        runs: Files, run logs or pairs of a set-up and a run log; one, several, or several by name.
        model: Wheel, sand, rig and effects in place of what the run logs believe of them; commands
            and starts are always the runs'.
        parameters: Fitted parameters; zeta and lambda where nothing is named, and beside a path
            nothing. Names, or `drftjax.own(...)` and `drftjax.shared(...)`. By name alone, zeta
            and the start are each run's own, and all else is shared by the runs. An effect's
            number is NAME.NUMBER, such as "drawbar.force"; the effect is added where it is not.
        zeta: "constant"; "phases", one for each phase of the command; or "path", zeta(t) as smooth
            as the data say, which is then each run's `path`, and the parameters beside it.
        knots: Time from knot to knot of a path [s].
        noise: Model of the residuals.
        starts: Starting points to try; see `identify.solver.multistart`.
        keep_rest: Compare samples after the last stop as well.
        compare: Channels that are compared, such as "z", of those that the simulation predicts.
        progress: Called with the stage, the solver's step and the sum of squares.
        settings: Decision numbers of a fit with constant parameters.
        path_settings: Decision numbers of a fit of zeta(t).
        posterior: Numbers of the Markov chains over the values; no chains where left out.

    Raises:
        InputError: where a run, a parameter or the whole cannot be fitted, and why.
    """
    if parameters is None:
        parameters = () if zeta == "path" else USUAL
    listed = [parameters] if isinstance(parameters, str | Parameter) else list(parameters)
    if not listed and zeta != "path":
        raise InputError("no parameter is named; give one or more, such as 'zeta'")
    wanted = [each if isinstance(each, Parameter) else _by_name(each) for each in listed]
    require_once(wanted)
    if zeta not in ZETAS:
        raise InputError(f"zeta is {zeta!r}, must be one of {', '.join(ZETAS)}")
    if zeta == "path" and (noise is not WHITE or starts != 1):
        raise InputError(
            "zeta='path' finds each channel's noise, from one start; leave noise and starts out"
        )
    if posterior is not None:
        if zeta == "path":
            raise InputError("zeta='path' goes without Markov chains; leave posterior out")
        require_extra()
    channels = (compare,) if isinstance(compare, str) else tuple(compare)
    require_channels(channels)
    if zeta == "path" and "z" not in channels:
        raise InputError("zeta='path' follows the sinkage, so compare must name z")
    with jax.enable_x64(True):
        prepared = prepare_runs(
            runs,
            model,
            fitted=[each.quantity.name for each in wanted],
            keep_rest=keep_rest,
            compare=channels,
        )
        made = library_provenance(runs, DRAWS_SEED if starts > 1 else None)
        if zeta == "path":
            result = fit_paths(prepared, knots, wanted, progress, path_settings)
            return replace(result, provenance=made)
        if zeta == "phases":
            wanted = zeta_phases(prepared, wanted)
        result = fit_prepared(prepared, wanted, progress, noise, starts=starts, settings=settings)
        result = replace(add_required_speeds(result), provenance=made)
        return result if posterior is None else result.sample_posterior(posterior)


def _by_name(name: str) -> Parameter:
    each = parameter(name, shared=True)
    own = each.quantity.name.startswith(EACH_RUNS_OWN)
    return parameter(name, shared=not own)
