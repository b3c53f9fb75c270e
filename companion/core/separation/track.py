"""Track message: position, velocity and destination of a vehicle, for its neighbours."""

from typing import Annotated

import msgspec
from msgspec import Meta

from companion.core.base.wire_message import Name, WireMessage


class Track(WireMessage, frozen=True, kw_only=True):
    """Position and velocity of a vehicle for its neighbours, sent five times a second."""

    vehicle: Name
    """Sender."""
    gnss_s: Annotated[float, Meta(ge=0.0)]
    """GNSS time of the position, seconds since 1970: the clock common to all vehicles."""
    lat_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]
    """Latitude."""
    lon_deg: Annotated[float, Meta(ge=-180.0, le=180.0)]
    """Longitude."""
    alt_amsl_m: Annotated[float, Meta(ge=-500.0, le=20_000.0)]
    """Height above mean sea level."""
    vel_n_mps: float
    """Velocity north."""
    vel_e_mps: float
    """Velocity east."""
    vel_d_mps: float
    """Velocity down."""
    pos_std_m: Annotated[float, Meta(ge=0.0)]
    """Error of each horizontal axis (one sigma)."""
    alt_std_m: Annotated[float, Meta(ge=0.0)]
    """Error of the height (one sigma)."""
    vel_std_mps: Annotated[float, Meta(ge=0.0)]
    """Error of each velocity (one sigma)."""
    avoiding: bool = msgspec.field(default=False, name="aside")
    """Whether it flies set-points for separation."""
    to_lat_deg: Annotated[float, Meta(ge=-90.0, le=90.0)] | None = None
    """Latitude of its destination, for displays and learned policies."""
    to_lon_deg: Annotated[float, Meta(ge=-180.0, le=180.0)] | None = None
    """Longitude of its destination."""
