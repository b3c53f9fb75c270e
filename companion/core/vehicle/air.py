"""Air density of a flight, from configured, measured or standard pressure and temperature.

An autopilot's barometer measures pressure to 0.1 %. Its thermometer is on a powered board and
warmer than the air: PX4 uses 15 degrees C instead (VehicleAirData, without an external sensor),
ArduPilot limits it to 35 (AP_Baro). 15 degrees are 5 % of density.
"""

import math
from dataclasses import dataclass

from companion.core.base.errors import check_range

REFERENCE_DENSITY_KGPM3 = 1.225
"""Density at which an airframe file gives drag: standard atmosphere at sea level (ISO 2533)."""

_GAS_CONSTANT_AIR = 287.05287  # J/(kg K), ISO 2533
_ZERO_C_K = 273.15
_STANDARD_PRESSURE_PA = 101_325.0
_STANDARD_TEMPERATURE_C = 15.0
_LAPSE_RATE_C_PER_M = 0.0065

BOARD_HEATING_C = 15.0
"""[est] Temperature of a flight controller's barometer minus ambient: middle of 10 to 20."""

MAX_PRESSURE_ERROR_FRAC = 0.1
"""Maximum deviation of a barometer from the standard pressure at its height. Records at sea level
are 870 to 1,085 hPa, and a column of warm or cold air adds 3 % at 3,000 m. A larger deviation means
another unit, a faulty sensor or another height."""

LOWEST_AMSL_M, HIGHEST_AMSL_M = -1_000.0, 11_000.0
"""Accepted heights: below the lowest ground on Earth to the top of the standard troposphere."""

COLDEST_C, WARMEST_C = -60.0, 55.0
"""Accepted air temperatures; the records of inhabited places are -68 and 57."""


_STANDARD_SOURCE = "standard temperature"


@dataclass(frozen=True, slots=True)
class Air:
    """Pressure and temperature at the depot; `source` describes their origin."""

    pressure_pa: float
    temperature_c: float
    source: str

    @property
    def density_kgpm3(self) -> float:
        """Density of dry air. Neglects humidity, which is 1 % at 30 degrees C."""
        return self.pressure_pa / (_GAS_CONSTANT_AIR * (self.temperature_c + _ZERO_C_K))

    @property
    def configured_or_measured_temperature_c(self) -> float | None:
        """Temperature if configured or measured, else None."""
        return None if self.source.endswith(_STANDARD_SOURCE) else self.temperature_c

    def __str__(self) -> str:
        pressure_hpa = self.pressure_pa / 100.0
        text = f"{pressure_hpa:.0f} hPa, {self.temperature_c:.0f} C ({self.source})"
        return f"air {self.density_kgpm3:.3f} kg/m3: {text}"


def standard_pressure_pa(alt_amsl_m: float) -> float:
    """Return the standard atmosphere's pressure at a height (ISO 2533, troposphere). Raises
    LeewayError for a height outside `LOWEST_AMSL_M` to `HIGHEST_AMSL_M`.
    """
    check_range("height above sea, m", alt_amsl_m, LOWEST_AMSL_M, HIGHEST_AMSL_M)
    return _STANDARD_PRESSURE_PA * (1.0 - 2.25577e-5 * alt_amsl_m) ** 5.25588


def standard_temperature_c(alt_amsl_m: float) -> float:
    """Return the standard atmosphere's temperature at a height."""
    return _STANDARD_TEMPERATURE_C - _LAPSE_RATE_C_PER_M * alt_amsl_m


def standard_air(alt_amsl_m: float, configured_temperature_c: float | None = None) -> Air:
    """Return the air at a height without measurements, at the configured temperature if any."""
    return air_from_best_available_source(alt_amsl_m, None, None, configured_temperature_c)


def air_from_best_available_source(
    alt_amsl_m: float,
    barometer_pressure_pa: float | None,
    board_temperature_c: float | None,
    configured_temperature_c: float | None,
) -> Air:
    """Return the air around a vehicle on the ground at a height, from the best source available.

    A configured temperature takes precedence over `board_temperature_c`, the barometer's reading.
    """
    pressure_pa, pressure_source = (
        standard_pressure_pa(alt_amsl_m),
        f"standard at {alt_amsl_m:.0f} m",
    )
    if (
        barometer_pressure_pa is not None
        and abs(barometer_pressure_pa / pressure_pa - 1.0) <= MAX_PRESSURE_ERROR_FRAC
    ):
        pressure_pa, pressure_source = barometer_pressure_pa, "barometer"
    if configured_temperature_c is not None:
        return Air(pressure_pa, configured_temperature_c, f"{pressure_source}, temperature stated")
    if (board_based_c := _air_temperature_from_board_c(board_temperature_c)) is not None:
        text = f"{pressure_source}, its board {BOARD_HEATING_C:.0f} C warmer"
        return Air(pressure_pa, board_based_c, text)
    return Air(
        pressure_pa, standard_temperature_c(alt_amsl_m), f"{pressure_source}, {_STANDARD_SOURCE}"
    )


def _air_temperature_from_board_c(board_temperature_c: float | None) -> float | None:
    """Return the air temperature from the board's; None if the reading is implausible."""
    if board_temperature_c is None or not math.isfinite(board_temperature_c):
        return None
    air_c = board_temperature_c - BOARD_HEATING_C
    return air_c if COLDEST_C <= air_c <= WARMEST_C else None
