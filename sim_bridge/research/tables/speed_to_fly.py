"""Is the speed to fly the cheapest that the simulator's truth has, and what does it save?

For every wind along and across the way and every load: the ground speed that the companion would
command by its own model, what the simulated vehicle then truly draws per metre, and the least that
it could draw at any airspeed that its tilt allows, by brute force. Beside it the fixed cruise
airspeed.
"""

import csv
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.routing.leg_energy import Leg, LegKind, RouteEnergy
from companion.core.vehicle.airframe import Airframe
from sim_bridge.research.results.sheet import Sheet
from sim_bridge.truth.params import AirframeTruth
from sim_bridge.truth.steady_flight import SteadyFlight

MOST_WIND_MPS = 12.0
WIND_STEP_MPS = 1.0
LOADS_FRAC = (0.0, 0.25, 0.5, 0.75, 1.0)
GOAL = 1.02
_AIRSPEED_STEP_MPS = 0.05
_LEAST_GROUND_MPS = 0.5  # slower is no way made
_WAY_M = 1000.0


@dataclass(frozen=True, slots=True)
class Cell:
    """One wind and load. Costs are true Wh/km; `cruise` None: at cruise airspeed no way is made."""

    payload_kg: float
    along_mps: float
    across_mps: float
    airspeed_mps: float
    ground_mps: float
    wh_per_km: float
    best_airspeed_mps: float
    best_wh_per_km: float
    cruise_wh_per_km: float | None

    @property
    def ratio(self) -> float:
        """True cost at the speed to fly over the least there is."""
        return self.wh_per_km / self.best_wh_per_km

    @property
    def saving_frac(self) -> float | None:
        """What the speed to fly saves of the energy at the fixed cruise airspeed."""
        if self.cruise_wh_per_km is None:
            return None
        return 1.0 - self.wh_per_km / self.cruise_wh_per_km


class TrueCosts:
    """The simulated vehicle's Wh/km in level flight at one load."""

    def __init__(self, truth: AirframeTruth, airframe: Airframe, payload_kg: float) -> None:
        flight = SteadyFlight(truth)
        tilt_rad = airframe.speeds.max_tilt_rad
        self.max_airspeed_mps = flight.max_level_airspeed_mps(tilt_rad, payload_kg)
        self.max_ground_mps = airframe.speeds.max_ground_mps
        count = round(self.max_airspeed_mps / _AIRSPEED_STEP_MPS)
        self.airspeed_mps = np.linspace(0.0, self.max_airspeed_mps, count + 1)
        self._power_w = np.array(
            [flight.level_flight_power_w(float(v), payload_kg) for v in self.airspeed_mps]
        )

    def wh_per_km(self, along_mps: float, across_mps: float) -> Floats:
        """At every airspeed; infinite where no way is made, or faster than may be commanded."""
        left = self.airspeed_mps**2 - across_mps**2
        ground = np.sqrt(np.maximum(left, 0.0)) + along_mps
        made = (left > 0.0) & (ground >= _LEAST_GROUND_MPS) & (ground <= self.max_ground_mps)
        return np.where(made, self._power_w / np.where(made, ground, 1.0) / 3.6, np.inf)

    def least(self, along_mps: float, across_mps: float) -> tuple[float, float]:
        """(airspeed, Wh/km) of the cheapest, that of the fastest ground speed allowed included."""
        each = self.wh_per_km(along_mps, across_mps)
        best = int(np.argmin(each))
        at_most = self.told(self.max_ground_mps, along_mps, across_mps)
        return min(
            (float(self.airspeed_mps[best]), float(each[best])), at_most, key=lambda pair: pair[1]
        )

    def told(self, ground_mps: float, along_mps: float, across_mps: float) -> tuple[float, float]:
        """(airspeed, Wh/km) when told a ground speed; tilt saturates and the line is held."""
        most = math.sqrt(max(self.max_airspeed_mps**2 - across_mps**2, 0.0)) + along_mps
        ground = min(ground_mps, most)
        if ground < _LEAST_GROUND_MPS:
            return self.max_airspeed_mps, math.inf
        airspeed = math.hypot(ground - along_mps, across_mps)
        power_w = float(np.interp(airspeed, self.airspeed_mps, self._power_w))
        return airspeed, power_w / ground / 3.6


def envelope_winds() -> list[tuple[float, float]]:
    """Winds along and across up to MOST_WIND_MPS in all."""
    along = np.arange(-MOST_WIND_MPS, MOST_WIND_MPS + 0.1, WIND_STEP_MPS)
    across = np.arange(0.0, MOST_WIND_MPS + 0.1, WIND_STEP_MPS)
    return [
        (float(a), float(c)) for a in along for c in across if math.hypot(a, c) <= MOST_WIND_MPS
    ]


def cell_at(
    route: RouteEnergy, costs: TrueCosts, payload_kg: float, along_mps: float, across_mps: float
) -> Cell:
    """One wind, along the way and across it."""
    leg = Leg(LegKind.CRUISE, (0.0, 0.0, 0.0), (_WAY_M, 0.0, 0.0), payload_kg)
    ground = route.ground_speed_mps(leg, np.array([along_mps, across_mps]))
    airspeed, cost = costs.told(ground, along_mps, across_mps)
    best_mps, best = costs.least(along_mps, across_mps)
    cruise_mps = route.airframe.speeds.cruise_airspeed_mps
    at_cruise: float | None = None
    if cruise_mps > across_mps:
        told = math.sqrt(cruise_mps**2 - across_mps**2) + along_mps
        if told >= _LEAST_GROUND_MPS:
            at_cruise = costs.told(min(told, costs.max_ground_mps), along_mps, across_mps)[1]
    return Cell(
        payload_kg=payload_kg,
        along_mps=along_mps,
        across_mps=across_mps,
        airspeed_mps=airspeed,
        ground_mps=ground,
        wh_per_km=cost,
        best_airspeed_mps=best_mps,
        best_wh_per_km=best,
        cruise_wh_per_km=at_cruise,
    )


def envelope(
    airframe: Airframe, truth: AirframeTruth, on_load: Callable[[], None] = lambda: None
) -> list[Cell]:
    """Every wind and load."""
    route = RouteEnergy(airframe)
    cells: list[Cell] = []
    for share in LOADS_FRAC:
        payload_kg = share * airframe.mass.max_payload_kg
        costs = TrueCosts(truth, airframe, payload_kg)
        cells += [cell_at(route, costs, payload_kg, a, c) for a, c in envelope_winds()]
        on_load()
    return cells


def sheet(cells: Sequence[Cell], airframe: Airframe) -> Sheet:
    """A row for each load and kind of wind, and in the note the whole envelope."""
    kinds: list[tuple[str, Callable[[Cell], bool]]] = [
        ("headwind 9 to 12", lambda c: c.along_mps <= -9.0),
        ("headwind 4 to 8", lambda c: -8.0 <= c.along_mps <= -4.0),
        ("calm or across", lambda c: abs(c.along_mps) < 4.0),
        ("tailwind 4 to 8", lambda c: 4.0 <= c.along_mps <= 8.0),
        ("tailwind 9 to 12", lambda c: c.along_mps >= 9.0),
    ]
    rows = [
        _row(f"{payload:g}", name, [c for c in cells if c.payload_kg == payload and which(c)])
        for payload in sorted({c.payload_kg for c in cells})
        for name, which in kinds
    ]
    head = ["payload kg", "wind along m/s", "speed to fly m/s", "true best m/s", "Wh/km there"]
    head += ["over the least", "worst", "saving against cruise", "cruise makes no way"]
    return Sheet(f"Speed to fly: {airframe.name}", head, rows, _note(cells, airframe))


def _row(payload: str, name: str, cells: Sequence[Cell]) -> list[str]:
    savings = [s for c in cells if (s := c.saving_frac) is not None]
    stuck = sum(c.cruise_wh_per_km is None for c in cells)
    return [
        payload,
        name,
        _span([c.airspeed_mps for c in cells]),
        _span([c.best_airspeed_mps for c in cells]),
        _span([c.wh_per_km for c in cells]),
        f"{np.mean([c.ratio for c in cells]):.4f}",
        f"{max(c.ratio for c in cells):.4f}",
        f"{100.0 * float(np.mean(savings)):.1f} %" if savings else "-",
        f"{stuck} of {len(cells)}",
    ]


def _span(values: Sequence[float]) -> str:
    return f"{min(values):.1f} to {max(values):.1f}"


def _note(cells: Sequence[Cell], airframe: Airframe) -> str:
    ratios = np.array([c.ratio for c in cells])
    worst = max(cells, key=lambda c: c.ratio)
    savings = np.array([s for c in cells if (s := c.saving_frac) is not None])
    stuck = sum(c.cruise_wh_per_km is None for c in cells)
    lines = [
        f"{len(cells)} winds and loads: wind to {MOST_WIND_MPS:g} m/s along and across,"
        f" 0 to {airframe.mass.max_payload_kg:g} kg.",
        f"Within {100.0 * (GOAL - 1.0):.0f} % of the truth's least in"
        f" {100.0 * float(np.mean(ratios <= GOAL)):.1f} % of them; mean ratio {ratios.mean():.4f},"
        f" worst {worst.ratio:.4f} at {worst.payload_kg:g} kg, {worst.along_mps:g} m/s along,"
        f" {worst.across_mps:g} across.",
        f"Against a fixed {airframe.speeds.cruise_airspeed_mps:g} m/s it saves"
        f" {100.0 * float(savings.mean()):.1f} % on average,"
        f" {100.0 * float(savings.max()):.0f} % at most; in {stuck} of {len(cells)} the fixed"
        " airspeed makes no way at all.",
    ]
    return " ".join(lines)


def write_cells(cells: Sequence[Cell], path: Path) -> None:
    """Every wind and load, as CSV."""
    names = list(Cell.__slots__)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow([*names, "ratio", "saving_frac"])
        for cell in cells:
            values = [getattr(cell, n) for n in names]
            row = [*values, cell.ratio, cell.saving_frac]
            writer.writerow(["" if v is None else f"{v:.5g}" for v in row])


_SHOWN = (("tailwind 8", 8.0, "C2"), ("calm", 0.0, "C0"), ("headwind 8", -8.0, "C3"))


def draw(airframe: Airframe, truth: AirframeTruth, path: Path) -> None:
    """True Wh/km over airspeed, empty and loaded; the speed to fly on it, and the cruise."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    route = RouteEnergy(airframe)
    cruise_mps = airframe.speeds.cruise_airspeed_mps
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.6), sharey=True)
    for axis, payload_kg in zip(axes, (0.0, airframe.mass.max_payload_kg), strict=True):
        costs = TrueCosts(truth, airframe, payload_kg)
        most = 0.0
        for name, along_mps, colour in _SHOWN:
            each = costs.wh_per_km(along_mps, 0.0)
            cell = cell_at(route, costs, payload_kg, along_mps, 0.0)
            most = max(most, cell.best_wh_per_km)
            axis.plot(
                costs.airspeed_mps, np.where(np.isinf(each), np.nan, each), c=colour, label=name
            )
            axis.plot(cell.airspeed_mps, cell.wh_per_km, "o", c=colour, markersize=7)
            axis.plot(cell.best_airspeed_mps, cell.best_wh_per_km, "k+", markersize=10)
        axis.axvline(cruise_mps, color="0.6", linestyle="--", linewidth=1.0)
        axis.set_ylim(0.0, 1.9 * most)
        axis.set_title(f"{airframe.name}, {payload_kg:g} kg")
        axis.set_xlabel("airspeed, m/s")
    axes[0].set_ylabel("true Wh/km over ground")
    axes[0].plot([], [], "o", c="0.3", label="speed to fly (companion)")
    axes[0].plot([], [], "k+", label="least by brute force")
    axes[0].plot([], [], c="0.6", linestyle="--", label=f"cruise, {cruise_mps:g} m/s")
    axes[0].legend(fontsize="small")
    figure.tight_layout()
    figure.savefig(path, dpi=90)
    plt.close(figure)
