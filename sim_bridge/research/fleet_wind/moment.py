"""One moment of a study for its picture: the wind that was, and what was believed of it."""

from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.wind_field.field_belief import FieldBelief
from companion.core.wind_field.field_process import FieldPoints
from companion.core.wind_field.settled_field import SettledField
from sim_bridge.research.fleet_wind.patrols import HEIGHT_M, SITE_M
from sim_bridge.research.fleet_wind.study import FleetWindSetting, drawn_field

SIDE = 25
AVERAGED_S = 60.0
AFTER_FRONT_S = 30.0
"""Seconds after the front has reached the middle of the site."""


@dataclass(frozen=True, slots=True)
class FieldMoment:
    """Mean winds over the next minute (side, side, 2) on a grid, and where the drones are."""

    north_m: Floats
    east_m: Floats
    actual: Floats
    believed: Floats
    alone: Floats
    drones: Floats

    @staticmethod
    def speed_mps(wind: Floats) -> Floats:
        """Its size."""
        return np.hypot(wind[..., 0], wind[..., 1])


def field_moment(setting: FleetWindSetting) -> FieldMoment:
    """The first draw's front, half a minute after it has reached the middle."""
    drawn = drawn_field(setting, 0, 0)
    world = drawn.world(front=True)
    then_s = drawn.front.t_s + AFTER_FRONT_S
    now_s = float(world.told_s[np.searchsorted(world.told_s, then_s)])
    fleet, alone = FieldBelief(world.process), FieldBelief(world.process)
    for index, t_s in enumerate(world.told_s):
        if t_s > now_s:
            break
        for number in range(len(world.drones)):
            telling = world.telling(number, index)
            fleet.tell(telling, float(t_s))
            if number == 0:
                alone.tell(telling, float(t_s))
    axis = np.linspace(-SITE_M, SITE_M, SIDE)
    north, east = (a.ravel() for a in np.meshgrid(axis, axis, indexing="ij"))
    seconds = now_s + np.arange(AVERAGED_S) + 0.5
    actual = np.mean(
        [world.truth.to_ne_mps(np.full(north.size, t), north, east, HEIGHT_M) for t in seconds],
        axis=0,
    )
    here = np.stack([way.at(np.array([now_s]))[0] for way in world.drones])
    shape = (SIDE, SIDE, 2)
    return FieldMoment(
        axis,
        axis,
        actual.reshape(shape),
        _means(fleet.settle(now_s), north, east).reshape(shape),
        _means(alone.settle(now_s), north, east).reshape(shape),
        here,
    )


def _means(field: SettledField, north: Floats, east: Floats) -> Floats:
    place = np.stack([north, east], axis=1)
    t_s = np.full(north.size, field.now_s + 0.5 * AVERAGED_S)
    points = FieldPoints(place, np.full(north.size, HEIGHT_M), t_s)
    return field.forecast(points, AVERAGED_S).mean_to_ne_mps
