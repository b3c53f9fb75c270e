"""Where a vehicle is and wants to be, as it tells its neighbours."""

from typing import Annotated

from msgspec import Meta

from companion.core.base.wire_message import Name, WireMessage


class Track(WireMessage, frozen=True, kw_only=True):
    """Where a vehicle is, five times a second, for its neighbours."""

    vehicle: Name
    """Who tells it."""
    gnss_s: Annotated[float, Meta(ge=0.0)]
    """Satellite time of the place, seconds since 1970: the one clock that all share."""
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
    aside: bool = False
    """It flies set-points to keep apart."""
    to_lat_deg: Annotated[float, Meta(ge=-90.0, le=90.0)] | None = None
    """Latitude of where it wants to, for people and for learned policies."""
    to_lon_deg: Annotated[float, Meta(ge=-180.0, le=180.0)] | None = None
    """Longitude of where it wants to."""
