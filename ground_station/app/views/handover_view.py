"""Summary of the day for the next dispatcher."""

from collections.abc import Iterator, Mapping

from ground_station.app.views.day_content import DisplayRows
from ground_station.app.views.times import format_local_time
from ground_station.core.schema.holds import Handover
from ground_station.core.schema.orders import AssignmentState, OrderState


def handover_lines(
    rows: DisplayRows, phases: Mapping[str, str], handover: Handover | None
) -> Iterator[str]:
    """Yield the summary. `phases`: last reported phase, by assignment."""
    for row in rows.assignments:
        what = phases.get(row.id, row.state.value)
        if row.state is not AssignmentState.IN_FLIGHT:
            what = "launch to confirm" if row.id in rows.launch_requests else row.state.value
        place = "in the air" if row.state is AssignmentState.IN_FLIGHT else "on the ground"
        yield f"{place}: {row.vehicle} with {row.order_id}, {what}"
    waiting = [row.order.id for row in rows.orders if row.state is OrderState.OPEN]
    yield f"{len(waiting)} open orders: {', '.join(waiting)}".rstrip(": ")
    for row in rows.orders:
        if row.state is OrderState.STUCK:
            yield f"stuck: {row.order.id}: {row.reason}"
    for order_id, text in rows.late_orders.items():
        yield f"late: {order_id} {text}"
    for hold in rows.hold_list:
        since = "" if not hold.set_us else f", since {format_local_time(hold.set_us)}"
        yield f"hold: {hold.text}{since}"
    for name, place in rows.spares.items():
        yield f"spare: {name} in place of {place}"
    held = {hold.scope for hold in rows.hold_list}
    for name, reason in rows.idle_reasons.items():
        if name not in held:
            yield f"no orders: {name}: {reason}"
    if handover is None:
        return
    for note in handover.notes:
        yield f"note: {format_local_time(note.at_us)} {note.by}: {note.text}"
    end = "not accepted yet"
    if handover.accepted_by:
        end = f"accepted by {handover.accepted_by} at {format_local_time(handover.accepted_us)}"
    yield f"handed over by {handover.by} at {format_local_time(handover.at_us)}: {end}"
