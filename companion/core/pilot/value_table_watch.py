"""When a value table is asked for, and what becomes of the answer."""

import math
from dataclasses import dataclass

from companion.core.mission.actions import MakeTable, Note, Severity
from companion.core.mission.events import Event, TableMade
from companion.core.pilot.context import FlightContext, ReturnBudget, WindHold
from companion.core.pilot.transitions import Phase
from companion.core.return_budget.remaining_mission import OnTheWay
from companion.core.return_budget.value_table.mission_value import TableRequest

ALLOWED_S = 20.0
"""From request to answer: some ten times what a table takes on a desktop's core."""

AGAIN_S = 15.0
"""After an answer no table is asked for, for so long."""

CHECK_S = 1.0
WIND_MOVED_MPS = 2.0
TROUBLES = 3
"""After so many tables that came to nothing none is asked for any more."""

WAITING_PHASES = (Phase.READY, Phase.ARM)
FLYING_PHASES = (Phase.MEASURE, Phase.OUTBOUND)


@dataclass(slots=True)
class TableState:
    """The request that is being worked on, and how the last ones went."""

    asked: TableRequest | None = None
    answered_s: float | None = None
    checked_s: float | None = None
    troubles: int = 0


class ValueTableWatch:
    """Keeps a value table that serves the plan, the load and the wind."""

    def __init__(self, budget: ReturnBudget, flight: WindHold) -> None:
        self._state = TableState()
        self._budget = budget
        self._flight = flight

    def tick(self, context: FlightContext) -> None:
        """Ask for a table where there is none, or none that still serves."""
        state, flown, estimates = self._state, context.flight_plan, context.estimates
        if flown is None:
            estimates.table, state.asked = None, None
            return
        idle = state.asked is None and state.troubles < TROUBLES and not context.options.check_only
        if not idle or 0.0 <= context.since_s(state.checked_s) < CHECK_S - 1e-6:
            return
        state.checked_s = context.t_s
        at = self._where(context)
        why = self._why(context, at) if at is not None else ""
        if at is None or not why:
            return
        on_ground = context.phase in WAITING_PHASES
        request = estimates.table_request(flown.plan, at, on_ground=on_ground)
        if request is not None:
            state.asked = request
            context.do(Note(f"value table asked for: {why}"), MakeTable(request, ALLOWED_S))

    def on_event(self, context: FlightContext, event: Event) -> None:
        """Use a table that came for the plan that is flown; say once that there is none."""
        if not isinstance(event, TableMade):
            return
        state, flown = self._state, context.flight_plan
        asked, state.asked = state.asked, None
        state.answered_s = context.t_s
        if event.table is None:
            state.troubles += 1
            context.do(Note(f"no value table: {event.trouble}"))
            words = "no value table: the return budget alone decides"
            context.say_once(Severity.WARNING, words)
            return
        if asked is None or flown is None or asked.plan != flown.plan:
            return
        state.troubles = 0
        context.estimates.table = event.table
        size_mb, weight = event.table.size_bytes / 1e6, event.table.loss_weight
        words = f"value table: {size_mb:.1f} MB, a loss counts {weight:.3g} successes"
        context.do(Note(words))

    def _where(self, context: FlightContext) -> OnTheWay | None:
        if context.phase in WAITING_PHASES:
            return OnTheWay(0, 1.0)
        here = context.here_ned()
        if context.phase not in FLYING_PHASES or here is None:
            return None
        return self._budget.remaining(context, here).at

    def _why(self, context: FlightContext, at: OnTheWay) -> str:
        """Say why the table does not serve any more; `""` while it does."""
        estimates = context.estimates
        table, wind, settled_s = estimates.table, estimates.wind, self._flight.settled_s
        rested = context.since_s(self._state.answered_s) >= AGAIN_S
        if table is None:
            return "none yet" if rested else ""
        settle_s = context.flight.mission.wind_settle_s
        settled = settled_s is not None and context.t_s - settled_s >= settle_s
        known = settled and wind is not None and wind.valid
        if known and not table.wind_known:
            return "the wind is known"
        if not rested:
            return ""
        max_loss, payload_kg = estimates.limits.max_loss, estimates.payload_kg
        if table.max_loss != max_loss or table.payload_kg != payload_kg:
            return "the load or what is accepted has changed"
        if known and wind is not None:
            north, east = wind.mean_to_ne_mps
            moved_mps = math.dist((east, north), table.made_for_en_mps)
            if moved_mps > WIND_MOVED_MPS:
                return f"wind moved by {moved_mps:.1f} m/s"
        reading = estimates.reading(at)
        if reading is not None and not reading.keeps(table.max_loss) and not table.keeps_nothing:
            return f"its P(home) {reading.p_home:.3f} is under what is accepted"
        return ""
