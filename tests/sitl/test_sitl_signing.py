"""Signing on, in both autopilots: a signed flight with a forger who lacks the key.

In flight the forger (sim_bridge/app/link/forger.py) commands both ends, ten times a second, to fly
elsewhere.
"""

import pytest

pytestmark = pytest.mark.sitl

FORGED = {"faults": [{"kind": "forger", "phase": "climb", "at_s": 0.0}]}


@pytest.fixture
def key(tmp_path):
    path = tmp_path / "key"
    path.write_bytes(bytes(range(32)))
    path.chmod(0o600)
    return path


def undisturbed(flown) -> bool:
    forger = flown.craft.link.forger
    return flown.row["outcome"] == "SUC" and forger is not None and forger.sent_count > 500


@pytest.mark.sample
@pytest.mark.drawn(of="autopilot_kind")
@pytest.mark.parametrize("autopilot_kind", ["px4", "ardupilot"])
def test_signed_it_delivers_whatever_a_forger_without_the_key_says(fly_case, autopilot_kind, key):
    flown = fly_case(autopilot_kind, FORGED, signing_key=key)
    assert undisturbed(flown), flown.row


@pytest.mark.sample
def test_the_check_fails_where_nothing_is_signed(fly_case):
    flown = fly_case("px4", FORGED)
    assert not undisturbed(flown), flown.row
