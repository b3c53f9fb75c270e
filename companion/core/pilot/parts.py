"""The parts of the pilot as a table: the events each receives, and the checkpoint keys it owns.

The wiring is derived: a constructor's parameter named in `OWNER_INPUTS`, apart from a leading
underscore, receives that input, any other the part of the class in its annotation; one with a
default keeps it. `PilotParts` creates the parts in an order that satisfies these needs. `PARTS`
lists them in the order of event delivery; `TICK_ORDER` is the order within a tick. An unsatisfied
need, a cycle of needs, a missing method, or a checkpoint key without exactly one owner is an error
at import.

`FlightSequence.tick` orders the ticks of six further parts: position loss, budget, mission
progress, parcel release, ground speed, landing. It owns their order because each may change the
phase, which decides whether the next one ticks. `FlightReports` reports in every phase, around the
ticks.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from inspect import signature
from typing import Any, TypeVar, cast

from companion.core.mission.checkpoint import Checkpoint
from companion.core.mission.events import (
    AbortOrdered,
    AutopilotParameters,
    ClockJumpedForward,
    ClockSteppedBack,
    ControlHandedBack,
    ControlReleaseOrdered,
    Event,
    GnssFix,
    GnssTime,
    Home,
    HomeStopRequested,
    LimitsChanged,
    LinkRecovered,
    LinkSilent,
    MissionAuthorised,
    MissionProgress,
    MissionUploaded,
    MissionVerified,
    MissionWriteDetected,
    ModeReport,
    NeighbourTrackReceived,
    OperatorMessageReceived,
    OrderAccepted,
    OrderRefused,
    OtherCompanionReport,
    OtherStationModeCommand,
    ParametersAwaited,
    ParametersSet,
    Position,
    ReleaseFeedback,
    StreamsConfigured,
    UnrestoredSettings,
    VehicleState,
)
from companion.core.mission.find_plan import PlanFound
from companion.core.pilot.authority import ControlAuthority, DisarmMonitor, OrderedMode
from companion.core.pilot.context import CurrentPlan, LatestAssessment
from companion.core.pilot.control.flight_reports import FlightReports
from companion.core.pilot.control.last_resort import LastResort
from companion.core.pilot.control.resume import FlightResumption, LinkMonitor
from companion.core.pilot.control.unanswered_hold import UnansweredHold
from companion.core.pilot.flight_sequence import FlightSequence
from companion.core.pilot.flight_state import (
    CurrentItem,
    FlightState,
    OnboardListState,
    ParcelState,
    PromisedStop,
    ReturnState,
)
from companion.core.pilot.ground.autopilot_settings import AutopilotSettings
from companion.core.pilot.ground.flight_planning import FlightPlanning
from companion.core.pilot.ground.ground_sequence import GroundSequence
from companion.core.pilot.ground.start_checks import (
    ArmingController,
    PreflightChecks,
    StartAuthorisation,
)
from companion.core.pilot.home_watch import HomeMonitor
from companion.core.pilot.landing import LandingController
from companion.core.pilot.landing_site import LandingStopController
from companion.core.pilot.mission_progress import GroundSpeedController, MissionProgressMonitor
from companion.core.pilot.neighbours.desired_velocity import DesiredVelocity
from companion.core.pilot.neighbours.setpoint_takeover import SetpointController
from companion.core.pilot.neighbours.traffic_exchange import TrafficExchange
from companion.core.pilot.observed_reactions import ObservedReactions
from companion.core.pilot.onboard_verification import OnboardMissionVerifier
from companion.core.pilot.parcel_release import ParcelReleaseController
from companion.core.pilot.return_course import PositionLossMonitor, ReturnCourseMonitor
from companion.core.pilot.return_decision import BudgetMonitor, ReturnDecision

PartT = TypeVar("PartT")

OWNER_INPUTS = ("obstacles", "requirements", "policy")
"""Parameters that the pilot's owner supplies, matched by name."""

KEYS_OF_PILOT = (
    *("format", "flight", "t_s", "phase", "authority", "finished"),
    *("plan", "frame", "asides", "judgement"),
)
"""Keys of a checkpoint that the pilot itself writes."""


@dataclass(frozen=True, slots=True)
class PilotPart:
    """One row: class, events that it receives, checkpoint keys that it owns."""

    part_class: type[Any]
    events: tuple[type[Event], ...] = ()
    checkpoint_keys: tuple[str, ...] = ()

    @property
    def constructor_dependencies(self) -> dict[str, Any]:
        """Needs by parameter without a default: a part's class, or the name of an input."""
        given = signature(self.part_class).parameters.values()
        return {
            one.name: name if (name := one.name.lstrip("_")) in OWNER_INPUTS else one.annotation
            for one in given
            if one.default is one.empty
        }


PARTS = (
    PilotPart(CurrentPlan),
    PilotPart(LatestAssessment),
    PilotPart(FlightState, checkpoint_keys=("flying", "took_off_s")),
    PilotPart(ParcelState, checkpoint_keys=("delivered", "drop_begun")),
    PilotPart(ReturnState, checkpoint_keys=("gate_closed", "rally")),
    PilotPart(PromisedStop, checkpoint_keys=("home", "wanted")),
    PilotPart(CurrentItem, checkpoint_keys=("leg",)),
    PilotPart(ReturnCourseMonitor),
    PilotPart(PositionLossMonitor),
    PilotPart(OnboardListState),
    PilotPart(OrderedMode),
    PilotPart(
        DisarmMonitor,
        (VehicleState, OrderAccepted, ClockSteppedBack),
        checkpoint_keys=("disarmed_by_another",),
    ),
    PilotPart(
        ControlAuthority,
        (
            *(VehicleState, ModeReport, ClockSteppedBack, AbortOrdered),
            *(OtherCompanionReport, ControlHandedBack, ControlReleaseOrdered),
        ),
    ),
    PilotPart(
        FlightResumption,
        (
            *(MissionUploaded, MissionVerified, MissionWriteDetected, OrderRefused),
            *(OtherStationModeCommand, VehicleState, ModeReport),
        ),
    ),
    PilotPart(LinkMonitor, (LinkSilent, LinkRecovered, ClockJumpedForward, ClockSteppedBack)),
    PilotPart(TrafficExchange, (GnssTime, NeighbourTrackReceived)),
    PilotPart(
        AutopilotSettings,
        (AutopilotParameters, ParametersAwaited, ParametersSet, UnrestoredSettings),
        checkpoint_keys=("settings_before",),
    ),
    PilotPart(FlightPlanning),
    PilotPart(PreflightChecks, (OperatorMessageReceived, GnssTime)),
    PilotPart(ArmingController),
    PilotPart(StartAuthorisation, checkpoint_keys=("authorised",)),
    PilotPart(
        GroundSequence,
        (
            MissionAuthorised,
            StreamsConfigured,
            PlanFound,
            MissionUploaded,
            MissionVerified,
            OrderRefused,
        ),
    ),
    PilotPart(
        OnboardMissionVerifier,
        (MissionUploaded, MissionVerified, MissionWriteDetected, MissionProgress),
    ),
    PilotPart(
        UnansweredHold,
        (VehicleState, ModeReport, ControlReleaseOrdered, MissionWriteDetected, MissionProgress),
    ),
    PilotPart(ObservedReactions, (MissionProgress, Position, VehicleState, GnssFix)),
    PilotPart(MissionProgressMonitor, (MissionProgress, OrderRefused)),
    PilotPart(GroundSpeedController),
    PilotPart(
        HomeMonitor,
        (OrderAccepted, OrderRefused, Home),
        checkpoint_keys=("took_off_from", "led_to"),
    ),
    PilotPart(LastResort, (OrderRefused,)),
    PilotPart(BudgetMonitor),
    PilotPart(ReturnDecision, (AbortOrdered, LimitsChanged)),
    PilotPart(LandingStopController, (HomeStopRequested,)),
    PilotPart(ParcelReleaseController, (ReleaseFeedback, OrderAccepted)),
    PilotPart(LandingController),
    PilotPart(DesiredVelocity),
    PilotPart(SetpointController),
    PilotPart(FlightSequence),
    PilotPart(FlightReports),
)

TICK_ORDER = (
    ControlAuthority,
    HomeMonitor,
    OnboardMissionVerifier,
    GroundSequence,
    FlightSequence,
    LastResort,
    SetpointController,
    UnansweredHold,
)


def sort_parts_by_dependency(parts: Iterable[PilotPart]) -> tuple[PilotPart, ...]:
    """Order the parts so that each follows its needs; raise ValueError if that is impossible."""
    waiting, instances, ordered = list(parts), set[Any](OWNER_INPUTS), list[PilotPart]()
    while waiting:
        ready = [
            one for one in waiting if instances.issuperset(one.constructor_dependencies.values())
        ]
        if not ready:
            names = ", ".join(part.part_class.__name__ for part in waiting)
            raise ValueError(f"parts: needs missing or circular: {names}")
        ordered += ready
        instances.update(part.part_class for part in ready)
        waiting = [part for part in waiting if part not in ready]
    return tuple(ordered)


def check_methods_and_keys(parts: Iterable[PilotPart], tick_order: Iterable[type[Any]]) -> None:
    """Check that methods and checkpoint keys match the table; raise ValueError at a wrong row."""
    keys = sorted([*KEYS_OF_PILOT, *(key for part in parts for key in part.checkpoint_keys)])
    if keys != (expected := sorted(Checkpoint.__struct_fields__)):
        raise ValueError(f"parts: checkpoint keys {keys}, expected one owner of each: {expected}")
    needed = [(part.part_class, "on_event", "context, event") for part in parts if part.events]
    needed += [(part_class, "tick", "context") for part_class in tick_order]
    for part in parts:
        if part.checkpoint_keys:
            needed += [(part.part_class, "to_dict", ""), (part.part_class, "restore", "checkpoint")]
    for part_class, name, parameters in needed:
        method = getattr(part_class, name, None)
        if method is None or ", ".join([*signature(method).parameters][1:]) != parameters:
            raise ValueError(f"parts: {part_class.__name__} has no method {name}({parameters})")
    if absent := set(tick_order) - {part.part_class for part in parts}:
        raise ValueError(f"parts: in the tick, but not in the table: {absent}")


check_methods_and_keys(PARTS, TICK_ORDER)
_ORDERED = tuple(
    (part.part_class, part.constructor_dependencies) for part in sort_parts_by_dependency(PARTS)
)


class PilotParts:
    """The parts of one flight."""

    def __init__(self, **inputs: Any) -> None:
        """Create the parts; `inputs` are named in `OWNER_INPUTS`."""
        instances: dict[Any, Any] = dict(inputs)
        for make, needs in _ORDERED:
            instances[make] = make(**{name: instances[need] for name, need in needs.items()})
        self._instances = instances
        self.checkpoint_parts = tuple(
            instances[part.part_class] for part in PARTS if part.checkpoint_keys
        )
        """Parts that own keys of the checkpoint."""
        self.tick_parts = tuple(instances[make] for make in TICK_ORDER)
        """Parts of the tick, in its order."""
        self._routes: dict[type[Event], list[Any]] = {}
        for part in PARTS:
            for event in part.events:
                self._routes.setdefault(event, []).append(instances[part.part_class])

    def part_of_class(self, part_class: type[PartT]) -> PartT:
        """Return the part of this class."""
        return cast(PartT, self._instances[part_class])

    def parts_receiving_event(self, event: Event) -> Iterable[Any]:
        """Return the parts that receive this event, in the order of delivery."""
        return self._routes.get(type(event), ())
