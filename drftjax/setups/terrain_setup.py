"""[terrain] of a set-up file: zeta and the numbers of one stress law, chosen by `law`.

Each stress law has a structure of its own, so that no table holds the numbers of another law.
A package adds a law by the entry-point group `drft.stress_laws`: its name in files, and a class
derived from `AbstractTerrainSetUp`.
"""

from collections.abc import Mapping
from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Any, ClassVar

import msgspec

from drftjax.common.errors import InputError
from drftjax.common.packages import load_plugins, require_known
from drftjax.physics.stress import (
    COEFFICIENT_NAMES,
    AbstractBisector,
    AbstractStressLaw,
    ArcBisector,
    Dynamic,
    QuasiStatic,
    StressCoefficients,
    VerticalBisector,
)
from drftjax.physics.terrain import ConstantZeta, KnotZeta, Terrain
from drftjax.setups.checked_table import CheckedTable

GROUP = "drft.stress_laws"


DEFAULT_LAW = "dynamic"


COEFFICIENTS = {
    "generic": StressCoefficients.generic,
    "loose poppy seeds": StressCoefficients.loose_poppy_seeds,
    "close poppy seeds": StressCoefficients.close_poppy_seeds,
}


BISECTORS: dict[str, type[AbstractBisector]] = {
    "vertical": VerticalBisector,
    "arc": ArcBisector,
}


class ZetaKnots(msgspec.Struct, forbid_unknown_fields=True):
    """zeta at knots in time [s] from the command's first knot on, linear in between."""

    time: list[float]
    value: list[float]


class AbstractTerrainSetUp(CheckedTable, tag_field="law"):
    """Entries of [terrain] that every stress law has; a law adds its own numbers and `stress_law`.

    The class keyword `tag` is the law's name in files.

    Attributes:
        zeta: Scaling factor [-], constant or at knots in time.
        coefficients: Name of a set in `COEFFICIENTS`, or nine numbers [N/cm3].
    """

    place: ClassVar[str] = "terrain"

    zeta: float | ZetaKnots = 0.7823
    coefficients: str | list[float] = "generic"

    def check(self) -> None:
        self.build()

    def stress_law(self) -> AbstractStressLaw:
        """The stress law with these numbers.

        Raises:
            InputError: says which number cannot be.
        """
        # Every law has its own; msgspec's metaclass lets no method be abstract.
        raise NotImplementedError

    def stress_coefficients(self) -> StressCoefficients:
        """The nine coefficients, of a named set or as listed.

        Raises:
            InputError: names the known sets.
        """
        if isinstance(self.coefficients, str):
            if self.coefficients not in COEFFICIENTS:
                raise InputError(
                    f"stress coefficients {self.coefficients!r} are not known; give one of "
                    f"{', '.join(map(repr, COEFFICIENTS))} or nine numbers in N/cm3"
                )
            return COEFFICIENTS[self.coefficients]()
        if len(self.coefficients) != len(COEFFICIENT_NAMES):
            raise InputError(
                f"stress coefficients are {len(self.coefficients)} numbers, must be nine "
                f"({' '.join(COEFFICIENT_NAMES)} in N/cm3)"
            )
        return StressCoefficients(self.coefficients)

    def put_coefficient(self, name: str, value: float) -> None:
        """Write one of the nine [N/cm3]; a named set becomes a list."""
        values = self.stress_coefficients().values.tolist()
        values[COEFFICIENT_NAMES.index(name)] = value
        self.coefficients = values

    def put_number(self, name: str, value: float) -> None:
        """Write a number of the law, such as "inertial_coefficient", in its file unit.

        Raises:
            InputError: the law has no such number.
        """
        if name not in self.__struct_fields__:
            raise InputError(
                f"the stress law {self.__struct_config__.tag!r} has no {name}; it has "
                f"{', '.join(self.__struct_fields__)}"
            )
        setattr(self, name, value)

    def build(self) -> Terrain:
        """The terrain: stress law and zeta.

        Raises:
            InputError: says which number cannot be.
        """
        law = self.stress_law()
        if isinstance(self.zeta, ZetaKnots):
            return Terrain(KnotZeta(self.zeta.time, self.zeta.value), law)
        return Terrain(ConstantZeta(self.zeta), law)


class DynamicTerrain(AbstractTerrainSetUp, tag="dynamic"):
    """[terrain] under dynamic resistive force theory; see `drftjax.physics.stress.Dynamic`.

    Attributes:
        inertial_coefficient: lambda [-].
        bulk_density: rho [kg/m3].
        height_decrease: Share of r (r omega^2 / g) taken off behind the wheel [-].
        bisector: Line that halves the contact: 'vertical', the reference model's, or 'arc', the
            middle of the arc that truly touches.
    """

    inertial_coefficient: float = 1.1
    bulk_density: float = 1490.0
    height_decrease: float = 1.0
    bisector: str = "vertical"

    def stress_law(self) -> Dynamic:
        require_known("terrain.bisector", self.bisector, BISECTORS)
        return Dynamic(
            self.inertial_coefficient,
            self.bulk_density,
            self.height_decrease,
            self.stress_coefficients(),
            bisector=BISECTORS[self.bisector](),
        )


class QuasiStaticTerrain(AbstractTerrainSetUp, tag="quasi-static"):
    """[terrain] under resistive force theory free of rate; see `physics.stress.QuasiStatic`."""

    def stress_law(self) -> QuasiStatic:
        return QuasiStatic(self.stress_coefficients())


def stress_laws() -> dict[str, type[AbstractTerrainSetUp]]:
    """Structures of [terrain] by the name of their law, those of installed packages included.

    Raises:
        InputError: names a plug-in that is no such structure, has another tag than its name, or
            takes a name twice.
    """
    known: dict[str, type[AbstractTerrainSetUp]] = {
        "dynamic": DynamicTerrain,
        "quasi-static": QuasiStaticTerrain,
    }
    for name, label, added in load_plugins(GROUP, AbstractTerrainSetUp, "stress law"):
        if name in known:
            raise InputError(f"{label} is there already")
        if added.__struct_config__.tag != name:
            raise InputError(
                f"{label} has the tag {added.__struct_config__.tag!r}, must be {name!r}"
            )
        if added.stress_law is AbstractTerrainSetUp.stress_law:
            raise InputError(f"{label} lacks stress_law, which every stress law has")
        known[name] = added
    return known


STRESS_LAWS = stress_laws()


if TYPE_CHECKING:
    TerrainSetUp = AbstractTerrainSetUp
else:
    # The tagged union that msgspec reads by `law`.
    TerrainSetUp = reduce(or_, STRESS_LAWS.values())


def with_law(document: dict[str, Any]) -> dict[str, Any]:
    """A set-up file's contents, its [terrain] with the default law where it names none.

    Args:
        document: Tables by name.

    Raises:
        InputError: for a law that is not known.
    """
    table = document.get("terrain", {})
    if not isinstance(table, Mapping):
        return document
    name = table.get("law", DEFAULT_LAW)
    if not isinstance(name, str):
        return document
    require_known("terrain.law", name, STRESS_LAWS)
    return drop_unused_numbers({**document, "terrain": {"law": name, **table}})


def drop_unused_numbers(setup: dict[str, Any]) -> dict[str, Any]:
    """A set-up whose [terrain] is without numbers that only other laws have.

    Files of before each law had a table of its own may hold the dynamic law's numbers beside any
    law, which never used them.

    Args:
        setup: Tables of a set-up by name.
    """
    table = setup.get("terrain")
    if not isinstance(table, Mapping) or table.get("law") not in STRESS_LAWS:
        return setup
    own = STRESS_LAWS[table["law"]].__struct_fields__
    others = {name for law in STRESS_LAWS.values() for name in law.__struct_fields__} - {*own}
    kept = {name: value for name, value in table.items() if name not in others}
    return {**setup, "terrain": kept}
