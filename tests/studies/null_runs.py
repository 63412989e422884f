"""Runs of rigs with nothing wrong, each fitted with one zeta: what is left beside the noise.

    python -m tests.studies.null_runs [FOLDER ...]

The last column is the mean of simulated less recorded sinkage in the tenth of a second after the
wheel begins to turn: some of these wheels jump up there, as no other run of the same load does.
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

FOLDERS = ("../shared/blind/practice/set_03", "../shared/blind/practice/set_08")
JUMP = 0.1


@dataclass(frozen=True)
class Left:
    """What a fit of one zeta leaves of a run's sinkage.

    Attributes:
        name: The run.
        zeta, error: The scaling factor and its standard error.
        noise: White noise of the recorded sinkage [mm].
        rmse: Simulated less recorded sinkage, RMS over the samples compared [mm].
        jump: Its mean just after the wheel begins to turn [mm].
    """

    name: str
    zeta: float
    error: float
    noise: float
    rmse: float
    jump: float


def left(paths: list[Path]) -> Iterator[Left]:
    """Each run fitted alone with one zeta."""
    from identify.candidate import candidates_of
    from identify.fitting import fit
    from identify.parameter import parameter

    for candidate in candidates_of(paths):
        (run,) = fit([candidate], [parameter("zeta", shared=False)]).runs
        row = run.channels.index("z")
        residual = 1e3 * run.residuals["z"]
        command = candidate.setup.command
        begins = command.time[int(np.flatnonzero(command.omega)[0])] - command.time[0]
        early = (run.time >= begins) & (run.time < begins + JUMP)
        (zeta,) = run.values.values()
        yield Left(
            run.name,
            zeta.value,
            zeta.error,
            1e3 * float(candidate.observation.noise[row]),
            float(np.sqrt(np.mean(residual[run.counts] ** 2))),
            float(residual[early].mean()),
        )


def main() -> None:
    from drftjax.commands.runtime import configure_jax

    configure_jax()
    print("| runs | zeta | noise of z [mm] | z RMSE [mm] | ratio | at the start [mm] |")
    print("| --- | --- | --- | --- | --- | --- |")
    for folder in sys.argv[1:] or FOLDERS:
        for each in left(sorted(Path(folder).glob("*.h5"))):
            print(
                f"| {Path(folder).name} {each.name} | {each.zeta:.4f} ± {each.error:.4f} "
                f"| {each.noise:.4f} | {each.rmse:.4f} | {each.rmse / each.noise:.2f} "
                f"| {each.jump:+.3f} |"
            )


if __name__ == "__main__":
    main()
