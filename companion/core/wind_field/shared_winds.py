"""What a desk tells one vehicle of the wind that others feel: the word, as it travels.

Whole numbers, so that a word of five others stays near 400 bytes. What each may be is checked when
it is decoded; whether it is believed is `fleet_wind`'s to say.
"""

import math
from collections.abc import Iterator
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from companion.core.base.geo import offset_m
from companion.core.base.wire_message import Name, WireMessage
from companion.core.wind_field.fronts import FELT_STD_S, FeltChange, FrontAhead
from companion.core.wind_field.tellings import WindTelling

MOST_TOLD = 5
"""Others in one word: with the 158 bytes a second that a state takes for the wind, 200 in all."""

TOLD_EVERY_S = 10.0
"""A telling is a mean over as long."""

MOST_AGE_S = 20
_MOST_M = 50_000
_CMPS = 100.0

Metres = Annotated[int, Meta(ge=-_MOST_M, le=_MOST_M)]
CmPerS = Annotated[int, Meta(ge=-6_000, le=6_000)]
VarCm2 = Annotated[int, Meta(ge=1, le=40_000)]
"""Hundredths of (m/s)^2."""


class ToldWind(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """One member's newest wind, as an array in this order."""

    member: Name
    """Who feels it."""
    age_s: Annotated[int, Meta(ge=0, le=MOST_AGE_S)]
    """How old it was at `as_of_s`."""
    north_m: Metres
    """Where it is felt, north of the word's place."""
    east_m: Metres
    """Likewise, east."""
    height_m: Annotated[int, Meta(ge=-3_000, le=3_000)]
    """Above the ground."""
    to_n_cmps: CmPerS
    """North part of where the air moves to, cm/s."""
    to_e_cmps: CmPerS
    """East part."""
    nn_cm2: VarCm2
    """Variance north, hundredths of (m/s)^2."""
    ee_cm2: VarCm2
    """Variance east. Uncorrelated, both are no less in any direction than what was told."""

    @classmethod
    def of(cls, telling: WindTelling, north_m: float, east_m: float, age_s: float) -> "ToldWind":
        """Rounded; no surer in any direction than told."""
        nn, ee = telling.variance_m2ps2
        north, east = telling.mean_to_ne_mps
        return cls(
            telling.member,
            min(max(round(age_s), 0), MOST_AGE_S),
            round(north_m),
            round(east_m),
            round(telling.height_m),
            round(_CMPS * north),
            round(_CMPS * east),
            _variance(nn),
            _variance(ee),
        )


class ToldFront(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A front that comes: when it passes a place, and the wind behind it."""

    arrives_in_s: Annotated[float, Meta(ge=-3600.0, le=3600.0)]
    """When it passes the word's place, after `as_of_s`."""
    slow_n_spm: Annotated[float, Meta(ge=-1.0, le=1.0)]
    """Seconds per metre towards north by which it passes later."""
    slow_e_spm: Annotated[float, Meta(ge=-1.0, le=1.0)]
    """Likewise towards east."""
    std_s: Annotated[float, Meta(ge=1.0, le=3600.0)]
    """Error of `arrives_in_s` (one sigma)."""
    slow_std_spm: Annotated[float, Meta(ge=0.0, le=1.0)]
    """Error of the two slownesses, each."""
    behind_n_mps: Annotated[float, Meta(ge=-60.0, le=60.0)]
    """The wind behind it, north part of where the air moves to."""
    behind_e_mps: Annotated[float, Meta(ge=-60.0, le=60.0)]
    """East part."""
    change_mps: Annotated[float, Meta(ge=0.0, le=60.0)]
    """How much the wind changes by it."""


class SharedWinds(WireMessage, frozen=True, kw_only=True):
    """The winds that others feel, told by the desk to one vehicle about every 10 s."""

    vehicle: Name
    """Who is told."""
    life: Annotated[str, Meta(pattern=r"^[A-Za-z0-9][A-Za-z0-9._:-]{0,63}\Z")]
    """`life` of the state that this rests on."""
    as_of_s: Annotated[float, Meta(ge=0.0)]
    """`uptime_s` of that state: from then on it is valid, and ages count from there."""
    lat_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]
    """The place that all others are given from."""
    lon_deg: Annotated[float, Meta(ge=-180.0, le=180.0)]
    """Its longitude."""
    told: Annotated[list[ToldWind], Meta(max_length=MOST_TOLD)]
    """The newest of each of the others nearest to it."""
    front: ToldFront | msgspec.UnsetType | None = msgspec.UNSET
    """A front that is new or better known; null: the one told is withdrawn; else left out."""

    def tellings(self, origin_deg: tuple[float, float], as_of_t_s: float) -> Iterator[WindTelling]:
        """As tellings about one's own origin; `as_of_t_s`: `as_of_s` on one's own clock."""
        north, east = offset_m(*origin_deg, self.lat_deg, self.lon_deg)
        for one in self.told:
            yield WindTelling(
                one.member,
                as_of_t_s - one.age_s,
                (north + one.north_m, east + one.east_m),
                float(one.height_m),
                (one.to_n_cmps / _CMPS, one.to_e_cmps / _CMPS),
                (one.nn_cm2 / 100.0, 0.0, one.ee_cm2 / 100.0),
            )

    def front_ahead(self, origin_deg: tuple[float, float], as_of_t_s: float) -> FrontAhead | None:
        """The front about one's own origin and on one's own clock."""
        front = self.front
        if front is msgspec.UNSET or front is None:
            return None
        place = offset_m(*origin_deg, self.lat_deg, self.lon_deg)
        behind = front.behind_n_mps, front.behind_e_mps
        # Only its size is told: the change lies along the wind behind it more or less.
        felt = FeltChange("desk", as_of_t_s, place, (front.change_mps, 0.0), behind, 0.0)
        known_s2 = max(front.std_s**2 - FELT_STD_S**2, 1.0)  # `arrives` adds the other part
        cov = np.diag([known_s2, front.slow_std_spm**2, front.slow_std_spm**2])
        slow = np.array([front.slow_n_spm, front.slow_e_spm])
        at_s = as_of_t_s + front.arrives_in_s
        return FrontAhead(as_of_t_s, (felt,), np.array(place), at_s, slow, cov)


def told_front(front: FrontAhead, place_ne_m: tuple[float, float], as_of_s: float) -> ToldFront:
    """A front as seen from a place, at `as_of_s` on the clock that it is known on."""
    arrives_s, std_s = front.arrives(place_ne_m)
    slow_n, slow_e = (float(x) for x in front.slowness_spm)
    slow_std = float(np.sqrt(max(front.cov[1, 1], front.cov[2, 2])))
    behind = np.mean([one.wind_ne_mps for one in front.felt], axis=0)
    size_mps = float(np.hypot(*front.change_ne_mps))
    return ToldFront(
        arrives_in_s=_within(arrives_s - as_of_s, 3600.0),
        slow_n_spm=_within(slow_n, 1.0, 5),
        slow_e_spm=_within(slow_e, 1.0, 5),
        std_s=min(max(round(std_s, 1), 1.0), 3600.0),
        slow_std_spm=_within(slow_std, 1.0, 5),
        behind_n_mps=_within(float(behind[0]), 60.0),
        behind_e_mps=_within(float(behind[1]), 60.0),
        change_mps=_within(size_mps, 60.0),
    )


def _within(value: float, most: float, digits: int = 1) -> float:
    return round(min(max(value, -most), most), digits)


def _variance(m2ps2: float) -> int:
    return min(max(math.ceil(100.0 * m2ps2), 1), 40_000)
