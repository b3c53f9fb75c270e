"""The mission part of a flight file (`flight/1`): destination, vehicle and accepted risk.

The tables `[wind]` and `[faults]` are for the simulator only. A companion reads the same file and
carries them as opaque tables, because a vehicle cannot know its wind from a file.
"""

from collections.abc import Sequence
from typing import Any, Literal

import msgspec

from companion.core.base.errors import LeewayError, check_range
from companion.core.base.geo_zones import ZoneAuthorisation
from companion.core.base.location import Location
from companion.core.base.safe_text import check_name
from companion.core.base.wire_message import Key, Name
from companion.core.base.zone_times import UtcSpan, parse_utc_s
from companion.core.ground.ground_table import GroundTable
from companion.core.vehicle.air import COLDEST_C, WARMEST_C
from companion.core.vehicle.speed_to_fly import SpeedRule

PLANE_MARGIN_M = 1000.0
"""Distance beyond a flight's positions within which its routes and detours stay."""


class Terrain(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Ground height around the depot: a plane given by its slopes, or a grid of heights.

    The companion uses a plane only for the limits of geo-zones above ground; `flat` states nothing.
    Above a grid it keeps `mission.clearance_m`.
    """

    kind: Literal["flat", "plane", "grid"] = "flat"
    """A plane by its slopes, a grid of heights, or flat."""
    slope_east_frac: float = 0.0
    """Rise of the ground for each metre east."""
    slope_north_frac: float = 0.0
    """Rise of the ground for each metre north."""
    grid: str | None = None
    """CSV file with the columns `east_m`, `north_m`, `up_m` (`docs/how-to/fly-over-ground.md`). An
    empty height is unknown. Only with kind "grid"."""
    heights: GroundTable | None = None
    """The grid's heights inline, instead of `grid`: the form that a dispatcher sends."""

    def __post_init__(self) -> None:
        check_range("site.terrain.slope_east_frac", self.slope_east_frac, -1.0, 1.0)
        check_range("site.terrain.slope_north_frac", self.slope_north_frac, -1.0, 1.0)
        source_count = (self.grid is not None) + (self.heights is not None)
        if source_count != (self.kind == "grid"):
            expected = 'expected a file name or heights if and only if kind = "grid"'
            raise LeewayError(f"site.terrain.grid: {expected}")

    def plane_bounds_m(self, positions_m: Sequence[Sequence[float]]) -> tuple[float, float] | None:
        """Return the lowest and highest ground near depot and positions (north, east); None: no
        plane is stated (`flat` is the default).
        """
        if self.kind != "plane":
            return None
        low_m = high_m = 0.0
        for axis, slope in enumerate((self.slope_north_frac, self.slope_east_frac)):
            values_m = [0.0, *(position[axis] for position in positions_m)]
            ends_m = (min(values_m) - PLANE_MARGIN_M, max(values_m) + PLANE_MARGIN_M)
            low_m += min(slope * end_m for end_m in ends_m)
            high_m += max(slope * end_m for end_m in ends_m)
        return low_m, high_m


def with_terrain_heights(flight: "Flight", heights: GroundTable | None) -> "Flight":
    """Return the flight with the heights of its grid inline, if it has a grid."""
    if heights is None:
        return flight
    terrain = Terrain(kind="grid", heights=heights)
    site = msgspec.structs.replace(flight.site, terrain=terrain)
    return msgspec.structs.replace(flight, site=site)


class Site(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Depot, customer, rally points and the obstacles between them."""

    customer: Location
    """Delivery position."""
    depot: Location | None = None
    """Start position of the vehicle. Absent: its home position."""
    rally: list[Location] = []
    """Alternative landing sites."""
    obstacles: str | None = None
    """GeoJSON file of polygons with a `height_m` property, above the depot; or geo-zones as ED-269
    or ED-318 (`docs/how-to/geo-zones.md`)."""
    terrain: Terrain = Terrain()
    """Ground height around the depot."""
    stops: list[Location] = []
    """Possible stops of a truck, each with a unique name."""
    home: str | None = None
    """The stop that the truck promises now, where the flight ends (safety rule 3). Absent: the
    depot."""
    air_temperature_c: float | None = None
    """Air temperature at the depot. Absent: from the autopilot's barometer, whose board is warmer,
    or from the standard atmosphere without one."""

    def __post_init__(self) -> None:
        names = [stop.name for stop in self.stops]
        if "" in names or len(set(names)) < len(names):
            raise LeewayError("site.stops: expected a unique name for each")
        if self.home is not None and self.home not in names:
            raise LeewayError(f"site.home = {self.home!r}: expected the name of one of site.stops")
        shared_names = set(names) & {location.name for location in self.rally}
        if shared_names:
            raise LeewayError(
                f"site.stops: {min(shared_names)!r} is already the name of a rally point"
            )
        if self.air_temperature_c is not None:
            low_c, high_c = COLDEST_C, WARMEST_C
            check_range("site.air_temperature_c", self.air_temperature_c, low_c, high_c)
        if self.depot is not None and self.depot.lat_deg is None:
            raise LeewayError("site.depot: expected lat_deg, lon_deg and alt_amsl_m")


class Vehicle(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The vehicle and its state at the start."""

    airframe: str
    """An airframe of params/airframes, or an airframe/1 file (.toml), relative to this file."""
    payload_kg: float = 0.0
    """Mass of the parcel."""
    charge_frac: float | list[float] = 1.0
    """Charge at the start: a number, or [lowest, highest] for a pack of unknown charge. The
    simulator draws from the range; the companion has to estimate the charge."""
    temperature_c: float = 20.0
    """Temperature of the pack."""
    battery_health_frac: float = 1.0
    """Remaining capacity of the pack relative to a new one."""
    pitot: bool = False
    """Whether an airspeed sensor is fitted."""
    autopilot_wind: bool = False
    """Use the autopilot's own wind estimate as one more measurement."""

    def __post_init__(self) -> None:
        check_range("vehicle.payload_kg", self.payload_kg, 0.0, 500.0)
        span = self.charge_frac if isinstance(self.charge_frac, list) else [self.charge_frac] * 2
        if len(span) != 2 or span[0] > span[1]:
            raise LeewayError("vehicle.charge_frac: expected a number, or [lowest, highest]")
        for value in span:
            check_range("vehicle.charge_frac", value, 0.05, 1.0)
        check_range("vehicle.temperature_c", self.temperature_c, -30.0, 60.0)
        check_range("vehicle.battery_health_frac", self.battery_health_frac, 0.3, 1.0)

    @property
    def stated_charge_frac(self) -> float | None:
        """Charge at the start if the file states it, else None."""
        return None if isinstance(self.charge_frac, list) else self.charge_frac


MIN_LOSS = 1e-6
"""Smallest loss probability that the models support."""


class Mission(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Task and accepted risk. Heights are above the depot."""

    max_loss: float = 0.01
    """Probability of losing the vehicle that the operator accepts."""
    max_loss_per_hour: float | None = None
    """Losses per flight hour that the operator accepts. Multiplied by the planned flight time, it
    bounds `max_loss`. Absent: `max_loss` alone."""
    reserve_frac: float = 0.15
    """Energy that must be left after landing, of the usable energy."""
    cruise_height_m: float = 40.0
    """Height of the outbound route, above the depot."""
    return_height_m: float | None = None
    """Height of the return route, above the depot. Absent: `cruise_height_m`."""
    clearance_m: float = 20.0
    """Minimum height above ground of every flown line, where `site.terrain` is a grid; waypoints
    are raised above `cruise_height_m` for it. Near the depot, the customer and landing sites the
    flight is lower, vertically above them."""
    drop_height_m: float = 6.0
    """Height above the customer's ground at which the parcel is released."""
    leg_length_m: float = 150.0
    """Maximum leg length: a decision is taken at the end of each leg."""
    wind_settle_s: float = 10.0
    """Hover after takeoff until the wind estimate has converged."""
    time_limit_s: float = 1800.0
    """Time after takeoff at which the vehicle turns back, independent of its budget."""
    cruise_airspeed_mps: float | None = None
    """Airspeed instead of the airframe's own."""
    speed: SpeedRule | None = None
    """Rule for the airspeed. Absent: least energy, or "cruise" if `cruise_airspeed_mps` is given.
    """
    wind_process: str = "coast"
    """Model of the wind variation at the site: a file of params/wind, or a path."""
    corner_tolerance_m: float | None = None
    """Maximum deviation where the return route cuts corners to save energy. Absent: 0."""
    authorised_zones: list[str] = []
    """Identifiers of geo-zones that the operator may enter: zones that require authorisation only,
    never prohibited ones."""
    from_utc: str | None = None
    """Earliest takeoff, as "2026-05-01T10:00:00Z"; with `until_utc`."""
    until_utc: str | None = None
    """Latest end of the flight. Geo-zones that are not in force between the two are ignored.
    Absent: every zone is in force."""

    def __post_init__(self) -> None:
        check_range("mission.max_loss", self.max_loss, MIN_LOSS, 0.5)
        if self.max_loss_per_hour is not None:
            check_range("mission.max_loss_per_hour", self.max_loss_per_hour, MIN_LOSS, 1.0)
        check_range("mission.reserve_frac", self.reserve_frac, 0.0, 0.6)
        check_range("mission.cruise_height_m", self.cruise_height_m, 5.0, 500.0)
        if self.return_height_m is not None:
            check_range("mission.return_height_m", self.return_height_m, 5.0, 500.0)
        check_range("mission.clearance_m", self.clearance_m, 5.0, 300.0)
        check_range("mission.drop_height_m", self.drop_height_m, 1.0, 100.0)
        check_range("mission.leg_length_m", self.leg_length_m, 20.0, 5000.0)
        check_range("mission.wind_settle_s", self.wind_settle_s, 0.0, 120.0)
        check_range("mission.time_limit_s", self.time_limit_s, 10.0, 24 * 3600.0)
        if self.cruise_airspeed_mps is not None:
            check_range("mission.cruise_airspeed_mps", self.cruise_airspeed_mps, 1.0, 60.0)
        if self.corner_tolerance_m is not None:
            check_range("mission.corner_tolerance_m", self.corner_tolerance_m, 0.5, 200.0)
        hours = self.flight_window_utc
        if hours is not None and hours.from_s >= hours.until_s:
            expected = f"expected a time after from_utc, {self.from_utc}"
            raise LeewayError(f"mission.until_utc = {self.until_utc!r}: {expected}")

    @property
    def flight_window_utc(self) -> UtcSpan | None:
        """Permitted flight times if the file states them, else None."""
        if self.from_utc is None and self.until_utc is None:
            return None
        return UtcSpan(
            parse_utc_s("mission.from_utc", self.from_utc),
            parse_utc_s("mission.until_utc", self.until_utc),
        )

    @property
    def zone_authorisation(self) -> ZoneAuthorisation:
        """Conditions under which geo-zones are evaluated."""
        return ZoneAuthorisation(frozenset(self.authorised_zones), self.flight_window_utc)

    @property
    def speed_rule(self) -> SpeedRule:
        """The speed rule in force."""
        if self.speed is not None:
            return self.speed
        return "least_energy" if self.cruise_airspeed_mps is None else "cruise"


MAX_NEIGHBOUR_FLEETS = 64
"""Maximum number of neighbouring fleets: each is received in some ten grid cells."""


class NeighbourFleet(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Another fleet from whose drones this flight keeps separation, with `--keep-apart`."""

    fleet: Name
    """Its name."""
    keys: dict[Name, Key] = {}
    """Its vehicles and the public key with which each signs its tracks, as listed on that fleet's
    roster. From a fleet with identities only these tracks are accepted; without identities, all
    tracks are."""


def check_neighbour_fleets(document_key: str, fleet_names: list[str]) -> None:
    """Raise LeewayError if a fleet is named twice or there are too many fleets."""
    duplicate_fleets = sorted({fleet for fleet in fleet_names if fleet_names.count(fleet) > 1})
    if duplicate_fleets:
        raise LeewayError(f"{document_key}: {', '.join(duplicate_fleets)} more than once")
    if len(fleet_names) > MAX_NEIGHBOUR_FLEETS:
        raise LeewayError(
            f"{document_key}: {len(fleet_names)} fleets, expected at most {MAX_NEIGHBOUR_FLEETS}"
        )


class Flight(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A `flight/1` file: one delivery, and the world that a simulator flies it in."""

    format: Literal["flight/1"]
    """The kind of file and its version."""
    site: Site
    """Depot, customer and the obstacles between them."""
    vehicle: Vehicle
    """The vehicle and its state at the start."""
    name: str = "flight"
    """The flight's name."""
    mission: Mission = Mission()
    """Task and accepted risk."""
    neighbours: list[NeighbourFleet] = []
    """Other fleets whose drones may be near."""
    wind: dict[str, Any] = {}
    """The true wind, for the simulator; the companion never reads it. Absent: still air."""
    faults: list[dict[str, Any]] = []
    """Injected faults, for the simulator; the companion never reads them."""

    def __post_init__(self) -> None:
        check_name("name", self.name)
        check_neighbour_fleets("neighbours", [one.fleet for one in self.neighbours])
