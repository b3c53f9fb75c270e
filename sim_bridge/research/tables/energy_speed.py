"""Energy per ground distance against airspeed, by wind and payload, with both power models.

The paper's figure: U-shaped at 0 and 8 kg, with a best speed that rises with payload. In level
flight the paper's formula, P = P_c + D V / c_T, depends on payload only by the drag of a heavier
vehicle and cannot reproduce that. The multirotor model includes induced power and can.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import (
    level_airspeed_at_max_tilt_mps,
    multirotor_power_w,
    paper_power_w,
)
from sim_bridge.research.study.run import Report
from sim_bridge.research.study.sheet import Sheet

WIND_MPS = 5.0
WINDS = ("tailwind", "calm", "crosswind", "headwind")
PAYLOADS_KG = (0.0, 8.0)
MODELS: dict[str, Callable[[Airframe, float, Floats], Floats]] = {
    "paper's formula": paper_power_w,
    "multirotor": multirotor_power_w,
}


@dataclass(frozen=True)
class EnergyCurve:
    """Wh/km over airspeed for one model, wind and payload; NaN where no progress is possible."""

    model: str
    wind: str
    payload_kg: float
    airspeed_mps: Floats
    wh_per_km: Floats

    @property
    def best(self) -> tuple[float, float]:
        """Return the airspeed of least energy per metre of ground, and that energy."""
        i = int(np.nanargmin(self.wh_per_km))
        return float(self.airspeed_mps[i]), float(self.wh_per_km[i])

    @property
    def is_u_shaped(self) -> bool:
        """Return True if the minimum lies inside the range, with higher values on both sides."""
        known = np.flatnonzero(np.isfinite(self.wh_per_km))
        i = int(np.nanargmin(self.wh_per_km))
        return bool(known[0] < i < known[-1])


def ground_speed_mps(airspeed_mps: Floats, wind_case: str) -> Floats:
    """Wind triangle for wind along or across the course, closed form; NaN without progress."""
    if wind_case == "crosswind":
        spare = airspeed_mps**2 - WIND_MPS**2
        return np.where(spare > 0.0, np.sqrt(np.maximum(spare, 1e-12)), np.nan)
    tailwind = {"tailwind": WIND_MPS, "calm": 0.0, "headwind": -WIND_MPS}[wind_case]
    speed = airspeed_mps + tailwind
    return np.where(speed > 0.0, speed, np.nan)


def compute_curves(airframe: Airframe) -> list[EnergyCurve]:
    """Compute all curves, up to the maximum level-flight airspeed of the heavier vehicle."""
    heaviest = airframe.mass.empty_kg + max(PAYLOADS_KG)
    top = min(level_airspeed_at_max_tilt_mps(airframe, heaviest), 30.0)
    speed = np.arange(1.0, top, 0.1)
    return [
        EnergyCurve(
            model,
            wind,
            payload,
            speed,
            power(airframe, airframe.mass.empty_kg + payload, speed)
            / ground_speed_mps(speed, wind)
            / 3.6,
        )
        for model, power in MODELS.items()
        for payload in PAYLOADS_KG
        for wind in WINDS
    ]


def build_energy_speed_report(airframe: Airframe) -> Report:
    """Return table and figure of all curves."""
    found = compute_curves(airframe)
    return Report(
        {"energy_speed": best_speed_sheet(found, airframe)},
        pictures={"energy_speed.png": lambda path: draw_curves(found, path)},
    )


def best_speed_sheet(found: list[EnergyCurve], airframe: Airframe) -> Sheet:
    """Tabulate the best speed and its energy on each curve."""
    return Sheet.from_objects(
        f"Energy and speed: {airframe.name}",
        found,
        {
            "model": "{0.model}",
            "payload kg": "{0.payload_kg:g}",
            f"wind {WIND_MPS:g} m/s": "{0.wind}",
            "best airspeed m/s": "{0.best[0]:.1f}",
            "best ground speed m/s": lambda c: (
                f"{ground_speed_mps(np.array([c.best[0]]), c.wind)[0]:.1f}"
            ),
            "Wh/km there": "{0.best[1]:.1f}",
            "U-shaped": lambda c: "yes" if c.is_u_shaped else "no",
        },
        _format_note(found),
    )


def _format_note(found: list[EnergyCurve]) -> str:
    best = {(c.model, c.payload_kg, c.wind): c.best for c in found}
    lines = []
    for model in MODELS:
        empty, loaded = (best[model, payload, "calm"] for payload in PAYLOADS_KG)
        lines.append(
            f"{model}: from 0 to 8 kg the best airspeed in calm changes from {empty[0]:.1f} to "
            f"{loaded[0]:.1f} m/s and its cost from {empty[1]:.1f} to {loaded[1]:.1f} Wh/km."
        )
    lines.append(
        "In level flight payload enters the paper's formula only through drag: its term for "
        "weight is m g sin(gamma). In hover and slow flight it gives little more than avionics."
    )
    return " ".join(lines)


def draw_curves(found: list[EnergyCurve], path: Path) -> None:
    """Draw one panel for each model and payload."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 8))
    axes = figure.subplots(2, 2, sharex=True)
    for row, model in enumerate(MODELS):
        for column, payload in enumerate(PAYLOADS_KG):
            axis = axes[row][column]
            for c in found:
                if c.model == model and c.payload_kg == payload:
                    axis.plot(c.airspeed_mps, c.wh_per_km, label=c.wind)
                    axis.plot(*c.best, "ko", markersize=4)
            lowest = min(c.best[1] for c in found if c.model == model)
            axis.set_ylim(0.0, 8.0 * lowest)
            axis.set_title(f"{model}, {payload:g} kg")
            axis.set_xlabel("airspeed, m/s")
            axis.set_ylabel("Wh/km over ground")
    axes[0][0].plot([], [], "ko", markersize=4, label="speed to fly")
    axes[0][0].legend()
    figure.tight_layout()
    figure.savefig(path, dpi=80)
