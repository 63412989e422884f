"""Where the gap between runs and model lies: its shares by run, phase, state and frequency."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.blocks import Splitter
from diagnose.case import Case
from diagnose.motion import PHASES, Motion, motion_of_run
from diagnose.spectrum import (
    HERTZ_LABELS,
    LINE_FROM,
    LINE_GAIN,
    LINE_SHARE,
    LINE_WIDTH,
    ORDER_FROM,
    ORDER_TO,
    ORDER_WIDTH,
    STANDS,
    Line,
    bands,
    evenly,
    in_turning,
    power_by_hertz,
    power_by_order,
)
from diagnose.stages import Stage

# Intervals hold the share with this probability.
PROBABILITY = 0.9
DRAWS = 400
SEED = 20240
# About as many bins in a state variable.
STATE_BINS = 5
# Their edges lie on a grid of about as many steps.
EDGE_STEPS = 25
# Share of an axis' range by which a value may lie under an edge and still count as on it.
ROUNDING = 1e-6
SLIP_EDGES = (0.0, 0.1, 0.2, 0.3, 0.5)
UNSEEN = "not recorded"
SLOWER, OTHER = "slower than once a turn", "other orders of the drive"
ONCE, UNPARTED = "once a turn", "once a turn or slower"
# In fewer turns than these a drift passes for a period.
FEWEST_TURNS = 3.0
# What a sentence names holds this share of the gap at least, what is most of it that; and how many
# it names at most.
LEAST_TOLD, MOST, MOST_TOLD = 0.25, 0.5, 3
# Share of the gap that a marked order (once a turn, grousers, a line) holds where nothing is there.
MARKED = 0.05
# Bins of the orders that say nothing in a sentence.
NOTHING_SAID = (SLOWER, UNPARTED, OTHER, STANDS, f"over {ORDER_TO:g} a turn")


@dataclass(frozen=True)
class Share:
    """Share of the gap in one bin of one axis.

    Attributes:
        axis: What the gap is cut by.
        label: The bin, with its unit.
        share: Of the summed squared residual, in units of the floor [-].
        interval: That holds it with a probability of 90 %.
        time: Share of the time spent there; NaN where that means nothing.
    """

    axis: str
    label: str
    share: float
    interval: tuple[float, float]
    time: float = np.nan


@dataclass(frozen=True, eq=False)
class _Run:
    """One run's error in floors: `error`, shape (channels, samples); zero where not recorded."""

    motion: Motion
    error: np.ndarray

    @property
    def power(self) -> np.ndarray:
        """Of every sample, over channels."""
        return (self.error**2).sum(axis=0)

    def in_bins(self, place: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Sums of `values` (rows, samples) over half seconds, shape (half seconds, rows)."""
        count = int(self.motion.bins.max()) + 1
        return np.stack([np.bincount(place, row, count) for row in values], axis=1)


@dataclass(frozen=True, eq=False)
class _Cut:
    """An axis: by run, power and samples of each half second in each bin of it."""

    axis: str
    labels: Sequence[str]
    power: list[np.ndarray]
    samples: list[np.ndarray] | None = None


def where(case: Case, residual: list[np.ndarray], floor: dict[str, float]) -> list[Share]:
    """Shares of the gap, each with an interval.

    Args:
        case: The runs.
        residual: By run: simulated less recorded, shape (channels, samples) [m, N, N m].
        floor: Noise floor of each channel in the same unit.

    Returns:
        Shares that add up to one on each axis; none where there is no gap. Of travel, its change
        from one half second to the next counts, so that one early slip does not count for ever.
    """
    runs = [_run(case, number, each, floor) for number, each in enumerate(residual) if each.size]
    total = sum(float(run.power.sum()) for run in runs)
    if not total > 0:
        return []
    candidates = [case.candidates[k] for k, each in enumerate(residual) if each.size]
    names, loads, profiles = (
        [each.name for each in candidates],
        _loads(candidates),
        _profiles(candidates),
    )
    random = np.random.default_rng(SEED)
    sizes = [int(run.motion.bins.max()) + 1 for run in runs]
    # A run's share says what that run did: only its half seconds are drawn again, not the run;
    # and the runs of a load, or of a profile, stand for that load or profile.
    grouped = {
        "run": _draws(random, sizes, list(range(len(runs)))),
        "load": _draws(random, sizes, loads),
        "profile": _draws(random, sizes, profiles),
    }
    drawn = _draws(random, sizes, [0] * len(runs))
    cuts = [
        _named(runs, axis, of)
        for axis, of in (("run", names), ("load", loads), ("profile", profiles))
    ]
    cuts += [_placed(runs, "phase", PHASES, [run.motion.phase for run in runs])]
    cuts += _states(runs)
    cuts += [_by_hertz(runs), _by_order(runs), _by_channel(runs, case.channels)]
    return [share for cut in cuts for share in _shares(cut, grouped.get(cut.axis, drawn), total)]


def by_stage(found: Sequence[Stage]) -> list[Share]:
    """What an unknown error in each stage would take away of the gap's slow part.

    Each stage is taken alone, so that these shares do not add up to one.
    """
    if not found:
        return []
    sizes = [len(each) for each in found[0].power]
    draws = _draws(np.random.default_rng(SEED), sizes, [0] * len(sizes))

    def of(stage: Stage) -> Share:
        before, after = (draws @ np.concatenate(stage.power)).T
        share = float(stage.explained)
        drawn = np.where(before > 0, 1 - after / np.maximum(before, 1e-300), share)
        tail = 50 * (1 - PROBABILITY)
        low, high = np.percentile(np.clip(drawn, 0, 1), [tail, 100 - tail])
        interval = (float(min(low, share)), float(max(high, share)))
        return Share("stage", f"{stage.name}: {stage.meaning}", share, interval)

    return [of(each) for each in found]


def sentence(shares: Sequence[Share]) -> str:
    """Where the gap lies, in one plain sentence.

    The bins that hold most beyond the time spent in them are named, at most three.
    """
    if not shares:
        return "There is no gap to speak of."
    axes: dict[str, list[Share]] = {}
    for each in shares:
        axes.setdefault(each.axis, []).append(each)
    told = []
    for axis, parts in axes.items():
        if len(parts) < 2 or axis in ("run", "frequency", "stage"):
            continue
        for part in parts:
            even = MARKED if axis == "order" else 1 / len(parts)
            expected = part.time if np.isfinite(part.time) else even
            sure = part.interval[0] > expected and part.share > LEAST_TOLD
            if sure and not (axis == "order" and part.label in NOTHING_SAID):
                told.append((part.share * np.log(part.share / max(expected, 1e-3)), part))
    told.sort(key=lambda each: -each[0])
    chosen: dict[str, Share] = {}
    for _, part in told:
        # A profile is fast or slow: one of the two says it.
        kind = "speed" if part.axis in ("profile", "angular velocity") else part.axis
        if len(chosen) < MOST_TOLD:
            chosen.setdefault(kind, part)
    if not chosen:
        return "The gap is spread about evenly over runs, phases and states."
    said = []
    for much, least, below in (("Most", MOST, np.inf), ("Much", LEAST_TOLD, MOST)):
        places = [_in_words(each) for each in chosen.values() if least <= each.share < below]
        if places:
            whole = f"{much.lower()} of it" if said else f"{much} of the gap lies"
            said.append(f"{whole} {'; '.join(places)}")
    return "; ".join(said) + "."


def _in_words(part: Share) -> str:
    place = {
        "phase": f"in the phase “{part.label}”",
        "channel": f"in {part.label}",
        "order": f"{part.label}",
        "load": f"at {part.label}",
        "profile": f"in the profile {part.label}",
    }.get(part.axis, f"at {part.axis} {part.label}")
    spent = f" in {part.time:.0%} of the time" if np.isfinite(part.time) else ""
    return f"{place} ({part.share:.0%} of it{spent})"


def _run(case: Case, number: int, residual: np.ndarray, floor: dict[str, float]) -> _Run:
    splitter = Splitter.of(case.time(number))
    error = np.zeros(residual.shape)
    for row, channel in enumerate(case.channels):
        values = residual[row]
        if not np.isfinite(values).all():
            continue
        if channel == "x":
            parts = splitter.split("x", values[:, None])
            change = np.r_[0.0, parts["slow"][:, 0]]
            values = splitter.back @ change + parts["fast"][:, 0]
        error[row] = values / floor[channel]
    return _Run(motion_of_run(case, number, splitter), error)


def _loads(candidates: Sequence) -> list[str]:
    rigs = [each.setup.rig for each in candidates]
    drawn = len({rig.drawbar_load for rig in rigs}) > 1
    carried = len({rig.mass_x for rig in rigs}) > 1 and len({rig.mass_z for rig in rigs}) == 1
    labels = []
    for rig in rigs:
        label = f"{rig.mass_x:.4g} kg carried" if carried else f"{rig.mass_z:.4g} kg on the wheel"
        labels.append(label + (f", {rig.drawbar_load:.3g} N drawn" if drawn else ""))
    return labels


def _profiles(candidates: Sequence) -> list[str]:
    labels: dict[tuple, str] = {}
    found = []
    for each in candidates:
        trial = each.trial
        knots = tuple(np.round(np.r_[trial.time, trial.omega, trial.vx], 6))
        if knots not in labels:
            fastest = np.rad2deg(float(np.abs(np.asarray(trial.omega)).max()))
            label = f"up to {fastest:.3g} deg/s in {float(trial.time[-1]):.3g} s"
            alike = sum(other.split(" (")[0] == label for other in labels.values())
            labels[knots] = f"{label} ({alike + 1})" if alike else label
        found.append(labels[knots])
    return found


def _draws(random: np.random.Generator, sizes: list[int], groups: Sequence) -> np.ndarray:
    """How often each half second is drawn, shape (draws, half seconds of all runs).

    Runs are drawn from their group, as many as it has; half seconds from each run drawn.
    """
    times = np.zeros((DRAWS, len(sizes)), int)
    for group in set(groups):
        members = [k for k, each in enumerate(groups) if each == group]
        even = np.full(len(members), 1 / len(members))
        times[:, members] = random.multinomial(len(members), even, size=DRAWS)
    parts = [
        random.multinomial(times[:, k] * size, np.full(size, 1 / size))
        for k, size in enumerate(sizes)
    ]
    return np.concatenate(parts, axis=1).astype(float)


def _shares(cut: _Cut, draws: np.ndarray, total: float) -> list[Share]:
    power = np.concatenate(cut.power)
    share = power.sum(axis=0) / power.sum()
    drawn = draws @ power
    whole = drawn.sum(axis=1, keepdims=True)
    drawn = np.where(whole > 1e-12 * total, drawn / np.maximum(whole, 1e-300), share)
    tail = 50 * (1 - PROBABILITY)
    low, high = np.percentile(drawn, [tail, 100 - tail], axis=0)
    time = np.full(len(share), np.nan)
    if cut.samples is not None:
        samples = np.concatenate(cut.samples).sum(axis=0)
        time = samples / samples.sum()
    return [
        Share(
            cut.axis,
            label,
            float(share[k]),
            (float(min(low[k], share[k])), float(max(high[k], share[k]))),
            float(time[k]),
        )
        for k, label in enumerate(cut.labels)
        if cut.samples is None or time[k] > 0
    ]


def _placed(
    runs: Sequence[_Run], axis: str, labels: Sequence[str], places: Sequence[np.ndarray]
) -> _Cut:
    """An axis by the number of each sample's bin."""
    power, samples = [], []
    for run, place in zip(runs, places, strict=True):
        inside = (place == np.arange(len(labels))[:, None]).astype(float)
        power.append(run.in_bins(run.motion.bins, inside * run.power))
        samples.append(run.in_bins(run.motion.bins, inside))
    return _Cut(axis, labels, power, samples)


def _named(runs: Sequence[_Run], axis: str, names: Sequence[str]) -> _Cut:
    """An axis by a name of each run."""
    labels = list(dict.fromkeys(names))
    places = [
        np.full(len(run.motion.time), labels.index(name))
        for run, name in zip(runs, names, strict=True)
    ]
    return _placed(runs, axis, labels, places)


def _states(runs: Sequence[_Run]) -> list[_Cut]:
    def all_of(pick, scale: float = 1.0) -> list[np.ndarray] | None:
        values = [pick(run.motion) for run in runs]
        if all(v is None for v in values):
            return None
        nothing = [np.full(len(run.motion.time), np.nan) for run in runs]
        return [n if v is None else scale * v for v, n in zip(values, nothing, strict=True)]

    degrees = float(np.rad2deg(1.0))
    axes = [
        ("angular velocity", "deg/s", all_of(lambda m: m.omega, degrees), None, UNSEEN),
        ("slip", "", all_of(lambda m: m.slip), np.array(SLIP_EDGES), STANDS),
        ("sinkage", "mm", all_of(lambda m: m.sinkage, 1e3), None, UNSEEN),
        ("travel", "m", all_of(lambda m: m.travel), None, UNSEEN),
        (
            "wheel angle",
            "deg",
            all_of(lambda m: np.mod(m.angle, 2 * np.pi), degrees),
            np.arange(45.0, 360.0, 45.0),
            UNSEEN,
        ),
    ]
    cuts = []
    for axis, unit, values, edges, otherwise in axes:
        if values is None:
            continue
        edges = _edges(np.concatenate(values)) if edges is None else edges
        labels = [*_labels(edges, unit), otherwise]
        slack = ROUNDING * float(np.abs(edges).max(initial=0))
        places = [
            np.where(np.isfinite(v), np.searchsorted(edges - slack, v), len(edges) + 1)
            for v in values
        ]
        cuts.append(_placed(runs, axis, labels, places))
    return cuts


def _edges(values: np.ndarray) -> np.ndarray:
    """Inner edges of bins at round numbers, with about as much time in each."""
    values = values[np.isfinite(values)]
    low, high = np.percentile(values, [1, 99]) if len(values) else (0.0, 0.0)
    if not high - low > 1e-6 * max(abs(low), abs(high), 1e-9):
        return np.zeros(0)
    wide = (high - low) / EDGE_STEPS
    power = 10.0 ** np.floor(np.log10(wide))
    step = power * next(each for each in (1, 2, 5, 10) if each * power >= wide)
    # A wheel that stands says little of where the edges should be.
    moving = values[np.abs(values) > 0.01 * max(abs(low), abs(high))]
    parts = np.percentile(moving, np.linspace(0, 100, STATE_BINS + 1)[1:-1])
    edges = np.unique(np.round(step * np.round(parts / step), 9))
    return edges[(edges > low) & (edges < high)]


def _labels(edges: np.ndarray, unit: str) -> list[str]:
    unit = f" {unit}" if unit else ""
    if not len(edges):
        return [f"all alike{unit and ' in' + unit}"]
    inner = [f"{a:g} to {b:g}{unit}" for a, b in itertools.pairwise(edges)]
    return [f"under {edges[0]:g}{unit}", *inner, f"over {edges[-1]:g}{unit}"]


def _by_channel(runs: Sequence[_Run], channels: Sequence[str]) -> _Cut:
    power = [run.in_bins(run.motion.bins, run.error**2) for run in runs]
    return _Cut("channel", channels, power)


def _by_hertz(runs: Sequence[_Run]) -> _Cut:
    power = []
    for run in runs:
        found = sum(power_by_hertz(run.motion.time, row) for row in run.error)
        power.append(_whole(run, run.in_bins(run.motion.bins, np.asarray(found))))
    return _Cut("frequency", HERTZ_LABELS, power)


def _whole(run: _Run, found: np.ndarray) -> np.ndarray:
    """Powers made to add up to the run's: interpolation loses some of the fastest."""
    total = found.sum()
    return found * (run.power.sum() / total) if total > 0 else found


def _by_order(runs: Sequence[_Run]) -> _Cut:
    hertz = _shared_hertz(runs)
    grousers = runs[0].motion.grousers
    drive = _shared_order(runs, grousers) if hertz is None else None
    edges, parted = _orders(grousers, drive)
    told = [_parted(run, parted) for run in runs]
    fixed = f"at {hertz:.2g} Hz, whatever the speed" if hertz is not None else "at fixed hertz"
    labels = [*dict.fromkeys(itertools.chain(*sorted(told, key=lambda each: UNPARTED in each)))]
    labels += [fixed, STANDS]
    power = []
    for run, names in zip(runs, told, strict=True):
        motion = run.motion
        stands = np.isin(motion.phase, [PHASES.index("stand"), PHASES.index("rest")])
        stands |= np.r_[True, np.diff(motion.turning) <= 0]
        found = np.zeros((int(motion.bins.max()) + 1, len(labels)))
        for row in run.error:
            rest = row
            if hertz is not None:
                even, step = evenly(motion.time, row)
                line = bands(even, step, (hertz - LINE_WIDTH, hertz + LINE_WIDTH))[1]
                rest = row - line
                found[:, -2] += run.in_bins(motion.bins, line[None] ** 2)[:, 0]
            found[:, -1] += run.in_bins(motion.bins, (np.where(stands, rest, 0) ** 2)[None])[:, 0]
            series, step, when = in_turning(motion.time, motion.turning, rest, stands)
            if not len(series):
                moving = np.where(stands, 0, rest) ** 2
                found[:, -1] += run.in_bins(motion.bins, moving[None])[:, 0]
                continue
            place = np.interp(when, motion.time, motion.bins).round().astype(int)
            within = power_by_order(series, step, edges)
            within *= (rest[~stands] ** 2).sum() / max(float(within.sum()), 1e-300)
            for name, values in zip(names, run.in_bins(place, within).T, strict=True):
                found[:, labels.index(name)] += values
        power.append(_whole(run, found))
    return _Cut("order", labels, power)


def _orders(grousers: int, drive: float | None) -> tuple[tuple[float, ...], list[str]]:
    """Edges between bands of periods in a turn, and the name of each band."""
    marks = [(1.0, ONCE)]
    if grousers > 1:
        passing = f"grouser passing ({grousers} a turn)"
        marks += [(float(grousers), passing), (2.0 * grousers, passing)]
    if drive is not None:
        marks.append((drive, f"drive order {drive:.2g}"))
    edges: list[float] = []
    names: list[str] = []
    for at, name in sorted(marks):
        between = SLOWER if not names else OTHER
        edges += [at - ORDER_WIDTH, at + ORDER_WIDTH]
        names += [between, name]
    if edges[-1] < ORDER_TO:
        edges.append(ORDER_TO)
        names.append(OTHER)
    return tuple(edges), [*names, f"over {ORDER_TO:g} a turn"]


def _parted(run: _Run, names: Sequence[str]) -> list[str]:
    """Names of the bands in one run."""
    if np.ptp(run.motion.turning) >= FEWEST_TURNS * 2 * np.pi:
        return list(names)
    return [UNPARTED if name in (SLOWER, ONCE) else name for name in names]


def _series(run: _Run, unit: float):
    """Every channel's even series in time and over turning, in some unit, each with its step."""
    motion = run.motion
    stands = np.isin(motion.phase, [PHASES.index("stand"), PHASES.index("rest")])
    stands |= np.r_[True, np.diff(motion.turning) <= 0]
    for row in run.error / unit:
        yield evenly(motion.time, row), in_turning(motion.time, motion.turning, row, stands)[:2]


def _lines(runs: Sequence[_Run]) -> tuple[tuple[float, float], tuple[float, float]]:
    """The strongest line over time [Hz] and over turning, each with its share of its octave."""
    steps = [float(np.diff(run.motion.time).mean()) for run in runs if len(run.motion.time) > 1]
    hertz = Line(LINE_FROM, 0.5 / max(steps, default=1.0), LINE_WIDTH)
    order = Line(ORDER_FROM, ORDER_TO, ORDER_WIDTH)
    for run in runs:
        whole = np.sqrt(max(float(run.power.sum()), 1e-300))
        for in_time, over_turning in _series(run, whole):
            hertz.add(*in_time)
            order.add(*over_turning)
    return hertz.strongest(), order.strongest()


def _shared_hertz(runs: Sequence[_Run]) -> float | None:
    """A frequency that the error keeps at every speed [Hz]; None without one."""
    (at, share), (_, other) = _lines(runs)
    return at if share > LINE_SHARE and share > LINE_GAIN * other else None


def _shared_order(runs: Sequence[_Run], grousers: int) -> float | None:
    """Periods in a turn that the error keeps, other than the grousers'; None without any."""
    _, (at, share) = _lines(runs)
    known = [1.0, *(k * grousers for k in (1, 2) if grousers)]
    near = any(abs(at - each) < 2 * ORDER_WIDTH for each in known)
    return at if share > LINE_SHARE and not near else None
