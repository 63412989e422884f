"""Scores of answers to blind sets against their opened labels."""

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from diagnose.blind.answers.answer_file import Answer, FreshAnswer, GapAnswer, read_answers
from diagnose.blind.generation.sealed_labels import open_labels
from diagnose.blind.scoring.proportion import Proportion
from diagnose.blind.scoring.scored_set import (
    CHANGE,
    DEFAULT_SCORING,
    FAINT,
    NONE,
    PAIR,
    SEVERAL,
    SINGLE,
    SWEEP,
    UNKNOWN,
    ScoredSet,
    ScoreSettings,
    scored_sets,
)
from diagnose.gap.gap import is_reducible, share_removed
from drftjax.common.errors import InputError


def _proportion(sets: Iterable[ScoredSet], is_hit: Callable[[ScoredSet], bool]) -> dict:
    hits = [is_hit(each) for each in sets]
    return Proportion(sum(hits), len(hits)).document()


def _of_given(cases: Iterable[bool | None]) -> dict:
    """Proportion of cases, without those not given."""
    given = [each for each in cases if each is not None]
    return Proportion(sum(given), len(given)).document()


def _together(cases: Iterable[Iterable[bool]]) -> dict:
    """Proportion of the cases of all sets together."""
    every = [case for each in cases for case in each]
    return Proportion(sum(every), len(every)).document()


def _order(kind: str) -> tuple[int, bool, bool]:
    kinds = SINGLE, PAIR, UNKNOWN, NONE, SEVERAL, CHANGE, SWEEP
    return kinds.index(kind.split(",")[0]), kind.endswith(NONE), kind.endswith(FAINT)


def by_kind(sets: list[ScoredSet]) -> dict[str, dict]:
    """Counts and proportions for each kind of set that occurs."""
    table = {}
    for kind in sorted({each.kind for each in sets}, key=_order):
        these = [each for each in sets if each.kind == kind]
        row: dict = {
            "sets": len(these),
            "first": _proportion(these, lambda each: each.first_is_right),
            "in_group": _proportion(these, lambda each: each.in_group),
            "mean_group_size": sum(each.group_size for each in these) / len(these),
            "confidently_wrong": _proportion(these, lambda each: each.confidently_wrong),
        }
        if kind.endswith(NONE):
            row["false_alarms"] = _proportion(these, lambda each: bool(each.answer.named()))
        elif kind.startswith(UNKNOWN):
            row["recognised"] = _proportion(these, lambda each: each.first == UNKNOWN)
            row["unknown_told"] = _proportion(these, lambda each: each.unknown_is_told)
        else:
            row["missed"] = _proportion(these, lambda each: not each.answer.named())
            row["called_unknown"] = _proportion(these, lambda each: each.first == UNKNOWN)
        if kind.startswith(PAIR):
            row["both"] = _proportion(these, lambda each: each.all_named)
            row["at_least_one"] = _proportion(
                these, lambda each: bool(each.right_names & set(each.answer.named()))
            )
        if kind == SEVERAL:
            row["effects_offered"] = _together(each.effects_offered for each in these)
            row["false_names"] = _together(each.confident_names for each in these)
            row["worse_channels"] = _together(each.worse_channels for each in these)
            row["budget_shares"] = _together(each.budget_shares for each in these)
        if kind.startswith(CHANGE):
            row["size"] = _of_given(each.size_is_right for each in these)
        table[kind] = row
    return table


def confusion(sets: list[ScoredSet]) -> dict[str, dict[str, int]]:
    """Number of sets by truth and by answer; the names of a pair are joined by +."""
    matrix: dict[str, Counter] = defaultdict(Counter)
    for each in sets:
        truth = " + ".join(sorted(each.true)) or NONE
        matrix[truth][" + ".join(sorted(each.answer.named())) or NONE] += 1
    return {truth: dict(sorted(row.items())) for truth, row in sorted(matrix.items())}


def calibration(sets: list[ScoredSet], settings: ScoreSettings = DEFAULT_SCORING) -> list[dict]:
    """Mean weight and proportion of right hypotheses, in equal bins of the weight."""
    count = settings.calibration_bins
    bins: list[list[tuple[float, bool]]] = [[] for _ in range(count)]
    for each in sets:
        for name, weight in each.answer.weights.items():
            # 0.3 times ten is 3 only nearly.
            index = int(count * weight + 1e-9)
            bins[min(max(index, 0), count - 1)].append((weight, each.is_right(name)))
    return [
        {
            "from": index / count,
            "to": (index + 1) / count,
            "mean_weight": sum(w for w, _ in pairs) / len(pairs) if pairs else None,
            "right": Proportion(sum(right for _, right in pairs), len(pairs)).document(),
        }
        for index, pairs in enumerate(bins)
    ]


def shrinkage(sets: list[ScoredSet], settings: ScoreSettings = DEFAULT_SCORING) -> dict[str, dict]:
    """Promised and realised shrinkage of the gap on fresh runs, by channel.

    Both are shares of the gap above the noise floor of the answer. A promise is untried if the
    fresh runs have no gap above it.
    """
    tried: dict[str, list[dict]] = defaultdict(list)
    untried: Counter[str] = Counter()
    for each in sets:
        for channel, fresh in each.answer.fresh.items():
            promise = each.answer.gap.get(channel)
            if promise is None or not is_reducible(promise.before_mm, promise.floor_mm):
                continue
            rows = tried[channel]
            if is_reducible(fresh.before_mm, promise.floor_mm):
                rows.append({"set": each.name, **_realised(promise, fresh, settings)})
            else:
                untried[channel] += 1
    return {
        channel: {
            "kept": Proportion(sum(row["kept"] for row in rows), len(rows)).document(),
            "in_interval": _of_given(row["in_interval"] for row in rows),
            "untried": untried[channel],
            "sets": rows,
        }
        for channel, rows in sorted(tried.items())
    }


def _realised(promise: GapAnswer, fresh: FreshAnswer, settings: ScoreSettings) -> dict:
    if fresh.after_mm is None:
        realised = math.nan
    else:
        realised = share_removed(fresh.before_mm, fresh.after_mm, promise.floor_mm)
    interval, difference = promise.shrinkage_interval, abs(realised - promise.shrinkage)
    return {
        "promised": promise.shrinkage,
        "realised": realised,
        "kept": difference <= settings.shrinkage_tolerance + 1e-12,
        "in_interval": interval and interval[0] <= realised <= interval[1],
    }


def score_answers(
    labels: Mapping[str, dict],
    answers: Mapping[str, Answer],
    settings: ScoreSettings = DEFAULT_SCORING,
) -> dict:
    """Score answers against labels.

    Args:
        labels: Label of each set, by its name.
        answers: Answer to each set, by its name.
        settings: Thresholds of the scores.

    Returns:
        All scores, as a result file holds them.
    """
    sets = scored_sets(labels, answers, settings)
    return {
        "schema": "drft-blind-score",
        "schema_version": 1,
        "sets": len(sets),
        "unanswered": sorted(set(labels) - set(answers)),
        "kinds": by_kind(sets),
        "confusion": confusion(sets),
        "calibration": calibration(sets, settings),
        "calibration_without_faint": calibration(
            [each for each in sets if not each.is_faint], settings
        ),
        "shrinkage": shrinkage(sets, settings),
        "wrong": [
            {"set": each.name, "true": list(each.true), "answered": each.answer.named()}
            for each in sets
            if not each.all_named
        ],
    }


def read_labels_and_answers(
    folders: Sequence[Path], files: Sequence[Path]
) -> tuple[dict[str, dict], dict[str, Answer]]:
    """Labels and answers by the name of the set; with several folders, by folder and set.

    Args:
        folders: Folders of sets with their labels.
        files: File of answers to each folder, in the same order.

    Raises:
        InputError: A folder has no answers of its own, or a file answers a set that is not there.
    """
    if len(folders) != len(files):
        raise InputError(
            f"{len(folders)} folders of sets and {len(files)} files of answers are given; each "
            "folder needs one --answers, in the same order"
        )
    if len({folder.resolve() for folder in folders}) < len(folders):
        raise InputError("a folder of sets is given twice")
    labels: dict[str, dict] = {}
    answers: dict[str, Answer] = {}
    for folder, file in zip(folders, files, strict=True):
        prefix = f"{folder}/" if len(folders) > 1 else ""
        given, known = read_answers(file), open_labels(folder)
        surplus = sorted(set(given) - set(known))
        if surplus:
            raise InputError(f"{file}: answers {surplus[0]!r}, which {folder} has no label of")
        labels |= {prefix + name: label for name, label in known.items()}
        answers |= {prefix + name: answer for name, answer in given.items()}
    return labels, answers
