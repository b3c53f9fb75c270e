"""What the state of a drone in the air tells of the wind, in metres about the depot."""

from dataclasses import dataclass

from companion.core.base.geo import offset_m
from companion.core.wind_field.tellings import WindTelling
from companion.fleet.messages import State

UNTOLD_STD_MPS = 1.5
"""Error on each axis of a wind that comes without a covariance, from a companion of before: as much
as our estimator's in its first minute.
"""

AIR_HEIGHT_M = 10.0
"""Lower it is the wind between houses and over the pad."""


@dataclass(slots=True)
class StateTellings:
    """Tellings of states. `depot_deg`: latitude and longitude; None: about the first place asked
    for.
    """

    depot_deg: tuple[float, float] | None

    def place_ne_m(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        """A place in metres about the depot."""
        if self.depot_deg is None:
            self.depot_deg = lat_deg, lon_deg
        return offset_m(*self.depot_deg, lat_deg, lon_deg)

    def telling(self, state: State, t_s: float) -> WindTelling | None:
        """What a drone in the air tells of the wind; None: nothing."""
        lat_deg, lon_deg, height_m = state.lat_deg, state.lon_deg, state.height_rel_m
        north, east = state.wind_to_n_mps, state.wind_to_e_mps
        if not state.armed or lat_deg is None or lon_deg is None or height_m is None:
            return None
        if north is None or east is None or height_m < AIR_HEIGHT_M:
            return None
        cov = state.wind_cov_m2ps2 or (UNTOLD_STD_MPS**2, 0.0, UNTOLD_STD_MPS**2)
        place = self.place_ne_m(lat_deg, lon_deg)
        return WindTelling(state.vehicle, t_s, place, height_m, (north, east), cov)
