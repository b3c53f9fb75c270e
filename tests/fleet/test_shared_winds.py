"""Wind reports of other vehicles over live TLS: receivers, accepted signers and size."""

from contextlib import closing
from pathlib import Path
from typing import Any

import msgspec
import pytest
import zenoh

from companion.core.mission.events import FleetWindReceived
from companion.core.wind_field.fronts import WindChange
from companion.core.wind_field.shared_winds import (
    MAX_REPORTS,
    REPORT_INTERVAL_S,
    EncodedWindReport,
    SharedWinds,
    encode_front,
)
from companion.core.wind_field.wind_reports import MemberWindReport
from companion.fleet.command_log import MAX_STATE_AGE_S
from companion.fleet.envelope import Envelope, decode_envelope
from companion.fleet.messages import encode_message
from companion.fleet.roster import Roster
from companion.fleet.topics import VehicleKeys
from companion.fleet.zenoh_config import read_and_check_zenoh_config
from ground_station.adapters import called_session
from ground_station.adapters.pki.access_rules import access_control_config
from ground_station.core.fleet.fleet_link import StateReceived
from tests.companion.wind_field.made_front import made_front
from tests.fleet.secure_site import SecureSite
from tests.fleet.strangers import KEPT_OUT_S, PATIENCE_S
from tests.fleet.test_called_session import Running, running
from tests.fleet.zenoh_net import FLEET, Vehicle

STATE_BYTES_A_S = 158
"""Bytes of a state for position, height, wind and covariance (docs/reference/key-space.md)."""


def word(vehicle: str, life: str, as_of_s: float, **more: Any) -> SharedWinds:
    names = [f"drone-{k}" for k in range(MAX_REPORTS)]
    told = [
        MemberWindReport(n, 0.0, (-512.0, 733.0), 41.0, (-11.26, 8.75), (0.31, -0.02, 0.28))
        for n in names
    ]
    return SharedWinds(
        vehicle=vehicle, instance_id=life, as_of_s=round(as_of_s, 1), lat_deg=55.47, lon_deg=8.4501,
        reports=[EncodedWindReport.encode(one, -512.0, 733.0, 4.0) for one in told], **more,
    )  # fmt: skip


def tells(fleet: Running, d1: Vehicle) -> list[FleetWindReceived]:
    """Send a wind report based on the vehicle's latest state; return the reports it accepts."""
    states = [h.state for h in fleet.turn() if isinstance(h, StateReceived)]
    as_of_s = states[-1].uptime_s if states else d1.port.member.uptime_s
    fleet.desk.publish(word("d1", d1.port.member.instance_id, as_of_s))
    return [
        event
        for event in d1.port.take_received_winds(100.0)
        if isinstance(event, FleetWindReceived)
    ]


def without_the_rule(roster: Roster) -> dict[str, Any]:
    table = access_control_config(roster)
    for policy in table["policies"]:
        policy["rules"] = [rule for rule in policy["rules"] if "-wind-" not in rule]
    table["rules"] = [rule for rule in table["rules"] if "-wind-" not in rule["id"]]
    return table


@pytest.mark.sample
@pytest.mark.drawn(of="called")
@pytest.mark.parametrize("called", ["desk", "router"])
@pytest.mark.parametrize("allowed", [True, False], ids=["told", "canary: no rule"])
def test_over_tls_a_vehicle_hears_the_winds_that_its_desk_tells(
    tmp_path, monkeypatch, called, allowed
):
    if not allowed:
        monkeypatch.setattr(called_session, "access_control_config", without_the_rule)
    with (
        running(called, tmp_path) as fleet,
        closing(fleet.site.vehicle("d1", tmp_path / "d1")) as d1,
    ):
        assert fleet.hears(d1)
        heard: list[FleetWindReceived] = []
        limit_s = PATIENCE_S if allowed else KEPT_OUT_S
        assert (
            fleet.until(lambda: bool(heard.extend(tells(fleet, d1)) or heard), limit_s) is allowed
        )
        if allowed:
            assert heard[0].winds.reports[0].to_n_cmps == -1126
            assert 0.0 <= heard[0].age_s < 5.0


def signer(raw: bytes) -> str:
    found = decode_envelope("winds", raw)
    assert isinstance(found, Envelope)
    return found.signer


@pytest.mark.sample
def test_another_vehicle_neither_hears_them_nor_may_tell_them(tmp_path):
    with (
        running("desk", tmp_path) as fleet,
        closing(fleet.site.vehicle("d1", tmp_path / "d1")) as d1,
        zenoh.open(read_and_check_zenoh_config(fleet.site.home("d2") / "zenoh.json5")) as other,
    ):
        heard: list[bytes] = []
        key = VehicleKeys(FLEET, "d1").wind_key
        ear = other.declare_subscriber(key, lambda sample: heard.append(sample.payload.to_bytes()))
        assert fleet.hears(d1)
        assert fleet.until(lambda: bool(tells(fleet, d1))), "canary: d1 hears the desk"
        link = d1.port.member.link
        raw = encode_message(word("d1", d1.port.member.instance_id, d1.port.member.uptime_s))
        came: list[bytes] = []

        def put_by_d2() -> bool:
            other.put(key, fleet.site.identity("d2").trust.sign_in_envelope("winds", raw))
            came.extend(link.link.drain_wind_messages())  # type: ignore[attr-defined]
            return "d2" in map(signer, came)  # reports of the desk may still be in transit

        assert not fleet.until(put_by_d2, KEPT_OUT_S)
        assert "desk" not in map(signer, heard)  # d2 receives only its own
        ear.undeclare()


# --- accepted signers and times ------------------------------------------------------------------


class ByHand:
    """A link whose received messages are set by the test."""

    def __init__(self) -> None:
        self.came: list[bytes] = []

    def drain_wind_messages(self) -> list[bytes]:
        came, self.came = self.came, []
        return came

    def close(self) -> None:
        return


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> SecureSite:
    return SecureSite(tmp_path_factory.mktemp("winds") / "pki")


@pytest.mark.parametrize(
    ("signer", "kind", "why"),
    [
        ("desk", "winds", ""),
        ("d2", "winds", "a vehicle may not publish them (d2)"),
        ("anna", "winds", "a dispatcher may not publish them (anna)"),
        ("desk", "state", "not the signature of desk"),
    ],
)
def test_only_a_desk_tells_the_winds_of_others(site, signer, kind, why) -> None:
    from companion.fleet.signed_link import SignedLink

    wire = ByHand()
    link = SignedLink(wire, site.identity("d1").trust, "life", lambda: 0.0)  # type: ignore[arg-type]
    raw = encode_message(word("d1", "life", 1.0))
    wire.came = [site.identity(signer).trust.sign_in_envelope(kind, raw)]
    assert link.drain_wind_messages() == ([] if why else [raw])
    said = link.rejections.pop_report_if_due(0.0) or ""
    assert why in said if why else not said
    changed = site.identity("desk").trust.sign_in_envelope("winds", raw)
    wire.came = [changed.replace(b"-1126", b"-1127"), raw]
    assert link.drain_wind_messages() == [], "changed on its way, and not signed at all"


@pytest.mark.parametrize(
    ("told", "why"),
    [
        ({}, ""),
        ({"vehicle": "d2"}, "another vehicle"),
        ({"life": "before"}, "another vehicle or instance"),
        ({"as_of_s": -MAX_STATE_AGE_S - 1.0}, "16 s old"),
        ({"as_of_s": 2.0}, "-2 s old"),
    ],
)
def test_a_word_for_somebody_else_or_of_another_time_is_left_out(
    tmp_path: Path, told: dict[str, Any], why: str
) -> None:
    wire, now_s = ByHand(), [100.0]
    port = port_on(tmp_path, wire, now_s)
    now_s[0] = 200.0  # uptime of 100 s in this life
    as_of_s = port.member.uptime_s + told.pop("as_of_s", -1.0)
    wire.came = [
        encode_message(
            word(**{"vehicle": "d1", "life": port.member.instance_id, "as_of_s": as_of_s} | told)
        )
    ]
    found = port.take_received_winds(50.0)
    assert len(found) == (0 if why else 1)
    assert why in (port.refusals.pop_report_if_due(0.0) or "")
    if not why:
        assert isinstance(found[0], FleetWindReceived)
        assert found[0].age_s == pytest.approx(1.0)
    port.close()


def port_on(folder: Path, wire: ByHand, now_s: list[float]) -> Any:
    from companion.adapters.files.params import read_airframe
    from companion.app.flight.fleet_port import FleetPort

    airframe = read_airframe("m100")
    return FleetPort.open("d1", "m100", airframe, folder, lambda life: wire, lambda: now_s[0])  # type: ignore[arg-type, return-value]


def test_up_and_down_together_are_at_most_two_hundred_bytes_a_second(site) -> None:
    seal = site.identity("desk").trust.sign_in_envelope
    raw = encode_message(word("drone-17", "4f1c2a9b7d3e", 12345.67))
    a_second = len(seal("winds", raw)) / REPORT_INTERVAL_S
    print(f"a word of {MAX_REPORTS} others: {len(seal('winds', raw))} bytes")
    assert STATE_BYTES_A_S + a_second <= 200.0
    felt = WindChange("d2", 100.0, (0.0, -1000.0), (0.0, 8.0), (0.0, 14.0), 60.0)
    front = encode_front(made_front(100.0, felt), (0.0, 0.0), 110.0)
    assert (
        len(seal("winds", encode_message(word("drone-17", "4f1c2a9b7d3e", 1.0, front=front))))
        < 1000
    )


def test_a_front_is_told_as_it_was_known() -> None:
    felt = WindChange("d2", 100.0, (300.0, -1000.0), (2.0, 8.0), (1.0, 14.0), 60.0)
    known = made_front(100.0, felt)
    told = word("d1", "life", 40.0, front=encode_front(known, (0.0, 0.0), 110.0))
    # The vehicle's clock reads 7 when the desk's reads 110; its origin is the report's position.
    heard = told.decode_front_or_none((told.lat_deg, told.lon_deg), 7.0)
    assert heard is not None
    for place in ((0.0, 0.0), (200.0, 300.0), (-250.0, 100.0)):
        (due_s, std_s), (heard_s, heard_std_s) = (
            known.arrival_time_and_std_s(place),
            heard.arrival_time_and_std_s(place),
        )
        assert heard_s - 7.0 == pytest.approx(due_s - 110.0, abs=0.2)
        assert heard_std_s == pytest.approx(std_s, rel=0.25)


def test_that_a_front_is_withdrawn_travels_apart_from_no_news_of_it() -> None:
    silent, withdrawn = word("d1", "life", 40.0), word("d1", "life", 40.0, front=None)
    assert b"front" not in encode_message(silent)
    heard = msgspec.json.decode(encode_message(withdrawn), type=SharedWinds)
    assert heard.front is None
    assert heard.decode_front_or_none((heard.lat_deg, heard.lon_deg), 7.0) is None


def test_a_covariance_is_told_as_no_less_in_any_direction() -> None:
    import numpy as np

    rng = np.random.default_rng(1)
    for _ in range(200):
        root = rng.normal(0.0, 0.5, (2, 2))
        cov = root @ root.T + 1e-3 * np.eye(2)
        telling = MemberWindReport(
            "d2", 0.0, (0.0, 0.0), 40.0, (1.0, 2.0), (cov[0, 0], cov[0, 1], cov[1, 1])
        )
        told = EncodedWindReport.encode(telling, 0.0, 0.0, 0.0)
        wire = np.diag([told.nn_cm2, told.ee_cm2]) / 100.0
        assert np.linalg.eigvalsh(wire - cov).min() >= -1e-9
