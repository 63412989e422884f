"""Set-up of a recorded run: a `SetUp`, as set-up files hold it, from a run log.

A run log holds a `RecordedSetup`: the few numbers that its operator knew, any of which may be
missing. A `SetUp` is complete: every number that a simulation needs, its command among them.
"""

from pathlib import Path
from typing import Any

from drftjax.common.errors import InputError
from drftjax.runlog.check import read_run_guarded
from drftjax.runlog.plausibility import require_upright, standing_problems
from drftjax.runlog.record import RunLog
from drftjax.setups.setup import CommandSetUp, RigSetUp, SetUp, StartSetUp, WheelSetUp
from drftjax.setups.terrain_setup import DynamicTerrain


def setup_like(path: Path) -> tuple[SetUp, RunLog]:
    """Read a recorded run and its set-up from an untrusted file.

    Args:
        path: Run log.

    Returns:
        The set-up, and the run.

    Raises:
        InputError: names the file, and the number that is missing or out of bounds.
    """
    run = read_run_guarded(path)
    try:
        require_upright(run)
        for reason in standing_problems(run.setup.known()):
            raise InputError(f"setup sinkage_static {reason}")
        return setup_from_run(run), run
    except InputError as problem:
        raise InputError(f"{path}: {problem}") from None


def setup_from_run(run: RunLog) -> SetUp:
    """Complete set-up of a recorded run, from the numbers in its run log.

    Numbers that are missing there are `SetUp`'s defaults, but for the wheel's radius, width and
    the vertical mass, without which no run can be simulated.

    Args:
        run: Recorded run.

    Raises:
        InputError: names the missing attributes of /setup.
    """
    known = run.setup.known()
    missing = [name for name in ("wheel_radius", "wheel_width", "mass_z") if name not in known]
    if missing:
        raise InputError(
            f"the run's /setup lacks {' and '.join(missing)}, without which it cannot be simulated"
        )

    def given(*pairs: tuple[str, str]) -> dict[str, Any]:
        return {ours: known[theirs] for ours, theirs in pairs if theirs in known}

    radius: dict[str, Any] = {"radius": known["wheel_radius"], "width": known["wheel_width"]}
    if known.get("grouser_count", 0):
        grousers = ("grouser_count", "grouser_height", "grouser_thickness")
        lacking = [name for name in grousers if name not in known]
        if lacking:
            raise InputError(f"the run's wheel has grousers but lacks {' and '.join(lacking)}")
        wheel = WheelSetUp(**radius, **given(*((name, name) for name in grousers)))
    else:
        wheel = WheelSetUp(shape="plain", **radius)
    command = run.command
    return SetUp(
        command=CommandSetUp(
            command.time.tolist(),
            command.omega.tolist(),
            None if command.vx is None else command.vx.tolist(),
        ),
        title=run.title,
        wheel=wheel,
        terrain=DynamicTerrain(
            **given(("zeta", "scaling_factor_initial"), ("bulk_density", "bulk_density"))
        ),
        rig=RigSetUp(
            **given(("mass_x", "mass_x"), ("mass_z", "mass_z"), ("gravity", "gravity")),
            carriage="free" if command.vx is None else "driven",
        ),
        start=StartSetUp(**given(("sinkage", "sinkage_static"))),
    )
