"""Air over a site in which four drones fly, reported as states once a second."""

import math

import numpy as np

from companion.fleet.messages import State
from ground_station.adapters.files.params import read_wind_process
from ground_station.core.schema.day import Forecast
from ground_station.core.site_wind.site_wind import SiteWind

DEPOT = (55.47, 8.45)
M_PER_DEG = 111_320.0
"""Metres per degree of latitude, within half a percent."""
COV = (0.3, 0.02, 0.35)
PLACES = {"d1": (0.0, -400.0), "d2": (0.0, 500.0), "d3": (700.0, 300.0), "d4": (-600.0, 100.0)}
FORECAST = Forecast(speed_mps=6.0, from_deg=270.0, std_mps=2.0)


def a_state(name: str, t_s: float, wind: tuple[float, float], **more: object) -> State:
    north, east = PLACES[name]
    fields: dict[str, object] = {
        "vehicle": name, "instance_id": "a", "uptime_s": t_s, "epoch_us": 0, "airframe": "m100",
        "max_payload_kg": 1.0, "phase": "outbound", "log": "l", "last_seq": 0, "armed": True,
        "lat_deg": DEPOT[0] + north / M_PER_DEG, "height_rel_m": 40.0,
        "lon_deg": DEPOT[1] + east / M_PER_DEG / math.cos(math.radians(DEPOT[0])),
        "wind_to_n_mps": wind[0], "wind_to_e_mps": wind[1], "wind_cov_m2ps2": COV,
    }  # fmt: skip
    return State(**{**fields, **more})  # pyright: ignore[reportArgumentType]


class Air:
    """An eastward wind with separate gusts at each drone, reported once a second."""

    def __init__(self, seed: int = 1, **more: object) -> None:
        self.wind = SiteWind(read_wind_process("coast"), DEPOT, FORECAST)
        self.rng, self.t_s, self.more = np.random.default_rng(seed), 0.0, more
        self.gusts = {name: np.zeros(2) for name in PLACES}
        self.mean = {name: np.array([0.0, 6.0]) for name in PLACES}

    def blow(self, for_s: float, silent: frozenset[str] = frozenset()) -> None:
        until_s = self.t_s + for_s
        while self.t_s < until_s:
            self.t_s += 1.0
            for name, gust in self.gusts.items():
                gust += -gust / 15.0 + self.rng.normal(0.0, 0.2, 2)  # 0.55 m/s, 15 s
                if name not in silent:
                    self.tell(name)

    def tell(self, name: str, **more: object) -> None:
        north, east = (round(float(x), 3) for x in self.mean[name] + self.gusts[name])
        told = a_state(name, self.t_s, (north, east), **(self.more | more))
        self.wind.update_from_state(told, self.t_s)


def front_comes(
    air: Air, change: tuple[float, float], speed_mps: float, for_s: float
) -> dict[str, float]:
    """Move a front eastward that is at d1 now; return its arrival time at each drone."""
    at = {n: air.t_s + (p[1] - PLACES["d1"][1]) / speed_mps for n, p in PLACES.items()}
    for _ in range(round(for_s)):
        for name, due_s in at.items():
            if abs(air.t_s - due_s) < 0.5:
                air.mean[name] = air.mean[name] + change
        air.blow(1.0)
    return at
