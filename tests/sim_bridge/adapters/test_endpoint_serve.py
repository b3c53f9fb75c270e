"""The host of served vehicles, over real sockets, without a ground station."""

import socket
import time
from contextlib import closing

import pytest

from sim_bridge.app.serve.server import Host
from sim_bridge.autopilot.kinds import AutopilotKind
from sim_bridge.autopilot.mavlink.codec import Decoder, Encoder, Message
from tests.sitl.served import on_the_ground

WAIT_S = 5.0
SPEEDUP = 20.0


def address(url: str) -> tuple[str, int]:
    return "127.0.0.1", int(url.rsplit(":", 1)[1])


class Client:
    """A MAVLink client on a connected socket."""

    def __init__(self, sock: socket.socket, component: int) -> None:
        self._socket = sock
        self._encoder = Encoder(1, component)
        self._decoder = Decoder(stream=True)
        sock.settimeout(WAIT_S)

    def beat(self) -> None:
        self.send("HEARTBEAT", type=18, autopilot=8, base_mode=0, custom_mode=0, system_status=4)

    def send(self, name: str, **fields: object) -> None:
        self._socket.send(self._encoder.encode_next_frame(Message(name, **fields)))

    def hear(self, name: str, component: int = 1) -> Message:
        deadline_s = time.monotonic() + WAIT_S
        while time.monotonic() < deadline_s:
            for message in self._decoder.decode_bytes(self._socket.recv(65536)):
                if message.msg_name == name and message.src_component == component:
                    return message
        raise AssertionError(f"no {name} from component {component}")


def udp(url: str) -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.connect(address(url))
    return made


@pytest.mark.parametrize("autopilot", AutopilotKind)
def test_a_vehicle_answers_on_udp_and_on_tcp_and_carries_messages_between_them(
    autopilot: AutopilotKind,
) -> None:
    with Host(SPEEDUP) as host:
        onboard, gcs = host.add_vehicle(
            on_the_ground(autopilot), onboard_urls=["udpin::0"], gcs_urls=["tcpin::0"]
        )
        with (
            host.serve_in_thread(),
            closing(udp(onboard)) as udp_socket,
            closing(socket.create_connection(address(gcs), timeout=WAIT_S)) as tcp_socket,
        ):
            companion, station = Client(udp_socket, 191), Client(tcp_socket, 190)
            companion.beat()
            station.beat()
            assert companion.hear("HEARTBEAT").autopilot in (3, 12)
            assert station.hear("HEARTBEAT").autopilot in (3, 12)
            station.send("PING", time_usec=7, seq=7, target_system=1, target_component=191)
            assert companion.hear("PING", component=190).seq == 7


def test_a_served_vehicles_signing_clock_is_the_time_of_day() -> None:
    with Host(SPEEDUP) as host:
        served = on_the_ground(AutopilotKind.PX4)
        host.add_vehicle(served, onboard_urls=["udpin::0"])
        served.autopilot.radio.enable_signing(bytes(32), 0)
        host.run_cycle()
        assert (signing := served.autopilot.radio.signing) is not None
        assert abs(signing.timestamp_10us / 1e5 + 1_420_070_400 - time.time()) < WAIT_S  # 2015


def test_several_vehicles_share_a_host_each_on_its_own_link() -> None:
    with Host(SPEEDUP) as host:
        urls = [
            host.add_vehicle(on_the_ground(autopilot, system_id=system), onboard_urls=["udpin::0"])[
                0
            ]
            for system, autopilot in ((1, AutopilotKind.PX4), (2, AutopilotKind.ARDUPILOT))
        ]
        with host.serve_in_thread():
            for system, url in enumerate(urls, 1):
                with closing(udp(url)) as client_socket:
                    client = Client(client_socket, 191)
                    client.beat()
                    assert client.hear("HEARTBEAT").src_system == system


def test_simulated_time_runs_no_faster_than_the_speed_up() -> None:
    with Host(SPEEDUP) as host:
        host.add_vehicle(on_the_ground(AutopilotKind.PX4), onboard_urls=["udpin::0"])
        start_s = time.monotonic()
        while host.t_s < 10.0:
            host.run_cycle()
        assert time.monotonic() - start_s >= 0.99 * 10.0 / SPEEDUP - 0.01  # the first turn is free


def test_what_goes_wrong_in_the_serving_thread_is_not_lost() -> None:
    served = on_the_ground(AutopilotKind.PX4)

    def broken(*_: object) -> None:
        raise RuntimeError("out of cheese")

    served.autopilot.process_readings = broken  # type: ignore[method-assign]
    with Host(SPEEDUP) as host:
        host.add_vehicle(served)
        with pytest.raises(RuntimeError, match="out of cheese"), host.serve_in_thread():
            time.sleep(0.1)
