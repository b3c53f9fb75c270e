"""What one source says of one pack: counters of what was used, and a percentage.

Sources are kept apart (SYS_STATUS, and BATTERY_STATUS of each pack): two packs, or two messages,
that differ are no fall. A reading that physics does not allow after the one before (it rose, or
fell faster than the vehicle can draw) is doubt. `AGREEING` of them in a row overrule what was
believed; fewer cost nothing.
"""

from dataclasses import dataclass, field

AGREEING = 3
"""Two wild or late messages in a row are outvoted; a gauge that was reset is believed in 1.5 s."""

SLACK_S = 1.0
"""A message may be as late as this, and the next one on time."""

FLICKER_FRAC = 0.03
"""Percentages come in whole per cents and are rounded in two ways; some filter by voltage."""


@dataclass(slots=True)
class Counter:
    """A count that rises with what was used. `counted_wh`: since the start, `None`: never heard."""

    last: float | None = None
    t_s: float = 0.0
    counted_wh: float | None = None
    doubted: list[tuple[float, float]] = field(default_factory=list)

    def hear(self, t_s: float, now: float, unit_wh: float, most_w: float, started: bool) -> None:
        """Take a reading; `unit_wh` is one of its units. Before the start it only sets the mark."""
        if self.last is None or not started:
            self._believe(t_s, now, 0.0, now > 0.0)
        elif 0.0 <= (now - self.last) * unit_wh <= _reach_wh(self.t_s, t_s, most_w):
            self._believe(t_s, now, (now - self.last) * unit_wh, now > 0.0)
        else:
            self._doubt(t_s, now, unit_wh, most_w)

    def _believe(self, t_s: float, now: float, used_wh: float, counts: bool) -> None:
        if self.counted_wh is not None or counts:
            self.counted_wh = (self.counted_wh or 0.0) + used_wh
        self.last, self.t_s = now, t_s
        self.doubted.clear()

    def _doubt(self, t_s: float, now: float, unit_wh: float, most_w: float) -> None:
        if self.doubted:
            before_s, before = self.doubted[-1]
            if not 0.0 <= (now - before) * unit_wh <= _reach_wh(before_s, t_s, most_w):
                self.doubted.clear()
        self.doubted.append((t_s, now))
        if len(self.doubted) >= AGREEING:
            first_s, first = self.doubted[0]
            # Counted anew since a reboot, or from anywhere: what it shows, as far as could be used.
            unheard_wh = min(first * unit_wh, most_w * max(first_s - self.t_s, 0.0) / 3600.0)
            self._believe(t_s, now, unheard_wh + (now - first) * unit_wh, True)


@dataclass(slots=True)
class Percentage:
    """A charge from 0 to 1. `left_frac` only falls once the flight has begun."""

    left_frac: float | None = None
    last_frac: float = 0.0
    t_s: float = 0.0
    doubted: list[float] = field(default_factory=list)

    def hear(
        self, t_s: float, now_frac: float, full_wh: float, most_w: float, started: bool
    ) -> bool:
        """Take a reading; True where agreeing ones overruled what was believed before the start."""
        reach_frac = _reach_wh(self.t_s, t_s, most_w) / full_wh + FLICKER_FRAC
        if self.left_frac is None:
            self.left_frac = now_frac
            self._believe(t_s, now_frac)
        elif self.last_frac - reach_frac <= now_frac <= self.last_frac + FLICKER_FRAC:
            self._fall_to(t_s, min(now_frac, self.last_frac))
        else:
            return self._doubt(t_s, now_frac, started)
        return False

    @property
    def doubt_frac(self) -> float:
        """How much lower than believed the newest reading is, while it is not believed."""
        return max(self.last_frac - self.doubted[-1], 0.0) if self.doubted else 0.0

    def _believe(self, t_s: float, now_frac: float) -> None:
        self.last_frac, self.t_s = now_frac, t_s
        self.doubted.clear()

    def _fall_to(self, t_s: float, now_frac: float) -> None:
        self.left_frac = max((self.left_frac or 0.0) - (self.last_frac - now_frac), 0.0)
        self._believe(t_s, now_frac)

    def _doubt(self, t_s: float, now_frac: float, started: bool) -> bool:
        if self.doubted and abs(now_frac - self.doubted[-1]) > FLICKER_FRAC:
            self.doubted.clear()
        self.doubted.append(now_frac)
        if len(self.doubted) < AGREEING:
            return False
        if not started:
            self.left_frac = now_frac
        elif now_frac < self.last_frac:
            self._fall_to(t_s, now_frac)
        self._believe(t_s, now_frac)
        return not started


@dataclass(slots=True)
class Gauge:
    """One source's counters and percentage."""

    energy: Counter = field(default_factory=Counter)
    charge: Counter = field(default_factory=Counter)
    percentage: Percentage = field(default_factory=Percentage)


def _reach_wh(before_s: float, t_s: float, most_w: float) -> float:
    """The most that can be used from one reading to the next."""
    return most_w * (max(t_s - before_s, 0.0) + SLACK_S) / 3600.0
