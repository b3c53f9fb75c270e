"""Flight planning with geo-zones: through, around and below them; validity at launch."""

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest
import shapely

from companion.adapters.autopilots.ardupilot import ArduPilot
from companion.adapters.autopilots.px4 import Px4
from companion.adapters.files.params import read_airframe
from companion.core.base.errors import LeewayError
from companion.core.exports.exported import build_mission_export
from companion.core.exports.ground_plan import plan_flight_without_vehicle
from companion.core.mission.events import GnssTime
from companion.core.mission.flight_file import Flight
from companion.core.mission.flight_plan import FlightPlan, route_properties
from companion.core.pilot.context import PilotOptions
from companion.core.pilot.transitions import Phase
from companion.core.routing.leg_energy import RouteEnergy
from tests.companion.pilot.fake_vehicle import FLIGHT, world

EXAMPLES = Path(__file__).parents[3] / "docs" / "how-to" / "geo-zones"
M100 = read_airframe("m100")
MORNING = {"from_utc": "2026-05-01T10:00:00Z", "until_utc": "2026-05-01T11:00:00Z"}
NOON = {"from_utc": "2026-05-01T12:00:00Z", "until_utc": "2026-05-01T13:00:00Z"}


def example(name: str) -> dict[str, Any]:
    return json.loads((EXAMPLES / name).read_text())


def flight(**mission: Any) -> Flight:
    """From the depot to 1,200 m east: the examples' zones are on the middle of the route."""
    table = {
        "format": "flight/1",
        "site": {
            "depot": {"lat_deg": 55.47, "lon_deg": 8.45, "alt_amsl_m": 12.0},
            "customer": {"north_m": 0.0, "east_m": 1200.0},
        },
        "vehicle": {"airframe": "m100"},
        "mission": {"cruise_height_m": 40.0} | mission,
    }
    return msgspec.convert(table, Flight)


def planned(name: str, **mission: Any) -> FlightPlan:
    asked = flight(**mission)
    return plan_flight_without_vehicle(asked, RouteEnergy(M100, 1.225), example(name))


def aside_m(flown: FlightPlan) -> float:
    """Return the largest distance from the straight line, outbound or returning."""
    plan = flown.plan
    return max(abs(north) for north, _, _ in (*plan.outbound_ned_m, *plan.return_ned_m))


def test_at_ten_the_flight_goes_through_a_zone_and_at_noon_round_it() -> None:
    assert aside_m(planned("ed269.json", **MORNING)) < 1.0
    assert aside_m(planned("ed269.json", **NOON)) > 80.0
    assert aside_m(planned("ed269.json")) > 80.0  # applicability unknown
    round_it = shapely.LineString(
        [p[:2] for p in planned("ed269.json", **NOON).plan.outbound_ned_m]
    )
    assert round_it.distance(shapely.Point(0.0, 600.6)) >= 80.0 + 15.0 - 1.0


@pytest.mark.parametrize(
    "table",
    [
        {"customer": {"lat_deg": 8.45, "lon_deg": 55.47, "alt_amsl_m": 12.0}},
        {"rally": [{"lat_deg": -55.47, "lon_deg": -171.55, "alt_amsl_m": 12.0}]},
    ],
)
def test_a_place_beyond_the_depots_reach_is_refused(table: dict[str, Any]) -> None:
    document = msgspec.to_builtins(flight())
    document["site"] |= table
    of = msgspec.convert(document, Flight)
    with pytest.raises(LeewayError, match=r"km from the depot: expected at most 100 km"):
        plan_flight_without_vehicle(of, RouteEnergy(M100, 1.225), None)


def test_leave_opens_the_straight_way() -> None:
    # 105 m cruise: the zone's floor, 137 m above sea level, is under 8 m above some flown height.
    assert aside_m(planned("ed318.json", cruise_height_m=105.0)) > 200.0
    leave = {"cruise_height_m": 105.0, "authorised_zones": ["XXX0002"]}
    assert aside_m(planned("ed318.json", **leave)) < 1.0


def test_a_zone_that_begins_above_the_flight_is_flown_under() -> None:
    flown = planned("ed318.json", cruise_height_m=60.0)
    assert aside_m(flown) < 1.0
    assert flown.is_line_clear_with_height_change((0.0, 0.0, -60.0), (0.0, 1200.0, -60.0))
    assert not flown.is_line_clear_with_height_change(
        (0.0, 0.0, -125.0), (0.0, 1200.0, -60.0)
    )  # outside its height range
    (area,) = build_mission_export(flown, "under").areas
    assert not area.in_fence
    assert area.bottom_m == pytest.approx(450 * 0.3048 - 12.0)


@pytest.mark.parametrize(
    ("terrain", "is_under"),
    [
        ({}, False),  # the default states nothing: the zone counts from the ground
        ({"kind": "plane"}, True),
        ({"kind": "plane", "slope_east_frac": -0.02}, False),  # 44 m lower in the east
    ],
)
def test_a_zone_above_ground_is_flown_under_over_a_stated_plane(
    terrain: dict[str, Any], is_under: bool
) -> None:
    document = example("ed269.json")
    document["features"][0]["geometry"][0] |= {"lowerLimit": 121, "upperLimit": 9999}
    table = msgspec.to_builtins(flight(cruise_height_m=60.0))
    table["site"]["terrain"] = terrain
    asked = msgspec.convert(table, Flight)
    flown = plan_flight_without_vehicle(asked, RouteEnergy(M100, 1.225), document)
    assert (aside_m(flown) < 1.0) == is_under


@pytest.mark.parametrize(
    ("profile", "name", "per_m"), [(ArduPilot(), "RTL_ALT", 100.0), (Px4(), "RTL_RETURN_ALT", 1.0)]
)
def test_the_autopilots_own_return_stays_under_the_zone_too(
    profile: ArduPilot | Px4, name: str, per_m: float
) -> None:
    asked = flight(cruise_height_m=60.0)
    facts = route_properties(asked, M100, planned("ed318.json", cruise_height_m=60.0))
    assert facts.ceiling_m == pytest.approx(450 * 0.3048 - 12.0 - 8.0)
    (rtl,) = (r for r in profile.parameter_requirements(facts) if r.names[0] == name)
    assert rtl.is_met({name: 80.0 * per_m})
    assert not rtl.is_met({name: 130.0 * per_m})


@pytest.mark.parametrize(
    ("mission", "words"),
    [
        ({"from_utc": "2026-05-01T10:00:00Z"}, r"mission\.until_utc = None: expected a time"),
        ({"from_utc": "ten", "until_utc": "eleven"}, r"mission\.from_utc = 'ten'"),
        (
            {"from_utc": NOON["from_utc"], "until_utc": MORNING["until_utc"]},
            r"mission\.until_utc = .*expected a time after from_utc",
        ),
    ],
)
def test_wrong_hours_are_named(mission: dict[str, str], words: str) -> None:
    with pytest.raises((LeewayError, msgspec.ValidationError), match=words):
        flight(**mission)


def timed_world(now_utc_s: float | None):
    mission = msgspec.structs.replace(FLIGHT.mission, **MORNING)
    options = PilotOptions(configure=True, authorise=True)
    w = world(flight=msgspec.structs.replace(FLIGHT, mission=mission), options=options)
    if now_utc_s is not None:
        w.tell(GnssTime(w.t_s, now_utc_s))
    return w


TEN_S = 1_777_629_600.0  # date -u -d 2026-05-01T10:00:00Z +%s


def test_a_flight_takes_off_within_its_hours_only() -> None:
    w = timed_world(TEN_S + 60.0)
    w.until(Phase.OUTBOUND)
    early = timed_world(TEN_S - 60.0)
    early.run(lambda w: "not yet" in w.said)
    assert early.t_s < 60.0
    early.until(Phase.OUTBOUND)
    assert early.t_s >= 60.0
    late = timed_world(TEN_S + 3590.0)
    late.run(lambda w: "no take-off: mission.until_utc" in w.said)
    assert not late.armed


def test_a_flight_with_hours_waits_for_a_time_of_day() -> None:
    w = timed_world(None)
    w.run(lambda w: "waiting: the autopilot reports no time of day" in w.said)
    assert not w.armed
