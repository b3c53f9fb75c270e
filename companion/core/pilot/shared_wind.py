"""What the fleet told of the wind, as the gate's outlook takes it in and as people are told of it.

Nothing of it outlives a restart: a vehicle that begins anew flies by its own wind until it has been
told again.
"""

import numpy as np

from companion.core.base.geo import Ned, offset_m
from companion.core.pilot.telemetry_state import POSITION_MAX_AGE_S, TelemetryState
from companion.core.return_budget.remaining_mission import Ahead
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import WindAhead, WindOutlook
from companion.core.wind.process import WindProcessParams
from companion.core.wind_field.field_process import FieldPoints, FieldProcess
from companion.core.wind_field.fleet_wind import OWN, FleetWind, others_words, wind_words
from companion.core.wind_field.fronts import FrontAhead
from companion.core.wind_field.shared_outlook import FrontOutlook, SharedOutlook
from companion.core.wind_field.shared_winds import SharedWinds
from companion.core.wind_field.tellings import WindTelling

WORDS = "wind of the fleet"
SHOWN_S = 300.0
"""People are told the mean of the next five minutes."""

LEAST_HEIGHT_M = 10.0
"""Lower it is the wind between houses and over the pad: as the desk has it."""


class SharedWind:
    """One vehicle's. `process` is the one that its own outlook rests on."""

    def __init__(self, process: WindProcessParams) -> None:
        self._tail_dof = process.tail_dof
        self._fleet = FleetWind(FieldProcess(process))
        self._origin_deg: tuple[float, float] | None = None
        self._here: tuple[float, float, float] | None = None
        self._said = ""
        self._front_said: FrontAhead | None = None
        self._withdrawn = False
        """And people are not told yet."""

    def feel(self, now: TelemetryState, wind: WindBelief) -> None:
        """Take one's own wind at a tick in the air."""
        position = now.position
        if position is None or not now.is_fresh(position, POSITION_MAX_AGE_S) or not wind.valid:
            return
        north, east = self._place(position.lat_deg, position.lon_deg)
        self._here = north, east, position.height_rel_m
        if position.height_rel_m < LEAST_HEIGHT_M:
            return
        mean = wind.mean_to_ne_mps
        nn, ne, ee = (float(wind.cov_ne_m2ps2[at]) for at in ((0, 0), (0, 1), (1, 1)))
        to_ne = float(mean[0]), float(mean[1])
        self._fleet.feel(
            WindTelling(OWN, now.t_s, (north, east), position.height_rel_m, to_ne, (nn, ne, ee))
        )

    def hear(self, winds: SharedWinds, t_s: float, age_s: float) -> None:
        """Take a word of the desk's that was valid from `age_s` before `t_s` on."""
        self._place(winds.lat_deg, winds.lon_deg)
        assert self._origin_deg is not None
        as_of_s = t_s - age_s
        told = winds.tellings(self._origin_deg, as_of_s)
        self._fleet.hear(told, winds.front_ahead(self._origin_deg, as_of_s), t_s)
        if winds.front is None and self._fleet.withdraw_front():
            self._withdrawn = True

    def outlook(self, ahead: Ahead, own: WindOutlook, t_s: float) -> WindAhead:
        """The outlook to ask the gate with: of the field, or one's own."""
        field = self._fleet.used(t_s)
        shift = self._shift(ahead)
        if field is None or shift is None or self._here is None:
            return own
        height_m = max(self._here[2], LEAST_HEIGHT_M)
        return SharedOutlook(field, height_m, shift, self._tail_dof)

    def with_front(self, ahead: Ahead, outlook: WindAhead, t_s: float) -> WindAhead | None:
        """The same, were the front to come that was told; None: none is on its way here."""
        shift, here = self._shift(ahead), self._here
        if shift is None or here is None:
            return None
        front = self._fleet.front_at(t_s, here[:2])
        return None if front is None else FrontOutlook(outlook, front, shift)

    def used_words(self, t_s: float) -> str:
        """By whom a decision's wind is known besides oneself; empty: by nobody."""
        field = self._fleet.used(t_s)
        return "" if field is None else f"{WORDS}: {others_words(field)}"

    def news(self, t_s: float, own: WindOutlook, belief: WindBelief) -> tuple[str, ...]:
        """What is new of it, in words: that it is used or not, and a front that comes."""
        said: list[str] = []
        field = self._fleet.used(t_s)
        state = "" if field is None else others_words(field)
        now = state or self._fleet.why_not
        if now != self._said:
            before, self._said = self._said, now
            if field is not None and belief.valid:
                said.append(f"{WORDS}: {state}: {self._compared(t_s, own, belief)}")
            elif field is None and (now or before):
                said.append(f"{WORDS}: not used, {now or 'nobody tells'}: own wind alone")
        return (*said, *self._front_news(t_s))

    def _front_news(self, t_s: float) -> tuple[str, ...]:
        if self._withdrawn:
            self._withdrawn, self._front_said = False, None
            return (f"{WORDS}: the front is withdrawn",)
        here = self._here
        front = None if here is None else self._fleet.front_at(t_s, here[:2])
        if here is None or front is None or front is self._front_said:
            return ()
        self._front_said = front
        due_s, std_s = front.arrives(here[:2])
        felt = front.felt[0]
        return (
            f"{WORDS}: a front of {felt.size_mps:.0f} m/s, here in {due_s - t_s:.0f} +- {std_s:.0f}"
            f" s, behind it {wind_words(felt.wind_ne_mps)}",
        )

    def _compared(self, t_s: float, own: WindOutlook, belief: WindBelief) -> str:
        """The mean of the next minutes here by the field, and by oneself alone."""
        field = self._fleet.used(t_s)
        assert field is not None
        assert self._here is not None
        north, east, height_m = self._here
        middle = np.array([0.5 * SHOWN_S])
        points = FieldPoints(np.array([[north, east]]), np.array([height_m]), t_s + middle)
        found = field.forecast(points, SHOWN_S)
        alone = own.forecast(belief, middle, SHOWN_S)
        fleet, lonely = (
            wind_words((float(each.mean_to_ne_mps[0, 0]), float(each.mean_to_ne_mps[0, 1])))
            for each in (found, alone)
        )
        var = max(float(found.north_cov_m2ps2[0, 0]), float(found.east_cov_m2ps2[0, 0]))
        return f"next {SHOWN_S / 60.0:.0f} min {fleet} +- {var**0.5:.1f}, own alone {lonely}"

    def _place(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        if self._origin_deg is None:
            self._origin_deg = lat_deg, lon_deg
        return offset_m(*self._origin_deg, lat_deg, lon_deg)

    def _shift(self, ahead: Ahead) -> tuple[float, float] | None:
        """From the places of what is left to fly, which begins here, to the field's."""
        start = _start(ahead)
        if self._here is None or start is None:
            return None
        return self._here[0] - start[0], self._here[1] - start[1]


def _start(ahead: Ahead) -> Ned | None:
    """Where the vehicle is: each way home from here begins there."""
    legs = ahead.ways_home_now[0].legs
    return legs[0].from_ned_m if legs else None
