"""Run logs on their way into a diagnosis: found, read in a guarded way, and of one wheel."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from drftjax.errors import InputError
from drftjax.runlog.guard import GuardedReader
from drftjax.runlog.layout import run_from
from drftjax.saved import HDF5_ENDINGS
from identify.candidate import Candidate, candidate, names_of

# Wheels are the same where their lengths agree to so many places of a millimetre.
PLACES = 3


@dataclass(frozen=True)
class Gathered:
    """Runs that can be simulated and compared, and those that cannot.

    Attributes:
        candidates: The runs.
        left_out: Why each other one is not among them, by its name.
    """

    candidates: list[Candidate]
    left_out: dict[str, str]


def run_files(given: Sequence[Path]) -> list[Path]:
    """Run logs by files and folders, each once; of a folder those that lie directly in it.

    Raises:
        InputError: where a folder holds none.
    """
    found: dict[Path, Path] = {}
    for path in given:
        files = [path]
        if path.is_dir():
            files = sorted(each for each in path.iterdir() if each.suffix in HDF5_ENDINGS)
            if not files:
                deeper = any(f for e in HDF5_ENDINGS for f in path.glob(f"*/*{e}"))
                hint = "; its folders do: name one of them" if deeper else ""
                raise InputError(
                    f"{path}: the folder holds no run log (*{', *'.join(HDF5_ENDINGS)}){hint}"
                )
        for each in files:
            found.setdefault(each.resolve(), each)
    if not found:
        raise InputError("no run was given; name run logs, or a folder of them")
    return list(found.values())


def gather(given: Sequence[Path]) -> Gathered:
    """Runs of one wheel from files and folders; what cannot be used is left out, and says why.

    Raises:
        InputError: where none can be used, or the runs are of several wheels and none prevails.
    """
    files = run_files(given)
    candidates: list[Candidate] = []
    left_out: dict[str, str] = {}
    with GuardedReader() as reader:
        for name, path, surveyed in zip(names_of(files), files, reader.surveys(files), strict=True):
            try:
                each = candidate(name, run_from(*surveyed))
                if "z" not in each.observation.channels:
                    raise InputError(
                        f"{name}: has no /measured/z, and without its sinkage its zeta is not known"
                    )
                candidates.append(each)
            except InputError as problem:
                why = str(problem).removeprefix(f"{name}: ")
                left_out[name] = why if str(path) in why else f"{path}: {why}"
    if not candidates:
        if len(files) == 1:
            raise InputError(*left_out.values())
        first = next(iter(left_out.values()))
        raise InputError(f"none of the {len(files)} files can be used; the first: {first}")
    kept, others = _of_one_wheel(candidates)
    return Gathered(kept, left_out | others)


def _of_one_wheel(candidates: Sequence[Candidate]) -> tuple[list[Candidate], dict[str, str]]:
    """The runs of the wheel and carriage that most have, and why the others are left out."""
    kinds: dict[str, list[Candidate]] = {}
    for each in candidates:
        kinds.setdefault(_kind(each), []).append(each)
    ranked = sorted(kinds.items(), key=lambda kind: -len(kind[1]))
    kind, kept = ranked[0]
    if len(ranked) > 1 and len(ranked[1][1]) == len(kept):
        told = "; ".join(f"{', '.join(c.name for c in runs)}: {kind}" for kind, runs in ranked[:2])
        raise InputError(
            f"the runs are of different wheels or carriages ({told}); diagnose each apart"
        )
    others = {
        each.name: f"{each.name}: has {other}, where the {len(kept)} runs kept have {kind}"
        for other, runs in ranked[1:]
        for each in runs
    }
    return kept, others


def _kind(each: Candidate) -> str:
    wheel = each.setup.wheel
    words = f"a wheel of radius {_mm(wheel.radius)}, width {_mm(wheel.width)}, "
    if wheel.shape == "grouser":
        tip = f"{_mm(wheel.grouser_height)} x {_mm(wheel.grouser_thickness)}"
        words += f"{wheel.grouser_count} grousers of {tip}"
    else:
        words += "no grousers"
    return f"{words}, on a {each.setup.rig.carriage} carriage"


def _mm(length: float) -> str:
    return f"{round(1e3 * length, PLACES):g} mm"
