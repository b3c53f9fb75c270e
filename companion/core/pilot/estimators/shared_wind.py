"""Wind reports of the fleet: use in the gate's outlook, and reports to operators.

None of it survives a restart: a restarted vehicle uses its own wind estimate until it receives new
reports.
"""

import numpy as np

from companion.core.base.geo import Ned, ne_offset_m
from companion.core.pilot.telemetry_state import POSITION_MAX_AGE_S, TelemetryState
from companion.core.return_budget.remaining_mission import RemainingMission
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import WindForecaster, WindOutlook
from companion.core.wind.process import WindProcessParams
from companion.core.wind_field.field_process import FieldPoints, FieldProcess
from companion.core.wind_field.fleet_wind import (
    OWN,
    FleetWind,
    other_member_count_text,
    wind_speed_and_origin_text,
)
from companion.core.wind_field.fronts import WindFront
from companion.core.wind_field.shared_outlook import FrontOutlook, SharedOutlook
from companion.core.wind_field.shared_winds import SharedWinds
from companion.core.wind_field.wind_reports import MemberWindReport

SOURCE_TEXT = "wind of the fleet"
REPORT_HORIZON_S = 300.0
"""Operators see the mean of the next five minutes."""

MIN_MEASUREMENT_HEIGHT_M = 10.0
"""Lower it is the wind between houses and over the pad; the desk's limit is the same."""


class FleetWindOutlook:
    """Shared wind of one vehicle. `process` is the process of its own outlook."""

    def __init__(self, process: WindProcessParams) -> None:
        self._tail_dof = process.tail_dof
        self._fleet = FleetWind(FieldProcess(process))
        self._origin_deg: tuple[float, float] | None = None
        self._here: tuple[float, float, float] | None = None
        self._reported_state = ""
        self._reported_front: WindFront | None = None
        self._is_withdrawal_pending = False
        """The front is withdrawn and operators are not informed yet."""

    def add_own_wind_estimate(self, telemetry: TelemetryState, wind_estimate: WindBelief) -> None:
        """Add the vehicle's own wind estimate at a tick in the air."""
        position = telemetry.recent_or_none(telemetry.position, POSITION_MAX_AGE_S)
        if position is None or not wind_estimate.valid:
            return
        north, east = self._to_local_ne_m(position.lat_deg, position.lon_deg)
        self._here = north, east, position.height_rel_m
        if position.height_rel_m < MIN_MEASUREMENT_HEIGHT_M:
            return
        mean = wind_estimate.mean_to_ne_mps
        nn, ne, ee = (float(wind_estimate.cov_ne_m2ps2[at]) for at in ((0, 0), (0, 1), (1, 1)))
        to_ne = float(mean[0]), float(mean[1])
        self._fleet.add_own_estimate(
            MemberWindReport(
                OWN, telemetry.t_s, (north, east), position.height_rel_m, to_ne, (nn, ne, ee)
            )
        )

    def add_fleet_wind_reports(self, fleet_reports: SharedWinds, t_s: float, age_s: float) -> None:
        """Process a message of the desk that was valid from `age_s` before `t_s` on."""
        self._to_local_ne_m(fleet_reports.lat_deg, fleet_reports.lon_deg)
        assert self._origin_deg is not None
        as_of_s = t_s - age_s
        wind_reports = fleet_reports.decode_reports(self._origin_deg, as_of_s)
        self._fleet.add_reports_and_front_of_desk(
            wind_reports, fleet_reports.decode_front_or_none(self._origin_deg, as_of_s), t_s
        )
        if fleet_reports.front is None and self._fleet.discard_front_and_return_if_expected():
            self._is_withdrawal_pending = True

    def fleet_or_own_outlook(
        self, remaining: RemainingMission, own_outlook: WindOutlook, t_s: float
    ) -> WindForecaster:
        """Return the outlook for the gate: from the field, or the vehicle's own."""
        field = self._fleet.joint_field_or_none(t_s)
        offset = self._offset_to_field_ne_m(remaining)
        if field is None or offset is None or self._here is None:
            return own_outlook
        height_m = max(self._here[2], MIN_MEASUREMENT_HEIGHT_M)
        return SharedOutlook(field, height_m, offset, self._tail_dof)

    def outlook_with_front(
        self, remaining: RemainingMission, outlook: WindForecaster, t_s: float
    ) -> WindForecaster | None:
        """Return the outlook with the reported front; None if none approaches."""
        offset, here = self._offset_to_field_ne_m(remaining), self._here
        if offset is None or here is None:
            return None
        front = self._fleet.expected_front_after_dropping_expired(t_s, here[:2])
        return None if front is None else FrontOutlook(outlook, front, offset)

    def fleet_source_text(self, t_s: float) -> str:
        """Return the other sources of a decision's wind; empty without any."""
        field = self._fleet.joint_field_or_none(t_s)
        return "" if field is None else f"{SOURCE_TEXT}: {other_member_count_text(field)}"

    def new_change_texts(
        self, t_s: float, own_outlook: WindOutlook, own_wind_estimate: WindBelief
    ) -> tuple[str, ...]:
        """Return changes as text: use of the field, and an approaching front."""
        texts: list[str] = []
        field = self._fleet.joint_field_or_none(t_s)
        state = "" if field is None else other_member_count_text(field)
        now = state or self._fleet.unused_reason
        if now != self._reported_state:
            before, self._reported_state = self._reported_state, now
            if field is not None and own_wind_estimate.valid:
                texts.append(
                    f"{state}: {self._fleet_and_own_wind_text(t_s, own_outlook, own_wind_estimate)}"
                )
            elif field is None and (now or before):
                texts.append(f"not used, {now or 'no reports'}: own wind only")
        return (*texts, *self._new_front_change_texts(t_s))

    def _new_front_change_texts(self, t_s: float) -> tuple[str, ...]:
        if self._is_withdrawal_pending:
            self._is_withdrawal_pending, self._reported_front = False, None
            return ("the front is withdrawn",)
        here = self._here
        front = (
            None
            if here is None
            else self._fleet.expected_front_after_dropping_expired(t_s, here[:2])
        )
        if here is None or front is None or front is self._reported_front:
            return ()
        self._reported_front = front
        due_s, std_s = front.arrival_time_and_std_s(here[:2])
        front_wind = front.detections[0]
        return (
            f"a front of {front_wind.magnitude_mps:.0f} m/s, here in {due_s - t_s:.0f} +-"
            f" {std_s:.0f} s, behind it {wind_speed_and_origin_text(front_wind.wind_ne_mps)}",
        )

    def _fleet_and_own_wind_text(
        self, t_s: float, own_outlook: WindOutlook, own_wind_estimate: WindBelief
    ) -> str:
        """Return the mean wind of the next minutes from field and own estimate, as text."""
        field = self._fleet.joint_field_or_none(t_s)
        assert field is not None
        assert self._here is not None
        north, east, height_m = self._here
        middle = np.array([0.5 * REPORT_HORIZON_S])
        points = FieldPoints(np.array([[north, east]]), np.array([height_m]), t_s + middle)
        found = field.forecast_at_points(points, REPORT_HORIZON_S)
        own_forecast = own_outlook.forecast(own_wind_estimate, middle, REPORT_HORIZON_S)
        fleet, own_text = (
            wind_speed_and_origin_text(
                (float(each.mean_to_ne_mps[0, 0]), float(each.mean_to_ne_mps[0, 1]))
            )
            for each in (found, own_forecast)
        )
        var = max(float(found.north_cov_m2ps2[0, 0]), float(found.east_cov_m2ps2[0, 0]))
        return (
            f"next {REPORT_HORIZON_S / 60.0:.0f} min {fleet} +- {var**0.5:.1f}, own estimate"
            f" {own_text}"
        )

    def _to_local_ne_m(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        if self._origin_deg is None:
            self._origin_deg = lat_deg, lon_deg
        return ne_offset_m(*self._origin_deg, lat_deg, lon_deg)

    def _offset_to_field_ne_m(self, remaining: RemainingMission) -> tuple[float, float] | None:
        """Return the offset from the remaining flight's positions to the field's."""
        start = _start_position_ned_m(remaining)
        if self._here is None or start is None:
            return None
        return self._here[0] - start[0], self._here[1] - start[1]


def _start_position_ned_m(remaining: RemainingMission) -> Ned | None:
    """Return the vehicle's position: each return route from here begins there."""
    leg_list = remaining.current_return_routes[0].leg_sequence
    return leg_list[0].from_ned_m if leg_list else None
