"""What the map shows, as the page gets it (JSON). What is unknown is absent.

Places are [latitude, longitude] in degrees, times microseconds since 1970 by this machine's clock.
"""

from typing import Any

import msgspec

Point = tuple[float, float]


class _Part(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A member that has its default is left out."""


class WayShown(_Part, frozen=True, kw_only=True):
    """The way of the mission that is aboard."""

    straight: bool = False
    """Its waypoints are not told: `out` and `home` are straight lines, which it may not fly."""
    out: list[Point] = []
    """From the launch pad to the customer."""
    home: list[Point] = []
    """From the customer to where it ends if nothing changes."""
    asked: list[Point] = []
    """To a stop that it was asked to move to and has not confirmed."""
    now: list[Point] = []
    """A diversion in force: from where it is to where it lands."""


class DroneShown(_Part, frozen=True, kw_only=True):
    """One drone."""

    phase: str
    """As it reports it, or where it is while its silence is expected."""
    present: bool = False
    """Heard, by one companion of this name."""
    at: Point | None = None
    height_rel_m: float | None = None
    course_deg: float | None = None
    """Where it moves to, of the last metres that it was heard to move."""
    ground_speed_mps: float | None = None
    heard_us: int | None = None
    order: str | None = None
    home: str | None = None
    asked: str | None = None
    delivered: bool = False
    armed: bool = False
    margin_wh: float | None = None
    p_home: float | None = None
    p_home_now: float | None = None
    p_success: float | None = None
    energy_left_wh: float | None = None
    wind_to_ne_mps: Point | None = None
    says: str = ""
    why: str = ""
    """Its last decision on this flight, in the gate's own words."""
    why_us: int | None = None
    way: WayShown = WayShown()
    alarms: list[str] = []


class DriveShown(_Part, frozen=True, kw_only=True):
    """A drive from stop to stop by the plan: it left when the desk noted it, and takes as long as
    the plan says. Where the road goes is not known.
    """

    start: Point
    end: Point
    left_us: int
    arrive_us: int


class TruckShown(_Part, frozen=True, kw_only=True):
    """The truck. `at` while it drives: absent, unless its terminal reports a position."""

    phase: str
    at: Point | None = None
    drive: DriveShown | None = None
    """While it drives and reports no position."""
    stop: str | None = None
    leaves_us: int | None = None
    """Planned departure from where it stands."""
    waits_for: list[str] = []
    """Sorties that keep it there, in the store's words."""
    alarms: list[str] = []


class OrderShown(_Part, frozen=True, kw_only=True):
    """One order."""

    at: Point
    state: str
    mass_kg: float
    vehicle: str | None = None
    why: str = ""
    note: str = ""


class StopShown(_Part, frozen=True, kw_only=True):
    """A stop of the truck's plan."""

    at: Point
    arrive_us: int | None = None
    depart_us: int | None = None


class NextShown(_Part, frozen=True, kw_only=True):
    """A sortie to come."""

    order: str
    vehicle: str
    launch: str
    home: str
    launch_us: int | None = None


class PlanShown(_Part, frozen=True, kw_only=True):
    """The plan in force. `route`: the truck's stops in order."""

    title: str
    stops: dict[str, StopShown] = {}
    route: list[str] = []
    next: list[NextShown] = []


class WindShown(_Part, frozen=True, kw_only=True):
    """A wind, where the air moves to, with its covariance [nn, ne, ee] in (m/s)^2."""

    to_ne_mps: Point
    cov_m2ps2: tuple[float, float, float]
    source: str


class AreaShown(_Part, frozen=True, kw_only=True):
    """An obstacle, or an area that no height clears (`height_m` absent)."""

    name: str
    ring: list[Point]
    height_m: float | None = None


class SiteShown(_Part, frozen=True, kw_only=True):
    """What a day file says of the place."""

    depot: Point | None = None
    areas: list[AreaShown] = []
    rally: dict[str, Point] = {}


class AttentionShown(_Part, frozen=True, kw_only=True):
    """Something that wants a person's eye. `who`: a member, an order, `store`, `certificates`."""

    who: str
    words: str


class MapPicture(_Part, frozen=True, kw_only=True):
    """All of it."""

    fleet: str
    site: SiteShown = SiteShown()
    attention: list[AttentionShown] = []
    notes: list[str] = []
    """Holds, and launches that a person has confirmed."""
    drones: dict[str, DroneShown] = {}
    truck: TruckShown | None = None
    orders: dict[str, OrderShown] = {}
    plan: PlanShown | None = None
    winds: list[WindShown] = []
    max_loss: float | None = None
    basemap: bool = False
    outline: bool = False
    """Without a base map: the world's coasts and borders are there to be drawn."""


def as_table(part: msgspec.Struct) -> dict[str, Any]:
    """As JSON's own types, without what is unknown."""
    return msgspec.to_builtins(part)
