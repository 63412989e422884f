"""Make blind sets: draw the mechanisms of each, simulate its runs, seal its label."""

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context

import numpy as np

from diagnose.blind.answers.answer import configure_helper
from diagnose.blind.generation.kinds.change import ZETA, changeable, make_change
from diagnose.blind.generation.kinds.single import make_one_rig
from diagnose.blind.generation.kinds.sweep import make_sweep
from diagnose.blind.generation.random_mechanisms import UNLISTED, effect_names, stage_of
from diagnose.blind.generation.sealed_labels import seal
from diagnose.blind.generation.settings import (
    CHANGE,
    DEFAULT_GENERATION,
    SEVERAL,
    SINGLE,
    SWEEP,
    GenerationRequest,
    GenerationSettings,
)
from drftjax.common.errors import InputError

MAKERS = {
    SINGLE: make_one_rig,
    SEVERAL: make_one_rig,
    CHANGE: make_change,
    SWEEP: make_sweep,
}


def planned_faults(
    request: GenerationRequest, settings: GenerationSettings = DEFAULT_GENERATION
) -> list[tuple[str, ...]]:
    """Draw the mechanisms of every set, such that all kinds come up equally often.

    Returns:
        Kinds of mechanism of each set.
    """
    random = np.random.default_rng([request.seed, 0])
    draw = {SINGLE: _single, SEVERAL: _several, CHANGE: _change, SWEEP: _sweep}[request.kind]
    drawn = draw(request, random, settings)
    return [drawn[index] for index in random.permutation(request.sets)]


def _single(
    request: GenerationRequest, random: np.random.Generator, settings: GenerationSettings
) -> list[tuple[str, ...]]:
    names = effect_names()
    singles, unlisted = _shuffled(names, random), _shuffled(list(UNLISTED), random)
    shares = {
        "none": settings.none_share,
        "unknown": settings.unknown_share,
        "pair": settings.pair_share,
    }
    counts = _counts(request, shares)
    drawn: list[tuple[str, ...]] = [()] * counts["none"]
    drawn += [(next(unlisted),) for _ in range(counts["unknown"])]
    drawn += _draw_pairs(names, counts["pair"], random)
    return drawn + [(next(singles),) for _ in range(request.sets - len(drawn))]


def _several(
    request: GenerationRequest, random: np.random.Generator, settings: GenerationSettings
) -> list[tuple[str, ...]]:
    singles = _shuffled(effect_names(), random)
    least, most = settings.several.effects
    drawn = []
    for _ in range(request.sets):
        several: list[str] = []
        wanted = int(random.integers(least, most + 1))
        while len(several) < wanted:
            if (name := next(singles)) not in several:
                several.append(name)
        drawn.append(tuple(several))
    return drawn


def _change(
    request: GenerationRequest, random: np.random.Generator, settings: GenerationSettings
) -> list[tuple[str, ...]]:
    shares = {"none": settings.change.none_share, ZETA: settings.change.zeta_share}
    counts = _counts(request, shares)
    singles = _shuffled(changeable(), random)
    drawn: list[tuple[str, ...]] = [()] * counts["none"] + [(ZETA,)] * counts[ZETA]
    return drawn + [(next(singles),) for _ in range(request.sets - len(drawn))]


def _sweep(
    request: GenerationRequest, random: np.random.Generator, settings: GenerationSettings
) -> list[tuple[str, ...]]:
    counts = _counts(request, {"none": settings.none_share})
    singles = _shuffled(effect_names(is_driven=True), random)
    drawn: list[tuple[str, ...]] = [()] * counts["none"]
    return drawn + [(next(singles),) for _ in range(request.sets - len(drawn))]


def _counts(request: GenerationRequest, shares: dict[str, float]) -> dict[str, int]:
    """Number of sets of each kind of fault; the others have one effect."""
    if request.wrong == "mixed":
        return {kind: round(request.sets * share) for kind, share in shares.items()}
    return {kind: request.sets if kind == request.wrong else 0 for kind in shares}


def _draw_pairs(names: list[str], count: int, random: np.random.Generator) -> list[tuple[str, ...]]:
    """Pairs of effects that act in different stages."""
    pairs: list[tuple[str, ...]] = []
    while len(pairs) < count:
        first, second = (str(each) for each in random.choice(names, 2, replace=False))
        if stage_of(first) != stage_of(second):
            pairs.append((first, second))
    return pairs


def _shuffled(names: list[str], random: np.random.Generator) -> Iterator[str]:
    """All names in random order, again and again."""
    while True:
        yield from (names[index] for index in random.permutation(len(names)))


def make_sets(
    request: GenerationRequest, jobs: int = 1, settings: GenerationSettings = DEFAULT_GENERATION
) -> Iterator[str]:
    """Make sets and seal their labels.

    Args:
        request: Number and kind of the sets.
        jobs: Number of processes; the sets do not depend on it.
        settings: Distribution of the rigs.

    Yields:
        The name of every set when it is complete.

    Raises:
        InputError: The folder is not empty.
    """
    folder = request.folder
    if folder.exists() and any(folder.iterdir()):
        raise InputError(f"{folder} is not empty; name a folder that is")
    folder.mkdir(parents=True, exist_ok=True)
    faults = planned_faults(request, settings)
    # Sets whose runs share a program are made one after the other.
    numbers = sorted(range(request.sets), key=lambda number: faults[number])
    labels: dict[str, dict] = {}
    if jobs == 1:
        for number in numbers:
            labels[request.name(number)] = make_set(request, number, faults[number], settings)
            yield request.name(number)
    else:
        # A fresh process each, as the threads of JAX do not survive a fork.
        with ProcessPoolExecutor(jobs, get_context("spawn"), configure_helper, (set(),)) as pool:
            waiting = {
                pool.submit(make_set, request, number, faults[number], settings): number
                for number in numbers
            }
            for done in as_completed(waiting):
                labels[request.name(waiting[done])] = done.result()
                yield request.name(waiting[done])
    seal(folder, dict(sorted(labels.items())))


def make_set(
    request: GenerationRequest,
    number: int,
    kinds: tuple[str, ...],
    settings: GenerationSettings = DEFAULT_GENERATION,
) -> dict:
    """Make one set.

    Args:
        request: Kind, seed, protocol and sizes.
        number: Number of the set, from zero; with the seed it decides every random choice.
        kinds: Kinds of its mechanisms.
        settings: Distribution of the rigs.

    Returns:
        Its label.

    Raises:
        InputError: The plant cannot run with any of the forms drawn.
    """
    random = np.random.default_rng([request.seed, 1, number])
    for _ in range(settings.redraws):
        try:
            label = MAKERS[request.kind](request, number, kinds, random, settings)
        except InputError:  # the wheel digs in or leaves its rail: another form may not
            continue
        return {"kind": request.kind, **label}
    raise InputError(f"no form of {' and '.join(kinds) or 'nothing'} lets the plant run")
