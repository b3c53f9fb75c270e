"""Wind reports from the states of airborne drones, in metres about the depot."""

from dataclasses import dataclass

from companion.core.base.geo import ne_offset_m
from companion.core.wind_field.wind_reports import MemberWindReport
from companion.fleet.messages import State

DEFAULT_STD_MPS = 1.5
"""Error on each axis of a wind without covariance, from an older companion: as large as this
project's estimator in its first minute.
"""

MIN_HEIGHT_M = 10.0
"""Minimum height of a report: lower winds are those between buildings and over the pad."""


@dataclass(slots=True)
class StateWindReports:
    """Converts states to wind reports. `depot_deg`: latitude and longitude; None: the first
    requested position becomes the origin.
    """

    depot_deg: tuple[float, float] | None

    def position_ne_m_setting_first_origin(
        self, lat_deg: float, lon_deg: float
    ) -> tuple[float, float]:
        """Return a position in metres about the depot."""
        if self.depot_deg is None:
            self.depot_deg = lat_deg, lon_deg
        return ne_offset_m(*self.depot_deg, lat_deg, lon_deg)

    def wind_report_from_state(self, state: State, t_s: float) -> MemberWindReport | None:
        """Return the wind report of an airborne drone; None: the state has none."""
        lat_deg, lon_deg, height_m = state.lat_deg, state.lon_deg, state.height_rel_m
        north, east = state.wind_to_n_mps, state.wind_to_e_mps
        if not state.armed or lat_deg is None or lon_deg is None or height_m is None:
            return None
        if north is None or east is None or height_m < MIN_HEIGHT_M:
            return None
        cov = state.wind_cov_m2ps2 or (DEFAULT_STD_MPS**2, 0.0, DEFAULT_STD_MPS**2)
        position_ne_m = self.position_ne_m_setting_first_origin(lat_deg, lon_deg)
        return MemberWindReport(state.vehicle, t_s, position_ne_m, height_m, (north, east), cov)
