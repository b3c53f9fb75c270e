"""When a value table is asked for, and what becomes of the answer."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from companion.core.mission.actions import MakeTable, Note, Severity
from companion.core.mission.events import TableMade
from companion.core.pilot.budget_question import here_ned, what_is_ahead
from companion.core.pilot.transitions import Phase
from companion.core.return_budget.remaining_mission import OnTheWay
from companion.core.return_budget.value_table.mission_value import TableRequest

if TYPE_CHECKING:
    from companion.core.pilot.pilot import Pilot

ALLOWED_S = 20.0
"""From request to answer: some ten times what a table takes on a desktop's core."""

AGAIN_S = 15.0
"""After an answer no table is asked for, for so long."""

LOOK_S = 1.0
WIND_MOVED_MPS = 2.0
TROUBLES = 3
"""After so many tables that came to nothing none is asked for any more."""

WAITING_PHASES = (Phase.READY, Phase.ARM)
FLYING_PHASES = (Phase.MEASURE, Phase.OUTBOUND)


@dataclass(slots=True)
class TableWatch:
    """The request that is being worked on, and how the last ones went."""

    asked: TableRequest | None = None
    answered_s: float = -1e9
    looked_s: float = -1e9
    troubles: int = 0


def mind(pilot: Pilot) -> None:
    """Ask for a table where there is none, or none that still serves."""
    watch, flown = pilot.tables, pilot.flown
    if flown is None:
        pilot.judge.table, watch.asked = None, None
        return
    t_s = pilot.now.t_s
    idle = watch.asked is None and watch.troubles < TROUBLES and not pilot.options.check_only
    if not idle or 0.0 <= t_s - watch.looked_s < LOOK_S - 1e-6:
        return
    watch.looked_s = t_s
    at = _where(pilot)
    why = _why(pilot, at) if at is not None else ""
    if at is None or not why:
        return
    request = pilot.judge.table_request(flown.plan, at, on_ground=pilot.phase in WAITING_PHASES)
    if request is not None:
        watch.asked = request
        pilot.do(Note(f"value table asked for: {why}"), MakeTable(request, ALLOWED_S))


def take(pilot: Pilot, event: TableMade) -> None:
    """Use a table that came for the plan that is flown; say once that there is none."""
    watch, flown = pilot.tables, pilot.flown
    asked, watch.asked = watch.asked, None
    watch.answered_s = pilot.now.t_s
    if event.table is None:
        watch.troubles += 1
        pilot.do(Note(f"no value table: {event.trouble}"))
        pilot.say_once(Severity.WARNING, "no value table: the return budget alone decides")
        return
    if asked is None or flown is None or asked.plan != flown.plan:
        return
    watch.troubles = 0
    pilot.judge.table = event.table
    size_mb, weight = event.table.size_bytes / 1e6, event.table.loss_weight
    pilot.do(Note(f"value table: {size_mb:.1f} MB, a loss counts {weight:.3g} successes"))


def _where(pilot: Pilot) -> OnTheWay | None:
    if pilot.phase in WAITING_PHASES:
        return OnTheWay(0, 1.0)
    here = here_ned(pilot)
    if pilot.phase not in FLYING_PHASES or here is None:
        return None
    return what_is_ahead(pilot, here).at


def _why(pilot: Pilot, at: OnTheWay) -> str:
    """Say why the table will not do any more; `""` while it does."""
    table, judge, now, air = pilot.judge.table, pilot.judge, pilot.now, pilot.air
    rested = now.t_s - pilot.tables.answered_s >= AGAIN_S
    if table is None:
        return "none yet" if rested else ""
    wind, settle_s = judge.wind, pilot.flight.mission.wind_settle_s
    settled = air.settled_s is not None and now.t_s - air.settled_s >= settle_s
    known = settled and wind is not None and wind.valid
    if known and not table.wind_known:
        return "the wind is known"
    if not rested:
        return ""
    if table.max_loss != judge.limits.max_loss or table.payload_kg != judge.payload_kg:
        return "the load or what is accepted has changed"
    if known and wind is not None:
        north, east = wind.mean_to_ne_mps
        moved_mps = math.dist((east, north), table.made_for_en_mps)
        if moved_mps > WIND_MOVED_MPS:
            return f"wind moved by {moved_mps:.1f} m/s"
    reading = judge.reading(at)
    if reading is not None and not reading.keeps(table.max_loss) and not table.keeps_nothing:
        return f"its P(home) {reading.p_home:.3f} is under what is accepted"
    return ""
