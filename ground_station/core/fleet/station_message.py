"""What a wind station tells on the fleet's network: typed, versioned, bounded JSON."""

from typing import Annotated

import msgspec
from msgspec import Meta

from companion.core.base.errors import LeewayError
from companion.core.base.safe_text import safe_text
from companion.core.base.wire_message import VERSION, Name, WireMessage
from companion.fleet.messages import LARGEST_BYTES, EpochUs, Refused


class StationWind(WireMessage, frozen=True, kw_only=True):
    """What a wind station measures, a mean over some seconds to a minute."""

    station: Name
    """Who tells it."""
    epoch_us: EpochUs
    """When it was measured: the end of its mean, microseconds since 1970."""
    speed_mps: Annotated[float, Meta(ge=0.0, le=100.0)]
    """Mean wind speed."""
    from_deg: Annotated[float, Meta(ge=0.0, le=360.0)]
    """Where it blows from, clockwise from true north."""
    std_mps: Annotated[float, Meta(gt=0.0, le=20.0)] | None = None
    """Its error on each axis, one sigma."""
    lat_deg: Annotated[float, Meta(ge=-90.0, le=90.0)] | None = None
    """Latitude, for who knows no day."""
    lon_deg: Annotated[float, Meta(ge=-180.0, le=180.0)] | None = None
    """Longitude."""
    height_m: Annotated[float, Meta(ge=0.0, le=500.0)] | None = None
    """Height above the ground."""


class _Versioned(msgspec.Struct, frozen=True):
    v: int


_versioned = msgspec.json.Decoder(_Versioned)
_decoder = msgspec.json.Decoder(StationWind)


def encode_station(wind: StationWind) -> bytes:
    """The bytes of a station's message."""
    return msgspec.json.encode(wind)


def decode_station(raw: bytes) -> StationWind | Refused:
    """A station's wind, or why these bytes are none."""
    if len(raw) > LARGEST_BYTES["station"]:
        return Refused(f"station: {len(raw)} bytes, expected at most {LARGEST_BYTES['station']}")
    try:
        version = _versioned.decode(raw).v
        if version != VERSION:
            return Refused(f"station: version {version}, expected {VERSION}")
        return _decoder.decode(raw)
    except (msgspec.DecodeError, LeewayError, UnicodeDecodeError, RecursionError) as error:
        return Refused(safe_text(f"station: {error}"[:300]))
