"""The day file (`day/1`): depot, fleet, truck, limits, forecast; checked as a whole."""

import math
from dataclasses import dataclass
from typing import Literal

import msgspec

from companion.core.base.errors import LeewayError, check_range
from companion.core.base.location import Location
from companion.core.base.safe_text import flatten_to_one_line
from companion.core.base.wire_message import Name
from companion.core.mission.flight_file import Mission, Terrain, check_neighbour_fleets
from companion.core.vehicle.air import COLDEST_C, WARMEST_C, Air, standard_air
from companion.fleet.topics import require_valid_name


@dataclass(frozen=True, slots=True)
class FileProblem:
    """One error in a file: position (row 1 is the header) and expected content."""

    file: str
    row: int | None
    column: str | None
    text: str

    def __str__(self) -> str:
        row = f", row {self.row}" if self.row is not None else ""
        column = f", column {self.column}" if self.column else ""
        return flatten_to_one_line(f"{self.file}{row}{column}: {self.text}")


class DayFilesError(LeewayError):
    """All errors in the day's files, one line each."""

    def __init__(self, problems: list[FileProblem]) -> None:
        self.problems = problems
        super().__init__("\n".join(str(problem) for problem in problems))


class Drone(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One vehicle of the fleet."""

    id: str
    """Its companion's name in the fleet."""
    airframe: str
    """An airframe of params/airframes, or the path of an airframe/1 file."""
    charge_frac: float = 1.0
    """Charge at the start of the day."""
    temperature_c: float = 20.0
    """The pack's temperature."""
    battery_health_frac: float = 1.0
    """Remaining capacity of the pack as a fraction of a new one's."""

    def __post_init__(self) -> None:
        check_range(f"drones.{self.id}.charge_frac", self.charge_frac, 0.05, 1.0)
        check_range(f"drones.{self.id}.temperature_c", self.temperature_c, -30.0, 60.0)
        check_range(f"drones.{self.id}.battery_health_frac", self.battery_health_frac, 0.3, 1.0)
        require_valid_name("drones.id", self.id)


class Truck(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The truck, and the times of its driver, who does one task at a time.

    Launch and recovery times are as in Murray and Raj, Transportation Research C 110, 2020.
    """

    speed_mps: float = 8.0
    """Speed on the road."""
    detour_factor: float = 1.3
    """Length of the road over the straight line, used without a road matrix."""
    capacity_kg: float = 800.0
    """Maximum load of the truck, including the drones' parcels."""
    deliver_s: float = 90.0
    """Time for the driver to deliver a parcel to the door."""
    launch_s: float = 60.0
    """Time for the driver to put a drone with its parcel on its pad."""
    recover_s: float = 30.0
    """Time for the driver to collect a drone and swap its pack."""
    ready_s: float = 60.0
    """Time from the pad to take-off, without the driver: position fix, mission upload, checks."""

    def __post_init__(self) -> None:
        check_range("truck.speed_mps", self.speed_mps, 0.5, 40.0)
        check_range("truck.detour_factor", self.detour_factor, 1.0, 5.0)
        check_range("truck.capacity_kg", self.capacity_kg, 0.0, 40_000.0)
        check_range("truck.deliver_s", self.deliver_s, 1.0, 3600.0)
        check_range("truck.launch_s", self.launch_s, 1.0, 3600.0)
        check_range("truck.recover_s", self.recover_s, 1.0, 3600.0)
        check_range("truck.ready_s", self.ready_s, 0.0, 3600.0)


class Forecast(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The wind at cruise height that the desk plans with: from a file, or constant."""

    file: str | None = None
    """A forecast: GRIB2 (needs the extra `weather`), or Open-Meteo's JSON. Excludes `speed_mps`,
    `from_deg` and `std_mps`.
    """
    speed_mps: float = 0.0
    """Mean wind at cruise height."""
    from_deg: float = 0.0
    """Direction that the wind blows from, clockwise from north."""
    std_mps: float = 2.0
    """Standard error of the forecast (one sigma)."""
    air_temperature_c: float | None = None
    """Air temperature at the depot; every flight file states it. Absent: the standard atmosphere at
    the depot's height, and vehicles use their own barometers.
    """

    def __post_init__(self) -> None:
        check_range("forecast.speed_mps", self.speed_mps, 0.0, 40.0)
        check_range("forecast.from_deg", self.from_deg, 0.0, 360.0)
        check_range("forecast.std_mps", self.std_mps, 0.1, 10.0)
        if self.air_temperature_c is not None:
            low_c, high_c = COLDEST_C, WARMEST_C
            check_range("forecast.air_temperature_c", self.air_temperature_c, low_c, high_c)

    @property
    def to_ne_mps(self) -> tuple[float, float]:
        """Direction of air motion, north and east."""
        angle = math.radians(self.from_deg)
        return -self.speed_mps * math.cos(angle), -self.speed_mps * math.sin(angle)


class WindStation(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A fixed site where the wind is measured."""

    id: Name
    """Name of the station; on the fleet's network, the name of its identity."""
    lat_deg: float
    """Latitude."""
    lon_deg: float
    """Longitude."""
    height_m: float
    """Height of the anemometer above the ground."""
    file: str | None = None
    """A CSV file to which the station appends (`docs/how-to/wind-stations.md`). Absent: it
    publishes on the fleet's network.
    """

    def __post_init__(self) -> None:
        check_range(f"stations.{self.id}.lat_deg", self.lat_deg, -85.0, 85.0)
        check_range(f"stations.{self.id}.lon_deg", self.lon_deg, -180.0, 180.0)
        check_range(f"stations.{self.id}.height_m", self.height_m, 1.0, 500.0)


class Depot(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Start of the truck and the drones."""

    lat_deg: float
    """Latitude."""
    lon_deg: float
    """Longitude."""
    alt_amsl_m: float
    """Height of the ground above mean sea level."""
    terrain: Terrain | None = None
    """Ground height around the depot, for orders without one; `elevation` takes precedence."""

    def __post_init__(self) -> None:
        check_range("depot.lat_deg", self.lat_deg, -85.0, 85.0)
        check_range("depot.lon_deg", self.lon_deg, -180.0, 180.0)
        check_range("depot.alt_amsl_m", self.alt_amsl_m, -500.0, 9000.0)
        if self.terrain is not None and self.terrain.kind == "grid":
            raise LeewayError('depot.terrain.kind: expected "flat" or "plane"')

    @property
    def stated_plane(self) -> Terrain | None:
        """The ground that the day states, as a plane; None: it states none."""
        is_flat = self.terrain is not None and self.terrain.kind == "flat"
        return Terrain(kind="plane") if is_flat else self.terrain

    @property
    def location(self) -> Location:
        """The depot as a position of a flight file."""
        return Location(
            name="depot", lat_deg=self.lat_deg, lon_deg=self.lon_deg, alt_amsl_m=self.alt_amsl_m
        )


class Day(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A `day/1` file: a day of deliveries. Its files are in the same folder."""

    format: Literal["day/1"]
    """The kind of file and its version."""
    depot: Depot
    """Start of the truck and the drones."""
    drones: list[Drone]
    """The drones, each with a unique `id`."""
    name: str = "day"
    """The day's name."""
    fleet: str = "fleet"
    """The fleet's name, as in the start command of the companions."""
    neighbours: list[Name] = []
    """Other fleets whose drones may be nearby in the air, and whose day names this fleet: vehicles
    receive their tracks and, with `--keep-apart`, avoid their drones.
    """
    orders: list[str] = []
    """Files of orders, CSV or GeoJSON."""
    columns: dict[str, str] = {}
    """Headings of columns of the orders that have another name than documented, as
    `{ lat_deg = "North", mass_g = "Parcel" }`.
    """
    no_fly: str | None = None
    """GeoJSON file of polygons with `height_m`; or geo-zones as ED-269 or ED-318
    (`docs/how-to/geo-zones.md`).
    """
    elevation: list[str] = []
    """GeoTIFF tiles of the ground (needs the extra `terrain`): heights of orders without one, and
    each flight's strip of ground.
    """
    roads: str | None = None
    """CSV matrix of driving times in seconds between the depot and the orders."""
    truck: Truck = Truck()
    """The truck and its driver."""
    mission: Mission = Mission()
    """Limits of every flight, as in flight/1."""
    forecast: Forecast = Forecast()
    """The wind that the desk plans with."""
    stations: list[WindStation] = []
    """Wind stations that the desk uses."""
    wind_limit_mps: float | None = None
    """Wind aloft, as reported by airborne drones, at which the desk launches no drone. Absent:
    three quarters of the top airspeed of the slowest drone.
    """
    watch_fronts: bool = True
    """Whether the desk detects fronts in the wind reports. False over steep ground, where the wind
    behind a hill resembles a front. `watch` knows no day and always detects fronts.
    """
    low_spare_wh: float = 10.0
    """Spare energy at landing below which the map asks for attention."""
    contact_timeout_s: float = 15.0
    """Time without a state after which the map reports no contact with a drone."""
    rally: list[Location] = []
    """Positions where a drone may land if it cannot return home."""

    def __post_init__(self) -> None:
        require_valid_name("fleet", self.fleet)
        check_neighbour_fleets("neighbours", self.neighbours)
        if self.fleet in self.neighbours:
            raise LeewayError(f"neighbours: {self.fleet} is this day's own fleet")
        check_range("low_spare_wh", self.low_spare_wh, 0.0, 1000.0)
        check_range("contact_timeout_s", self.contact_timeout_s, 2.0, 600.0)
        if self.wind_limit_mps is not None:
            check_range("wind_limit_mps", self.wind_limit_mps, 1.0, 40.0)
        names = [drone.id for drone in self.drones]
        duplicates = sorted({name for name in names if names.count(name) > 1})
        if duplicates:
            raise LeewayError(f"drones.id: {', '.join(duplicates)} more than once")
        names += [station.id for station in self.stations]
        duplicates = sorted({name for name in names if names.count(name) > 1})
        if duplicates:
            raise LeewayError(f"stations.id: {', '.join(duplicates)} more than once, or a drone's")

    @property
    def standard_air_at_depot(self) -> Air:
        """The air that the desk prices flights in; no measurement at the depot exists."""
        return standard_air(self.depot.alt_amsl_m, self.forecast.air_temperature_c)

    def find_drone(self, id_: str) -> Drone | None:
        """Return the drone of this name."""
        return next((drone for drone in self.drones if drone.id == id_), None)
