"""A point on the ground as defined in flight, day and order files."""

import msgspec

from companion.core.base.errors import LeewayError, check_range
from companion.core.base.safe_text import check_name


class Location(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A point on the ground, geodetic or relative to the depot; one form, never both.

    Heights are those of the ground there (safety rule 8).
    """

    name: str = ""
    """Name in messages and displays."""
    lat_deg: float | None = None
    """Latitude."""
    lon_deg: float | None = None
    """Longitude."""
    alt_amsl_m: float | None = None
    """Height of the ground above mean sea level, with `lat_deg` and `lon_deg`."""
    east_m: float | None = None
    """East of the depot."""
    north_m: float | None = None
    """North of the depot."""
    up_m: float = 0.0
    """Height of the ground above the depot's, with `east_m` and `north_m`."""

    def __post_init__(self) -> None:
        check_name("name", self.name)
        geodetic = (self.lat_deg, self.lon_deg, self.alt_amsl_m)
        relative = (self.east_m, self.north_m)
        where = self.name or "place"
        if all(v is not None for v in geodetic) and all(v is None for v in relative):
            check_range(f"{where}.lat_deg", self.lat_deg or 0.0, -85.0, 85.0)
            check_range(f"{where}.lon_deg", self.lon_deg or 0.0, -180.0, 180.0)
            check_range(f"{where}.alt_amsl_m", self.alt_amsl_m or 0.0, -500.0, 9000.0)
            if self.up_m != 0.0:
                raise LeewayError(f"{where}.up_m: not allowed with lat_deg, lon_deg, alt_amsl_m")
        elif all(v is not None for v in relative) and all(v is None for v in geodetic):
            for key, value in (("east_m", self.east_m), ("north_m", self.north_m)):
                check_range(f"{where}.{key}", value or 0.0, -50_000.0, 50_000.0)
            check_range(f"{where}.up_m", self.up_m, -3000.0, 3000.0)
        else:
            raise LeewayError(
                f"{where}: expected lat_deg, lon_deg and alt_amsl_m, or east_m and north_m"
                " (and up_m) relative to the depot"
            )
