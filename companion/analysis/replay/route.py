"""Remaining mission at a time of a recorded flight, with or without its flight file."""

import math
from dataclasses import replace

from companion.core.base.geo import LocalFrame, Ned, horizontal_distance_m
from companion.core.mission.flight_file import Flight
from companion.core.mission.flight_plan import DROP_TOTAL_S, FlightPlan, position_to_ned_m
from companion.core.mission.mission_items import Part
from companion.core.pilot.diversion import has_clear_line_to_rally
from companion.core.pilot.estimators.release_watch import (
    add_hover_samples_from_telemetry,
    build_release_monitor,
)
from companion.core.pilot.telemetry_state import TelemetryState
from companion.core.pilot.transitions import Phase
from companion.core.return_budget.remaining_from_plan import (
    remaining_delivery,
    remaining_outbound,
    remaining_return,
    remaining_to_other_home,
)
from companion.core.return_budget.remaining_mission import RemainingMission, ReturnRoute, Stage
from companion.core.routing.leg_energy import Leg, LegKind, RouteEnergy

EXTRAPOLATION_S = 30.0
"""Time of continued straight flight that the gate assesses without a plan."""

MAX_HOVER_MPS = 1.0
ARRIVAL_RADIUS_M = 20.0
DEPARTURE_RADIUS_M = 30.0
ABORT_DISTANCE_M = 100.0
MIN_SINK_M = 5.0
TAKE_OFF = "take-off"


class UnplannedRoute:
    """Route without a plan: straight home to the take-off point at the present height."""

    def __init__(self, frame: LocalFrame) -> None:
        self._frame = frame
        self._velocity_ne_mps = (0.0, 0.0)

    def update_and_get_position_ned(self, telemetry: TelemetryState) -> Ned | None:
        """Update with the telemetry state; return the vehicle position."""
        if telemetry.position is None:
            return None
        self._velocity_ne_mps = (telemetry.position.vel_n_mps, telemetry.position.vel_e_mps)
        return position_to_ned_m(self._frame, telemetry.position)

    def remaining_mission(self, position_ned: Ned, payload_kg: float) -> RemainingMission:
        """Return the route home from here, and from the position after continued flight."""
        north, east = self._velocity_ne_mps
        speed = math.hypot(north, east)
        if speed > MAX_HOVER_MPS:
            extrapolated_position = (
                position_ned[0] + EXTRAPOLATION_S * north,
                position_ned[1] + EXTRAPOLATION_S * east,
                position_ned[2],
            )
            on = Leg(
                LegKind.CRUISE,
                position_ned,
                extrapolated_position,
                payload_kg,
                ground_speed_mps=speed,
            )
        else:
            extrapolated_position = position_ned
            on = Leg(LegKind.HOVER, position_ned, position_ned, payload_kg, EXTRAPOLATION_S)
        stage = Stage(
            (on,), (_direct_return_route(extrapolated_position, payload_kg),), delivers=True
        )
        return RemainingMission((_direct_return_route(position_ned, payload_kg),), (stage,))


def _direct_return_route(position_ned: Ned, payload_kg: float) -> ReturnRoute:
    over = (0.0, 0.0, position_ned[2])
    land = Leg(LegKind.LAND, over, (0.0, 0.0, 0.0), payload_kg)
    if horizontal_distance_m(position_ned, over) <= MAX_HOVER_MPS:
        return ReturnRoute(TAKE_OFF, (land,))
    return ReturnRoute(TAKE_OFF, (Leg(LegKind.CRUISE, position_ned, over, payload_kg), land))


class PlannedRoute:
    """Route of the flight file's plan. The position on it follows from the mission progress, if the
    log has it for this mission, else from the flown track.
    """

    def __init__(self, flown: FlightPlan, flight: Flight, route_energy: RouteEnergy) -> None:
        self._flown = flown
        self._drop_height_m = flight.mission.drop_height_m
        self._settle_s = flight.mission.wind_settle_s
        self._settled_s: float | None = None
        self._now_s = 0.0
        self._release_detector = _ReleaseDetector(route_energy, flight.vehicle.payload_kg)
        self._leg = 0
        self._return_index: int | None = None
        self._away_index: int | None = None
        self._min_distance_m = math.inf
        self._landing = False
        self._rally: str | None = None
        self.delivery_evidence = ""
        self.mismatched_item_count: int | None = None
        self.phase = Phase.MEASURE

    @property
    def phase_and_leg(self) -> tuple[Phase, int | None]:
        """Phase and outbound leg; each change is a decision."""
        return self.phase, self._leg if self.phase is Phase.OUTBOUND else None

    @property
    def is_before_delivery(self) -> bool:
        """Whether the flight is outbound or not started, so that a closed gate matters."""
        return (
            self.phase in (Phase.MEASURE, Phase.OUTBOUND, Phase.DELIVER)
            and not self.delivery_evidence
        )

    def update_and_get_position_ned(self, telemetry: TelemetryState) -> Ned | None:
        """Update with the telemetry state; return the vehicle position."""
        if telemetry.position is None:
            return None
        self._now_s = telemetry.t_s
        here = self._flown.position_to_ned_m(telemetry.position)
        before = self.phase
        if not self._update_phase_from_mission_progress(telemetry):
            self._update_phase_from_position(here)
        if self.phase in (Phase.DELIVER, Phase.RELEASE) and not self.delivery_evidence:
            self.delivery_evidence = self._release_detector.update_and_get_release_evidence(
                telemetry, is_release_commanded=self.phase is Phase.RELEASE
            )
        elif before is Phase.RELEASE:
            self.delivery_evidence = (
                self.delivery_evidence
                or self._release_detector.update_and_get_release_evidence(
                    telemetry, is_release_commanded=True
                )
            )
        return here

    def remaining_mission(self, position_ned: Ned, payload_kg: float) -> RemainingMission:
        """Return the remaining mission of the plan."""
        plan, drop_m = self._flown.plan, self._drop_height_m
        if self.phase is Phase.MEASURE:
            settled_s = 0.0 if self._settled_s is None else self._now_s - self._settled_s
            left_s = max(0.0, self._settle_s - settled_s)
            return remaining_outbound(
                plan, position_ned, 0, payload_kg, drop_m, DROP_TOTAL_S, left_s
            )
        if self.phase is Phase.OUTBOUND:
            return remaining_outbound(
                plan, position_ned, self._leg, payload_kg, drop_m, DROP_TOTAL_S
            )
        if self.phase in (Phase.DELIVER, Phase.RELEASE) and not self.delivery_evidence:
            return remaining_delivery(plan, position_ned, payload_kg, drop_m, DROP_TOTAL_S)
        delivered = bool(self.delivery_evidence)
        if self._away_index is not None:
            return remaining_to_other_home(
                plan, position_ned, self._away_index, payload_kg, delivered
            )
        index = None if self._landing else self._nearest_return_waypoint_index(position_ned)
        return remaining_return(plan, position_ned, index, payload_kg, delivered, self._rally)

    @property
    def landing_site_name(self) -> str:
        """Name of the landing site of the plan's return route."""
        return self._flown.plan.return_route_end_name

    @property
    def planned_mission_item_count(self) -> int:
        """Number of items in the plan's mission."""
        return len(self._flown.mission.items)

    def has_clear_line_to_rally_point(self, rally_point_name: str, position_ned: Ned) -> bool:
        """Return whether the straight line to a rally point is clear."""
        return has_clear_line_to_rally(self._flown, rally_point_name, position_ned)

    def _nearest_return_waypoint_index(self, position_ned: Ned) -> int:
        if self._return_index is not None:
            return self._return_index
        points = self._flown.plan.return_ned_m
        return min(range(len(points)), key=lambda i: horizontal_distance_m(position_ned, points[i]))

    def _update_phase_from_mission_progress(self, telemetry: TelemetryState) -> bool:
        """Follow MISSION_CURRENT; return False if the log has none for this mission."""
        mission, progress = self._flown.mission, telemetry.progress
        if progress is None or progress.index is None:
            return False
        if progress.total is not None and progress.total != len(mission.items):
            self.mismatched_item_count = progress.total
            return False
        index = progress.index
        self._away_index = mission.pad_return.index(index) if index in mission.pad_return else None
        match mission.part_of_item(index):
            case Part.RETURN if index not in mission.returning:
                self.phase = Phase.RETURN
            case Part.TAKEOFF | Part.SETTLE:
                self.phase = Phase.MEASURE
                if index >= mission.settle and self._settled_s is None:
                    self._settled_s = telemetry.t_s
            case Part.OUTBOUND:
                self.phase = Phase.OUTBOUND
                if index in mission.outbound:
                    self._leg = mission.outbound.index(index)
            case Part.DELIVER:
                self.phase = Phase.DELIVER
            case Part.RELEASE:
                self.phase = Phase.RELEASE
            case Part.RETURN:
                self.phase = Phase.RETURN
                self._return_index = max(0, mission.returning.index(index) - 1)
            case Part.RALLY:
                self.phase = Phase.DIVERT
                self._rally = self._flown.other_landing_site_name_of_item(index)
                self._mark_stop_as_promised(self._rally)
                self._return_index = None
            case Part.RALLY_LAND:
                self.phase, self._landing = Phase.LAND, True
                self._rally = self._flown.other_landing_site_name_of_item(index) or self._rally
            case Part.LAND | Part.END:
                self.phase, self._landing = Phase.LAND, True
            case None:
                return False
        return True

    def _mark_stop_as_promised(self, stop_name: str | None) -> None:
        """Mark a stop that was flown to as promised."""
        if stop_name is not None:
            plan = self._flown.plan.copy_with_selectable_stops(stop_name)
            self._flown = replace(self._flown, plan=plan)

    def _update_phase_from_position(self, position_ned: Ned) -> None:
        """Follow the flown track along the plan's points."""
        points = self._flown.plan.outbound_ned_m
        last = len(points) - 1
        if (
            self.phase is Phase.MEASURE
            and horizontal_distance_m(position_ned, (0.0, 0.0, 0.0)) > ARRIVAL_RADIUS_M
        ):
            self.phase = Phase.OUTBOUND
        if self.phase is Phase.OUTBOUND:
            customer_distance_m = horizontal_distance_m(position_ned, points[last])
            self._min_distance_m = min(self._min_distance_m, customer_distance_m)
            while self._leg < last and (
                customer_distance_m < horizontal_distance_m(points[self._leg], points[last])
                or horizontal_distance_m(position_ned, points[self._leg]) < ARRIVAL_RADIUS_M
            ):
                self._leg += 1
            if (
                customer_distance_m < ARRIVAL_RADIUS_M
                and position_ned[2] > points[last][2] + MIN_SINK_M
            ):
                self.phase = Phase.DELIVER
            elif customer_distance_m > self._min_distance_m + ABORT_DISTANCE_M:
                self.phase = Phase.RETURN
        elif self.phase is Phase.DELIVER:
            drop_down_m = self._flown.plan.customer_ned_m[2] - self._drop_height_m
            if position_ned[2] > drop_down_m - MIN_SINK_M:
                self.phase = Phase.RELEASE
        elif (
            self.phase is Phase.RELEASE
            and horizontal_distance_m(position_ned, points[last]) > DEPARTURE_RADIUS_M
        ):
            self.phase = Phase.RETURN


class _ReleaseDetector:
    """Detects the parcel release, with the companion's own detector."""

    def __init__(self, route_energy: RouteEnergy, payload_kg: float) -> None:
        self._watch = (  # the drop expected in calm air: the log has no wind at its start
            build_release_monitor(route_energy, payload_kg, 0.0) if payload_kg > 0.0 else None
        )

    def update_and_get_release_evidence(
        self, telemetry: TelemetryState, *, is_release_commanded: bool
    ) -> str:
        """Update with the telemetry state; return the evidence of the release, or `""`."""
        if self._watch is None:
            return "there was no parcel to weigh" if is_release_commanded else ""
        if is_release_commanded:
            self._watch.record_release_order(telemetry.t_s)
        add_hover_samples_from_telemetry(self._watch, telemetry)
        return self._watch.release_evidence_text(telemetry.t_s) or ""
