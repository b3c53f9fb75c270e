"""The mission half of a flight file (`flight/1`): where to, with what, at which risk.

The file's `[wind]` and `[faults]` tables are the simulator's own. A companion reads the same file
and carries them as opaque tables, because a vehicle cannot know its wind from a file.
"""

from typing import Any, Literal

import msgspec

from companion.core.base.errors import LeewayError, check_range
from companion.core.base.geo_zones import ZoneTerms
from companion.core.base.place import Place
from companion.core.base.safe_text import check_name
from companion.core.base.wire_message import Key, Name
from companion.core.base.zone_times import UtcSpan, utc_s
from companion.core.ground.ground_table import GroundTable
from companion.core.vehicle.air import COLDEST_C, WARMEST_C
from companion.core.vehicle.speed_to_fly import SpeedRule


class Terrain(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Ground height around the depot: a plane by its slopes, or a grid of heights.

    The plane is the simulator's. Over a grid the companion keeps `mission.clearance_m`.
    """

    kind: Literal["flat", "plane", "grid"] = "flat"
    """A plane by its slopes, a grid of heights, or flat."""
    slope_east_frac: float = 0.0
    """Rise of the ground for each metre east."""
    slope_north_frac: float = 0.0
    """Rise of the ground for each metre north."""
    grid: str | None = None
    """CSV file with the columns `east_m`, `north_m`, `up_m` (`docs/how-to/fly-over-ground.md`); a
    height may be empty: unknown. Only with kind "grid".
    """
    heights: GroundTable | None = None
    """The same heights written out, in place of `grid`: as a dispatcher sends them."""

    def __post_init__(self) -> None:
        check_range("site.terrain.slope_east_frac", self.slope_east_frac, -1.0, 1.0)
        check_range("site.terrain.slope_north_frac", self.slope_north_frac, -1.0, 1.0)
        given = (self.grid is not None) + (self.heights is not None)
        if given != (self.kind == "grid"):
            words = 'a file name, or heights, exactly when kind = "grid"'
            raise LeewayError(f"site.terrain.grid: {words}")


def with_heights(flight: "Flight", heights: GroundTable | None) -> "Flight":
    """The same flight with the heights of its grid written out, where it has any."""
    if heights is None:
        return flight
    terrain = Terrain(kind="grid", heights=heights)
    site = msgspec.structs.replace(flight.site, terrain=terrain)
    return msgspec.structs.replace(flight, site=site)


class Site(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Depot, customer, rally points and what stands between them."""

    customer: Place
    """Where the parcel goes."""
    depot: Place | None = None
    """Where the vehicle starts. Absent: where it stands (its own home position)."""
    rally: list[Place] = []
    """Other places where it may land."""
    obstacles: str | None = None
    """GeoJSON file of polygons with a `height_m` property, above the depot; or geo-zones as ED-269
    or ED-318 (`docs/how-to/geo-zones.md`).
    """
    terrain: Terrain = Terrain()
    """Ground height around the depot."""
    stops: list[Place] = []
    """Places where a truck may stand, each with a name of its own."""
    home: str | None = None
    """The stop that the truck promises now, where the flight ends (safety rule 3). Absent:
    the depot.
    """
    air_temperature_c: float | None = None
    """Of the air at the depot. Absent: by the autopilot's barometer, whose board is warmer, and
    the standard atmosphere's without one.
    """

    def __post_init__(self) -> None:
        names = [stop.name for stop in self.stops]
        if "" in names or len(set(names)) < len(names):
            raise LeewayError("site.stops: expected a name of its own for each")
        if self.home is not None and self.home not in names:
            raise LeewayError(f"site.home = {self.home!r}: expected the name of one of site.stops")
        shared = set(names) & {place.name for place in self.rally}
        if shared:
            raise LeewayError(f"site.stops: {min(shared)!r} is a rally point's name already")
        if self.air_temperature_c is not None:
            low_c, high_c = COLDEST_C, WARMEST_C
            check_range("site.air_temperature_c", self.air_temperature_c, low_c, high_c)
        if self.depot is not None and self.depot.lat_deg is None:
            raise LeewayError("site.depot: expected lat_deg, lon_deg and alt_amsl_m")


class Vehicle(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What flies, and how it starts."""

    airframe: str
    """An airframe of params/airframes, or the path of an airframe/1 file."""
    payload_kg: float = 0.0
    """Mass of the parcel."""
    charge_frac: float | list[float] = 1.0
    """Charge at the start: a number, or [lowest, highest] for a pack as it comes from the
    shelf. The simulator draws from the range; the companion has to find the charge out by
    itself.
    """
    temperature_c: float = 20.0
    """The pack's temperature."""
    battery_health_frac: float = 1.0
    """What is left of the pack's capacity, of a new one's."""
    pitot: bool = False
    """An airspeed sensor is aboard."""
    autopilot_wind: bool = False
    """Take the autopilot's own wind estimate as one more measurement."""

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
    def charge_frac_stated(self) -> float | None:
        """The charge at the start, where the file states it."""
        return None if isinstance(self.charge_frac, list) else self.charge_frac


LEAST_LOSS = 1e-6
"""Below, no promise of ours means anything."""


class Mission(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What the operator asks, and the risk that they accept. Heights are above the depot."""

    max_loss: float = 0.01
    """Probability of losing the vehicle that the operator accepts."""
    max_loss_per_hour: float | None = None
    """Losses per flight hour that the operator accepts: times the planned flight's hours it bounds
    `max_loss`. Absent: `max_loss` alone.
    """
    reserve_frac: float = 0.15
    """Energy that must be left after landing, of the usable energy."""
    cruise_height_m: float = 40.0
    """Height of the way out, above the depot."""
    return_height_m: float | None = None
    """Height of the way back, above the depot. Absent: `cruise_height_m`."""
    clearance_m: float = 20.0
    """Least height over the ground of every line that is flown, where `site.terrain` is a grid;
    waypoints are lifted over `cruise_height_m` for it. Near the depot, the customer and landing
    places the flight is lower, straight above them.
    """
    drop_height_m: float = 6.0
    """Height above the customer's ground at which the parcel is released."""
    leg_length_m: float = 150.0
    """Longest leg: a decision is taken at the end of each."""
    wind_settle_s: float = 10.0
    """Hover after take-off, until the wind estimate has settled."""
    time_limit_s: float = 1800.0
    """The vehicle turns back so long after take-off, whatever its budget says."""
    cruise_airspeed_mps: float | None = None
    """Airspeed in place of the airframe's own."""
    speed: SpeedRule | None = None
    """How the airspeed is chosen. Absent: least energy, or "cruise" where
    `cruise_airspeed_mps` is given.
    """
    wind_process: str = "coast"
    """How wind changes at the site: a file of params/wind, or a path."""
    corner_tolerance_m: float | None = None
    """How far the way home may cut corners where that costs less. Absent: never."""
    authorised_zones: list[str] = []
    """Identifiers of the geo-zones that the operator may enter: of those that ask for leave, never
    of prohibited ones.
    """
    from_utc: str | None = None
    """The flight takes off no earlier, as "2026-05-01T10:00:00Z"; with `until_utc`."""
    until_utc: str | None = None
    """The flight is over by then. Geo-zones that are not in force between the two are flown
    through. Absent: every zone is in force.
    """

    def __post_init__(self) -> None:
        check_range("mission.max_loss", self.max_loss, LEAST_LOSS, 0.5)
        if self.max_loss_per_hour is not None:
            check_range("mission.max_loss_per_hour", self.max_loss_per_hour, LEAST_LOSS, 1.0)
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
        hours = self.hours
        if hours is not None and hours.from_s >= hours.until_s:
            words = f"expected a time after from_utc, {self.from_utc}"
            raise LeewayError(f"mission.until_utc = {self.until_utc!r}: {words}")

    @property
    def hours(self) -> UtcSpan | None:
        """When the flight may be in the air, where the file states it."""
        if self.from_utc is None and self.until_utc is None:
            return None
        return UtcSpan(
            utc_s("mission.from_utc", self.from_utc), utc_s("mission.until_utc", self.until_utc)
        )

    @property
    def zone_terms(self) -> ZoneTerms:
        """On which terms geo-zones are judged."""
        return ZoneTerms(frozenset(self.authorised_zones), self.hours)

    @property
    def speed_rule(self) -> SpeedRule:
        """The rule in force."""
        if self.speed is not None:
            return self.speed
        return "least_energy" if self.cruise_airspeed_mps is None else "cruise"


MOST_NEIGHBOURS = 64
"""Neighbouring fleets of one flight: each is listened to in some ten cells."""


class NeighbourFleet(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Another fleet whose drones this flight keeps apart from, with `--keep-apart`."""

    fleet: Name
    """Its name."""
    keys: dict[Name, Key] = {}
    """Its vehicles, and the public key that each signs its tracks with, as the desk found them on
    that fleet's roster. A fleet with identities believes nobody else of them; without identities
    everybody is heard.
    """


def check_neighbours(where: str, fleets: list[str]) -> None:
    """LeewayError where a fleet is named twice, or too many are."""
    twice = sorted({fleet for fleet in fleets if fleets.count(fleet) > 1})
    if twice:
        raise LeewayError(f"{where}: {', '.join(twice)} more than once")
    if len(fleets) > MOST_NEIGHBOURS:
        raise LeewayError(f"{where}: {len(fleets)} fleets, expected at most {MOST_NEIGHBOURS}")


class Flight(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A `flight/1` file: one delivery, and the world that a simulator flies it in."""

    format: Literal["flight/1"]
    """The kind of file and its version."""
    site: Site
    """Depot, customer and what stands between them."""
    vehicle: Vehicle
    """What flies, and how it starts."""
    name: str = "flight"
    """The flight's name."""
    mission: Mission = Mission()
    """What the operator asks, and the risk that they accept."""
    neighbours: list[NeighbourFleet] = []
    """Other fleets whose drones may be near."""
    wind: dict[str, Any] = {}
    """The true wind, for the simulator; the companion never reads it. Absent: still air."""
    faults: list[dict[str, Any]] = []
    """What goes wrong, for the simulator; the companion never reads it."""

    def __post_init__(self) -> None:
        check_name("name", self.name)
        check_neighbours("neighbours", [one.fleet for one in self.neighbours])
