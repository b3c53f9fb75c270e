"""Pressure at a height, and density at a pressure and a temperature."""

GRAVITY_MPS2 = 9.80665  # ISO 80000-3 standard gravity
_STANDARD_PRESSURE_PA = 101_325.0  # ISO 2533 (ISA)
_STANDARD_TEMPERATURE_K = 288.15
_LAPSE_KPM = 0.0065
_GAS_CONSTANT_JPKGK = 287.05287


STANDARD_DENSITY_KGPM3 = 1.225


def air_pressure_pa(alt_amsl_m: float) -> float:
    """ISA pressure at a height in the troposphere."""
    exponent = GRAVITY_MPS2 / (_GAS_CONSTANT_JPKGK * _LAPSE_KPM)
    return (
        _STANDARD_PRESSURE_PA
        * (1.0 - _LAPSE_KPM * alt_amsl_m / _STANDARD_TEMPERATURE_K) ** exponent
    )


def air_density_kgpm3(alt_amsl_m: float, temperature_c: float) -> float:
    """Density of dry air: ISA pressure at the altitude, ideal gas at the given temperature."""
    return air_pressure_pa(alt_amsl_m) / (_GAS_CONSTANT_JPKGK * (temperature_c + 273.15))
