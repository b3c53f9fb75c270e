"""The motion that set-points follow: advanced at common ticks, as the separation filter permits."""

import numpy as np

from companion.core.mission.flight_plan import AVOIDANCE_LEVELS, AVOIDANCE_STEP_M
from companion.core.pilot.context import FlightContext
from companion.core.pilot.neighbours.desired_velocity import MIN_AVOIDANCE_HEIGHT_M
from companion.core.separation.separation_filter import Clearance, SeparationFilter
from companion.core.separation.setpoint_motion import (
    FLEET_SEPARATION,
    Floats,
    Motion,
    down_velocity_to_height_mps,
    level_velocity_away_from_nearest,
)
from companion.core.separation.stopping_paths import Neighbours

FLEET_FILTER = SeparationFilter(FLEET_SEPARATION)

STUCK_TICKS, STUCK_MPS = 20, 0.5
"""A vehicle that should move but has not moved for this many ticks moves to the next height."""

BACK_OFF_S, BACK_OFF_MPS = 4.0, 2.0
"""It backs off first: two vehicles at minimum distance can neither pass nor climb."""

LAYER_HOLD_S = 20.0
"""Duration for which it then continues at that height."""

AVOIDANCE_GROUND_RADIUS_M = 200.0
"""All layers clear the ground within this distance, the range of a manoeuvre of 20 s."""

MAX_REFERENCE_ERROR_M = 2.0
"""At a larger distance from the reference, the reference restarts at the vehicle's position."""

POSITION_GAIN_PS = 1.0


class SetpointReference:
    """The reference motion of one takeover.

    It begins at the vehicle once the autopilot follows set-points, and again where the vehicle is
    too far from it. If the filter stops the vehicle for long, the vehicle backs off and then
    continues at the next avoidance height.
    """

    def __init__(self) -> None:
        self._motion: Motion | None = None
        self._avoidance_rank = 0
        """Index of its avoidance height."""
        self._stuck_ticks = 0
        self._stuck_s: float | None = None
        """Time at which it was last stuck."""

    def clear_motion(self) -> None:
        """Begin at the vehicle again."""
        self._motion = None

    def set_avoidance_rank(self, rank: int) -> None:
        """Set the rank of this vehicle among those near at the takeover."""
        self._avoidance_rank = rank

    def end(self) -> None:
        """End the takeover; the avoidance height stays."""
        self._motion, self._stuck_ticks, self._stuck_s = None, 0, None

    def position_velocity_ned(
        self, t_s: float, position_ned_m: Floats, velocity_ned_mps: Floats
    ) -> tuple[Floats, Floats]:
        """Return position and velocity of the reference, or the vehicle's without one."""
        if self._motion is None:
            return position_ned_m, velocity_ned_mps
        return self._motion.pos_vel_accel_at(t_s, FLEET_SEPARATION)[:2]

    def setpoint_velocity_accel_ned(
        self, t_s: float, position_ned_m: Floats, velocity_ned_mps: Floats
    ) -> tuple[Floats, Floats]:
        """Return velocity and acceleration to send; without a reference the vehicle's velocity."""
        if self._motion is None:
            return velocity_ned_mps, np.zeros(3)
        pos, vel, accel = self._motion.pos_vel_accel_at(t_s, FLEET_SEPARATION)
        return vel + POSITION_GAIN_PS * (pos - position_ned_m), accel

    def advance(
        self,
        context: FlightContext,
        position_ned_m: Floats,
        velocity_ned_mps: Floats,
        desired_velocity_ned_mps: Floats,
        neighbours: Neighbours,
    ) -> None:
        """Advance the reference by one tick, as the filter permits."""
        t_s = context.t_s
        pos, vel = self.position_velocity_ned(t_s, position_ned_m, velocity_ned_mps)
        if float(np.linalg.norm(pos - position_ned_m)) > MAX_REFERENCE_ERROR_M:
            pos, vel = position_ned_m, velocity_ned_mps
        since_s = context.seconds_since(self._stuck_s)
        layer_down_m = self._avoidance_height_down_m(context)
        if since_s < BACK_OFF_S:
            desired_velocity_ned_mps = level_velocity_away_from_nearest(
                position_ned_m, desired_velocity_ned_mps, neighbours, BACK_OFF_MPS
            )
        if since_s < LAYER_HOLD_S:
            down_mps = down_velocity_to_height_mps(
                float(position_ned_m[2]), layer_down_m, FLEET_SEPARATION
            )
            desired_velocity_ned_mps = np.array([*desired_velocity_ned_mps[:2], down_mps])
        safe_velocity = desired_velocity_ned_mps
        if context.options.separation_filter:
            found = FLEET_FILTER.nearest_safe_velocities(
                pos[None],
                vel[None],
                desired_velocity_ned_mps[None],
                neighbours,
                np.array([layer_down_m]),
                _clearance_function(context),
            )
            safe_velocity = found.vel_ned_mps[0]
        self._motion = Motion.from_initial_and_final_velocity(
            t_s, pos, vel, safe_velocity, FLEET_SEPARATION
        )
        is_blocked = (
            float(np.linalg.norm(safe_velocity))
            < STUCK_MPS
            < float(np.linalg.norm(desired_velocity_ned_mps[:2]))
        )
        self._stuck_ticks = self._stuck_ticks + 1 if is_blocked else 0
        if self._stuck_ticks >= STUCK_TICKS:
            self._avoidance_rank += 1
            self._stuck_ticks, self._stuck_s = 0, t_s

    def _avoidance_height_down_m(self, context: FlightContext) -> float:
        """Return the avoidance height, by the rank of this vehicle among those near at the
        takeover.
        """
        assert context.flight_plan is not None
        flown, here = context.flight_plan, context.recent_position_ned_m()
        level = flown.plan.outbound_ned_m[-1][2]
        ground = flown.site.ground
        if ground is not None and here is not None:
            # The lowest layer clears all known ground that is near.
            least_m = ground.min_plan_height_near_m(here, AVOIDANCE_GROUND_RADIUS_M)
            level = min(level, -least_m + min(AVOIDANCE_LEVELS) * AVOIDANCE_STEP_M)
        return min(
            level
            - AVOIDANCE_LEVELS[self._avoidance_rank % len(AVOIDANCE_LEVELS)] * AVOIDANCE_STEP_M,
            -MIN_AVOIDANCE_HEIGHT_M,
        )


def _clearance_function(context: FlightContext) -> Clearance | None:
    """Return a function for the distance of points to obstacles and ground, at their heights."""
    assert context.flight_plan is not None
    site, here = context.flight_plan.site, context.recent_position_ned_m()
    obstacles, ground = site.obstacles, site.ground
    # Low over a customer or a landing site it is closer to the ground than on any route.
    if (
        ground is not None
        and here is not None
        and ground.height_above_clearance_m(np.array([here]))[0] > 0.0
    ):
        return lambda points, _: np.minimum(
            obstacles.distance_to_nearest_outline_m(points), ground.height_above_clearance_m(points)
        )
    return (
        (lambda points, _: obstacles.distance_to_nearest_outline_m(points))
        if obstacles.obstacles
        else None
    )
