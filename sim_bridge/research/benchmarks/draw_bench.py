"""`sim-bridge research bench draw`: how soon a rise of the draw is told, and how soon it could be.

Flights that nothing befalls are flown in three kinds of air, and each comparison of measured with
expected power is kept as the companion made it. Then the companion's own detector hears them again
with the draw raised from some second on: one flight gives many rises. Beside it stands what no
detector can beat: for white noise of the density that these flights have, the delay of the CUSUM
that is tuned to this very rise (Moustakides, Annals of Statistics 14, 1986: none is sooner for the
same rate of false alarms; in continuous time Shiryaev 1996, Beibel 1996).
"""

import math
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from scipy.optimize import root_scalar

from companion.core.vehicle.power_bias import PowerScale
from sim_bridge.app.faults.runner import write_flight
from sim_bridge.app.flight.fly import FlyOptions, fly
from sim_bridge.app.flight.record import COLUMNS
from sim_bridge.research.results.sheet import Sheet

RISES = (1.25, 1.4, 1.7, 2.0, 2.2)
AIRS = {"calm": 0.0, "as in the suite": 5.0, "rough": 9.0}
"""Mean wind at 10 m, m/s; with Dryden turbulence, whose gusts go with it."""

AUTOPILOTS = ("px4", "ardupilot")
LONG = {
    "site": {"customer": {"name": "customer", "east_m": -900.0, "north_m": -60.0, "up_m": 4.5}},
    "vehicle": {"charge_frac": 1.0},
}
"""The suite's flight with a longer way out and home."""

KEPT = "power.csv"
KEEPING = f"""\
import pathlib, sys
from companion.core.pilot.estimates import Estimates
KEPT = (pathlib.Path(sys.argv[-1]) / "{KEPT}").open("a", buffering=1)
def compare(self, measured_w, modelled_w, age_s, real=Estimates._compare_power):
    print(self._battery_s, measured_w, modelled_w, age_s, sep=",", file=KEPT)
    real(self, measured_w, modelled_w, age_s)
Estimates._compare_power = compare
"""
"""Runs in the companion's process before its `main`: it keeps what the detector hears."""

PRIOR_STD_FRAC = 0.1
"""About as m100's file has it; what is learned in flight soon replaces it."""

HeardRow = tuple[float, float, float, float, bool]
"""Time, measured and modelled power, age of the measurement, and whether it flew level."""

LEVEL_MPS = 0.5
"""Slower up or down than this, and faster over the ground."""

EVERY_S = 2.0
"""A rise each so many seconds."""

FIRST_S = 15.0
"""Of level flight, before the first rise: noise and model are known by then."""

AFTER_S = 30.0
"""Rises begin so long before what was kept ends, at the latest."""

WINDOW_S = 10.0
FALSE_ALARM_H = 100.0
"""One false alarm in so many flight hours: some 2,000 flights of three minutes."""


class AirDelays(msgspec.Struct, frozen=True, kw_only=True):
    """Of one air: what was flown, its noise, alarms where nothing rose, and the rises."""

    air: str
    flights: int
    flown_s: float
    noise_s: float
    false_alarms: int
    rises: list["RiseDelays"]


class RiseDelays(msgspec.Struct, frozen=True, kw_only=True):
    """Of one size of rise; `median_s` and `p90_s` None: not told by then before the flight ended.

    `bound_s`: the mean delay that no detector beats at one false alarm in 100 flight hours.
    """

    rise: float
    tried: int
    told: int
    within_10_s: int
    median_s: float | None
    p90_s: float | None
    bound_s: float


@dataclass(frozen=True, slots=True)
class PowerHeard:
    """What the detector heard of one flight: times, W, W, s; and when it flew level."""

    t_s: np.ndarray
    measured_w: np.ndarray
    modelled_w: np.ndarray
    age_s: np.ndarray
    is_level: np.ndarray

    @classmethod
    def of(cls, rows: Sequence[HeardRow]) -> "PowerHeard":
        """From rows as they are kept."""
        numbers = np.array([row[:4] for row in rows], float)
        return cls(*numbers.T, is_level=np.array([row[4] for row in rows], bool))

    def starts(self) -> np.ndarray:
        """Where a rise may begin."""
        level_s = self.t_s[self.is_level]
        if not level_s.size:
            return level_s
        begin_s, end_s = level_s[0] + FIRST_S, self.t_s[-1] - AFTER_S
        grid = np.arange(begin_s, end_s, EVERY_S)
        near = np.searchsorted(self.t_s, grid).clip(0, len(self.t_s) - 1)
        return grid[self.is_level[near]]

    def told_after_s(self, rise: float, from_s: float) -> float | None:
        """How long after a rise it is told; None: not before the flight ends."""
        return next(
            (t_s - float(from_s) for t_s in self._told(rise, from_s) if t_s >= from_s), None
        )

    def false_alarms(self) -> int:
        """How often a rise is told where nothing rose."""
        return sum(1 for _ in self._told(1.0, math.inf))

    def _told(self, rise: float, from_s: float) -> Iterator[float]:
        scale = PowerScale(PRIOR_STD_FRAC)
        before_s = self.t_s[0]
        raised = np.where(self.t_s >= from_s, rise, 1.0) * self.measured_w
        for k, t_s in enumerate(self.t_s):
            dt_s, before_s = t_s - before_s, t_s
            before = scale.error().scale
            told = scale.observe(dt_s, raised[k], self.modelled_w[k], self.age_s[k])
            if told and scale.error().scale > before:
                yield float(t_s)

    def noise_s(self) -> float:
        """Noise density of the log ratio in level flight: variance of means of 10 s, times 10 s;
        each stretch of level flight about its own mean.
        """
        log = np.log(self.measured_w / self.modelled_w)
        ends = np.flatnonzero(np.diff(self.is_level.astype(int))) + 1
        means: list[float] = []
        for piece in np.split(np.arange(len(log)), ends):
            if self.is_level[piece[0]]:
                means += _means(self.t_s[piece], log[piece])
        return float(np.var(means) * WINDOW_S) if len(means) > 1 else math.nan


def _means(t_s: np.ndarray, log: np.ndarray) -> list[float]:
    window = ((t_s - t_s[0]) // WINDOW_S).astype(int)
    whole = range(int((t_s[-1] - t_s[0]) // WINDOW_S))
    means = [float(log[window == k].mean()) for k in whole if np.any(window == k)]
    return list(np.array(means) - np.mean(means)) if len(means) > 2 else []


def bound_s(rise: float, noise_s: float, false_alarm_h: float = FALSE_ALARM_H) -> float:
    """The least mean delay of any test of a rise, at a mean time between false alarms.

    CUSUM on a Brownian motion: with m = 2 N / mu^2 the mean time to a false alarm is
    m (e^h - h - 1), the delay m (h - 1 + e^-h).
    """
    unit_s = 2.0 * noise_s / math.log(rise) ** 2
    wanted = 3600.0 * false_alarm_h / unit_s
    h = root_scalar(lambda h: math.exp(h) - h - 1.0 - wanted, bracket=(0.0, 60.0)).root
    return unit_s * (h - 1.0 + math.exp(-h))


def fly_one(task: tuple[str, str, int]) -> list[HeardRow]:
    """Fly in this air, by this autopilot and seed, and give what the detector heard."""
    air, autopilot, seed = task
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        wind = {"kind": "steady", "speed_mps": AIRS[air], "from_deg": 70.0}
        wind |= {"turbulence": "dryden" if AIRS[air] else "none"}
        file = write_flight(folder / "flight.toml", LONG, {"wind": wind})
        options = FlyOptions(
            flight_file=file,
            autopilot=autopilot,
            seed=seed,
            run_root=folder,
            picture=False,
            before_companion=KEEPING,
        )
        fly(options)
        (run_dir,) = (path.parent for path in folder.rglob(KEPT))
        return _heard(run_dir)


def _heard(run_dir: Path) -> list[HeardRow]:
    kept = np.loadtxt(run_dir / KEPT, delimiter=",", ndmin=2)
    truth = np.load(run_dir / "truth.npy")
    t_s, down_m = truth[:, COLUMNS.index("t_s")], truth[:, COLUMNS.index("down_m")]
    level = np.abs(np.gradient(down_m, t_s)) < LEVEL_MPS
    moves = np.hypot(truth[:, COLUMNS.index("vel_n_mps")], truth[:, COLUMNS.index("vel_e_mps")])
    near = np.searchsorted(t_s, kept[:, 0]).clip(0, len(t_s) - 1)
    is_level = (level & (moves > LEVEL_MPS))[near]
    return [(*row, bool(flag)) for row, flag in zip(kept.tolist(), is_level, strict=True)]


def tasks(seeds: int) -> list[tuple[str, str, int]]:
    """Air, autopilot and seed of each flight."""
    return [(air, kind, k) for air in AIRS for kind in AUTOPILOTS for k in range(1, seeds + 1)]


def by_air(
    work: Sequence[tuple[str, str, int]], kept: Sequence[Sequence[HeardRow]]
) -> list[AirDelays]:
    """All flights judged, air by air."""
    heard = [(task[0], PowerHeard.of(rows)) for task, rows in zip(work, kept, strict=True)]
    return [judged(air, [flight for its, flight in heard if its == air]) for air in AIRS]


def judged(air: str, flights: Sequence[PowerHeard]) -> AirDelays:
    """All rises of one air."""
    noise_s = float(np.nanmean([flight.noise_s() for flight in flights]))
    return AirDelays(
        air=air,
        flights=len(flights),
        flown_s=float(sum(flight.t_s[-1] - flight.t_s[0] for flight in flights)),
        noise_s=noise_s,
        false_alarms=sum(flight.false_alarms() for flight in flights),
        rises=[_rise(rise, flights, noise_s) for rise in RISES],
    )


def _rise(rise: float, flights: Sequence[PowerHeard], noise_s: float) -> RiseDelays:
    after = [f.told_after_s(rise, from_s) for f in flights for from_s in f.starts()]
    told = sorted(seconds for seconds in after if seconds is not None)
    return RiseDelays(
        rise=rise,
        tried=len(after),
        told=len(told),
        within_10_s=sum(1 for seconds in told if seconds <= 10.0),
        median_s=_quantile(told, len(after), 0.5),
        p90_s=_quantile(told, len(after), 0.9),
        bound_s=bound_s(rise, noise_s),
    )


def _quantile(told: Sequence[float], tried: int, frac: float) -> float | None:
    """Those that were never told come last."""
    at = math.ceil(frac * tried) - 1
    return told[at] if 0 <= at < len(told) else None


def sheet(rows: Sequence[AirDelays]) -> Sheet:
    """The table."""
    head = (
        "air",
        "rise",
        "median, s",
        "9 of 10, s",
        "within 10 s",
        "told in the flight",
        "bound, s",
    )
    lines = [
        (
            air.air,
            f"{each.rise:g}",
            _seconds(each.median_s),
            _seconds(each.p90_s),
            f"{each.within_10_s} of {each.tried}",
            f"{each.told} of {each.tried}",
            f"{each.bound_s:.0f}",
        )
        for air in rows
        for each in air.rises
    ]
    notes = "; ".join(
        f"{air.air}: {air.flights} flights, {air.flown_s / 60.0:.0f} min, noise density"
        f" {air.noise_s:.3f} s, {air.false_alarms} false alarms"
        for air in rows
    )
    return Sheet("Time to tell a rise of the draw", head, lines, f"{notes}.")


def _seconds(value: float | None) -> str:
    return "never" if value is None else f"{value:.0f}"
