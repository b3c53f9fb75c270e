"""The day file (`day/1`): depot, fleet, truck, limits, forecast; checked as a whole."""

import math
from dataclasses import dataclass
from typing import Literal

import msgspec

from companion.core.base.errors import LeewayError, check_range
from companion.core.base.place import Place
from companion.core.mission.flight_file import Mission, Terrain
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
        return f"{self.file}{row}{column}: {self.words}"


class DayFilesError(LeewayError):
    """Everything that is wrong in the day's files, one line each."""

    def __init__(self, problems: list[FileProblem]) -> None:
        self.problems = problems
        super().__init__("\n".join(str(problem) for problem in problems))


class Drone(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One drone. `id`: the name of its companion in the fleet."""

    id: str
    airframe: str
    charge_frac: float = 1.0
    temperature_c: float = 20.0
    battery_health_frac: float = 1.0

    def __post_init__(self) -> None:
        check_range(f"drones.{self.id}.charge_frac", self.charge_frac, 0.05, 1.0)
        check_range(f"drones.{self.id}.temperature_c", self.temperature_c, -30.0, 60.0)
        check_range(f"drones.{self.id}.battery_health_frac", self.battery_health_frac, 0.3, 1.0)
        checked_name("drones.id", self.id)


class Truck(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The truck and its driver.

    Without a road matrix it drives straight lines, `detour_factor` longer. The driver does one
    thing at a time: `deliver_s` for a parcel to the door, `launch_s` to put a drone with its
    parcel on its pad, `recover_s` to take a drone aboard and change its pack (the last two as in
    Murray and Raj, Transportation Research C 110, 2020). `ready_s`: from then until take-off,
    without the driver: the drone finds its position, takes its mission and checks it.
    `capacity_kg`: everything on the truck, the drones' parcels too.
    """

    speed_mps: float = 8.0
    detour_factor: float = 1.3
    capacity_kg: float = 800.0
    deliver_s: float = 90.0
    launch_s: float = 60.0
    recover_s: float = 30.0
    ready_s: float = 60.0

    def __post_init__(self) -> None:
        check_range("truck.speed_mps", self.speed_mps, 0.5, 40.0)
        check_range("truck.detour_factor", self.detour_factor, 1.0, 5.0)
        check_range("truck.capacity_kg", self.capacity_kg, 0.0, 40_000.0)
        check_range("truck.deliver_s", self.deliver_s, 1.0, 3600.0)
        check_range("truck.launch_s", self.launch_s, 1.0, 3600.0)
        check_range("truck.recover_s", self.recover_s, 1.0, 3600.0)
        check_range("truck.ready_s", self.ready_s, 0.0, 3600.0)


class Forecast(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The wind at cruise height to plan with; `std_mps`: its standard deviation."""

    speed_mps: float = 0.0
    from_deg: float = 0.0
    std_mps: float = 2.0

    def __post_init__(self) -> None:
        check_range("forecast.speed_mps", self.speed_mps, 0.0, 40.0)
        check_range("forecast.from_deg", self.from_deg, 0.0, 360.0)
        check_range("forecast.std_mps", self.std_mps, 0.1, 10.0)

    @property
    def to_ne_mps(self) -> tuple[float, float]:
        """Where the air moves to, north and east."""
        angle = math.radians(self.from_deg)
        return -self.speed_mps * math.cos(angle), -self.speed_mps * math.sin(angle)


class Depot(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Start of truck and drones. `terrain`: heights of orders that state none."""

    lat_deg: float
    lon_deg: float
    alt_amsl_m: float
    terrain: Terrain | None = None

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
    """A `day/1` file. File names in it are relative to it.

    `orders`: CSV or GeoJSON. `no_fly`: GeoJSON polygons with `height_m`. `roads`: a CSV matrix of
    seconds between the depot and the orders.
    """

    format: Literal["day/1"]
    depot: Depot
    drones: list[Drone]
    name: str = "day"
    fleet: str = "fleet"
    orders: list[str] = []
    no_fly: str | None = None
    roads: str | None = None
    truck: Truck = Truck()
    mission: Mission = Mission()
    forecast: Forecast = Forecast()
    rally: list[Place] = []

    def __post_init__(self) -> None:
        checked_name("fleet", self.fleet)
        names = [drone.id for drone in self.drones]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise LeewayError(f"drones.id: {', '.join(twice)} more than once")

    def drone(self, id_: str) -> Drone | None:
        """The drone of this name."""
        return next((drone for drone in self.drones if drone.id == id_), None)
