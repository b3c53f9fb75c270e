"""The desk's watch over the forecast: its file, what the fleet felt against it, and launches that
it closes.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from companion.core.base.errors import LeewayError
from companion.core.base.geo import Ned, place_ned
from companion.core.mission.flight_plan import frame_at
from ground_station.adapters.files.followed_file import FollowedFile
from ground_station.adapters.store.order_store import Store
from ground_station.core.dispatch.launch_promise import (
    Closing,
    PromisedSorties,
    closing_of,
    hour_words,
)
from ground_station.core.dispatch.wind_holds import HELD_BY
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.planning.launch_windows import SortieInForecast
from ground_station.core.schema.day import Drone, Forecast
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_forecast import DayForecast
from ground_station.core.schema.day_plan import PlannedSortie, PlannedStop
from ground_station.core.schema.holds import Hold
from ground_station.core.schema.orders import AssignmentRow, Order, OrderState, Service, place_of
from ground_station.core.schema.sortie_rows import SortieRow
from ground_station.core.site_wind.followed_forecast import FollowedForecast
from ground_station.core.site_wind.site_wind import SiteWind

EXPECT_S = 60.0
"""What is expected before anybody tells moves on so often."""

SAY_S = 1800.0
"""How good the forecast was is said so often, and when it is off or no longer."""

LOOK_S = 30.0
"""A launch that waits is judged anew so often, and where the forecast is another."""

LEAST_SHUT_S, PATIENCE_S = 300.0, 1800.0
"""A launch that was closed stays so for a while. One that does not open again within half an hour
is given back after that while: its drone and its order are free for others, and a person has had
time to release it.
"""

ORDERS_A_TURN = 2
"""Closings of open orders that are worked out in a turn: each takes some 20 ms."""

ROUND_S = 120.0
"""All open orders are looked at so often, or as fast as that goes."""

URGENT_S = 3600.0
"""Orders that are closed within the hour go first."""

MOVED_S = 600.0
"""A closing that has moved by less is not said again."""


@dataclass(frozen=True, slots=True)
class _Verdict:
    """A waiting launch: when it was judged, and why and since when it is closed."""

    vehicle: str
    looked_s: float
    version: int
    why: str = ""
    since_s: float = math.inf
    again_s: float | None = None


@dataclass(slots=True)
class ForecastWatch:
    """One desk's. `file`: None where nothing newer can come.
    `at_depot`: open orders are judged, too; with a truck that is the plan's.
    """

    follows: FollowedForecast
    file: FollowedFile | None
    data: DayData
    wind: SiteWind
    store: Store
    clock: Clock
    say: Callable[[str], None]
    at_depot: bool
    closings: dict[str, Closing] = field(default_factory=dict)
    """Of open orders, as they were looked at last."""
    sorties: PromisedSorties = field(init=False)
    _verdicts: dict[str, _Verdict] = field(default_factory=dict)
    _said: dict[str, float | None] = field(default_factory=dict)
    _waiting: list[Order] = field(default_factory=list)
    _round: dict[str, Closing] = field(default_factory=dict)
    _round_s: float = -math.inf
    _expected_s: float = -math.inf
    _score_said_s: float | None = None
    _was_off: bool = False
    _end_said: bool = False
    _ned: dict[str, Ned] = field(default_factory=dict)
    _kinds: list[Drone] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.sorties = PromisedSorties(self.data)
        kinds = {
            (d.airframe, d.charge_frac, d.temperature_c, d.battery_health_frac): d
            for d in self.data.day.drones
        }
        self._kinds = list(kinds.values())
        self._score_said_s = self.clock.monotonic_s()

    def turn(self, now_s: float) -> None:
        """Look at the file, at what the fleet feels, and at some open orders. Raises StoreError."""
        self._look_at_file(now_s)
        self.follows.compare(self.wind)
        if now_s - self._expected_s >= EXPECT_S:
            self._expected_s = now_s
            self.wind.expect(self.follows.unbiased(now_s))
        self._say_score(now_s)
        self._say_end()
        if self.at_depot:
            self._look_at_orders(now_s)

    def expected(self, ahead_s: float = 0.0) -> Forecast:
        """The wind forecast at cruise height some time from now, with what the fleet felt."""
        return self.follows.expected(self.clock.monotonic_s() + ahead_s)

    # --- the file ------------------------------------------------------------------------------

    def _look_at_file(self, now_s: float) -> None:
        found = None if self.file is None else self.file.look(now_s)
        if found is None:
            return
        try:
            if isinstance(found, LeewayError):
                raise found
            self.follows.take(found)
        except LeewayError as error:
            self.say(f"LOOK: forecast not taken, the old one goes on: {error}")
            return
        self._expected_s, self._round_s, self._end_said = -math.inf, -math.inf, False
        wind, height_m = self.follows.now.wind(now_s, self.follows.height_m), self.follows.height_m
        self.say(f"a newer forecast: {wind} at {height_m:.0f} m now")

    def _say_score(self, now_s: float) -> None:
        score = self.follows.score
        is_off = score is not None and score.is_off
        due = self._score_said_s is None or now_s - self._score_said_s >= SAY_S
        if score is None or not (due or is_off != self._was_off):
            return
        self._score_said_s, self._was_off = now_s, is_off
        self.say(score.words)

    def _say_end(self) -> None:
        if self._end_said or not self.follows.has_ended:
            return
        self._end_said = True
        self.say(
            "LOOK: the forecast says nothing of now: its last wind counts on; launches are closed"
            " by nothing that it says"
        )

    # --- launches that wait --------------------------------------------------------------------

    def held(
        self,
        rows: Iterable[AssignmentRow],
        orders: Mapping[str, Order],
        sorties: Mapping[str, SortieRow],
        now_s: float,
    ) -> dict[str, str]:
        """Who is to be held, and why: assignments whose launch now is not promised."""
        found: dict[str, str] = {}
        forecast = self.follows.now
        kept: dict[str, _Verdict] = {}
        for row in rows:
            order = orders.get(row.order_id)
            if order is None:
                continue
            verdict = self._verdict(row, order, sorties.get(row.id), forecast, now_s)
            kept[row.id] = verdict
            if verdict.why:
                found[row.vehicle] = verdict.why
        self._verdicts = kept
        return found

    def given_back(self, holds: Iterable[Hold]) -> dict[str, str]:
        """Assignments that have been closed for a while and stay so, and why. Not those whose hold
        a person has released.
        """
        now_s = self.clock.monotonic_s()
        held = {hold.scope for hold in holds if hold.by == HELD_BY}
        return {
            id_: one.why
            for id_, one in self._verdicts.items()
            if one.why
            and now_s - one.since_s >= LEAST_SHUT_S
            and (one.again_s is None or one.again_s - now_s > PATIENCE_S)
            and one.vehicle in held
        }

    def _verdict(
        self,
        row: AssignmentRow,
        order: Order,
        sortie: SortieRow | None,
        forecast: DayForecast,
        now_s: float,
    ) -> _Verdict:
        before = self._verdicts.get(row.id)
        version = self.follows.version
        if before is not None:
            fresh = now_s - before.looked_s < LOOK_S and before.version == version
            if fresh or (before.why and now_s - before.since_s < LEAST_SHUT_S):
                return before
        flown = self._sortie_of(row, order, sortie, forecast, now_s)
        words = "" if flown is None else flown.forbidden_by(now_s)
        if flown is None or not words:
            return _Verdict(row.vehicle, now_s, version)
        again_s = closing_of(flown, now_s).again_s
        why = (
            f"order {order.id} is not promised: {words} by the forecast, launched at"
            f" {hour_words(forecast, now_s)}{again_words(forecast, again_s)}"
        )
        since_s = before.since_s if before is not None and before.why else now_s
        return _Verdict(row.vehicle, now_s, version, why, since_s, again_s)

    def _sortie_of(
        self,
        row: AssignmentRow,
        order: Order,
        sortie: SortieRow | None,
        forecast: DayForecast,
        now_s: float,
    ) -> SortieInForecast | None:
        if sortie is not None:
            if sortie.promised not in sortie.pads or sortie.sortie.launch not in sortie.pads:
                return None
            pads = sortie.pads[sortie.sortie.launch], sortie.pads[sortie.promised]
            return self.sorties.by_plan(order, sortie.sortie, pads, forecast)
        drone = self.data.day.drone(row.vehicle)
        if drone is None:
            return None
        wind, layer = self.follows.expected(now_s), row.layer or 0
        return self.sorties.from_depot(order, self._ground(order), drone, layer, forecast, wind)

    def _ground(self, order: Order) -> Ned:
        if order.id not in self._ned:
            frame = frame_at(self.data.day.depot.place)
            self._ned[order.id] = place_ned(frame, place_of(order))
        return self._ned[order.id]

    # --- open orders of a depot ----------------------------------------------------------------

    def shut(self) -> frozenset[str]:
        """Open orders that are not promised now: they are given to nobody."""
        now_s = self.clock.monotonic_s()
        return frozenset(id_ for id_, one in self.closings.items() if one.is_shut(now_s))

    def urgent(self) -> list[str]:
        """Open orders that are promised now and not any more in an hour, the first to close
        first.
        """
        now_s = self.clock.monotonic_s()
        soon = [
            (one.until_s, id_)
            for id_, one in self.closings.items()
            if one.until_s is not None and 0.0 <= one.until_s - now_s <= URGENT_S
        ]
        return [id_ for _, id_ in sorted(soon)]

    def opens_again(self) -> bool:
        """Whether an order that is closed now is promised again in what is looked at."""
        now_s = self.clock.monotonic_s()
        return any(one.again_s is not None and one.is_shut(now_s) for one in self.closings.values())

    def why_left(self, order: str) -> str | None:
        """Why an open order is given to nobody, in words; None: the forecast closes nothing."""
        closing = self.closings.get(order)
        if closing is None or not closing.is_shut(self.clock.monotonic_s()):
            return None
        return f"{closing.wind} by the forecast{again_words(self.follows.now, closing.again_s)}"

    def _look_at_orders(self, now_s: float) -> None:
        if not self._waiting:
            if now_s - self._round_s < ROUND_S:
                return
            self._round_s = now_s
            rows = self.store.orders(OrderState.OPEN)
            self._waiting = [r.order for r in rows if r.order.service is not Service.TRUCK]
            self._round = {}
        forecast, wind = self.follows.now, self.follows.expected(now_s)
        for order in self._waiting[:ORDERS_A_TURN]:
            self._round[order.id] = self._closing(order, forecast, wind, now_s)
        del self._waiting[:ORDERS_A_TURN]
        if not self._waiting:
            self.closings = self._round
            self._say_closings(forecast)

    def _closing(
        self, order: Order, forecast: DayForecast, wind: Forecast, now_s: float
    ) -> Closing:
        """Of the kind of drone that may bring it longest."""
        found: list[Closing] = []
        for drone in self._kinds:
            if order.mass_kg > self.data.airframes[drone.airframe].mass.max_payload_kg:
                continue
            ground = self._ground(order)
            flown = self.sorties.from_depot(order, ground, drone, 0, forecast, wind)
            closing = closing_of(flown, now_s)
            if closing.until_s is None:
                return closing
            found.append(closing)
        if not found:
            return Closing(order.id, None)
        return max(found, key=lambda one: (one.until_s or 0.0, -(one.again_s or math.inf)))

    def _say_closings(self, forecast: DayForecast) -> None:
        """Those that are new or have moved; what closes at one time is one line."""
        groups: dict[tuple[float, float | None], list[Closing]] = {}
        for one in self.closings.values():
            said_s = self._said.get(one.order)
            moved = said_s is None or one.until_s is None or abs(one.until_s - said_s) >= MOVED_S
            if one.until_s is None:
                if said_s is not None:
                    self.say(f"order {one.order} is promised again")
                self._said.pop(one.order, None)
            elif moved and not (said_s is not None and one.until_s < self.clock.monotonic_s()):
                self._said[one.order] = one.until_s
                groups.setdefault((one.until_s, one.again_s), []).append(one)
        for (until_s, again_s), group in sorted(groups.items(), key=lambda item: item[0][0]):
            self.say(closing_words(forecast, until_s, again_s, group, self.clock.monotonic_s()))


def closing_words(
    forecast: DayForecast,
    until_s: float,
    again_s: float | None,
    group: Sequence[Closing],
    now_s: float,
) -> str:
    """A line for orders that close at one time."""
    names = [one.order for one in group]
    shown = ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
    who = f"order {shown} is" if len(names) == 1 else f"orders {shown} are"
    again = again_words(forecast, again_s)
    why = f"{who} not promised: {group[0].wind} by the forecast{again}"
    return why if until_s < now_s else f"after {hour_words(forecast, until_s)} {why}"


def again_words(forecast: DayForecast, again_s: float | None) -> str:
    """From when a launch is promised again, for people; empty: not in what was looked at."""
    return "" if again_s is None else f"; again from {hour_words(forecast, again_s)}"


def plan_closes(
    watch: ForecastWatch,
    sorties: Iterable[tuple[PlannedSortie, float]],
    stops: Mapping[str, PlannedStop],
    orders: Mapping[str, Order],
) -> dict[str, str]:
    """Planned sorties that the forecast does not let fly when they are due, each with the wind.

    `sorties`: with the time of launch that is expected now, by the desk's monotonic clock.
    """
    forecast = watch.follows.now
    found: dict[str, str] = {}
    for sortie, launch_s in sorties:
        order = orders.get(sortie.order)
        launch, home = stops.get(sortie.launch), stops.get(sortie.home)
        if order is None or launch is None or home is None:
            continue
        start, end = launch.pads.get(sortie.vehicle), home.pads.get(sortie.vehicle)
        if start is None or end is None:
            continue
        flown = watch.sorties.by_plan(order, sortie, (start, end), forecast)
        words = "" if flown is None else flown.forbidden_by(launch_s)
        if words:
            found[sortie.order] = words
    return found
