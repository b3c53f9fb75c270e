"""Wind stations over zenoh with identities: received as stations only."""

import time
from pathlib import Path

import pytest

from companion.core.base.errors import LeewayError
from companion.fleet.membership import JoinOptions
from companion.fleet.roles import Role
from companion.fleet.topics import VehicleKeys, station_wind_key
from companion.fleet.zenoh_config import read_and_check_zenoh_config
from ground_station.adapters.zenoh_station import ZenohStation
from ground_station.core.fleet.fleet_link import MessageRejected, StateReceived, StationWindReceived
from ground_station.core.fleet.station_message import StationWind, encode_station_wind
from tests.fleet.secure_site import YEAR_DAYS, SecureSite
from tests.fleet.zenoh_net import FLEET

WITHIN_S = 15.0


def a_word(station: str, speed_mps: float = 6.0) -> StationWind:
    return StationWind(
        station=station, epoch_us=time.time_ns() // 1000, speed_mps=speed_mps, from_deg=270.0
    )


class Heard:
    """Collects everything that a desk receives."""

    def __init__(self, desk) -> None:
        self.desk, self.winds, self.rejected, self.states = desk, [], [], []

    def listen(self, until, tell=lambda: None) -> bool:
        end_s = time.monotonic() + WITHIN_S
        while time.monotonic() < end_s:
            tell()
            for one in self.desk.receive(0.2):
                match one:
                    case StationWindReceived():
                        self.winds.append(one.wind)
                    case MessageRejected():
                        self.rejected.append(f"{one.key}: {one.reason}")
                    case StateReceived():
                        self.states.append(one.state)
                    case _:
                        pass
            if until():
                return True
        return False


@pytest.fixture
def site(tmp_path: Path) -> SecureSite:
    made = SecureSite(tmp_path / "pki")
    made.pki.add_member("mast", Role.STATION, YEAR_DAYS, "")
    return made


def test_a_station_is_heard_by_desk_and_viewer_and_only_in_its_own_name(site: SecureSite):
    desk = site.person("desk")
    viewer = site.person("otto")
    station = ZenohStation(FLEET, "mast", None, JoinOptions(site.home("mast")))
    heard, seen = Heard(desk), Heard(viewer)
    try:
        assert heard.listen(lambda: heard.winds != [], lambda: station.publish_wind(a_word("mast")))
        assert heard.winds[0].station == "mast"
        assert heard.rejected == []
        assert seen.listen(lambda: seen.winds != [], lambda: station.publish_wind(a_word("mast")))
        station.publish_wind(a_word("pier"))
        assert heard.listen(lambda: heard.rejected != [])
        assert "mast sent a report of pier" in heard.rejected[0]
    finally:
        station.close()
        desk.close()
        viewer.close()


@pytest.mark.sample
def test_nobody_else_tells_a_stations_wind_and_a_station_tells_no_state(site: SecureSite):
    """With the members' own keys over TLS, and by signatures where the network accepts all."""
    desk = site.person("desk")
    heard = Heard(desk)
    import zenoh

    sessions = []
    try:
        for name in ("d1", "mast"):
            session = zenoh.open(read_and_check_zenoh_config(site.identity(name).zenoh_config_path))
            sessions.append(session)
        drone, station = sessions
        raw = encode_station_wind(a_word("mast", 20.0))
        forged = site.identity("d1").trust.sign_in_envelope("station", raw)
        own = site.identity("mast").trust.sign_in_envelope("station", raw)
        state = VehicleKeys(FLEET, "d1").state_key

        def tell() -> None:
            drone.put(station_wind_key(FLEET, "mast"), forged)
            drone.put(station_wind_key(FLEET, "mast"), own)  # a replay of a recorded message
            station.put(state, own)

        end_s = time.monotonic() + 5.0
        heard.listen(lambda: time.monotonic() > end_s, tell)
        assert heard.winds == []
        assert heard.states == []
        # Signatures reject what the network's rules let through.
        desk.inbox.add_report("station", station_wind_key(FLEET, "mast"), forged)
        assert heard.listen(lambda: heard.rejected != [])
        assert "signed by d1" in heard.rejected[0]
        as_state = site.identity("mast").trust.sign_in_envelope("state", raw)
        desk.inbox.add_state(VehicleKeys(FLEET, "mast").state_key, as_state)
        assert heard.listen(lambda: any("is a station" in why for why in heard.rejected))
        unsigned = encode_station_wind(a_word("mast"))
        desk.inbox.add_report("station", station_wind_key(FLEET, "mast"), unsigned)
        assert heard.listen(lambda: any("not signed" in why for why in heard.rejected))
    finally:
        for session in sessions:
            session.close()
        desk.close()


def test_an_identity_of_another_role_or_name_is_refused_before_anything_is_sent(site: SecureSite):
    with pytest.raises(LeewayError, match="d1 is a vehicle, expected a station"):
        ZenohStation(FLEET, "d1", None, JoinOptions(site.home("d1")))
    with pytest.raises(LeewayError, match="is mast's, expected pier's"):
        ZenohStation(FLEET, "pier", None, JoinOptions(site.home("mast")))
