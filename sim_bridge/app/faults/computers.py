"""Other onboard computers on the vehicle's own system: a payload's, and a second companion."""

import shutil
from dataclasses import dataclass, field
from pathlib import Path

from sim_bridge.adapters.endpoint import EndpointSet, bundled
from sim_bridge.adapters.lockstep import Lockstep
from sim_bridge.app.faults.people import Station
from sim_bridge.app.faults.stage import Stage
from sim_bridge.app.flight.companion_process import CompanionProcess
from sim_bridge.autopilot.kinds import LinkKind
from sim_bridge.autopilot.mavlink.codec import Encoder, Message

SECOND_LINK = 3
BOOT_LIMIT_S = 60.0
ANSWER_LIMIT_S = 20.0
PAYLOAD_COMPONENT = 192
ONBOARD_CONTROLLER, NO_AUTOPILOT, ACTIVE = 18, 8, 4
AUTO_ENABLED = 4


def payload_computer(stage: Stage) -> Station:
    """Component 192 on the vehicle's system, on a link of its own."""
    return Station(stage, (stage.craft.number, PAYLOAD_COMPONENT), LinkKind.ONBOARD)


def beat(computer: Station, *, flies_since_s: float | None = None) -> None:
    """Its heartbeat; with a time: it says that it has flown this flight from then on."""
    flies = flies_since_s is not None
    computer.send(
        Message(
            "HEARTBEAT",
            type=ONBOARD_CONTROLLER,
            autopilot=NO_AUTOPILOT,
            base_mode=AUTO_ENABLED if flies else 0,
            custom_mode=round((flies_since_s or 0.0) * 1000.0),
            system_status=ACTIVE,
            mavlink_version=3,
        )
    )


@dataclass(slots=True)
class SecondCompanion:
    """A second companion process on a link of its own, in lockstep like the first."""

    stage: Stage
    run_dir: Path
    process: CompanionProcess = field(init=False)
    _endpoints: EndpointSet = field(init=False)
    _lockstep: Lockstep = field(init=False)
    _frames: list[bytes] = field(default_factory=list)
    _clock: Encoder = field(init=False)

    def __post_init__(self) -> None:
        craft, ends = self.stage.craft, self.stage.ends
        self._clock = Encoder(craft.number, 1)
        self._endpoints = ends.enter_context(EndpointSet(["udpin:127.0.0.1:0"]))
        port = self._endpoints.urls[0].rsplit(":", 1)[1]
        others = [a for a in craft.companion.arguments if not a.startswith("--link=")]
        arguments = [f"--link=udpout:127.0.0.1:{port}", *others]
        self.process = CompanionProcess(self.run_dir, arguments, forks=craft.companion.forks)
        self._lockstep = Lockstep(
            self._endpoints,
            range(1),
            lambda _, t_ns: self._ask(t_ns),
            limit_s=ANSWER_LIMIT_S,
            is_alive=lambda _: self.process.running,
        )
        craft.autopilot.add_link(SECOND_LINK, LinkKind.ONBOARD)
        craft.others[SECOND_LINK] = lambda _, frame: self._frames.append(frame)
        ends.callback(self.process.end)

    def start(self) -> None:
        """Start it; simulated time stands still until it is up, or has ended."""
        self.process.start()
        gathered = self._lockstep.await_clients(self._t_ns, BOOT_LIMIT_S)
        self._deliver(gathered.received)

    def turn(self) -> None:
        """One exchange of 0.1 s."""
        if self.process.running:
            self._deliver(self._lockstep.exchange(self._t_ns).received)

    @property
    def _t_ns(self) -> int:
        return max(1, round(self.stage.t_s * 1e9))

    def _ask(self, t_ns: int) -> list[bytes]:
        frames, self._frames = self._frames, []
        request = self._clock.encode(Message("TIMESYNC", tc1=0, ts1=t_ns))
        return [*bundled(frames), request]

    def _deliver(self, received: list[tuple[int, bytes]]) -> None:
        for _, datagram in received:
            self.stage.craft.autopilot.receive(SECOND_LINK, datagram)


def copied(run_dir: Path) -> Path:
    """A copy of a run folder beside it, as after a change of the computer's card."""
    copy = run_dir.with_name(f"{run_dir.name}-second")
    shutil.copytree(run_dir, copy, ignore=shutil.ignore_patterns("lock", "companion.out"))
    return copy
