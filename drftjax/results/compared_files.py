"""Results of one kind side by side: their files, common inputs, and quantities with errors."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Any, Final

import msgspec

from drftjax import __version__
from drftjax.common.errors import InputError
from drftjax.common.text import value_with_error
from drftjax.results.agreement import Agreement, agreement
from drftjax.results.provenance import Provenance, encodable, read_result_document
from drftjax.runlog.files import HDF5_ENDINGS, digest_of

COMPARISON_SCHEMA: Final = "drft-comparison"

# Values and errors up to this size, and errors down to one over it, have squares that are numbers.
LARGEST = 1e150


# Layouts of results that can be compared, where there is more than the first: every entry of an
# older one means the same in the newer.
KNOWN_VERSIONS = {"drft-diagnosis": (1, 2)}


@dataclass(frozen=True)
class SideBySideSettings:
    """Numbers of the sentences on several results.

    Attributes:
        chance: Values disagree where chance makes them scatter as much in fewer cases than this,
            shared out over all quantities compared: so one comparison in twenty names a quantity
            whose errors are right.
        shown_weight: Weight of an effect in any diagnosis from which on it has a row [-].
    """

    chance: float = 0.05
    shown_weight: float = 0.05


SIDE_BY_SIDE_SETTINGS = SideBySideSettings()


class ReportedValue(msgspec.Struct, frozen=True):
    """A number with its standard error, as results write it; None for one that is not finite."""

    value: float | None
    error: float | None
    unit: str = "-"
    label: str = ""
    at_bound: bool = False


@dataclass(frozen=True)
class FileValue:
    """Value of a quantity in one file.

    Attributes:
        value, error: The number and its standard error; of each run's own values, their mean.
        runs: Number of runs it is the mean of; None where the file has one value.
        scatter: Standard deviation from run to run beyond the errors; None where that is not
            reported.
        at_bound: True where a fit ended at a bound of it, where its error means nothing.
    """

    value: float
    error: float | None
    runs: int | None = None
    scatter: float | None = None
    at_bound: bool = False

    @property
    def counts(self) -> bool:
        """True where it can be compared by its error."""
        if self.error is None or self.at_bound:
            return False
        return abs(self.value) < LARGEST and 1 / LARGEST < self.error < LARGEST

    def __str__(self) -> str:
        if self.at_bound:
            return f"{self.value:.5g}, at a bound"
        told = f"{self.value:.5g}"
        if self.counts and self.error is not None:
            told = value_with_error(self.value, self.error)
        if self.runs is None or self.runs == 1:
            return told
        scatter = "" if self.scatter is None else f", scatter {self.scatter:.2g}"
        return f"{told} (mean of {self.runs}{scatter})"


@dataclass(frozen=True)
class ComparedQuantity:
    """One quantity in all files.

    Attributes:
        name, label, unit: As in the results; "-" for no unit.
        values: By file; None where it has none.
        agreement: Of those that can be compared; None for fewer than two.
        disagrees: True where they scatter by more than chance makes them.
    """

    name: str
    label: str
    unit: str
    values: tuple[FileValue | None, ...]
    agreement: Agreement | None
    disagrees: bool

    @property
    def compared(self) -> list[int]:
        """Places of the files whose values are compared."""
        return [at for at, each in enumerate(self.values) if each is not None and each.counts]

    def sentence(self, names: Sequence[str]) -> str:
        """Sentence on its disagreement; `names` are the files'."""
        found = self.agreement
        assert found is not None
        first, second = (self.compared[at] for at in found.apart)
        unit = "" if self.unit == "-" else f" {self.unit}"
        return (
            f"{self.label} disagrees: {self.values[first]}{unit} in {names[first]} and "
            f"{self.values[second]}{unit} in {names[second]} lie {found.errors_apart:.2g} errors "
            f"apart; over the files it scatters by {found.ratio:.2g} times what the errors allow."
        )


def compared_quantities(
    found: Mapping[str, tuple[str, str, Sequence[FileValue | None]]],
    settings: SideBySideSettings = SIDE_BY_SIDE_SETTINGS,
) -> list[ComparedQuantity]:
    """Quantities with their agreement over the files.

    Args:
        found: Label, unit and values by file of each quantity, by its name.
        settings: Level at which values disagree.
    """
    tested = {}
    for name, (_, _, values) in found.items():
        known = [each for each in values if each is not None and each.counts]
        tested[name] = agreement([v.value for v in known], [v.error or 0.0 for v in known])
    level = settings.chance / max(1, sum(each is not None for each in tested.values()))
    return [
        ComparedQuantity(
            name, label, unit, tuple(values), each, each is not None and each.chance < level
        )
        for (name, (label, unit, values)), each in zip(found.items(), tested.values(), strict=True)
    ]


@dataclass(frozen=True)
class ResultInput:
    """One of the results that are compared.

    Attributes:
        path: Its file.
        plain: Contents as plain values.
        schema: Kind of result.
        provenance: Its origin, where it names one.
    """

    path: Path
    plain: dict[str, Any]
    schema: str
    provenance: Provenance | None

    @property
    def name(self) -> str:
        """Name of the file in sentences."""
        return encodable(str(self.path))

    @property
    def run_logs(self) -> dict[str, str]:
        """Names of its run logs by their SHA-256; empty where it names none."""
        inputs = self.provenance.inputs if self.provenance is not None else ()
        return {
            each.sha256: each.name
            for each in inputs
            if each.sha256 is not None and Path(each.name).suffix in HDF5_ENDINGS
        }


def read_results(paths: Sequence[Path], kinds: Mapping[str, str]) -> list[ResultInput]:
    """Read results of one kind.

    Args:
        paths: Their JSON files, two or more.
        kinds: Kinds that can be compared: a word for each, by schema.

    Raises:
        InputError: fewer than two, one is no result, or they are of several kinds.
    """
    if len(paths) < 2:
        raise InputError(f"{paths[0]} is one result; name two or more to compare")
    for at, path in enumerate(paths):
        if path.absolute() in [each.absolute() for each in paths[:at]]:
            raise InputError(f"{path} is named twice; name each result once")
    found = []
    for path in paths:
        plain, document = read_result_document(path)
        if document.schema not in kinds:
            known = " or ".join(f"of a {each}" for each in kinds.values())
            raise InputError(f"{path}: is a {document.schema}, must be the JSON file {known}")
        known_versions = KNOWN_VERSIONS.get(document.schema, (1,))
        if plain.get("schema_version") not in known_versions:
            are = " and ".join(map(str, known_versions)) + (" are" if known_versions[1:] else " is")
            raise InputError(
                f"{path}: schema_version {plain.get('schema_version')} is not known here ({are})"
            )
        found.append(ResultInput(path, plain, document.schema, document.provenance))
    first = found[0]
    for each in found[1:]:
        if each.schema != first.schema:
            raise InputError(
                f"{first.path} is a {kinds[first.schema]} and {each.path} a {kinds[each.schema]}; "
                "compare results of one kind"
            )
    return found


def input_sentences(results: Sequence[ResultInput]) -> list[str]:
    """Sentences on run logs that results have in common, by which their errors are not independent.

    Args:
        results: Results of one kind.
    """
    silent = [each.name for each in results if not each.run_logs]
    sentences = []
    if silent:
        name = "names" if len(silent) == 1 else "name"
        sentences.append(
            f"{', '.join(silent)} {name} no run logs by their SHA-256: whether its runs are those "
            "of the others cannot be said."
        )
    common = False
    for one, other in combinations([each for each in results if each.run_logs], 2):
        both = one.run_logs.keys() & other.run_logs.keys()
        common |= bool(both)
        if both and one.run_logs.keys() == other.run_logs.keys():
            sentences.append(f"{one.name} and {other.name} are made from the same run logs.")
        elif both:
            logs = sorted(one.run_logs[each] for each in both)
            sentences.append(f"{one.name} and {other.name} have {', '.join(logs)} in common.")
    if common:
        sentences.append(
            "So their errors are not independent, as chi-square takes them: noise moves both "
            "alike, and a difference is one of options or models."
        )
    elif not silent:
        sentences.append("No run log is in two of them.")
    return sentences


@dataclass(frozen=True)
class ComparedResults:
    """Results side by side.

    Attributes:
        kind: Their schema.
        files: The results.
        quantities: Their numbers, by file.
        weights: Weights of effects by file, None where one was not considered; empty for fits.
        sentences: On common runs, and on what agrees and what does not.
        next_steps: Sentences on what to record next.
    """

    kind: str
    files: Sequence[ResultInput]
    quantities: Sequence[ComparedQuantity]
    sentences: Sequence[str]
    next_steps: Sequence[str]
    weights: Mapping[str, Sequence[float | None]] = field(default_factory=dict)

    def document(self) -> dict[str, Any]:
        """Plain values, in the layout of the JSON file."""
        return {
            "schema": COMPARISON_SCHEMA,
            "schema_version": 1,
            "software": f"drftjax {__version__}",
            "kind": self.kind,
            "files": [{"name": each.name, "sha256": digest_of(each.path)} for each in self.files],
            "quantities": [_plain(each) for each in self.quantities],
            "weights": {name: list(each) for name, each in self.weights.items()},
            "sentences": list(self.sentences),
            "next": list(self.next_steps),
        }


def _plain(quantity: ComparedQuantity) -> dict[str, Any]:
    found = quantity.agreement
    numbers = {} if found is None else msgspec.to_builtins(found) | {"ratio": found.ratio}
    return {
        "name": quantity.name,
        "label": quantity.label,
        "unit": quantity.unit,
        "values": msgspec.to_builtins(quantity.values),
        "agreement": numbers or None,
        "disagrees": quantity.disagrees,
    }
