"""The true course of a flight, sampled from the simulated world for judging and drawing."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

COLUMNS = (
    "t_s",
    "north_m",
    "east_m",
    "down_m",
    "vel_n_mps",
    "vel_e_mps",
    "wind_to_n_mps",
    "wind_to_e_mps",
    "power_w",
    "energy_used_wh",
    "usable_wh",
    "airborne",
    "parcel_aboard",
)


@dataclass(slots=True)
class TruthRecord:
    """Truth at 10 Hz; positions about the vehicle's depot, wind where the air moves to."""

    rows: list[tuple[float, ...]] = field(default_factory=list)
    crashed: bool = False
    """It met the ground too fast, sideways or tilted."""
    landed_by_person: bool = False
    """Whose hand it was in when it came down: a pilot's, or another ground station's."""
    took_off_s: float | None = None
    landed_s: float | None = None
    released_ned_m: tuple[float, float, float] | None = None
    release_height_m: float | None = None

    def add(self, truth: Any, ground_up_m: float, *, flown_by_person: bool = False) -> None:
        """Append one sample; notes take-off, landing, crash and release as they happen."""
        n, e, d = truth.pos_ned_m
        wind = truth.wind_to_ned_mps
        vel = truth.vel_ned_mps
        self.crashed = self.crashed or truth.crashed
        if self.rows and self.rows[-1][-1] and not truth.parcel_aboard:
            self.released_ned_m = (n, e, d)
            self.release_height_m = -d - ground_up_m
        if truth.airborne:
            if self.took_off_s is None:
                self.took_off_s = truth.t_s
            self.landed_s = None
        elif self.took_off_s is not None and self.landed_s is None:
            self.landed_s = truth.t_s
            self.landed_by_person = flown_by_person
        self.rows.append(
            (
                truth.t_s,
                n,
                e,
                d,
                vel[0],
                vel[1],
                wind[0],
                wind[1],
                truth.power_w,
                truth.energy_used_wh,
                truth.usable_wh,
                float(truth.airborne),
                float(truth.parcel_aboard),
            )
        )

    def arrays(self) -> dict[str, np.ndarray]:
        """The samples as one array a column (COLUMNS), all of the same length."""
        table = np.asarray(self.rows, float).reshape(-1, len(COLUMNS))
        return {name: table[:, k] for k, name in enumerate(COLUMNS)}
