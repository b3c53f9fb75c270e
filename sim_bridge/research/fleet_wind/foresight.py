"""Wind forecast of one mission's vehicle with fleet wind reports, using the flight code.

`companion.core.wind_field.fleet_wind` decides whether fleet wind is used. As in flight, a front
can only cause a return, never prevent one. Times are relative to the mission's start.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import WindForecast, WindForecaster
from companion.core.wind.process import WindProcessParams
from companion.core.wind_field.field_process import FieldProcess
from companion.core.wind_field.fleet_wind import OWN, FleetWind
from companion.core.wind_field.fronts import WindFront
from companion.core.wind_field.shared_outlook import FrontOutlook, SharedOutlook
from companion.core.wind_field.shared_winds import MAX_REPORTS
from companion.core.wind_field.wind_reports import MemberWindReport
from sim_bridge.research.fleet_wind.fields import HEIGHT_M, FleetWorld
from sim_bridge.research.fleet_wind.fronts import KnownFronts
from sim_bridge.research.promise.planner import HISTORY_S, ScaledForecaster


@dataclass(frozen=True, slots=True)
class _FixedPositionForecast:
    """Forecast at one fixed position, whose wind the mission meets along its whole route."""

    outlook: WindForecaster

    def forecast_on_route(
        self, belief: WindBelief, horizon_s: Floats, position_ne_m: Floats
    ) -> WindForecast:
        return self.outlook.forecast_on_route(belief, horizon_s, np.zeros_like(position_ne_m))


class FleetForecaster:
    """Wind forecast of a mission that starts at `start_s` and meets the wind of one position.

    The vehicle is the world's first drone. It receives the other drones' reports from the start of
    its own wind history. `fronts`: as the desk reports them, in chronological order.
    """

    def __init__(
        self,
        world: FleetWorld,
        fronts: KnownFronts,
        process: WindProcessParams,
        position_ne_m: Floats,
        start_s: float,
    ) -> None:
        self._world, self._start_s = world, start_s
        self._position_ne_m = float(position_ne_m[0]), float(position_ne_m[1])
        self._own = ScaledForecaster(process, 1.0)
        self._fleet = FleetWind(FieldProcess(process))
        self._tail_dof = process.tail_dof
        begin_s = start_s - HISTORY_S
        self._next = int(np.searchsorted(world.report_times_s, begin_s))
        self._fronts = [
            (known_s - start_s, None if one is None else _time_shifted_front(one, -start_s))
            for known_s, one in fronts
            if known_s > begin_s
        ]
        self.decision_count = self.fleet_used_count = 0
        """Number of decisions, and of those that used fleet wind."""

    def update_from_estimate(self, belief: WindBelief) -> None:
        """Add the vehicle's own wind estimate, after all reports received until then."""
        self._process_reports_until(belief.t_s)
        self._own.update_from_estimate(belief)
        north, east = (float(x) for x in belief.mean_to_ne_mps)
        nn, ee = float(belief.cov_ne_m2ps2[0, 0]), float(belief.cov_ne_m2ps2[1, 1])
        own = MemberWindReport(
            OWN, belief.t_s, self._position_ne_m, HEIGHT_M, (north, east), (nn, 0.0, ee)
        )
        self._fleet.add_own_estimate(own)

    def candidate_forecasts(self, t_s: float) -> tuple[WindForecaster, ...]:
        """Return the forecast (fleet or own wind), and a second one with a reported front."""
        self._process_reports_until(t_s)
        field = self._fleet.joint_field_or_none(t_s)
        self.decision_count += 1
        self.fleet_used_count += field is not None
        calm: WindForecaster = self._own
        if field is not None:
            calm = _FixedPositionForecast(
                SharedOutlook(field, HEIGHT_M, self._position_ne_m, self._tail_dof)
            )
        front = self._fleet.expected_front_after_dropping_expired(t_s, self._position_ne_m)
        if front is None:
            return (calm,)
        return calm, _FixedPositionForecast(FrontOutlook(calm, front, self._position_ne_m))

    def _process_reports_until(self, t_s: float) -> None:
        report_times_s = self._world.report_times_s
        while (
            self._next < report_times_s.size and report_times_s[self._next] - self._start_s <= t_s
        ):
            now_s = float(report_times_s[self._next]) - self._start_s
            front, withdrawn = self._pop_due_front_and_withdrawal(now_s)
            self._fleet.add_reports_and_front_of_desk(self._nearest_reports(now_s), front, now_s)
            if withdrawn:
                self._fleet.discard_front_and_return_if_expected()
            self._next += 1

    def _nearest_reports(self, now_s: float) -> list[MemberWindReport]:
        """Return the latest reports of the nearest other drones, as a desk publishes them."""
        others = range(1, len(self._world.drones))
        wind_reports = [self._world.wind_report(k, self._next) for k in others]
        wind_reports.sort(key=lambda one: math.dist(one.position_ne_m, self._position_ne_m))
        return [replace(one, t_s=now_s) for one in wind_reports[:MAX_REPORTS]]

    def _pop_due_front_and_withdrawal(self, now_s: float) -> tuple[WindFront | None, bool]:
        """Return the latest front reported since the last call, and True if it is withdrawn."""
        front, withdrawn = None, False
        while self._fronts and self._fronts[0][0] <= now_s:
            front = self._fronts.pop(0)[1]
            withdrawn = front is None
        return front, withdrawn


def _time_shifted_front(front: WindFront, time_shift_s: float) -> WindFront:
    """Return the front with its times shifted by `time_shift_s`."""
    shifted_points = tuple(replace(one, t_s=one.t_s + time_shift_s) for one in front.detections)
    return replace(
        front,
        detected_s=front.detected_s + time_shift_s,
        t0_s=front.t0_s + time_shift_s,
        detections=shifted_points,
    )
