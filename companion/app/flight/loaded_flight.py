"""What a flight needs, read and built before anything is opened, promised or answered.

Settings are the same for every flight of this companion: a mistake in them is its operator's. The
flight file, its obstacles and its wind process belong to one flight: a mistake in them ends that
flight only.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from companion.adapters.autopilots.ardupilot import ArduPilot
from companion.adapters.autopilots.codec import MavlinkCodec
from companion.adapters.autopilots.operator_port import GROUND_STATION
from companion.adapters.autopilots.px4 import Px4
from companion.adapters.files.certificate_file import read_certificate
from companion.adapters.files.checkpoint_file import read_checkpoint
from companion.adapters.files.params import (
    airframe_path,
    digest_of,
    read_airframe,
    read_grounded_flight,
    read_obstacle_document,
    read_wind_process,
)
from companion.adapters.files.policy_file import read_policy
from companion.adapters.files.signing_files import StampKeeper, read_signing_key
from companion.app.flight.monitor_keeper import MonitorKeeper
from companion.core.base.errors import LeewayError
from companion.core.certificate.certificate import Certificate
from companion.core.mission.events import AutopilotKind
from companion.core.mission.flight_file import Flight
from companion.core.mission.flight_plan import frame_at, site_map
from companion.core.mission.preflight_checks import Requirement, RouteFacts
from companion.core.monitor.doubts import NO_DOUBTS, Doubts
from companion.core.pilot.checkpoint import Checkpoint
from companion.core.pilot.context import PilotOptions
from companion.core.pilot.pilot import Pilot
from companion.core.separation.learned_policy import AvoidancePolicy
from companion.core.vehicle.airframe import Airframe
from companion.core.wind.process import WindProcessParams


@dataclass(frozen=True, slots=True)
class RunOptions:
    """What the command line asks."""

    link: str
    airframe: str
    mission: Path
    run_dir: Path
    wind_process: str | None = None
    params: Path | None = None
    signing_key: Path | None = None
    system_id: int | None = None
    silence_limit_s: float = 300.0
    policy: str | None = None
    settings_folder: Path | None = None
    """Where it stands what was changed on a vehicle and not put back; None: nowhere."""
    monitor_folder: Path | None = None
    """Where the record of the vehicle's service is kept; None: nowhere."""
    pack: str = ""
    """The pack that is aboard; empty: nobody named it."""
    operators: tuple[int, ...] = (GROUND_STATION,)
    """MAVLink systems whose orders count where nothing is signed."""
    plan_at_once: bool = False
    """The loop plans, in a world that waits for it: what is decided is the same in every run."""
    record_at_once: bool = False
    """The flight waits for the disk: what a killed companion leaves is the same in every run."""
    pilot: PilotOptions = field(default_factory=PilotOptions)

    def of_flight(self, mission: Path, run_dir: Path) -> "RunOptions":
        """The same settings for one flight of several."""
        return replace(self, mission=mission, run_dir=run_dir)


@dataclass(frozen=True, slots=True)
class Settings:
    """What stays the same from flight to flight. `wind_process` None: the flight file's own."""

    airframe: Airframe
    certificate: Certificate | None
    """What lies beside the airframe file."""
    wind_process: WindProcessParams | None
    policy: AvoidancePolicy | None
    signing_key: bytes | None
    folder: Path
    """Where the vehicle's time stamps are kept: the same for all its flights."""

    @classmethod
    def read(cls, options: RunOptions) -> "Settings":
        """Raises LeewayError for a mistake in the command line, or a file that it names."""
        process, key = options.wind_process, options.signing_key
        airframe = read_airframe(options.airframe, options.params)
        return cls(
            airframe,
            read_certificate(airframe_path(options.airframe, options.params), airframe),
            read_wind_process(process, options.params) if process is not None else None,
            flying_policy(options.policy) if options.policy is not None else None,
            read_signing_key(key) if key is not None else None,
            options.run_dir,
        )

    def codec(self, *, datagrams: bool) -> tuple[MavlinkCodec, StampKeeper | None]:
        """A codec for the vehicle's link; with a key, who keeps the time stamps heard."""
        codec = MavlinkCodec(datagrams=datagrams, signing_key=self.signing_key)
        return codec, None if self.signing_key is None else StampKeeper(self.folder, codec)


@dataclass(frozen=True, slots=True)
class LoadedFlight:
    """A flight that this companion can begin: every file is read, and the pilot was built."""

    options: RunOptions
    settings: Settings
    flight: Flight
    wind_process: WindProcessParams
    obstacles: dict[str, Any] | None
    digest: str

    @classmethod
    def read(cls, options: RunOptions, settings: Settings | None = None) -> "LoadedFlight":
        """Raises LeewayError for whatever would end the flight before it begins."""
        settings = settings or Settings.read(options)
        flight = read_grounded_flight(options.mission)
        process = settings.wind_process or read_wind_process(
            flight.mission.wind_process, options.params
        )
        obstacles = read_obstacle_document(flight, options.mission)
        digest = digest_of(options.mission, settings.airframe, process, flight.site.terrain.heights)
        loaded = cls(options, settings, flight, process, obstacles, digest)
        loaded.pilot(None)
        if flight.site.depot is not None:
            site_map(flight, frame_at(flight.site.depot), obstacles)
        return loaded

    @property
    def names(self) -> str:
        """What is flown, with what, in what wind."""
        of = f"mission {self.flight.name}, airframe {self.settings.airframe.name}"
        return f"{of}, wind process {self.wind_process.name}"

    def pilot(self, checkpoint: Checkpoint | None, doubts: Doubts = NO_DOUBTS) -> Pilot:
        """A pilot for this flight, going on from what an earlier process kept."""
        return Pilot(
            self.flight,
            self.settings.airframe,
            self.wind_process,
            obstacles=self.obstacles,
            requirements=requirements,
            digest=self.digest,
            options=self.options.pilot,
            checkpoint=checkpoint,
            policy=self.settings.policy,
            doubts=doubts,
            certificate=self.settings.certificate,
        )

    def monitor(self) -> MonitorKeeper | None:
        """The monitor of the vehicle's service; None: nothing is kept."""
        options = self.options
        if options.monitor_folder is None:
            return None
        airframe = self.settings.airframe
        return MonitorKeeper.open(
            options.monitor_folder, options.pilot.name, airframe, options.pack, self.digest
        )

    def kept(self) -> tuple[Checkpoint | None, str]:
        """The checkpoint, and what is wrong with it: a broken one stops no flight from home."""
        if self.options.pilot.check_only:
            return None, ""
        try:
            return read_checkpoint(self.options.run_dir, self.digest), ""
        except LeewayError as error:
            return None, f"checkpoint not used: {error}"


def requirements(autopilot_kind: AutopilotKind, facts: RouteFacts) -> tuple[Requirement, ...]:
    """What the promise asks of this autopilot's parameters."""
    profile = ArduPilot() if autopilot_kind is AutopilotKind.ARDUPILOT else Px4()
    return profile.requirements(facts)


def flying_policy(name: str) -> AvoidancePolicy:
    """A learned actor, by name or by its card; only one whose view this companion draws."""
    policy, card = read_policy(name)
    if card.frame != "goal":
        raise LeewayError(f"policy {name}: its frame is {card.frame!r}, expected 'goal'")
    return policy
