"""The simulated autopilots against recorded responses of the real ones, and a suite that can fail.

The suite runs against a simulated vehicle in this process: waiting advances the simulation. The
bytes are those of a socket connection, but without the socket a run is reproducible and as fast as
the machine.
"""

from collections.abc import Sequence
from pathlib import Path

import pytest
from typer.testing import CliRunner

from sim_bridge.app.cli import conforming
from sim_bridge.app.serve.server import SITL_RECEIVER, SITL_SETTINGS, Host
from sim_bridge.app.world.vehicle_host import Home, VehicleHost
from sim_bridge.autopilot.kinds import AutopilotKind, BatterySensing
from sim_bridge.autopilot.mavlink.enums import Cmd, MavResult
from sim_bridge.conform import reference
from sim_bridge.conform.behaviour import Behaviour, Observation
from sim_bridge.conform.client import Client
from sim_bridge.conform.reference import Parity
from sim_bridge.conform.suite import CATALOGUE, select_behaviours
from sim_bridge.main import app
from sim_bridge.truth.wind_field import SteadyWind, WindField
from tests.sitl.served import on_the_ground

PARAMS = Path(__file__).parents[3] / "params"
STEPS_A_TURN = 2
BOTH = pytest.mark.parametrize("kind", AutopilotKind)
SPEEDUP = 20.0
HOME = Home()
TIME_OUT = {AutopilotKind.PX4: "COM_OF_LOSS_T", AutopilotKind.ARDUPILOT: "GUID_TIMEOUT"}
TIME_OUTS_S = {AutopilotKind.PX4: 1.0, AutopilotKind.ARDUPILOT: 3.0}  # their defaults
SENSING = {
    AutopilotKind.PX4: BatterySensing.SIH_TIMER,
    AutopilotKind.ARDUPILOT: BatterySensing.POWER_MODULE,
}
WIND = SteadyWind(4.0, from_deg=270.0)  # as the references were recorded
OF_LANDINGS = ("landing", "height")
LANDINGS = [behaviour.name for behaviour in CATALOGUE if behaviour.group_name in OF_LANDINGS]
ALL_ELSE = [behaviour.name for behaviour in CATALOGUE if behaviour.group_name not in OF_LANDINGS]
"""One pack lasts for either group, but not for both."""


class InProcess:
    """A link whose other end is an autopilot in this process."""

    def __init__(self, served: VehicleHost) -> None:
        self._served = served
        served.autopilot.add_link(0)

    def send(self, data: bytes) -> None:
        self._served.autopilot.process_received_datagram(0, data)

    def receive(self, timeout_s: float) -> bytes:
        self._served.advance(STEPS_A_TURN)
        return b"".join(data for _, data in self._served.autopilot.take_frames_to_send())

    def close(self) -> None:
        pass


class Watcher:
    """Prints the messages that pytest shows for a failed run."""

    def update(self, status: str) -> None:
        pass

    def on_behaviour_start(self, behaviour: Behaviour) -> None:
        pass

    def on_behaviour_end(self, behaviour: Behaviour, seen: Observation) -> None:
        words = seen.problem and f"NOT SEEN: {seen.problem}"
        print(f"{behaviour.name}: {behaviour.description} {words or seen.value} ({seen.note})")


def stood(kind: AutopilotKind) -> VehicleHost:
    """Return an autopilot on the ground, in the wind of the references."""
    return on_the_ground(
        kind,
        SITL_SETTINGS[kind],
        home=HOME,
        wind_field=WindField(WIND),
        payload_kg=0.5,
        battery_sensing=SENSING[kind],
        receiver_channels_us=SITL_RECEIVER[kind],
    )


def ask(served: VehicleHost, behaviours: Sequence[Behaviour]) -> reference.ConformanceResult:
    """Return the responses of a vehicle, whose state is restored afterwards."""
    return conforming.run_behaviours_and_restore_vehicle(
        connected(served), behaviours, Watcher(), allow_force_disarm=True
    )


def connected(served: VehicleHost) -> Client:
    return Client(InProcess(served), lambda: served.autopilot.t_s)


def recorded(kind: AutopilotKind) -> reference.ConformanceResult:
    return reference.read_result(reference.reference_folder() / f"{kind.value}.json")


def known_differences(kind: AutopilotKind) -> dict[str, str]:
    return dict(reference.read_known_difference_reasons(reference.reference_folder(), kind.value))


def judged(kind: AutopilotKind, seen: reference.ConformanceResult) -> dict[str, Parity]:
    return reference.compare_results(seen, recorded(kind), known_differences(kind))


def wrong(verdicts: dict[str, Parity]) -> list[str]:
    bad = (Parity.DIFFERENT, Parity.NOT_OBSERVED)
    return [name for name, verdict in verdicts.items() if verdict in bad]


@pytest.mark.sample
@pytest.mark.sitl
@pytest.mark.timeout(900)  # 20 s of one idle core; a machine with ten such at once takes minutes
@pytest.mark.drawn(of="kind")
@pytest.mark.parametrize(("lasts_for", "at_least"), [(ALL_ELSE, 40), (LANDINGS, len(LANDINGS))])
@BOTH
def test_our_autopilot_behaves_as_the_real_autopilot_was_seen_to(
    kind: AutopilotKind, lasts_for: list[str], at_least: int
) -> None:
    served = stood(kind)
    answers = recorded(kind).results
    chosen = [b for b in select_behaviours(lasts_for, include_reboots=True) if b.name in answers]
    verdicts = judged(kind, ask(served, chosen))
    assert wrong(verdicts) == []
    assert sum(verdict is Parity.SAME for verdict in verdicts.values()) >= at_least
    assert not served.autopilot.is_armed
    assert not served.truth.airborne
    assert not served.autopilot.store.mission[1:]


@pytest.mark.sitl
@pytest.mark.parametrize("kind", [f for f in AutopilotKind if known_differences(f)])
def test_a_known_difference_is_one(kind: AutopilotKind) -> None:
    """A listed difference in reasons.toml that does not exist would hide the next one."""
    reasons = known_differences(kind)
    verdicts = judged(kind, ask(stood(kind), select_behaviours(reasons, include_reboots=True)))
    assert {name: verdicts[name] for name in reasons} == dict.fromkeys(reasons, Parity.EXPLAINED)


class Impatient(Watcher):
    """Presses Ctrl-C when a behaviour starts, with the vehicle airborne."""

    def __init__(self, at: str) -> None:
        self._at = at

    def on_behaviour_start(self, behaviour: Behaviour) -> None:
        if behaviour.name == self._at:
            raise KeyboardInterrupt


@pytest.mark.sample
@pytest.mark.sitl
@BOTH
def test_ctrl_c_in_the_air_leaves_the_vehicle_as_it_was_found(kind: AutopilotKind) -> None:
    served = stood(kind)
    chosen = select_behaviours(
        ("guided/velocity_stops", "speed/ground", "speed/air"), include_reboots=False
    )
    client = connected(served)
    with pytest.raises(KeyboardInterrupt):
        conforming.run_behaviours_and_restore_vehicle(
            client, chosen, Impatient("speed/air"), allow_force_disarm=True
        )
    autopilot = served.autopilot
    assert not autopilot.is_armed
    assert not served.truth.airborne
    assert not autopilot.store.mission[1:]
    assert autopilot.params[TIME_OUT[kind]] == TIME_OUTS_S[kind]
    link = autopilot.radio.links[0]
    assert (link.message_interval_s("RC_CHANNELS"), link.message_interval_s("HEARTBEAT")) == (
        None,
        1.0,
    )


@pytest.mark.sitl
def test_an_autopilot_that_answers_wrongly_turns_the_suite_red() -> None:
    """Canary: a PX4 that accepts ArduPilot's jump, and reads parameters as C casts."""
    served = stood(AutopilotKind.PX4)
    commands = dict(served.autopilot.behaviour.commands)
    commands[Cmd.DO_SET_MISSION_CURRENT] = lambda *_: MavResult.ACCEPTED
    served.autopilot.behaviour.commands = commands
    served.autopilot.params.integers_bytewise = False
    chosen = select_behaviours(
        ("mission/jump_on_ground", "parameters/integer_encoding"), include_reboots=False
    )
    assert wrong(judged(AutopilotKind.PX4, ask(served, chosen))) == [
        "parameters/integer_encoding",
        "mission/jump_on_ground",
    ]


def test_every_recorded_answer_belongs_to_a_behaviour() -> None:
    names = {behaviour.name for behaviour in CATALOGUE}
    assert len(names) == len(CATALOGUE)
    for kind in AutopilotKind:
        assert recorded(kind).results.keys() <= names


def test_arducopter_4_6_2_differs_from_4_7_in_two_answers_to_speed_commands() -> None:
    path = reference.reference_folder() / "ardupilot-4.6.2.json"
    of_4_6_2, of_4_7 = reference.read_result(path), recorded(AutopilotKind.ARDUPILOT)
    verdicts = reference.compare_results(of_4_6_2, of_4_7, {})
    assert verdicts.keys() == of_4_7.results.keys()
    assert wrong(verdicts) == ["acks/speed_type", "speed/none"]


def test_the_command_asks_over_udp_and_judges(tmp_path: Path) -> None:
    out = tmp_path / "seen.json"
    with Host(SPEEDUP) as host:
        (url,) = host.add_vehicle(stood(AutopilotKind.PX4), onboard_urls=["udpin:127.0.0.1:0"])
        link = url.replace("udpin", "udpout")
        words = ["conform", "--link", link, "--as", "px4", "--only", "parameters/*encoding"]
        with host.serve_in_thread():
            done = CliRunner().invoke(app, [*words, "--json", str(out)])
    assert done.exit_code == 0, done.output
    assert "1 same" in done.output
    seen = reference.read_result(out)
    assert seen.vehicle.autopilot == "px4"
    assert seen.results["parameters/integer_encoding"].value == "integer bits in the float"


@pytest.mark.parametrize(
    ("link", "told"),
    [
        ("udpout:192.0.2.7:14550", []),
        ("udpin:0.0.0.0:14550", []),
        ("serial:/dev/ttyACM0", ["--yes-it-may-fly"]),
        ("tcp:192.0.2.7:5760", ["--not-a-simulator"]),
    ],
)
def test_what_is_not_on_this_machine_is_refused_unless_told_twice(
    link: str, told: list[str]
) -> None:
    done = CliRunner().invoke(app, ["conform", "--link", link, *told])
    assert done.exit_code != 0
    assert "leaves this machine" in str(done.exception)


def test_two_results_are_compared_as_a_table() -> None:
    path = str(reference.reference_folder() / "px4.json")
    done = CliRunner().invoke(app, ["conform", "--compare", path, path])
    assert done.exit_code == 0
    assert (
        "| Items of an upload are requested with | MISSION_REQUEST_INT | MISSION_REQUEST_INT | = |"
        in done.output
    )
