"""Force and torque sensors of the plant, and a frame that gives under the force."""

from dataclasses import dataclass, replace

import numpy as np

from diagnose.blind.plant.sensors import AbstractPlantSensor, PlantReading


@dataclass(frozen=True)
class PlantVerticalCompliance(AbstractPlantSensor):
    r"""Height read too deep by $c F_0 (F_z / F_0)^p$, as by a frame with play in its joints.

    Attributes:
        compliance: Compliance c at the force $F_0$ [m/N].
        force: Force $F_0$ [N].
        power: Exponent p [-].
    """

    compliance: float
    force: float = 185.0
    power: float = 0.8

    def read(self, true: PlantReading) -> PlantReading:
        share = np.maximum(true.fz / self.force, 0) ** self.power
        return replace(true, z=true.z - self.compliance * self.force * share)


@dataclass(frozen=True)
class PlantForceOffset(AbstractPlantSensor):
    """Constant in the readings of both forces, as of a sensor that was not set to zero.

    Attributes:
        offset: Length of the offset [N].
        direction: Its direction, from x upward [rad].
    """

    offset: float
    direction: float = 0.0

    def read(self, true: PlantReading) -> PlantReading:
        x, z = self.offset * np.cos(self.direction), self.offset * np.sin(self.direction)
        return replace(true, fx=true.fx + x, fz=true.fz + z)


@dataclass(frozen=True)
class PlantForceGain(AbstractPlantSensor):
    """Ratio error of both forces, not the same for both.

    Attributes:
        gain: Relative error of fz [-].
        fx_share: Relative error of fx over that of fz [-].
    """

    gain: float
    fx_share: float = 1.0

    def read(self, true: PlantReading) -> PlantReading:
        return replace(
            true, fx=true.fx * (1 + self.gain * self.fx_share), fz=true.fz * (1 + self.gain)
        )


@dataclass(frozen=True)
class PlantForceCrosstalk(AbstractPlantSensor):
    """Sensor that is mounted askew: both forces are turned by `angle` [rad]."""

    angle: float

    def read(self, true: PlantReading) -> PlantReading:
        sine, cosine = np.sin(self.angle), np.cos(self.angle)
        return replace(
            true,
            fx=cosine * true.fx + sine * true.fz,
            fz=cosine * true.fz - sine * true.fx,
        )


@dataclass(frozen=True)
class PlantTorqueOffset(AbstractPlantSensor):
    """Constant `offset` [N m] in the reading of the torque."""

    offset: float

    def read(self, true: PlantReading) -> PlantReading:
        return replace(true, torque=true.torque + self.offset)


@dataclass(frozen=True)
class PlantTorqueFriction(AbstractPlantSensor):
    """Bearing friction in the reading of the torque, in part by the force that the bearing bears.

    Attributes:
        friction: Friction under the force `force` [N m].
        share: Share of it that is in proportion to the force [-].
        force: Force on the bearing [N].
    """

    friction: float
    share: float = 0.3
    force: float = 185.0

    def read(self, true: PlantReading) -> PlantReading:
        borne = np.hypot(true.fx, true.fz) / self.force
        friction = self.friction * (1 - self.share + self.share * borne)
        return replace(true, torque=true.torque + friction * np.sign(true.omega))


@dataclass(frozen=True)
class PlantTorqueGain(AbstractPlantSensor):
    """Ratio error of the torque that shrinks with the torque.

    Attributes:
        gain: Relative error of a small torque [-].
        bend: Share of the error that is gone at the torque `torque` [-].
        torque: A large torque [N m].
    """

    gain: float
    bend: float = 0.0
    torque: float = 20.0

    def read(self, true: PlantReading) -> PlantReading:
        gone = self.bend * np.minimum(np.abs(true.torque) / self.torque, 1)
        return replace(true, torque=true.torque * (1 + self.gain * (1 - gone)))
