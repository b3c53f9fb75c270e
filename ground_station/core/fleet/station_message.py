"""Message of a wind station on the fleet's network: typed, versioned, bounded JSON."""

from typing import Annotated

import msgspec
from msgspec import Meta

from companion.core.base.errors import LeewayError
from companion.core.base.safe_text import safe_text
from companion.core.base.wire_message import VERSION, Name, WireMessage
from companion.fleet.messages import MAX_MESSAGE_BYTES, EpochUs, Refused


class StationWind(WireMessage, frozen=True, kw_only=True):
    """Measurement of a wind station, a mean over some seconds to a minute."""

    station: Name
    """Name of the station."""
    epoch_us: EpochUs
    """Time of the measurement: the end of its mean, microseconds since 1970."""
    speed_mps: Annotated[float, Meta(ge=0.0, le=100.0)]
    """Mean wind speed."""
    from_deg: Annotated[float, Meta(ge=0.0, le=360.0)]
    """Direction that the wind blows from, clockwise from true north."""
    std_mps: Annotated[float, Meta(gt=0.0, le=20.0)] | None = None
    """Error on each axis, one sigma."""
    lat_deg: Annotated[float, Meta(ge=-90.0, le=90.0)] | None = None
    """Latitude, for receivers without a day."""
    lon_deg: Annotated[float, Meta(ge=-180.0, le=180.0)] | None = None
    """Longitude."""
    height_m: Annotated[float, Meta(ge=0.0, le=500.0)] | None = None
    """Height above the ground."""


class _Versioned(msgspec.Struct, frozen=True):
    v: int


_versioned = msgspec.json.Decoder(_Versioned)
_decoder = msgspec.json.Decoder(StationWind)


def encode_station_wind(wind: StationWind) -> bytes:
    """Encode a station's message."""
    return msgspec.json.encode(wind)


def decode_station_wind(raw: bytes) -> StationWind | Refused:
    """Decode a station's message, or return the reason of its refusal."""
    if len(raw) > MAX_MESSAGE_BYTES["station"]:
        return Refused(
            f"station: {len(raw)} bytes, expected at most {MAX_MESSAGE_BYTES['station']}"
        )
    try:
        version = _versioned.decode(raw).v
        if version != VERSION:
            return Refused(f"station: version {version}, expected {VERSION}")
        return _decoder.decode(raw)
    except (msgspec.DecodeError, LeewayError, UnicodeDecodeError, RecursionError) as error:
        return Refused(safe_text(f"station: {error}"[:300]))
