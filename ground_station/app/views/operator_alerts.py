"""Items for the operator's attention, equal on terminal and map."""

from collections.abc import Iterator, Sequence

from companion.fleet.roster import WARN_DAYS
from ground_station.app.views.day_content import DayShown
from ground_station.core.fleet.certificate_ends import CertificateExpiry, days_until_expiry
from ground_station.core.fleet.fleet_status import VehicleStatus
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.schema.orders import OrderRow, OrderState

CERTIFICATES_SUBJECT, DESK_SUBJECT = "certificates", "desk"
MAX_NAMED = 5
"""Maximum number of certificates named in one line; the others are counted."""


def prelaunch_silence_reason(vehicle_status: VehicleStatus, day: DayShown | None) -> str | None:
    """Return the location of a silent drone if its silence is expected."""
    if day is None or vehicle_status.vehicle == TRUCK or vehicle_status.instance_ids:
        return None
    sortie = day.active_sortie_of(vehicle_status.vehicle)
    if sortie is None:
        return "on the truck"
    if sortie.launched_us is not None:
        return None
    return "starting up" if sortie.put_on_pad else "to be put out"


def vehicle_alarm_texts(
    vehicle_status: VehicleStatus, day: DayShown | None, t_s: float
) -> Iterator[str]:
    """Return the faults of one member."""
    state = vehicle_status.state
    yield from vehicle_status.doubts
    if state is not None and state.monitor_text:
        yield state.monitor_text
    if prelaunch_silence_reason(vehicle_status, day) is None and not vehicle_status.instance_ids:
        yield "not on the network"
    elif (
        vehicle_status.instance_ids
        and not vehicle_status.is_uniquely_online_and_reporting(t_s)
        and state is not None
    ):
        yield f"silent for {vehicle_status.seconds_since_last_state(t_s) or 0.0:.0f} s"
    if state and state.armed and state.assignment and (state.margin_wh or 0.0) < 0.0:
        yield f"{-(state.margin_wh or 0.0):.1f} Wh short of its promise"


def stuck_order_texts(orders: Sequence[OrderRow]) -> Iterator[tuple[str, str]]:
    """Return orders that wait for the operator, with the reason."""
    stuck_rows = (row for row in orders if row.state is OrderState.STUCK)
    yield from ((row.order.id, f"is stuck: {row.reason}") for row in stuck_rows)


def expiring_certificates_text(certificates: CertificateExpiry | None, now_us: int) -> str:
    """Return certificates that expire within a month, soonest first; empty: none does.

    All are in one line because the certificates of a fleet often expire on the same day.
    """
    if certificates is None:
        return ""
    own = [] if certificates.own_expiry_us is None else [("your own", certificates.own_expiry_us)]
    ends = [
        (owner, days_until_expiry(end_us, now_us))
        for owner, end_us in [*own, *certificates.member_expiries_us]
    ]
    expiring = [
        f"{owner} has ended" if days < 0.0 else f"{owner} ends in {days:.0f} days"
        for owner, days in ends
        if days <= WARN_DAYS
    ]
    if not expiring:
        return ""
    others = f" and {len(expiring) - MAX_NAMED} others" if len(expiring) > MAX_NAMED else ""
    return f"{', '.join(expiring[:MAX_NAMED])}{others} (ground-station pki renew)"
