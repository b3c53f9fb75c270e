"""True winds of other packages, checked."""

import math
from typing import Any

from companion.core.base.plugin import WINDS, PluginGuard, load_plugin
from sim_bridge.truth.wind_field import MeanWind

MAX_WIND_MPS = 60.0


class CheckedMeanWind:
    """A mean wind whose exceptions and invalid values become a LeewayError."""

    def __init__(self, label: str, wind: Any) -> None:
        """`wind`: a `MeanWind`, or a class or function without arguments that returns one."""
        self._guard = PluginGuard(f"wind {label}")
        is_built = hasattr(wind, "to_ne_mps") and not isinstance(wind, type)
        self._wind: Any = wind if is_built else self._guard.call("constructor", wind)

    def to_ne_mps(self, t_s: float) -> tuple[float, float]:
        """Return the direction and speed of air motion, north and east; below 60 m/s."""
        found = self._guard.call("to_ne_mps", lambda: tuple(map(float, self._wind.to_ne_mps(t_s))))
        if len(found) != 2 or not math.hypot(*found) < MAX_WIND_MPS:
            expected = f"2 numbers, below {MAX_WIND_MPS:.0f} m/s"
            raise self._guard.error(f"to_ne_mps({t_s:.2f}) = {found}: expected {expected}")
        return found


def checked_wind(wind: str | MeanWind) -> CheckedMeanWind:
    """Return a checked wind: a plug-in by name, or an object of the caller."""
    if isinstance(wind, str):
        plugin = load_plugin(WINDS, wind)
        return CheckedMeanWind(plugin.label, plugin.target)
    return CheckedMeanWind(type(wind).__name__, wind)
