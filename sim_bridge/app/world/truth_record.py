"""True trajectory of one power cycle of a vehicle, for evaluation and plots, and its outcome."""

import math
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

HOME_RADIUS_M = 12.0  # a pad with room for GNSS error (2.5 m CEP) and landing drift
DELIVERY_RADIUS_M = 12.0
DROP_HEIGHT_SLACK_M = 4.0  # barometer and GNSS height error at the drop
LOST_OUTCOMES = ("DEL", "FAIL")
"""Neither home nor landed intact by a pilot."""


def is_within_home_radius(ne_m: tuple[float, float], site_ne_m: tuple[float, float]) -> bool:
    """Return whether a landing at this position is a landing at this site."""
    return math.dist(ne_m, site_ne_m) <= HOME_RADIUS_M


@dataclass(slots=True)
class TruthRecord:
    """Truth at 5 Hz. Times and positions are the owner's: the vehicle's since power-up and about
    its depot, or those of a day. Wind is a to-vector.
    """

    rows: list[tuple[float, ...]] = field(default_factory=list)
    crashed: bool = False
    """The vehicle touched the ground too fast, with sideways speed or tilted."""
    pilot_landings_s: list[float] = field(default_factory=list)
    """Landings at which a pilot or another ground station controlled the vehicle."""
    takeoff_s: float | None = None
    landed_s: float | None = None
    airborne_since_s: float | None = None
    """Last take-off; None on the ground."""
    last_airborne_s: float | None = None
    """Last airborne sample."""
    released_s: float | None = None
    released_ned_m: tuple[float, float, float] | None = None
    release_height_m: float | None = None
    """Height above the ground at the release of the parcel."""
    has_parcel: bool = False
    """Parcel state of the last sample; set by its owner after a person has loaded or removed it."""

    def append_sample_and_record_events(
        self, t_s: float, truth: Any, height_m: float, *, under_external_control: bool = False
    ) -> None:
        """Append one sample and record take-off, landing, crash and parcel release.

        `height_m`: height above the ground.
        """
        self.crashed = self.crashed or truth.crashed
        if self.has_parcel and not truth.parcel_aboard:
            self.released_s, self.released_ned_m = t_s, tuple(truth.pos_ned_m)
            self.release_height_m = float(height_m)  # a drifting barometer gives a NumPy scalar
        self.has_parcel = truth.parcel_aboard
        if truth.airborne:
            if self.takeoff_s is None:
                self.takeoff_s = t_s
            if self.airborne_since_s is None:
                self.airborne_since_s = t_s
            self.last_airborne_s, self.landed_s = t_s, None
        else:
            self.airborne_since_s = None
            if self.takeoff_s is not None and self.landed_s is None:
                self.landed_s = t_s
                if under_external_control:
                    self.pilot_landings_s.append(t_s)
        self.rows.append(
            (
                t_s,
                *truth.pos_ned_m,
                *truth.vel_ned_mps[:2],
                *truth.wind_to_ned_mps[:2],
                truth.power_w,
                truth.energy_used_wh,
                truth.usable_wh,
                float(truth.airborne),
                float(truth.parcel_aboard),
            )
        )

    def samples_by_column(self) -> dict[str, np.ndarray]:
        """Return the samples as one array for each column (COLUMNS), all of the same length."""
        table = np.asarray(self.rows, float).reshape(-1, len(COLUMNS))
        return {name: table[:, k] for k, name in enumerate(COLUMNS)}

    def is_parcel_released_at(
        self,
        customer_ne_m: tuple[float, float],
        drop_height_m: float,
        begin_s: float = -math.inf,
        end_s: float = math.inf,
    ) -> bool:
        """Return whether the parcel was released low over this customer, in this interval."""
        return (
            self.released_s is not None
            and begin_s <= self.released_s <= end_s
            and self.released_ned_m is not None
            and self.release_height_m is not None
            and math.dist(self.released_ned_m[:2], customer_ne_m) <= DELIVERY_RADIUS_M
            and self.release_height_m <= drop_height_m + DROP_HEIGHT_SLACK_M
        )

    def evaluate_outcome(
        self, *, delivered: bool, landed_s: float | None, at_home: bool, reserve_wh: float
    ) -> "FlightOutcome":
        """Return the outcome of the flight that ended with this landing (None: still airborne).

        Home means landed there intact with the reserve unused, or not taken off. TAKEN: landed
        intact elsewhere by a pilot or another ground station.
        """
        last = dict(zip(COLUMNS, self.rows[-1], strict=True))
        margin_wh = float(last["usable_wh"]) - reserve_wh
        landed_intact = landed_s is not None and not self.crashed
        home = self.takeoff_s is None or (landed_intact and at_home and margin_wh >= 0.0)
        if home:
            code = "SUC" if delivered else "ABRT"
        elif landed_intact and landed_s in self.pilot_landings_s:
            code = "TAKEN"
        else:
            code = "DEL" if delivered else "FAIL"
        return FlightOutcome(code, delivered, home, float(last["energy_used_wh"]), margin_wh)


@dataclass(frozen=True, slots=True)
class FlightOutcome:
    """True outcome of one flight. `code`: SUC, DEL, FAIL, ABRT or TAKEN
    (docs/reference/outcomes.md).

    `margin_wh`: usable energy above the reserve at the end.
    """

    code: str
    delivered: bool
    home: bool
    energy_used_wh: float
    margin_wh: float
