"""Content of the map as the page receives it (JSON). Unknown values are absent.

Positions are [latitude, longitude] in degrees, times are epoch microseconds of this machine.
"""

from typing import Any

import msgspec

from ground_station.core.schema.holds import Handover

Point = tuple[float, float]


class _PicturePart(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Part of the picture; fields with default values are omitted."""


class RouteShown(_PicturePart, frozen=True, kw_only=True):
    """Route of the uploaded mission."""

    is_straight: bool = msgspec.field(default=False, name="straight")
    """Waypoints are not reported: `out` and `home` are straight lines, not the flown route."""
    outbound: list[Point] = msgspec.field(default_factory=list, name="out")
    """From the launch pad to the customer."""
    home: list[Point] = []
    """From the customer to the planned end of the flight."""
    to_requested_stop: list[Point] = msgspec.field(default_factory=list, name="asked")
    """To a stop that a home change has requested and the drone has not confirmed."""
    diversion: list[Point] = msgspec.field(default_factory=list, name="now")
    """Diversion in force: from the current position to the landing site."""


class DroneShown(_PicturePart, frozen=True, kw_only=True):
    """One drone."""

    phase: str
    """Reported phase, or the location during expected silence."""
    present: bool = False
    """Received, from exactly one companion of this name."""
    position: Point | None = msgspec.field(default=None, name="at")
    height_rel_m: float | None = None
    course_deg: float | None = None
    """Course over the last metres of received movement."""
    ground_speed_mps: float | None = None
    received_us: int | None = msgspec.field(default=None, name="heard_us")
    hold: str = ""
    """The hold that keeps it on the ground, as text."""
    in_place_of: str = ""
    """The drone of the day whose place this spare has."""
    pack: str = ""
    """The fitted pack, as a person has stated it."""
    order: str | None = None
    home: str | None = None
    requested_stop: str | None = msgspec.field(default=None, name="asked")
    delivered: bool = False
    armed: bool = False
    margin_wh: float | None = None
    """Spare energy at landing: above the reserve."""
    spare_min: float | None = None
    """The same as minutes of hover."""
    p_home: float | None = None
    """By the model; `risk` is the stated value."""
    risk: str = ""
    """Risk of not returning, as text, at least the limit of evidence; `risk_now`: returning now."""
    risk_now: str = ""
    p_success: float | None = None
    energy_left_wh: float | None = None
    energy_needed_wh: float | None = None
    """Energy needed to land on the reserve, with the reserve."""
    full_wh: float | None = None
    """Usable energy of the full pack."""
    reserve_wh: float | None = None
    launch_us: int | None = None
    """Launch of the current flight, planned or flown; `drop_us`, `land_us`: expected times."""
    drop_us: int | None = None
    land_us: int | None = None
    wind_to_ne_mps: Point | None = None
    last_message: str = msgspec.field(default="", name="says")
    decision_text: str = msgspec.field(default="", name="why")
    """Latest decision on this flight: the quantity that decided, in words."""
    decision_us: int | None = msgspec.field(default=None, name="why_us")
    route: RouteShown = msgspec.field(default=RouteShown(), name="way")
    diverted_to: str | None = None


class DriveShown(_PicturePart, frozen=True, kw_only=True):
    """A planned drive between two stops: it starts when the desk records the departure, and has the
    planned duration. The road is unknown.
    """

    start: Point
    end: Point
    departure_us: int = msgspec.field(name="left_us")
    arrive_us: int


class TruckShown(_PicturePart, frozen=True, kw_only=True):
    """The truck. `position` is absent during a drive unless its terminal reports a position."""

    phase: str
    position: Point | None = msgspec.field(default=None, name="at")
    drive: DriveShown | None = None
    """Present during a drive without a reported position."""
    stop: str | None = None
    planned_departure_us: int | None = msgspec.field(default=None, name="leaves_us")
    """Planned departure from the current stop."""
    binding_sorties: list[str] = msgspec.field(default_factory=list, name="waits_for")
    """Sorties that keep the truck at its stop, as the store's text."""
    received_us: int | None = msgspec.field(default=None, name="heard_us")


class OrderShown(_PicturePart, frozen=True, kw_only=True):
    """One order."""

    position: Point = msgspec.field(name="at")
    state: str
    mass_kg: float
    vehicle: str | None = None
    reason: str = msgspec.field(default="", name="why")
    note: str = ""
    confirmed_by: str | None = None
    """The operator who has confirmed its launch."""
    customer: str | None = None
    address: str | None = None
    phone: str | None = None
    earliest_us: int | None = None
    """Delivery window."""
    latest_us: int | None = None
    service_s: float | None = None
    priority: bool = False


class StopShown(_PicturePart, frozen=True, kw_only=True):
    """A stop of the truck's plan."""

    position: Point = msgspec.field(name="at")
    arrive_us: int | None = None
    depart_us: int | None = None
    arrived_us: int | None = None
    departed_us: int | None = None
    serves: list[str] = []
    """Orders that the driver delivers from here."""


class SortieShown(_PicturePart, frozen=True, kw_only=True):
    """A sortie of the plan; `state`: planned, flying, landed or lost. Flown times where known."""

    order: str
    vehicle: str
    launch: str
    home: str
    launch_us: int | None = None
    land_us: int | None = None
    drop_us: int | None = None
    state: str


class ManifestRow(_PicturePart, frozen=True, kw_only=True):
    """A row of the manifest (`ground_station.app.map.manifest`)."""

    stop: str
    arrive_us: int | None = None
    leave_us: int | None = None
    does: str = ""
    order: str = ""
    drone: str | None = None


class PlanShown(_PicturePart, frozen=True, kw_only=True):
    """The plan in force. `route`: the truck's stops in order. `late_s`: the truck's lateness."""

    title: str
    stops: dict[str, StopShown] = {}
    route: list[str] = []
    sorties: list[SortieShown] = []
    end_us: int | None = None
    late_s: int | None = None


class WindShown(_PicturePart, frozen=True, kw_only=True):
    """A wind vector that points to where the air moves, with covariance [nn, ne, ee] in (m/s)^2."""

    to_ne_mps: Point
    cov_m2ps2: tuple[float, float, float]
    source: str


class AreaShown(_PicturePart, frozen=True, kw_only=True):
    """An obstacle, or an area that is closed at all heights (`height_m` absent)."""

    name: str
    ring: list[Point]
    height_m: float | None = None


class SiteShown(_PicturePart, frozen=True, kw_only=True):
    """Site data from a day file."""

    depot: Point | None = None
    areas: list[AreaShown] = []
    rally: dict[str, Point] = {}


class AttentionShown(_PicturePart, frozen=True, kw_only=True):
    """Item of the attention list (`ground_station.core.fleet.attention`)."""

    key: str
    level: str
    subject: str = msgspec.field(name="who")
    title: str
    text: str = msgspec.field(default="", name="words")
    actions: list[str] = msgspec.field(default_factory=list, name="acts")
    times_us: dict[str, int] = msgspec.field(default_factory=dict, name="times")
    since_us: int | None = None


class MapPicture(_PicturePart, frozen=True, kw_only=True):
    """The whole picture."""

    fleet: str
    site: SiteShown = SiteShown()
    alerts: list[AttentionShown] = msgspec.field(default_factory=list, name="attention")
    desk_received_us: int | None = msgspec.field(default=None, name="desk_heard_us")
    """Last heartbeat of a desk."""
    notes: list[str] = []
    """Holds, and launches that an operator has confirmed."""
    handover: Handover | None = None
    """The latest hand-over of a shift."""
    drones: dict[str, DroneShown] = {}
    truck: TruckShown | None = None
    orders: dict[str, OrderShown] = {}
    plan: PlanShown | None = None
    winds: list[WindShown] = []
    max_loss: float | None = None
    risk_limit: str = ""
    low_spare_wh: float = 10.0
    contact_timeout_s: float = 15.0
    holds: list[str] = []
    """Held vehicles; `*`: all."""
    basemap: bool = False
    outline: bool = False
    """Without a base map: coasts and borders are available."""


def to_json_types(part: msgspec.Struct) -> dict[str, Any]:
    """Return a part as JSON types, without unknown values."""
    return msgspec.to_builtins(part)
