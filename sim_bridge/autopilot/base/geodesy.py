"""Latitude and longitude against metres north and east, on the WGS 84 ellipsoid."""

import math

Vec3 = tuple[float, float, float]
"""North, east, down (or forward, right, down)."""

SEMI_MAJOR_M = 6378137.0
"""WGS 84 (NIMA TR8350.2, table 3.1)."""
FLATTENING = 1.0 / 298.257223563
ECCENTRICITY2 = FLATTENING * (2.0 - FLATTENING)
SEMI_MINOR_M = SEMI_MAJOR_M * (1.0 - FLATTENING)
SECOND_ECCENTRICITY2 = ECCENTRICITY2 / (1.0 - ECCENTRICITY2)


class LocalFrame:
    """The tangent plane at a point: exact horizontally, with unchanged altitudes.

    North and east are those of the east-north-up frame at the origin for a point at the origin's
    height; the vertical is not from that frame, because a barometer follows the ellipsoid, not the
    tangent plane.
    """

    __slots__ = (
        "_cos_lat",
        "_cos_lon",
        "_sin_lat",
        "_sin_lon",
        "_x0",
        "_y0",
        "_z0",
        "alt_amsl_m",
        "lat_deg",
        "lon_deg",
    )

    def __init__(self, lat_deg: float, lon_deg: float, alt_amsl_m: float) -> None:
        self.lat_deg = lat_deg
        self.lon_deg = lon_deg
        self.alt_amsl_m = alt_amsl_m
        lat, lon = math.radians(lat_deg), math.radians(lon_deg)
        self._sin_lat, self._cos_lat = math.sin(lat), math.cos(lat)
        self._sin_lon, self._cos_lon = math.sin(lon), math.cos(lon)
        self._x0, self._y0, self._z0 = self._ecef_at_origin_height_m(lat_deg, lon_deg)

    def _ecef_at_origin_height_m(
        self, lat_deg: float, lon_deg: float
    ) -> tuple[float, float, float]:
        lat, lon = math.radians(lat_deg), math.radians(lon_deg)
        sin_lat, cos_lat = math.sin(lat), math.cos(lat)
        radius = SEMI_MAJOR_M / math.sqrt(1.0 - ECCENTRICITY2 * sin_lat * sin_lat)
        height = self.alt_amsl_m
        return (
            (radius + height) * cos_lat * math.cos(lon),
            (radius + height) * cos_lat * math.sin(lon),
            (radius * (1.0 - ECCENTRICITY2) + height) * sin_lat,
        )

    def to_ne_m(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        """Metres north and east of the origin."""
        x, y, z = self._ecef_at_origin_height_m(lat_deg, lon_deg)
        dx, dy, dz = x - self._x0, y - self._y0, z - self._z0
        outward = self._cos_lon * dx + self._sin_lon * dy
        north = -self._sin_lat * outward + self._cos_lat * dz
        return north, -self._sin_lon * dx + self._cos_lon * dy

    def to_lat_lon_deg(self, north_m: float, east_m: float) -> tuple[float, float]:
        """Latitude and longitude of a point; the inverse of `to_ne_m` to a millimetre at 50 km.

        Bowring (1976), one step, from the tangent plane dropped to the ellipsoid.
        """
        up = -(north_m * north_m + east_m * east_m) / (2.0 * (SEMI_MAJOR_M + self.alt_amsl_m))
        outward = self._cos_lat * up - self._sin_lat * north_m
        x = self._x0 + self._cos_lon * outward - self._sin_lon * east_m
        y = self._y0 + self._sin_lon * outward + self._cos_lon * east_m
        z = self._z0 + self._sin_lat * up + self._cos_lat * north_m
        from_axis = math.hypot(x, y)
        parametric_lat_rad = math.atan2(z * SEMI_MAJOR_M, from_axis * SEMI_MINOR_M)
        lat = math.atan2(
            z + SECOND_ECCENTRICITY2 * SEMI_MINOR_M * math.sin(parametric_lat_rad) ** 3,
            from_axis - ECCENTRICITY2 * SEMI_MAJOR_M * math.cos(parametric_lat_rad) ** 3,
        )
        return math.degrees(lat), math.degrees(math.atan2(y, x))


def horizontal_distance_m(first_ned_m: tuple[float, ...], second_ned_m: tuple[float, ...]) -> float:
    """Horizontal distance of two points."""
    return (
        (first_ned_m[0] - second_ned_m[0]) ** 2 + (first_ned_m[1] - second_ned_m[1]) ** 2
    ) ** 0.5
