"""Energy per ground distance against airspeed, by wind and payload, with both power models.

The paper's figure: U-shaped at 0 and 8 kg, the best speed rising with payload. Its own formula,
P = P_c + D V / c_T in level flight, does not know the payload but through the drag of a heavier
vehicle, and cannot show that; the multirotor model beside it, with induced power, does.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import max_airspeed_mps, multirotor_power_w, paper_power_w
from sim_bridge.research.results.sheet import Sheet

WIND_MPS = 5.0
WINDS = ("tailwind", "calm", "crosswind", "headwind")
PAYLOADS_KG = (0.0, 8.0)
MODELS: dict[str, Callable[[Airframe, float, Floats], Floats]] = {
    "paper's formula": paper_power_w,
    "multirotor": multirotor_power_w,
}


@dataclass(frozen=True)
class Curve:
    """Wh/km over airspeed for one model, wind and payload; NaN where no way is made."""

    model: str
    wind: str
    payload_kg: float
    airspeed_mps: Floats
    wh_per_km: Floats

    @property
    def best(self) -> tuple[float, float]:
        """The airspeed that costs least per metre of ground, and what it costs."""
        i = int(np.nanargmin(self.wh_per_km))
        return float(self.airspeed_mps[i]), float(self.wh_per_km[i])

    @property
    def is_u_shaped(self) -> bool:
        """True when the least lies inside the range, with more to pay on either side."""
        known = np.flatnonzero(np.isfinite(self.wh_per_km))
        i = int(np.nanargmin(self.wh_per_km))
        return bool(known[0] < i < known[-1])


def ground_speed_mps(airspeed_mps: Floats, wind: str) -> Floats:
    """Closed form of the wind triangle for wind along or across the course; NaN: no way made."""
    if wind == "crosswind":
        room = airspeed_mps**2 - WIND_MPS**2
        return np.where(room > 0.0, np.sqrt(np.maximum(room, 1e-12)), np.nan)
    along = {"tailwind": WIND_MPS, "calm": 0.0, "headwind": -WIND_MPS}[wind]
    speed = airspeed_mps + along
    return np.where(speed > 0.0, speed, np.nan)


def curves(airframe: Airframe) -> list[Curve]:
    """All curves, up to the speed that the heavier vehicle holds in level flight."""
    heaviest = airframe.mass.empty_kg + max(PAYLOADS_KG)
    top = min(max_airspeed_mps(airframe, heaviest), 30.0)
    speed = np.arange(1.0, top, 0.1)
    return [
        Curve(
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


def sheet(found: list[Curve], airframe: Airframe) -> Sheet:
    """The best speed and its cost on each curve."""
    rows = []
    for c in found:
        speed, cost = c.best
        ground = ground_speed_mps(np.array([speed]), c.wind)[0]
        rows.append(
            [
                c.model,
                f"{c.payload_kg:g}",
                c.wind,
                f"{speed:.1f}",
                f"{ground:.1f}",
                f"{cost:.1f}",
                "yes" if c.is_u_shaped else "no",
            ]
        )
    head = ["power model", "payload kg", f"wind {WIND_MPS:g} m/s", "best airspeed m/s"]
    head += ["best ground speed m/s", "Wh/km there", "U-shaped"]
    return Sheet(f"Energy and speed: {airframe.name}", head, rows, _note(found))


def _note(found: list[Curve]) -> str:
    best = {(c.model, c.payload_kg, c.wind): c.best for c in found}
    lines = []
    for model in MODELS:
        empty, loaded = (best[model, payload, "calm"] for payload in PAYLOADS_KG)
        lines.append(
            f"{model}: from 0 to 8 kg the best airspeed in calm goes from {empty[0]:.1f} to "
            f"{loaded[0]:.1f} m/s and its cost from {empty[1]:.1f} to {loaded[1]:.1f} Wh/km."
        )
    lines.append(
        "In level flight the paper's formula feels payload only where drag does: its term for "
        "weight is m g sin(gamma). Hover and slow flight cost it little more than avionics."
    )
    return " ".join(lines)


def draw(found: list[Curve], path: Path) -> None:
    """One panel for each model and payload."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(11, 8), sharex=True)
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
    plt.close(figure)
