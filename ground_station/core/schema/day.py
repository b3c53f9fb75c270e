"""The day file (`day/1`): depot, fleet, truck, limits, forecast; checked as a whole."""

import math
from dataclasses import dataclass
from typing import Literal

import msgspec

from companion.core.base.errors import LeewayError, check_range
from companion.core.base.place import Place
from companion.core.base.safe_text import one_line
from companion.core.base.wire_message import Name
from companion.core.mission.flight_file import Mission, Terrain, check_neighbours
from companion.core.vehicle.air import COLDEST_C, WARMEST_C, Air, standard_air
from companion.fleet.topics import checked_name


@dataclass(frozen=True, slots=True)
class FileProblem:
    """One mistake in a file: where (row 1 is the header) and what was expected."""

    file: str
    row: int | None
    column: str | None
    words: str

    def __str__(self) -> str:
        row = f", row {self.row}" if self.row is not None else ""
        column = f", column {self.column}" if self.column else ""
        return one_line(f"{self.file}{row}{column}: {self.words}")


class DayFilesError(LeewayError):
    """Everything that is wrong in the day's files, one line each."""

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
    """What is left of the pack's capacity, of a new one's."""

    def __post_init__(self) -> None:
        check_range(f"drones.{self.id}.charge_frac", self.charge_frac, 0.05, 1.0)
        check_range(f"drones.{self.id}.temperature_c", self.temperature_c, -30.0, 60.0)
        check_range(f"drones.{self.id}.battery_health_frac", self.battery_health_frac, 0.3, 1.0)
        checked_name("drones.id", self.id)


class Truck(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The truck, and the times of its driver, who does one thing at a time.

    Launch and recovery times are as in Murray and Raj, Transportation Research C 110, 2020.
    """

    speed_mps: float = 8.0
    """Speed on the road."""
    detour_factor: float = 1.3
    """Length of the road over the straight line, where no road matrix is given."""
    capacity_kg: float = 800.0
    """All that rides on the truck: the drones' parcels too."""
    deliver_s: float = 90.0
    """The driver brings a parcel to the door."""
    launch_s: float = 60.0
    """The driver puts a drone with its parcel onto its pad."""
    recover_s: float = 30.0
    """The driver takes a drone aboard again and gives it a fresh pack."""
    ready_s: float = 60.0
    """From the pad to take-off, without the driver: the drone finds its position, takes its
    mission and checks it.
    """

    def __post_init__(self) -> None:
        check_range("truck.speed_mps", self.speed_mps, 0.5, 40.0)
        check_range("truck.detour_factor", self.detour_factor, 1.0, 5.0)
        check_range("truck.capacity_kg", self.capacity_kg, 0.0, 40_000.0)
        check_range("truck.deliver_s", self.deliver_s, 1.0, 3600.0)
        check_range("truck.launch_s", self.launch_s, 1.0, 3600.0)
        check_range("truck.recover_s", self.recover_s, 1.0, 3600.0)
        check_range("truck.ready_s", self.ready_s, 0.0, 3600.0)


class Forecast(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The wind at cruise height that the desk plans with: of a file, or else constant."""

    file: str | None = None
    """A forecast: GRIB2 (needs the extra `weather`), or Open-Meteo's JSON. Not beside `speed_mps`,
    `from_deg` and `std_mps`.
    """
    speed_mps: float = 0.0
    """Mean wind at cruise height."""
    from_deg: float = 0.0
    """Where it blows from, clockwise from north."""
    std_mps: float = 2.0
    """How wrong the forecast may be (one sigma)."""
    air_temperature_c: float | None = None
    """Of the air at the depot; every flight file states it. Absent: the standard atmosphere's at
    the depot's height, and vehicles go by their own barometers.
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
        """Where the air moves to, north and east."""
        angle = math.radians(self.from_deg)
        return -self.speed_mps * math.cos(angle), -self.speed_mps * math.sin(angle)


class WindStation(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A fixed place where the wind is measured."""

    id: Name
    """Its name: on the fleet's network it is its identity's."""
    lat_deg: float
    """Latitude."""
    lon_deg: float
    """Longitude."""
    height_m: float
    """Of its anemometer above the ground."""
    file: str | None = None
    """A CSV file that it appends to (`docs/how-to/wind-stations.md`). Absent: it tells on the
    fleet's network.
    """

    def __post_init__(self) -> None:
        check_range(f"stations.{self.id}.lat_deg", self.lat_deg, -85.0, 85.0)
        check_range(f"stations.{self.id}.lon_deg", self.lon_deg, -180.0, 180.0)
        check_range(f"stations.{self.id}.height_m", self.height_m, 1.0, 500.0)


class Depot(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Where truck and drones start."""

    lat_deg: float
    """Latitude."""
    lon_deg: float
    """Longitude."""
    alt_amsl_m: float
    """Height of the ground above mean sea level."""
    terrain: Terrain | None = None
    """Ground height around the depot, for orders that state none; `elevation` goes before it."""

    def __post_init__(self) -> None:
        check_range("depot.lat_deg", self.lat_deg, -85.0, 85.0)
        check_range("depot.lon_deg", self.lon_deg, -180.0, 180.0)
        check_range("depot.alt_amsl_m", self.alt_amsl_m, -500.0, 9000.0)
        if self.terrain is not None and self.terrain.kind == "grid":
            raise LeewayError('depot.terrain.kind: expected "flat" or "plane"')

    @property
    def place(self) -> Place:
        """As a flight file's place."""
        return Place(
            name="depot", lat_deg=self.lat_deg, lon_deg=self.lon_deg, alt_amsl_m=self.alt_amsl_m
        )


class Day(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A `day/1` file: a day of deliveries. The files that it names lie beside it."""

    format: Literal["day/1"]
    """The kind of file and its version."""
    depot: Depot
    """Where truck and drones start."""
    drones: list[Drone]
    """The drones, each with an `id` of its own."""
    name: str = "day"
    """The day's name."""
    fleet: str = "fleet"
    """The fleet's name, as companions are started with."""
    neighbours: list[Name] = []
    """Other fleets whose drones may be near in the air, and name this one in their day: vehicles
    hear their tracks and, with `--keep-apart`, keep apart from their drones.
    """
    orders: list[str] = []
    """Files of orders, CSV or GeoJSON."""
    no_fly: str | None = None
    """GeoJSON file of polygons with `height_m`; or geo-zones as ED-269 or ED-318
    (`docs/how-to/geo-zones.md`).
    """
    elevation: list[str] = []
    """GeoTIFF tiles of the ground (needs the extra `terrain`): heights of orders that state none,
    and each flight's strip of ground.
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
    """Wind stations that the desk hears."""
    wind_limit_mps: float | None = None
    """Wind aloft, as drones in the air tell it, at which the desk launches nothing. Absent: three
    quarters of the top airspeed of the slowest drone.
    """
    watch_fronts: bool = True
    """Whether the desk looks for fronts in what drones tell. False over steep ground: the wind
    behind a hill would be taken for one. `watch` knows no day, and looks all the same.
    """
    rally: list[Place] = []
    """Places where a drone may land if it cannot come home."""

    def __post_init__(self) -> None:
        checked_name("fleet", self.fleet)
        check_neighbours("neighbours", self.neighbours)
        if self.fleet in self.neighbours:
            raise LeewayError(f"neighbours: {self.fleet} is this day's own fleet")
        if self.wind_limit_mps is not None:
            check_range("wind_limit_mps", self.wind_limit_mps, 1.0, 40.0)
        names = [drone.id for drone in self.drones]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise LeewayError(f"drones.id: {', '.join(twice)} more than once")
        names += [station.id for station in self.stations]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise LeewayError(f"stations.id: {', '.join(twice)} more than once, or a drone's")

    @property
    def air(self) -> Air:
        """The air that the desk prices flights in: nobody at the depot has measured it."""
        return standard_air(self.depot.alt_amsl_m, self.forecast.air_temperature_c)

    def drone(self, id_: str) -> Drone | None:
        """The drone of this name."""
        return next((drone for drone in self.drones if drone.id == id_), None)
