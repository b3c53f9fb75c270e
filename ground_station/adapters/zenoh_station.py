"""A wind station's network connection: publishes its own wind and receives nothing."""

from pathlib import Path

from companion.core.base.errors import LeewayError
from companion.fleet.identity import read_identity_of_fleet_and_member
from companion.fleet.membership import DEFAULT_JOIN_OPTIONS, JoinOptions
from companion.fleet.roles import WIND_STATIONS
from companion.fleet.topics import station_wind_key
from companion.fleet.zenoh_config import read_and_check_zenoh_config
from companion.fleet.zenoh_session import open_session
from ground_station.core.fleet.station_message import StationWind, encode_station_wind


class ZenohStation:
    """Session of one wind station."""

    def __init__(
        self,
        fleet: str,
        station: str,
        config: Path | None,
        options: JoinOptions = DEFAULT_JOIN_OPTIONS,
    ) -> None:
        """Join as this station. Raises LeewayError if a file is invalid or the identity is not that
        of a station with this name.
        """
        self._key, self._trust = station_wind_key(fleet, station), None
        if options.identity is not None:
            identity = read_identity_of_fleet_and_member(options.identity, fleet, station)
            self._trust, config = identity.trust, config or identity.zenoh_config_path
            me = identity.trust.own_roster_entry
            if me is None or me.role not in WIND_STATIONS:
                role = "not on the roster" if me is None else f"a {me.role.value}"
                raise LeewayError(f"{options.identity}: {station} is {role}, expected a station")
        checked_config = read_and_check_zenoh_config(config, open_network=options.open_network)
        self._session = open_session(checked_config, config)

    def publish_wind(self, wind: StationWind) -> None:
        """Publish a measured wind, signed if the station has an identity."""
        raw = encode_station_wind(wind)
        self._session.put(
            self._key, raw if self._trust is None else self._trust.sign_in_envelope("station", raw)
        )

    def close(self) -> None:
        """Leave the network."""
        self._session.close()
