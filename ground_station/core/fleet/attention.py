"""The attention list: items on which an operator can act, one per cause, worst first.

Pure functions from facts to items. `active_keys` are the items of the previous list: a threshold on
a quantity that varies (spare energy) has a hysteresis. An item ends with its cause.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum

from ground_station.core.fleet.risk_words import format_loss
from ground_station.core.schema.holds import Handover

HYSTERESIS_FRAC = 0.2
FRONT, STORE, DESK, ROSTER, CERTIFICATES = "wind", "store", "desk", "roster", "certificates"
HANDOVER = "handover"


class Level(IntEnum):
    """Level of an item, most urgent first."""

    WARNING = 0
    CAUTION = 1
    YOUR_TURN = 2

    @property
    def label(self) -> str:
        """Name of the level in the picture."""
        return self.name.lower()


@dataclass(frozen=True, slots=True)
class AttentionItem:
    """One cause that needs the operator.

    `text` may contain {time} names of `times_us`, which the display formats in its time zone.
    `actions`: commands and views that the display offers.
    """

    key: str
    level: Level
    subject: str
    title: str
    text: str = ""
    actions: tuple[str, ...] = ("show",)
    times_us: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class AttentionLimits:
    """Thresholds of a day."""

    low_spare_wh: float = 10.0
    contact_timeout_s: float = 15.0
    max_loss: float | None = None


@dataclass(frozen=True, slots=True)
class VehicleFacts:
    """Facts on one vehicle. `contact_age_s` None: no state received. `is_expected`: it should be in
    contact. `last_position`: last reported position, as text.
    """

    name: str
    contact_age_s: float | None = None
    is_online: bool = True
    is_expected: bool = True
    is_airborne: bool = False
    is_on_flight: bool = False
    spare_wh: float | None = None
    spare_min: float | None = None
    last_position: str = ""
    height_rel_m: float | None = None
    land_us: int | None = None
    diverted_to: str | None = None
    faults: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class LaunchFacts:
    """A launch that waits for a confirmation."""

    order: str
    vehicle: str
    risk: str = ""
    launch_by_us: int | None = None


@dataclass(frozen=True, slots=True)
class FleetFacts:
    """All facts of one moment. `desk_alarm`: a silent desk; `fronts`, `stations`: as text."""

    vehicles: Sequence[VehicleFacts] = ()
    launches: Sequence[LaunchFacts] = ()
    stuck: Sequence[tuple[str, str]] = ()
    idle_reasons: Mapping[str, str] = field(default_factory=dict)
    late: Mapping[str, str] = field(default_factory=dict)
    held: Collection[str] = ()
    out_of_service: Mapping[str, str] = field(default_factory=dict)
    handover: Handover | None = None
    desk_silence_s: float | None = None
    desk_alarm: str = ""
    store_error: str = ""
    roster_alarm: str = ""
    certificates: str = ""
    fronts: Sequence[str] = ()
    stations: Sequence[str] = ()


def attention_items(
    facts: FleetFacts, limits: AttentionLimits, active_keys: Collection[str] = ()
) -> list[AttentionItem]:
    """Return the list, by level and then in the order of the causes."""
    out = facts.out_of_service
    items = [
        *_ground_station_items(facts),
        *(
            item
            for vehicle in facts.vehicles
            for item in _vehicle_items(vehicle, limits, active_keys)
        ),
        *(_launch_item(launch, limits) for launch in facts.launches),
        *(_stuck_item(order, reason) for order, reason in facts.stuck),
        *(_late_item(order, text) for order, text in facts.late.items()),
        *_handover_items(facts.handover),
        *_wind_items(facts.fronts, facts.stations),
        *_idle_items(out, facts.held, "is out of service"),
        *_idle_items(
            {name: text for name, text in facts.idle_reasons.items() if name not in out}, facts.held
        ),
    ]
    return sorted(_without_repeated_keys(items), key=lambda item: item.level)


def _without_repeated_keys(items: Iterable[AttentionItem]) -> list[AttentionItem]:
    return list({item.key: item for item in reversed(list(items))}.values())[::-1]


def _ground_station_items(facts: FleetFacts) -> Iterator[AttentionItem]:
    if facts.desk_silence_s is not None:
        yield AttentionItem(
            DESK,
            Level.WARNING,
            DESK,
            f"Desk not responding for {facts.desk_silence_s:.0f} s",
            "No new orders or plans reach drones. Start it again: ground-station dispatch DAY.",
            (),
        )
    elif facts.desk_alarm:
        text = facts.desk_alarm
        yield AttentionItem(DESK, Level.CAUTION, DESK, "Check the desk's clock", text, ())
    if facts.store_error:
        title = "The desk's data is not reachable"
        yield AttentionItem(
            STORE, Level.WARNING, STORE, title, f"Orders are old: {facts.store_error}", ()
        )
    if facts.roster_alarm:
        title = "A roster was refused"
        yield AttentionItem(ROSTER, Level.WARNING, ROSTER, title, facts.roster_alarm, ())
    if facts.certificates:
        title = "Certificates end soon"
        yield AttentionItem(
            CERTIFICATES, Level.CAUTION, CERTIFICATES, title, facts.certificates, ()
        )


def _vehicle_items(
    vehicle: VehicleFacts, limits: AttentionLimits, active_keys: Collection[str]
) -> Iterator[AttentionItem]:
    name, spare_wh = vehicle.name, vehicle.spare_wh
    contact = _contact_item(vehicle, limits)
    if contact is not None:
        yield contact
    if vehicle.faults:
        text = f"{'; '.join(vehicle.faults)}. It gets no order."
        yield AttentionItem(f"fault {name}", Level.CAUTION, name, f"Check {name}", text)
    if spare_wh is None or not vehicle.is_on_flight or contact is not None:
        return
    if spare_wh < 0.0:
        site = vehicle.diverted_to
        text = f"It diverts to {site}. Keep {site} clear." if site else "It lands by its own rules."
        title = f"{name} is {-spare_wh:.1f} Wh short of coming home"
        yield AttentionItem(f"spare {name}", Level.WARNING, name, title, text)
    elif is_low_spare(spare_wh, limits, is_active=f"spare {name}" in active_keys):
        minutes = "" if vehicle.spare_min is None else f" ({vehicle.spare_min:.0f} min)"
        title = f"{name} has {spare_wh:.0f} Wh{minutes} to spare"
        text = f"Below {limits.low_spare_wh:g} Wh."
        yield AttentionItem(f"spare {name}", Level.CAUTION, name, title, text, ("recall", "show"))


def is_low_spare(spare_wh: float, limits: AttentionLimits, *, is_active: bool) -> bool:
    """Return whether spare energy is low; a low one must rise by a fifth above the limit."""
    return spare_wh < limits.low_spare_wh * (1.0 + HYSTERESIS_FRAC * is_active)


def _contact_item(vehicle: VehicleFacts, limits: AttentionLimits) -> AttentionItem | None:
    age_s, name = vehicle.contact_age_s, vehicle.name
    if not vehicle.is_expected:
        return None
    key = f"contact {name}"
    if age_s is None:
        title, text = f"No contact with {name} yet", "Check its power and its radio."
        return None if vehicle.is_online else AttentionItem(key, Level.CAUTION, name, title, text)
    if age_s <= limits.contact_timeout_s:
        return None
    title = f"No contact with {name} for {age_s:.0f} s"
    if not vehicle.is_airborne:
        return AttentionItem(
            key, Level.CAUTION, name, title, f"On the ground{_seen(vehicle)}. Check its radio."
        )
    times_us = {} if vehicle.land_us is None else {"land": vehicle.land_us}
    by = " at {land}" if times_us else ""
    height = "" if vehicle.height_rel_m is None else f", {vehicle.height_rel_m:.0f} m up"
    text = f"Last seen{_seen(vehicle)}{height}. It should land by itself{by}."
    return AttentionItem(key, Level.WARNING, name, title, text, ("show", "call_driver"), times_us)


def _seen(vehicle: VehicleFacts) -> str:
    return f" {vehicle.last_position}" if vehicle.last_position else ""


def _launch_item(launch: LaunchFacts, limits: AttentionLimits) -> AttentionItem:
    risk = f" Risk {launch.risk}" if launch.risk else ""
    if risk and limits.max_loss is not None:
        risk += f" (limit {format_loss(limits.max_loss)})"
    times_us = {} if launch.launch_by_us is None else {"by": launch.launch_by_us}
    text = f"Order {launch.order}.{risk}{'.' if risk else ''}"
    if times_us:
        text += " Launch by {by} to keep the plan."
    title = f"{launch.vehicle} waits for your launch"
    return AttentionItem(
        f"launch {launch.order}",
        Level.YOUR_TURN,
        launch.vehicle,
        title,
        text,
        (f"launch {launch.order}", "hold", "show"),
        times_us,
    )


def _stuck_item(order: str, reason: str) -> AttentionItem:
    actions = *(f"settle {end}" for end in ("delivered", "lost", "back")), "return"
    text = f"{reason}. Where is the parcel?"
    return AttentionItem(
        f"stuck {order}", Level.YOUR_TURN, order, f"{order} is stuck", text, (*actions, "show")
    )


def _late_item(order: str, text: str) -> AttentionItem:
    """`text`: `arrives 13 min after its window, ...`."""
    title, _, reason = text.partition(", ")
    actions = ("call", f"edit {order}", "show")
    return AttentionItem(
        f"late {order}", Level.CAUTION, order, f"{order} {title}", f"{reason}.", actions
    )


def _handover_items(handover: Handover | None) -> Iterator[AttentionItem]:
    if handover is None or handover.accepted_by:
        return
    text = "; ".join(f"{note.by}: {note.text}" for note in handover.notes)
    title, actions = f"{handover.by} has handed over the shift", ("show", "accept")
    text = f"At {{at}}. {text.rstrip('.')}."
    times_us = {"at": handover.at_us}
    yield AttentionItem(HANDOVER, Level.YOUR_TURN, HANDOVER, title, text, actions, times_us)


def _wind_items(fronts: Sequence[str], stations: Sequence[str]) -> Iterator[AttentionItem]:
    if fronts:
        title, actions = "A wind front approaches", ("hold_all",)
        yield AttentionItem(FRONT, Level.CAUTION, FRONT, title, "; ".join(fronts), actions)
    if stations:
        title = "A wind station is not used"
        yield AttentionItem("stations", Level.CAUTION, FRONT, title, "; ".join(stations), ())


def _idle_items(
    reasons: Mapping[str, str], held: Collection[str], what: str = "gets no orders"
) -> Iterator[AttentionItem]:
    for name, reason in reasons.items():
        actions = ("release", "show") if name in held else ("show",)
        title = f"{name} {what}"
        yield AttentionItem(
            f"idle {name}", Level.YOUR_TURN, name, title, f"{reason.rstrip('.')}.", actions
        )
