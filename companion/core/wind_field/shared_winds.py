"""Message with the other members' wind reports, from a desk to one vehicle.

Integers keep a message with five others near 400 bytes. Decoding checks the range of each value;
`fleet_wind` decides which reports are used.
"""

import math
from collections.abc import Iterator
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from companion.core.base.geo import ne_offset_m
from companion.core.base.wire_message import Name, WireMessage
from companion.core.wind_field.fronts import DETECTION_STD_S, WindChange, WindFront
from companion.core.wind_field.wind_reports import MemberWindReport

MAX_REPORTS = 5
"""Members in one message: 200 bytes/s with the 158 bytes/s of the wind in state messages."""

REPORT_INTERVAL_S = 10.0
"""Message interval, equal to the averaging time of a report."""

MOST_AGE_S = 20
_MAX_OFFSET_M = 50_000
_CMPS = 100.0

Metres = Annotated[int, Meta(ge=-_MAX_OFFSET_M, le=_MAX_OFFSET_M)]
CmPerS = Annotated[int, Meta(ge=-6_000, le=6_000)]
VarCm2 = Annotated[int, Meta(ge=1, le=40_000)]
"""Hundredths of (m/s)^2."""


class EncodedWindReport(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """One member's latest wind, as an array in this order."""

    member: Name
    """The reporting member."""
    age_s: Annotated[int, Meta(ge=0, le=MOST_AGE_S)]
    """Age at `reference_time_s`."""
    north_m: Metres
    """Position of the report, north of the message's reference position."""
    east_m: Metres
    """East of the reference position."""
    height_m: Annotated[int, Meta(ge=-3_000, le=3_000)]
    """Above the ground."""
    to_n_cmps: CmPerS
    """North component of the direction that the air moves to, cm/s."""
    to_e_cmps: CmPerS
    """East component, cm/s."""
    nn_cm2: VarCm2
    """Variance north, hundredths of (m/s)^2."""
    ee_cm2: VarCm2
    """Variance east. Uncorrelated, in each direction at least the reported variance."""

    @classmethod
    def encode(
        cls, report: MemberWindReport, north_m: float, east_m: float, age_s: float
    ) -> "EncodedWindReport":
        """Round a report without reducing its variance in any direction."""
        nn, ee = report.conservative_variance_ne_m2ps2
        north, east = report.mean_to_ne_mps
        return cls(
            report.member,
            min(max(round(age_s), 0), MOST_AGE_S),
            round(north_m),
            round(east_m),
            round(report.height_m),
            round(_CMPS * north),
            round(_CMPS * east),
            _encode_variance(nn),
            _encode_variance(ee),
        )


class EncodedFront(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An approaching front: its time of arrival, and the wind behind it."""

    arrives_in_s: Annotated[float, Meta(ge=-3600.0, le=3600.0)]
    """Time of arrival at the reference position, after `reference_time_s`."""
    slow_n_spm: Annotated[float, Meta(ge=-1.0, le=1.0)]
    """Slowness: increase of the time of arrival per metre to the north."""
    slow_e_spm: Annotated[float, Meta(ge=-1.0, le=1.0)]
    """The same to the east."""
    std_s: Annotated[float, Meta(ge=1.0, le=3600.0)]
    """Error of `arrives_in_s` (one sigma)."""
    slow_std_spm: Annotated[float, Meta(ge=0.0, le=1.0)]
    """Error of each slowness."""
    post_front_n_mps: Annotated[float, Meta(ge=-60.0, le=60.0)] = msgspec.field(name="behind_n_mps")
    """Wind behind the front, north component of the direction that the air moves to."""
    post_front_e_mps: Annotated[float, Meta(ge=-60.0, le=60.0)] = msgspec.field(name="behind_e_mps")
    """East component."""
    change_mps: Annotated[float, Meta(ge=0.0, le=60.0)]
    """Magnitude of the change of wind."""


class SharedWinds(WireMessage, frozen=True, kw_only=True):
    """Wind reports of other members, sent by the desk to one vehicle about every 10 s."""

    vehicle: Name
    """The receiving vehicle."""
    instance_id: Annotated[str, Meta(pattern=r"^[A-Za-z0-9][A-Za-z0-9._:-]{0,63}\Z")] = (
        msgspec.field(name="life")
    )
    """`instance_id` of the vehicle state that the message is based on."""
    as_of_s: Annotated[float, Meta(ge=0.0)]
    """`uptime_s` of that state: start of validity, reference of all ages."""
    lat_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]
    """Latitude of the reference position."""
    lon_deg: Annotated[float, Meta(ge=-180.0, le=180.0)]
    """Longitude of the reference position."""
    reports: Annotated[list[EncodedWindReport], Meta(max_length=MAX_REPORTS)] = msgspec.field(
        name="told"
    )
    """The latest report of each of the nearest other members."""
    front: EncodedFront | msgspec.UnsetType | None = msgspec.UNSET
    """A front that is new or better estimated; null: withdrawn; absent: no change."""

    def decode_reports(
        self, origin_deg: tuple[float, float], reference_time_on_clock_s: float
    ) -> Iterator[MemberWindReport]:
        """Yield wind reports about the vehicle's origin; `reference_time_on_clock_s`:
        `reference_time_s` on its clock.
        """
        north, east = ne_offset_m(*origin_deg, self.lat_deg, self.lon_deg)
        for one in self.reports:
            yield MemberWindReport(
                one.member,
                reference_time_on_clock_s - one.age_s,
                (north + one.north_m, east + one.east_m),
                float(one.height_m),
                (one.to_n_cmps / _CMPS, one.to_e_cmps / _CMPS),
                (one.nn_cm2 / 100.0, 0.0, one.ee_cm2 / 100.0),
            )

    def decode_front_or_none(
        self, origin_deg: tuple[float, float], reference_time_on_clock_s: float
    ) -> WindFront | None:
        """Return the front about the vehicle's origin and on its clock, or None."""
        front = self.front
        if front is msgspec.UNSET or front is None:
            return None
        position = ne_offset_m(*origin_deg, self.lat_deg, self.lon_deg)
        post_front_ne_mps = front.post_front_n_mps, front.post_front_e_mps
        # The message has the magnitude only: the change is roughly parallel to the wind behind.
        detection = WindChange(
            "desk",
            reference_time_on_clock_s,
            position,
            (front.change_mps, 0.0),
            post_front_ne_mps,
            0.0,
        )
        # `arrival_time_and_std_s` adds the other part
        known_s2 = max(front.std_s**2 - DETECTION_STD_S**2, 1.0)
        cov = np.diag([known_s2, front.slow_std_spm**2, front.slow_std_spm**2])
        slow = np.array([front.slow_n_spm, front.slow_e_spm])
        at_s = reference_time_on_clock_s + front.arrives_in_s
        return WindFront(
            reference_time_on_clock_s, (detection,), np.array(position), at_s, slow, cov
        )


def encode_front(
    front: WindFront, reference_ne_m: tuple[float, float], reference_time_s: float
) -> EncodedFront:
    """Return a front's message for a reference position, at `reference_time_s` on the front's
    clock.
    """
    arrives_s, std_s = front.arrival_time_and_std_s(reference_ne_m)
    slow_n, slow_e = (float(x) for x in front.slowness_spm)
    slow_std = float(np.sqrt(max(front.cov[1, 1], front.cov[2, 2])))
    post_front_ne_mps = np.mean([one.wind_ne_mps for one in front.detections], axis=0)
    size_mps = float(np.hypot(*front.change_ne_mps))
    return EncodedFront(
        arrives_in_s=_round_clamped(arrives_s - reference_time_s, 3600.0),
        slow_n_spm=_round_clamped(slow_n, 1.0, 5),
        slow_e_spm=_round_clamped(slow_e, 1.0, 5),
        std_s=min(max(round(std_s, 1), 1.0), 3600.0),
        slow_std_spm=_round_clamped(slow_std, 1.0, 5),
        post_front_n_mps=_round_clamped(float(post_front_ne_mps[0]), 60.0),
        post_front_e_mps=_round_clamped(float(post_front_ne_mps[1]), 60.0),
        change_mps=_round_clamped(size_mps, 60.0),
    )


def _round_clamped(value: float, max_magnitude: float, digits: int = 1) -> float:
    return round(min(max(value, -max_magnitude), max_magnitude), digits)


def _encode_variance(variance_m2ps2: float) -> int:
    return min(max(math.ceil(100.0 * variance_m2ps2), 1), 40_000)
