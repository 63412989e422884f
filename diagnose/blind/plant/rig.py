"""Single-wheel rig of the plant: its wheel, its masses, its carriage, and the sand it stands on."""

from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp

from drftjax.common.arrays import as_real
from drftjax.physics.rig import DrivenCarriage, FreeCarriage, Rig
from drftjax.physics.wheel import (
    DEFAULT_PLATE_SIZE,
    PLAIN_PLATE_SIZE,
    AbstractWheel,
    GrouserWheel,
    PlainWheel,
)

GRAVITY = 9.81  # [m/s2]


@dataclass(frozen=True)
class PlantRig:
    """Rig of a set; the default is that of Fuke, Ishikawa & Ishigami 2024.

    Attributes:
        radius, width: Rim radius and wheel width [m].
        grouser_count: Number of grousers; 0 for a smooth wheel.
        grouser_height, grouser_thickness: Size of a grouser [m]; without meaning on a smooth wheel.
        mass_x, mass_z: Horizontal mass, and vertical mass of a run with the standard load [kg].
        is_driven: Whether the carriage is driven; free otherwise.
        stress_factors: Factor on each of the nine coefficients of the stress per depth, in the
            order of `drftjax.physics.stress.COEFFICIENT_NAMES` [-].
    """

    radius: float = 0.150
    width: float = 0.120
    grouser_count: int = 12
    grouser_height: float = 0.018
    grouser_thickness: float = 0.009
    mass_x: float = 13.902
    mass_z: float = 18.837
    is_driven: bool = False
    stress_factors: tuple[float, ...] = (1.0,) * 9

    @property
    def length_scale(self) -> float:
        """Radius over that of the default rig [-]."""
        return self.radius / PlantRig.radius

    @property
    def force_scale(self) -> float:
        """Vertical mass over that of the default rig [-]."""
        return self.mass_z / PlantRig.mass_z

    def wheel(self, plate_size: float) -> AbstractWheel:
        """Wheel of the rig.

        Wheels with as many grousers have as many plates, whatever their size, and share a program.

        Args:
            plate_size: Length of a plate on a wheel of the default size [m]; of a bare rim that
                part of it by which a fit's are shorter.
        """
        if self.grouser_count:
            wheel = GrouserWheel(grouser_count=self.grouser_count, plate_size=plate_size)
            sizes = self.radius, self.width, self.grouser_height, self.grouser_thickness
            return eqx.tree_at(
                lambda w: (w.radius, w.width, w.grouser_height, w.grouser_thickness),
                wheel,
                tuple(map(as_real, sizes)),
            )
        sizes = as_real(self.radius), as_real(self.width)
        bare = PlainWheel(plate_size=plate_size * PLAIN_PLATE_SIZE / DEFAULT_PLATE_SIZE)
        return eqx.tree_at(lambda w: (w.radius, w.width), bare, sizes)

    def frame(self, mass_z: float) -> Rig:
        """Masses and carriage of the rig with this vertical mass [kg]."""
        carriage = DrivenCarriage() if self.is_driven else FreeCarriage()
        return Rig(mass_x=self.mass_x, mass_z=mass_z, carriage=carriage)

    def coefficients(self, generic: jnp.ndarray) -> jnp.ndarray:
        """Coefficients of the stress per depth of its sand, from the generic ones [N/cm3]."""
        return generic * jnp.asarray(self.stress_factors, generic.dtype)


DEFAULT_RIG = PlantRig()
