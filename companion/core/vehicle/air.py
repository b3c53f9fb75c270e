"""The air that a flight is flown in: its density, from what is stated, measured, or standard.

Density is pressure over temperature. An autopilot's barometer tells pressure to a thousandth. Its
thermometer sits on a powered board and is warmer than the air: PX4 takes 15 degrees C in its place
(VehicleAirData, without an outside sensor), ArduPilot believes no more than 35 (AP_Baro). 15
degrees are 5 % of density.
"""

import math
from dataclasses import dataclass

from companion.core.base.errors import check_range

REFERENCE_DENSITY_KGPM3 = 1.225
"""At which an airframe file states drag: the standard atmosphere at sea level (ISO 2533)."""

_GAS_CONSTANT_AIR = 287.05287  # J/(kg K), ISO 2533
_ZERO_C_K = 273.15
_SEA_LEVEL_PA = 101_325.0
_SEA_LEVEL_C = 15.0
_LAPSE_CPM = 0.0065

BOARD_WARMTH_C = 15.0
"""[est] A flight controller's barometer over the air about it: 10 to 20 degrees, in the middle."""

PRESSURE_FRAC = 0.1
"""A barometer may be so far from the standard pressure at its height: 870 to 1,085 hPa are the
records at sea level, and a column of warm or cold air adds 3 % at 3,000 m. More is another unit, a
broken sensor, or another height."""

LOWEST_AMSL_M, HIGHEST_AMSL_M = -1_000.0, 11_000.0
"""Between the lowest ground there is and the top of the standard troposphere."""

COLDEST_C, WARMEST_C = -60.0, 55.0
"""Air in which anything flies; the records are -68 and 57 where people live."""


_BY_STANDARD = "standard temperature"


@dataclass(frozen=True, slots=True)
class Air:
    """Pressure and temperature at the depot; `source` says in words where they are from."""

    pressure_pa: float
    temperature_c: float
    source: str

    @property
    def density_kgpm3(self) -> float:
        """Density of dry air: damp air is 1 % lighter at 30 degrees C, which is left out."""
        return self.pressure_pa / (_GAS_CONSTANT_AIR * (self.temperature_c + _ZERO_C_K))

    @property
    def known_temperature_c(self) -> float | None:
        """The temperature where somebody stated or measured it."""
        return None if self.source.endswith(_BY_STANDARD) else self.temperature_c

    def __str__(self) -> str:
        pressure_hpa = self.pressure_pa / 100.0
        words = f"{pressure_hpa:.0f} hPa, {self.temperature_c:.0f} C ({self.source})"
        return f"air {self.density_kgpm3:.3f} kg/m3: {words}"


def standard_pressure_pa(alt_amsl_m: float) -> float:
    """The standard atmosphere's pressure at a height (ISO 2533, troposphere). LeewayError for a
    height at which nothing flies.
    """
    check_range("height above sea, m", alt_amsl_m, LOWEST_AMSL_M, HIGHEST_AMSL_M)
    return _SEA_LEVEL_PA * (1.0 - 2.25577e-5 * alt_amsl_m) ** 5.25588


def standard_temperature_c(alt_amsl_m: float) -> float:
    """The standard atmosphere's temperature at a height."""
    return _SEA_LEVEL_C - _LAPSE_CPM * alt_amsl_m


def standard_air(alt_amsl_m: float, stated_temperature_c: float | None = None) -> Air:
    """The air at a height with nothing measured; its temperature as stated, if it is."""
    return air_at(alt_amsl_m, None, None, stated_temperature_c)


def air_at(
    alt_amsl_m: float,
    measured_pa: float | None,
    board_temperature_c: float | None,
    stated_temperature_c: float | None,
) -> Air:
    """The air about a vehicle that stands at a height, by the best that is known of it.

    `board_temperature_c` is what the barometer's own thermometer reads. A statement goes before it.
    """
    pressure_pa, by = standard_pressure_pa(alt_amsl_m), f"standard at {alt_amsl_m:.0f} m"
    if measured_pa is not None and abs(measured_pa / pressure_pa - 1.0) <= PRESSURE_FRAC:
        pressure_pa, by = measured_pa, "barometer"
    if stated_temperature_c is not None:
        return Air(pressure_pa, stated_temperature_c, f"{by}, temperature stated")
    if (by_board_c := _by_board_c(board_temperature_c)) is not None:
        words = f"{by}, its board {BOARD_WARMTH_C:.0f} C warmer"
        return Air(pressure_pa, by_board_c, words)
    return Air(pressure_pa, standard_temperature_c(alt_amsl_m), f"{by}, {_BY_STANDARD}")


def _by_board_c(board_temperature_c: float | None) -> float | None:
    """The air's temperature by the board's; `None` where that reading cannot be one."""
    if board_temperature_c is None or not math.isfinite(board_temperature_c):
        return None
    air_c = board_temperature_c - BOARD_WARMTH_C
    return air_c if COLDEST_C <= air_c <= WARMEST_C else None
