"""The shipped TLS and access files let the fleet in, and refuse what they should.

Certificates are made here; the shipped files are used as they are, but for paths and addresses.
"""

import datetime
import ipaddress
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from companion.fleet.messages import Answered, Command, Recall, encode
from ground_station.adapters.clock import monotonic_s
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.core.fleet.fleet_link import (
    CommandAnswered,
    FleetInput,
    LivelinessChanged,
    StateReceived,
)
from tests.fleet.zenoh_net import FLEET, Vehicle, free_port

SHIPPED = Path(__file__).parents[2] / "deploy" / "zenoh"
PATIENCE_S = 20.0
REFUSED_S = 2.0


class Authority:
    """A certificate authority that signs for one folder."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        self.folder = folder
        self._key = ec.generate_private_key(ec.SECP256R1())
        self._name = _name("authority")
        basic = x509.BasicConstraints(ca=True, path_length=0)
        own = _certificate(self._name, self._name, self._key.public_key())
        own = own.add_extension(basic, critical=True).sign(self._key, hashes.SHA256())
        (folder / "ca.pem").write_bytes(own.public_bytes(serialization.Encoding.PEM))

    def sign(self, name: str) -> None:
        key = ec.generate_private_key(ec.SECP256R1())
        address = x509.IPAddress(ipaddress.ip_address("127.0.0.1"))
        names = x509.SubjectAlternativeName([x509.DNSName("localhost"), address])
        made = _certificate(_name(name), self._name, key.public_key())
        made = made.add_extension(names, critical=False)
        made = made.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        signed = made.sign(self._key, hashes.SHA256())
        (self.folder / f"{name}.pem").write_bytes(signed.public_bytes(serialization.Encoding.PEM))
        (self.folder / f"{name}.key").write_bytes(
            key.private_bytes(
                serialization.Encoding.PEM,
                serialization.PrivateFormat.PKCS8,
                serialization.NoEncryption(),
            )
        )


def _name(common: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _certificate(subject: x509.Name, issuer: x509.Name, key: Any) -> x509.CertificateBuilder:
    now = datetime.datetime.now(datetime.UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(hours=1))
        .not_valid_after(now + datetime.timedelta(days=1))
    )


class Site:
    """The shipped files, laid out for loopback."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.port = free_port()
        self.ours = Authority(folder / "tls")
        self.foreign = Authority(folder / "foreign")
        for name in ("desk", "d1", "d2"):
            self.ours.sign(name)
        self.foreign.sign("d1")

    def desk(self, *, rules: bool = True) -> Path:
        text = (SHIPPED / "desk-tls.json5").read_text()
        head, on, tail = text.partition("access_control: {\n    enabled: true")
        assert on
        text = text if rules else head + on.replace("true", "false") + tail
        assert "tls/0.0.0.0:7447" in text
        text = text.replace("tls/0.0.0.0:7447", f"tls/127.0.0.1:{self.port}")
        return self._write("desk.json5", text, self.ours)

    def vehicle(self, name: str = "d1", authority: Authority | None = None) -> Path:
        text = (SHIPPED / "vehicle-tls.json5").read_text()
        assert "tls/desk.harbour.example:7447" in text
        text = text.replace("tls/desk.harbour.example:7447", f"tls/127.0.0.1:{self.port}")
        text = text.replace("/d1.", f"/{name}.")
        return self._write(f"{name}.json5", text, authority or self.ours)

    def _write(self, name: str, text: str, authority: Authority) -> Path:
        path = self.folder / name
        path.write_text(text.replace("/etc/leeway/tls", str(authority.folder)))
        return path


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Site:
    return Site(tmp_path_factory.mktemp("site"))


@pytest.fixture
def desk(site: Site) -> Iterator[ZenohFleet]:
    fleet = ZenohFleet(FLEET, site.desk())
    yield fleet
    fleet.close()


def hears(fleet: ZenohFleet, wanted: Callable[[FleetInput], Any], wait_s: float) -> Any:
    limit_s = monotonic_s() + wait_s
    while monotonic_s() < limit_s:
        for heard in fleet.receive(0.05):
            found = wanted(heard)
            if found:
                return found
    return None


def state_of(vehicle: str) -> Callable[[FleetInput], Any]:
    return lambda h: (
        h.state if isinstance(h, StateReceived) and h.state.vehicle == vehicle else None
    )


def recall(vehicle: str, life: str = "x") -> Command:
    return Command(id="r1", vehicle=vehicle, life=life, as_of_s=0.0, by="desk", deed=Recall())


def test_a_vehicle_with_its_certificate_is_seen_commanded_and_missed(site, desk, tmp_path):
    vehicle = Vehicle("d1", tmp_path / "d1", site.vehicle())
    life = vehicle.port.life
    try:
        assert hears(desk, lambda h: h == LivelinessChanged("d1", life, True), PATIENCE_S)
        assert hears(desk, state_of("d1"), PATIENCE_S)
        desk.send(recall("d1", life), 5.0)
        answer = hears(desk, lambda h: h if isinstance(h, CommandAnswered) else None, PATIENCE_S)
        assert answer.result is not None
        assert answer.result.answer is Answered.DONE
    finally:
        vehicle.close()
    assert hears(desk, lambda h: h == LivelinessChanged("d1", life, False), PATIENCE_S)


def test_a_certificate_of_another_authority_is_not_let_in(site, desk, tmp_path):
    vehicle = Vehicle("d1", tmp_path / "d1", site.vehicle(authority=site.foreign))
    try:
        assert not hears(desk, lambda h: True, REFUSED_S)
    finally:
        vehicle.close()


def test_a_vehicle_cannot_speak_for_another_nor_one_without_a_rule_at_all(site, desk, tmp_path):
    liar = Vehicle("d1", tmp_path / "liar", site.vehicle("d2"))
    stranger = Vehicle("d2", tmp_path / "d2", site.vehicle("d2"))
    honest = Vehicle("d1", tmp_path / "d1", site.vehicle("d1"))
    try:
        assert hears(
            desk, lambda h: h == LivelinessChanged("d1", honest.port.life, True), PATIENCE_S
        )
        lives = {liar.port.life, stranger.port.life}

        def foul(heard: FleetInput) -> bool:
            state_life = heard.state.life if isinstance(heard, StateReceived) else None
            return state_life in lives or (
                isinstance(heard, LivelinessChanged) and heard.life in lives
            )

        assert not hears(desk, foul, REFUSED_S)
    finally:
        for vehicle in (liar, stranger, honest):
            vehicle.close()


@pytest.mark.parametrize("rules", [True, False], ids=["with the rules", "without them it can"])
def test_a_vehicles_certificate_commands_nobody(site, tmp_path, rules):
    desk = ZenohFleet(FLEET, site.desk(rules=rules))
    honest = Vehicle("d1", tmp_path / "d1", site.vehicle("d1"))
    try:
        assert hears(desk, state_of("d1"), PATIENCE_S)
        with zenoh.open(zenoh.Config.from_file(str(site.vehicle("d1")))) as rogue:
            key = f"leeway/{FLEET}/vehicle/d1/command"
            replies = list(rogue.get(key, payload=encode(recall("d1")), timeout=REFUSED_S))
        assert any(reply.ok is not None for reply in replies) is not rules
        assert len(honest.done) == (0 if rules else 1)
    finally:
        honest.close()
        desk.close()
