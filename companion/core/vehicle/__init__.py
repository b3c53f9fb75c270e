"""Airframe: file, power, remaining energy, speed to fly, wind triangle. Imports base."""

from typing import TYPE_CHECKING

from companion.core.base.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from companion.core.vehicle.airframe import Airframe, BatteryPack, airframe_from_dict
    from companion.core.vehicle.energy_ledger import EnergyBelief, EnergyLedger
    from companion.core.vehicle.power import multirotor_power_w, paper_power_w
    from companion.core.vehicle.power_bias import ModelError
    from companion.core.vehicle.wind_triangle import ground_speeds_mps

__all__ = [
    "Airframe",
    "BatteryPack",
    "EnergyBelief",
    "EnergyLedger",
    "ModelError",
    "airframe_from_dict",
    "ground_speeds_mps",
    "multirotor_power_w",
    "paper_power_w",
]

__getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "Airframe": ".airframe",
        "BatteryPack": ".airframe",
        "EnergyBelief": ".energy_ledger",
        "EnergyLedger": ".energy_ledger",
        "ModelError": ".power_bias",
        "airframe_from_dict": ".airframe",
        "ground_speeds_mps": ".wind_triangle",
        "multirotor_power_w": ".power",
        "paper_power_w": ".power",
    },
)
