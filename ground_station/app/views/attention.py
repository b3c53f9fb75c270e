"""What wants a person's eye: the same for who watches a terminal and who watches the map."""

from collections.abc import Iterator, Sequence

from companion.fleet.messages import State
from companion.fleet.roster import WARN_DAYS
from ground_station.app.views.watched_rows import DayShown
from ground_station.core.fleet.desk_figures import CertificateFigures, days_left
from ground_station.core.fleet.fleet_status import VehicleStatus
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.schema.orders import OrderRow, OrderState

CERTIFICATES = "certificates"
NAMED = 5
"""Certificates that are named in one line; the others are counted."""


def expected_silence(seen: VehicleStatus, day: DayShown | None) -> str | None:
    """Where a silent drone is, if its silence is expected."""
    if day is None or seen.vehicle == TRUCK or seen.lives:
        return None
    sortie = day.sortie(seen.vehicle)
    if sortie is None:
        return "on the truck"
    if sortie.launched_us is not None:
        return None
    return "starting up" if sortie.placed else "to be put out"


def vehicle_alarms(seen: VehicleStatus, day: DayShown | None, t_s: float) -> Iterator[str]:
    """What is wrong with one member."""
    state = seen.state
    yield from seen.doubts
    if state is not None and state.doubt:
        yield state.doubt
    if expected_silence(seen, day) is None and not seen.lives:
        yield "not on the network"
    elif seen.lives and not seen.present(t_s) and state is not None:
        yield f"not heard for {seen.silent_s(t_s) or 0.0:.0f} s"
    if state is not None and flies(state) and (state.margin_wh or 0.0) < 0.0:
        yield f"{-(state.margin_wh or 0.0):.1f} Wh short of its promise"


def flies(state: State) -> bool:
    """Whether its motors may turn for an assignment."""
    return bool(state.armed and state.assignment)


def stuck_orders(orders: Sequence[OrderRow]) -> Iterator[tuple[str, str]]:
    """Orders that wait for a person, and why."""
    stuck = (row for row in orders if row.state is OrderState.STUCK)
    yield from ((row.order.id, f"is stuck: {row.why}") for row in stuck)


def ending_certificates(certificates: CertificateFigures | None, now_us: int) -> str:
    """Whose certificates end within a month, soonest first; empty: nobody's.

    In one line: a fleet that was set up on one day ends on one day.
    """
    if certificates is None:
        return ""
    own = [] if certificates.own_us is None else [("your own", certificates.own_us)]
    ends = [(who, days_left(end_us, now_us)) for who, end_us in [*own, *certificates.members_us]]
    soon = [_ends(who, days) for who, days in ends if days <= WARN_DAYS]
    if not soon:
        return ""
    others = f" and {len(soon) - NAMED} others" if len(soon) > NAMED else ""
    return f"{', '.join(soon[:NAMED])}{others} (ground-station pki renew)"


def _ends(who: str, days: float) -> str:
    return f"{who} has ended" if days < 0.0 else f"{who} ends in {days:.0f} days"
