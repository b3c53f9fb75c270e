"""Battery readings of one source for one pack: consumption counters and a percentage.

Each source (SYS_STATUS, BATTERY_STATUS of each pack) has its own state, so that a difference
between two packs or messages is no fall. A reading that rose, or fell faster than the vehicle can
draw, is pending. `CONSISTENT_READINGS` pending readings in a row replace the accepted value.
"""

from dataclasses import dataclass, field

CONSISTENT_READINGS = 3
"""Consistent readings that replace the accepted value: a reset gauge is accepted after 1.5 s."""

MAX_DELAY_S = 1.0
"""Maximum delay of a message whose successor is on time."""

TOLERANCE_FRAC = 0.03
"""Tolerance of percentages: whole per cents, rounded in two ways, some filtered by voltage."""


@dataclass(slots=True)
class Counter:
    """Consumption counter. `counted_wh` is the count since the start; None: never received."""

    last: float | None = None
    t_s: float = 0.0
    counted_wh: float | None = None
    doubted: list[tuple[float, float]] = field(default_factory=list)

    def update_from_reading(
        self,
        t_s: float,
        counter_reading: float,
        wh_per_count: float,
        max_draw_w: float,
        has_started: bool,
    ) -> None:
        """Process a reading in units of `wh_per_count`. Before the start it only sets the
        baseline.
        """
        if self.last is None or not has_started:
            self._accept_reading(t_s, counter_reading, 0.0, counter_reading > 0.0)
        elif (
            0.0
            <= (counter_reading - self.last) * wh_per_count
            <= _max_consumption_wh(self.t_s, t_s, max_draw_w)
        ):
            self._accept_reading(
                t_s,
                counter_reading,
                (counter_reading - self.last) * wh_per_count,
                counter_reading > 0.0,
            )
        else:
            self._add_pending_reading(t_s, counter_reading, wh_per_count, max_draw_w)

    def _accept_reading(
        self, t_s: float, counter_reading: float, newly_consumed_wh: float, is_counting: bool
    ) -> None:
        if self.counted_wh is not None or is_counting:
            self.counted_wh = (self.counted_wh or 0.0) + newly_consumed_wh
        self.last, self.t_s = counter_reading, t_s
        self.doubted.clear()

    def _add_pending_reading(
        self, t_s: float, counter_reading: float, wh_per_count: float, max_draw_w: float
    ) -> None:
        if self.doubted:
            before_s, before = self.doubted[-1]
            if (
                not 0.0
                <= (counter_reading - before) * wh_per_count
                <= _max_consumption_wh(before_s, t_s, max_draw_w)
            ):
                self.doubted.clear()
        self.doubted.append((t_s, counter_reading))
        if len(self.doubted) >= CONSISTENT_READINGS:
            first_s, first = self.doubted[0]
            # The counter restarted, from 0 (reboot) or elsewhere: add at most the possible draw.
            unobserved_wh = min(
                first * wh_per_count, max_draw_w * max(first_s - self.t_s, 0.0) / 3600.0
            )
            self._accept_reading(
                t_s, counter_reading, unobserved_wh + (counter_reading - first) * wh_per_count, True
            )


@dataclass(slots=True)
class Percentage:
    """Charge from 0 to 1. `left_frac` never rises during a flight."""

    left_frac: float | None = None
    last_frac: float = 0.0
    t_s: float = 0.0
    doubted: list[float] = field(default_factory=list)

    def update_and_report_replacement_at_start(
        self, t_s: float, charge_frac: float, full_wh: float, max_draw_w: float, has_started: bool
    ) -> bool:
        """Process a reading. Returns True if it replaced the accepted value before the start."""
        max_drop_frac = _max_consumption_wh(self.t_s, t_s, max_draw_w) / full_wh + TOLERANCE_FRAC
        if self.left_frac is None:
            self.left_frac = charge_frac
            self._accept_reading(t_s, charge_frac)
        elif self.last_frac - max_drop_frac <= charge_frac <= self.last_frac + TOLERANCE_FRAC:
            self._accept_and_subtract_drop(t_s, min(charge_frac, self.last_frac))
        else:
            return self._add_pending_and_report_replacement(t_s, charge_frac, has_started)
        return False

    @property
    def pending_drop_frac(self) -> float:
        """Amount by which the latest pending reading is below the accepted one."""
        return max(self.last_frac - self.doubted[-1], 0.0) if self.doubted else 0.0

    def _accept_reading(self, t_s: float, charge_frac: float) -> None:
        self.last_frac, self.t_s = charge_frac, t_s
        self.doubted.clear()

    def _accept_and_subtract_drop(self, t_s: float, charge_frac: float) -> None:
        self.left_frac = max((self.left_frac or 0.0) - (self.last_frac - charge_frac), 0.0)
        self._accept_reading(t_s, charge_frac)

    def _add_pending_and_report_replacement(
        self, t_s: float, charge_frac: float, has_started: bool
    ) -> bool:
        if self.doubted and abs(charge_frac - self.doubted[-1]) > TOLERANCE_FRAC:
            self.doubted.clear()
        self.doubted.append(charge_frac)
        if len(self.doubted) < CONSISTENT_READINGS:
            return False
        if not has_started:
            self.left_frac = charge_frac
        elif charge_frac < self.last_frac:
            self._accept_and_subtract_drop(t_s, charge_frac)
        self._accept_reading(t_s, charge_frac)
        return not has_started


@dataclass(slots=True)
class Gauge:
    """Counters and percentage of one source."""

    energy: Counter = field(default_factory=Counter)
    charge: Counter = field(default_factory=Counter)
    percentage: Percentage = field(default_factory=Percentage)


def _max_consumption_wh(previous_reading_s: float, t_s: float, max_draw_w: float) -> float:
    """Return the maximum consumption from one reading to the next."""
    return max_draw_w * (max(t_s - previous_reading_s, 0.0) + MAX_DELAY_S) / 3600.0
