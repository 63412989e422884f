"""Remedies: what an experimenter can do about an effect on the rig, in one clause each."""

from collections.abc import Mapping
from types import MappingProxyType

REMEDIES: Mapping[str, str] = MappingProxyType(
    {
        "loosening": "loosen and level the sand the same way before every run",
        "slip_softening": "keep it in the model; on a rover use zeta at the slip it drives at",
        "rate_hardening": "keep it in the model, or drive slower",
        "depth_hardening": "measure a pressure-sinkage curve of the sand",
        "terrain_variation": "stir and level the whole bed, then repeat a run from another place",
        "surface_profile": "level the surface with a blade and repeat a run",
        "surface_slope": "level the bed and the rail with a spirit level",
        "rigid_floor": "fill in more sand: the bed is shallow for this wheel",
        "cohesion": "dry the sand, or keep it in the model",
        "excavation": "keep it in the model; slip digs",
        "slip_sinkage": "keep it in the model; slip digs",
        "bulldozing": "keep it in the model, or rake the sand ahead of the wheel away",
        "heap": "keep it in the model, or rake the sand ahead of the wheel away",
        "momentum_flux": "fit lambda, with runs at several speeds",
        "height_decrease": "fit the height decrease behind the wheel, or keep it in the model",
        "sand": "measure zeta again with every new preparation",
        "wheel_radius": "measure the rim's diameter, grousers apart, and correct the set-up",
        "grouser_height": "measure the grousers and correct the set-up; look for wear",
        "grouser_shadowing": "keep it in the model; sand between grousers turns with the wheel",
        "eccentricity": "centre the wheel on its axle",
        "imbalance": "balance the wheel",
        "vertical_load": "weigh the wheel with its carriage, counterweight and cables",
        "vertical_coulomb": "clean and oil the vertical guide, or keep it in the model",
        "vertical_viscous": "look for thick grease or a damper at the vertical guide",
        "horizontal_coulomb": "oil the rail, or keep it in the model",
        "horizontal_viscous": "look for thick grease or a damper at the rail",
        "drawbar": "level the rail and free the cables, or keep it in the model",
        "cable_spring": "give the cables slack over the whole travel",
        "vertical_spring": "free the cables and hoses at the vertical guide",
        "vertical_compliance": "stiffen the frame, or measure height beside the wheel",
        "carriage_gain": "calibrate the carriage's speed with a stopwatch and a ruler",
        "speed_gain": "calibrate the wheel's speed: count turns over a minute",
        "speed_lag": "tighten the speed loop, or record the wheel's own encoder",
        "speed_ripple": "record the wheel's own encoder; look at gear and coupling",
        "backlash": "look for play in gear, coupling and keys",
        "force_offset": "zero the load cell with the wheel off the sand",
        "force_gain": "calibrate the load cell with a known weight",
        "force_crosstalk": "align the load cell, and calibrate both axes together",
        "torque_offset": "zero the torque sensor with the wheel in the air",
        "torque_friction": "turn the wheel in the air: what it reads is bearing friction",
        "torque_gain": "calibrate the torque sensor with a known weight on an arm",
        "channel_delay": "record all channels with one clock",
        "sinkage_gain": "calibrate the vertical scale with gauge blocks",
        "sinkage_drift": "let the vertical sensor warm up; read it again after the run",
        "sinkage_offset": "zero the vertical scale on the level surface",
        "travel_gain": "calibrate the horizontal scale with a ruler",
        "measurement_delay": "record command and readings with one clock",
        "measurement_filter": "turn the filter of the readings off",
    }
)

KEEP = "keep it in the model"


def remedy(name: str) -> str:
    """Remedy for an effect by its reported name; for one of the user's own, that it be kept."""
    return REMEDIES.get(name, KEEP)
