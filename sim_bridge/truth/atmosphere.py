"""Air density at a height and a temperature."""

GRAVITY_MPS2 = 9.80665  # ISO 80000-3 standard gravity
_SEA_LEVEL_PA = 101_325.0  # ISO 2533 (ISA)
_SEA_LEVEL_K = 288.15
_LAPSE_KPM = 0.0065
_GAS_CONSTANT_JPKGK = 287.05287


def air_density_kgpm3(alt_amsl_m: float, temperature_c: float) -> float:
    """Density of dry air: ISA pressure at the altitude, ideal gas at the given temperature."""
    exponent = GRAVITY_MPS2 / (_GAS_CONSTANT_JPKGK * _LAPSE_KPM)
    pressure_pa = _SEA_LEVEL_PA * (1.0 - _LAPSE_KPM * alt_amsl_m / _SEA_LEVEL_K) ** exponent
    return pressure_pa / (_GAS_CONSTANT_JPKGK * (temperature_c + 273.15))
