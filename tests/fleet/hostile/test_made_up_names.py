"""Vehicle names that are not in the roster, sent through an attacker's router: a desk with an
identity allocates no memory for them.
"""

import pytest

from ground_station.adapters.fleet_inbox import NOT_ON_ROSTER
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.core.fleet.fleet_link import (
    FleetInput,
    LivelinessChanged,
    MessageRejected,
    StateReceived,
)
from tests.fleet.secure_site import SecureSite
from tests.fleet.strangers import PATIENCE_S, forged_state, hears, plain_network
from tests.fleet.zenoh_net import FLEET

NAMES = [f"x{number}" for number in range(100)]


@pytest.mark.sample
@pytest.mark.parametrize("identity", [True, False], ids=["not heard", "canary: heard"])
def test_who_is_not_listed_is_never_there_and_says_nothing(tmp_path, identity):
    with plain_network(SecureSite(tmp_path / "pki"), tmp_path) as net:
        everybodys = ZenohFleet(FLEET, tmp_path / "client.json5")
        desk = net.desk if identity else everybodys
        first = StateReceived if identity else LivelinessChanged
        assert hears(desk, lambda heard: isinstance(heard, first), PATIENCE_S)
        found: list[FleetInput] = []

        def is_all(heard: FleetInput) -> bool:
            """Match a state of d1 after two seconds; without an identity, states of all names."""
            found.append(heard)
            if not identity:
                return stated_by(found) >= set(NAMES)
            return isinstance(heard, StateReceived) and heard.state.uptime_s > begun_s + 2.0

        begun_s = net.d1.port.member.uptime_s
        own = [f"leeway/{FLEET}/vehicle/{name}" for name in NAMES]
        tokens = [net.rogue.liveliness().declare_token(f"{key}/alive/a") for key in own]
        for name in NAMES:
            net.put("state", forged_state().replace(b'"d1"', f'"{name}"'.encode()), name)
        assert hears(desk, is_all, PATIENCE_S)
        for token in tokens:
            token.undeclare()
        everybodys.close()
    joined = {one.vehicle for one in found if isinstance(one, LivelinessChanged)}
    stated = stated_by(found)
    rejected = [one for one in found if isinstance(one, MessageRejected)]
    if not identity:
        assert joined & stated >= set(NAMES)
        return
    assert joined | stated == {"d1"}
    assert {(one.key, one.reason) for one in rejected} == {("", NOT_ON_ROSTER)}
    assert sum(one.count for one in rejected) == 2 * len(NAMES)


def stated_by(found: list[FleetInput]) -> set[str]:
    return {one.state.vehicle for one in found if isinstance(one, StateReceived)}
