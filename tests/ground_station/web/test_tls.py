"""The map for other machines: served with TLS, under the names of its certificate."""

import base64
import hashlib
import ipaddress
import ssl
from datetime import UTC, datetime, timedelta
from pathlib import Path

import httpx
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from typer.testing import CliRunner

from companion.core.base.errors import LeewayError
from companion.fleet.roles import Role
from ground_station.adapters.clock import epoch_us
from ground_station.adapters.files.token_file import generate_random_token
from ground_station.adapters.web.map_server import MapDataSources, MapServer
from ground_station.adapters.web.people import MapAccess
from ground_station.adapters.web.tls_files import load_checked_tls_files
from ground_station.app.cli.main import app
from ground_station.core.people.web_tokens import TokenRegistry
from tests.ground_station.web.browser import browsing, needs_chromium, running
from tests.ground_station.web.map_site import MapSite

DAY_US = 86_400 * 1_000_000


def certificate(folder: Path, names: list[x509.GeneralName], days: int = 30) -> tuple[Path, Path]:
    """A self-signed certificate and its key."""
    key, now = ec.generate_private_key(ec.SECP256R1()), datetime.now(tz=UTC)
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "map")])
    made = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(days=1))
        .not_valid_after(now + timedelta(days=days))
        .add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
    )
    if names:
        made = made.add_extension(x509.SubjectAlternativeName(names), critical=False)
    cert_file, key_file = folder / "map.pem", folder / "map.key"
    signed = made.sign(key, hashes.SHA256())
    cert_file.write_bytes(signed.public_bytes(serialization.Encoding.PEM))
    key_file.touch(mode=0o600)
    key_file.write_bytes(
        key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        )
    )
    return cert_file, key_file


LOCAL = [x509.DNSName("localhost"), x509.IPAddress(ipaddress.ip_address("127.0.0.1"))]


def test_it_is_served_with_tls_under_the_certificates_names_only(site: MapSite, tmp_path: Path):
    files = certificate(tmp_path, LOCAL)
    tls = load_checked_tls_files(*files, epoch_us())
    assert tls.names == ("localhost", "127.0.0.1")
    server = MapServer("127.0.0.1", 0, tls)
    site.held.callback(server.close)
    feed = site.decode_bytes
    server.start_serving(
        MapDataSources(feed.stream, feed.margin_history_of, feed.reachable_area_boundary)
    )
    site.step()
    assert server.address == f"https://localhost:{server.port}"
    trusted = ssl.create_default_context(cafile=files[0])
    with httpx.Client(verify=trusted) as client:
        assert client.get(f"{server.address}/picture.json").json() == site.picture
        for header, value, status in (
            ("host", f"desk.example:{server.port}", 421),
            ("origin", server.address.replace("https", "http"), 403),
            ("origin", server.address, 200),
        ):
            assert client.get(server.address, headers={header: value}).status_code == status
    with pytest.raises(httpx.HTTPError):
        httpx.get(server.address.replace("https", "http"))
    with pytest.raises(httpx.ConnectError):
        httpx.get(server.address)  # the certificate is not trusted


def test_files_that_would_not_serve_are_refused_in_words(tmp_path: Path):
    cert, key = certificate(tmp_path, LOCAL)
    with pytest.raises(LeewayError, match="is in force from"):
        load_checked_tls_files(cert, key, epoch_us() + 40 * DAY_US)
    with pytest.raises(LeewayError, match="is in force from"):
        load_checked_tls_files(cert, key, epoch_us() - 40 * DAY_US)
    key.chmod(0o644)
    with pytest.raises(LeewayError, match="mode 0644, expected 0600"):
        load_checked_tls_files(cert, key, epoch_us())
    other = tmp_path / "other"
    other.mkdir()
    _, other_key = certificate(other, LOCAL)
    for wrong in (other_key, tmp_path / "none"):
        with pytest.raises(LeewayError, match=r"^--tls "):
            load_checked_tls_files(cert, wrong, epoch_us())
    nameless = certificate(other, [])
    with pytest.raises(LeewayError, match="expected a subjectAltName"):
        load_checked_tls_files(*nameless, epoch_us())


@pytest.mark.parametrize("given", [[], ["--tls"], ["--tokens"]])
def test_beyond_this_machine_both_tls_and_tokens_are_asked_for(tmp_path: Path, given: list[str]):
    cert, key = certificate(tmp_path, LOCAL)
    options = {"--tls": [str(cert), str(key)], "--tokens": [str(tmp_path / "tokens.json")]}
    words = [word for name in given for word in (name, *options[name])]
    done = CliRunner().invoke(app, ["map", "--fleet", "harbour", "--host", "0.0.0.0", *words])
    assert isinstance(done.exception, LeewayError)
    assert "add --tls CERT KEY and --tokens FILE" in str(done.exception)


def key_pin(certificate_file: Path) -> str:
    """SHA-256 of the certificate's public key (RFC 7469, 2.4): Chromium trusts this one only."""
    key = x509.load_pem_x509_certificate(certificate_file.read_bytes()).public_key()
    form = serialization.PublicFormat.SubjectPublicKeyInfo
    spki = key.public_bytes(serialization.Encoding.DER, form)
    return base64.b64encode(hashlib.sha256(spki).digest()).decode()


def test_in_a_browser_it_is_seen_over_tls_by_who_signs_in_and_under_this_key_only(
    site: MapSite, tmp_path: Path
):
    program = needs_chromium()
    files = certificate(tmp_path, LOCAL)
    token = generate_random_token()
    book = TokenRegistry().with_holder("vera", Role.VIEWER, token, "2026-01-01")
    server = MapServer("127.0.0.1", 0, load_checked_tls_files(*files, epoch_us()))
    site.held.callback(server.close)
    feed, people = site.decode_bytes, MapAccess(lambda: book, None, requires_token=True)
    server.start_serving(
        MapDataSources(
            feed.stream, feed.margin_history_of, feed.reachable_area_boundary, access=people
        )
    )
    site.until_flying("d1")
    pin = f"--ignore-certificate-errors-spki-list={key_pin(files[0])}"
    with running(program, pin) as browser, browsing(browser) as page:
        page.goto(server.address)
        page.locator("#link", has_text="Sign in to see the fleet").wait_for()
        assert page.locator("#list .row").count() == 0
        assert page.evaluate("isSecureContext && location.protocol") == "https:"
        page.locator("#sign-in").click()
        page.locator("#token").fill(token)
        page.keyboard.press("Enter")
        page.wait_for_selector("#link.live")
        page.locator('#map .drone[data-key="d1"]').wait_for(state="attached")
        site.fleet_link.more["d1"] = {"phase": "return"}
        site.step(2)
        page.locator("#list .name", has_text="Flying back").wait_for()
    with running(program) as browser:
        stranger = browser.new_context().new_page()
        with pytest.raises(Exception, match="ERR_CERT_AUTHORITY_INVALID"):
            stranger.goto(server.address)
