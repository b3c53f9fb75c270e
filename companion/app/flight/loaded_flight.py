"""Inputs of a flight, read and validated before a link opens or a command is acknowledged.

Settings apply to every flight of this companion: an error in them ends the program. Flight file,
obstacles and wind process belong to one flight: an error in them ends that flight only.
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
    airframe_file_path,
    flight_configuration_digest,
    read_airframe,
    read_flight_with_terrain_heights,
    read_obstacle_document,
    read_wind_process,
)
from companion.adapters.files.policy_file import read_policy
from companion.adapters.files.signing_files import SigningStampStore, read_signing_key
from companion.app.flight.monitor_keeper import MonitorKeeper
from companion.core.base.errors import LeewayError
from companion.core.certificate.certificate import Certificate
from companion.core.mission.checkpoint import Checkpoint
from companion.core.mission.events import AutopilotKind
from companion.core.mission.flight_file import Flight
from companion.core.mission.flight_plan import build_site_map, depot_frame
from companion.core.mission.preflight_checks import ParameterRequirement, RouteProperties
from companion.core.monitor.corrections import NO_CORRECTIONS, MonitorCorrections
from companion.core.pilot.context import PilotOptions
from companion.core.pilot.pilot import Pilot
from companion.core.separation.learned_policy import AvoidancePolicy
from companion.core.vehicle.airframe import Airframe
from companion.core.wind.process import WindProcessParams


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Options of the command line."""

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
    """Folder of changed vehicle settings that are not restored yet; None: not stored."""
    monitor_folder: Path | None = None
    """Folder of the vehicle's service record; None: not stored."""
    pack: str = ""
    """Name of the installed pack; empty: unnamed."""
    operators: tuple[int, ...] = (GROUND_STATION,)
    """MAVLink systems whose commands are accepted without signing."""
    plan_synchronously: bool = False
    """Plan in the loop (simulation only), so that each run takes the same decisions."""
    record_synchronously: bool = False
    """Write synchronously, so that a killed companion leaves the same files in each run."""
    pilot: PilotOptions = field(default_factory=PilotOptions)

    def with_mission_and_run_dir(self, mission: Path, run_dir: Path) -> "RunOptions":
        """Return these options for one of several flights."""
        return replace(self, mission=mission, run_dir=run_dir)


@dataclass(frozen=True, slots=True)
class Settings:
    """Inputs common to all flights. `wind_process` None: use the flight file's."""

    airframe: Airframe
    certificate: Certificate | None
    """The certificate file next to the airframe file, if any."""
    wind_process: WindProcessParams | None
    policy: AvoidancePolicy | None
    signing_key: bytes | None
    folder: Path
    """Folder of the signing time stamps, shared by all flights."""

    @classmethod
    def read_settings_files(cls, options: RunOptions) -> "Settings":
        """Read all files. Raises LeewayError for an error in the options or in a file."""
        process, key = options.wind_process, options.signing_key
        airframe = read_airframe(options.airframe, options.params)
        return cls(
            airframe,
            read_certificate(airframe_file_path(options.airframe, options.params), airframe),
            read_wind_process(process, options.params) if process is not None else None,
            read_policy_in_goal_frame(options.policy) if options.policy is not None else None,
            read_signing_key(key) if key is not None else None,
            options.run_dir,
        )

    def build_codec(self, *, datagrams: bool) -> tuple[MavlinkCodec, SigningStampStore | None]:
        """Return a codec for the vehicle's link and, with a key, the keeper of its time stamps."""
        codec = MavlinkCodec(datagrams=datagrams, signing_key=self.signing_key)
        return codec, None if self.signing_key is None else SigningStampStore(self.folder, codec)


@dataclass(frozen=True, slots=True)
class LoadedFlight:
    """A flight that this companion can start: files are read and the pilot can be built."""

    options: RunOptions
    settings: Settings
    flight: Flight
    wind_process: WindProcessParams
    obstacles: dict[str, Any] | None
    digest: str

    @classmethod
    def read_and_validate(
        cls, options: RunOptions, settings: Settings | None = None
    ) -> "LoadedFlight":
        """Read and validate. Raises LeewayError for each error that would prevent the start."""
        settings = settings or Settings.read_settings_files(options)
        flight = read_flight_with_terrain_heights(options.mission)
        process = settings.wind_process or read_wind_process(
            flight.mission.wind_process, options.params
        )
        obstacles = read_obstacle_document(flight, options.mission)
        digest = flight_configuration_digest(
            options.mission, settings.airframe, process, flight.site.terrain.heights
        )
        loaded = cls(options, settings, flight, process, obstacles, digest)
        loaded.build_pilot(None)
        if flight.site.depot is not None:
            build_site_map(flight, depot_frame(flight.site.depot), obstacles)
        return loaded

    @property
    def summary_text(self) -> str:
        """Mission, airframe and wind process, as text."""
        of = f"mission {self.flight.name}, airframe {self.settings.airframe.name}"
        return f"{of}, wind process {self.wind_process.name}"

    def build_pilot(
        self,
        checkpoint: Checkpoint | None,
        monitor_corrections: MonitorCorrections = NO_CORRECTIONS,
    ) -> Pilot:
        """Build the pilot; with a checkpoint it resumes the flight of an earlier process."""
        return Pilot(
            self.flight,
            self.settings.airframe,
            self.wind_process,
            obstacles=self.obstacles,
            requirements=autopilot_parameter_requirements,
            flight_digest=self.digest,
            options=self.options.pilot,
            checkpoint=checkpoint,
            policy=self.settings.policy,
            monitor_corrections=monitor_corrections,
            certificate=self.settings.certificate,
        )

    def read_service_monitor(self) -> MonitorKeeper | None:
        """Open the service monitor; None: not stored."""
        options = self.options
        if options.monitor_folder is None:
            return None
        airframe = self.settings.airframe
        return MonitorKeeper.read_or_create(
            options.monitor_folder, options.pilot.name, airframe, options.pack, self.digest
        )

    def read_checkpoint_or_error(self) -> tuple[Checkpoint | None, str]:
        """Return the checkpoint and an error text; a corrupt one does not prevent a new flight."""
        if self.options.pilot.check_only:
            return None, ""
        try:
            return read_checkpoint(self.options.run_dir, self.digest), ""
        except LeewayError as error:
            return None, f"checkpoint not used: {error}"


def autopilot_parameter_requirements(
    autopilot_kind: AutopilotKind, route_properties: RouteProperties
) -> tuple[ParameterRequirement, ...]:
    """Return the required parameters of this autopilot."""
    profile = ArduPilot() if autopilot_kind is AutopilotKind.ARDUPILOT else Px4()
    return profile.parameter_requirements(route_properties)


def read_policy_in_goal_frame(name: str) -> AvoidancePolicy:
    """Read a learned policy by name or card. Raises LeewayError unless its frame is `goal`."""
    policy, card = read_policy(name)
    if card.frame != "goal":
        raise LeewayError(f"policy {name}: its frame is {card.frame!r}, expected 'goal'")
    return policy
