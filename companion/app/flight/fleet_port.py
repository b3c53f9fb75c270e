"""The vehicle's connection to the dispatcher: states and events out, commands in and answered.

Commands become the same events as an operator's MAVLink commands (`operator_port`), so the pilot
alone keeps safety rule 1.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from companion.adapters.clock import epoch_us, is_due, wall_s
from companion.adapters.files.atomic_file import read_whole, settle_folder, write_whole
from companion.adapters.files.disk import Disk
from companion.app.flight.state_told import share, told_of
from companion.core.base.errors import LeewayError
from companion.core.mission.actions import (
    Action,
    Answer,
    Decision,
    Finished,
    PhaseChanged,
    Reply,
    Say,
    Severity,
    TellPlace,
)
from companion.core.mission.events import (
    AbortOrdered,
    Authorised,
    ControlHandedBack,
    ControlTaken,
    Event,
    HomeMoved,
    LimitsChanged,
    NeighbourHeard,
    WindsTold,
)
from companion.core.pilot.neighbours.traffic_exchange import ALT_STD_M, POS_STD_M, VEL_STD_MPS
from companion.core.pilot.pilot import Pilot
from companion.core.pilot.telemetry_state import TelemetryState
from companion.core.pilot.transitions import GROUND_PHASES, Phase
from companion.core.separation.track import Track
from companion.core.separation.track_cells import cell_of
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.endurance import longest_flight_s
from companion.fleet.command_log import FRESH_S, CommandBook, Verdict
from companion.fleet.event_log import EventLog
from companion.fleet.member import FleetMember
from companion.fleet.messages import (
    Answered,
    Assign,
    Command,
    EventKind,
    HandBack,
    HandsOff,
    Launch,
    MoveHome,
    Recall,
    Refused,
    SetLimits,
    TruckDeed,
    Withdraw,
    decode_told_track,
    decode_winds,
    encode,
)
from companion.fleet.network import MemberLink
from companion.fleet.refusals import Refusals

STATE_S = 1.0
FUTURE_S = 0.5
"""A word that rests on a state of ours from the future rests on none."""

CURRENT = "current.json"
STANDBY = "standby"

ANSWER = {
    Reply.ACCEPTED: Answered.DONE,
    Reply.LATER: Answered.LATER,
    Reply.DENIED: Answered.REFUSED,
}


class Assigned(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The assignment aboard, as `current.json` keeps it through restarts."""

    assignment: str
    order: str


@dataclass(slots=True)
class FleetPort:
    """One life of a companion in a fleet. `vehicle` and `airframe` are what it announces.

    `begin_trouble` says why no flight may begin now, empty: it may.
    """

    member: FleetMember
    airframe_name: str
    max_payload_kg: float
    current: Assigned | None
    begin_trouble: Callable[[], str] = lambda: ""
    doubt: str = ""
    """What the monitor of its service holds in doubt, in words."""
    refusals: Refusals = field(default_factory=Refusals)
    """Of neighbours' tracks, and of the winds that are told."""
    _told_s: float | None = None
    _told_phase: str = ""

    @classmethod
    def open(
        cls,
        vehicle: str,
        airframe_name: str,
        airframe: Airframe,
        folder: Path,
        link_of: Callable[[str], MemberLink],
        clock_s: Callable[[], float] = wall_s,
        epoch_us: Callable[[], int] = epoch_us,
        trouble_until: Callable[[float], str] = lambda seconds: "",
        disk: Disk | None = None,
    ) -> "FleetPort":
        """Take up what the folder keeps of earlier lives; `link_of(life)` opens the link.
        `trouble_until(seconds)` says why nothing may begin that takes so long. `disk` writes in its
        own time; None: at once.

        Raises LeewayError where a file there is broken: a vehicle that forgot its commands must
        not take new ones.
        """
        current, trouble = _read_current(folder / CURRENT)
        member = FleetMember.open(vehicle, folder, link_of, clock_s, epoch_us, disk)
        longest_s = longest_flight_s(airframe)
        port = cls(member, airframe_name, airframe.mass.max_payload_kg, current)
        port.begin_trouble = lambda: trouble_until(longest_s)
        if trouble:
            port.tell(EventKind.SAID, trouble)
        return port

    @property
    def vehicle(self) -> str:
        """Its name in the fleet."""
        return self.member.vehicle

    @property
    def folder(self) -> Path:
        """Where everything is kept through restarts."""
        return self.member.folder

    @property
    def link(self) -> MemberLink:
        """Its way to the desk."""
        return self.member.link

    @property
    def life(self) -> str:
        """This start of the companion."""
        return self.member.life

    @property
    def book(self) -> CommandBook:
        """Commands taken."""
        return self.member.book

    @property
    def log(self) -> EventLog:
        """Events kept."""
        return self.member.log

    @property
    def uptime_s(self) -> float:
        """Seconds of this life."""
        return self.member.uptime_s

    def turn(self, carry_out: Callable[[Command], Verdict]) -> None:
        """Answer everything that was asked."""
        self.member.turn(lambda command: self._not_begun(command) or carry_out(command))
        self._say_refused()

    def _not_begun(self, command: Command) -> Verdict | None:
        """Why a flight is not begun that could outlast our certificate; what has begun goes on."""
        deed = command.deed
        if not isinstance(deed, Assign | Launch):
            return None
        aboard = self.current is not None and deed.assignment == self.current.assignment
        trouble = "" if aboard and isinstance(deed, Assign) else self.begin_trouble()
        return Verdict(Answered.REFUSED, trouble) if trouble else None

    # --- assignments ---------------------------------------------------------------------------

    def folder_of(self, assignment: str) -> Path:
        """Where an assignment's mission and record lie."""
        return self.folder / f"assignment-{assignment}"

    def take_aboard(self, assigned: Assigned) -> None:
        """Keep an assignment through restarts."""
        write_whole(self.folder / CURRENT, msgspec.to_builtins(assigned))
        self.current = assigned

    def put_ashore(self) -> None:
        """The assignment is over; its end is written down first."""
        if self.current is None:
            return
        self.book.close(self.current.assignment)
        self.member.save_book()  # its outcome stands in the log of events all the same
        self.member.settle()
        self.member.remark = ""  # what was said of one flight is not said of the next
        (self.folder / CURRENT).unlink(missing_ok=True)
        settle_folder(self.folder)
        self.current = None
        self.link.hear_fleets(())

    def give_back(self, why: str, *, flew: bool) -> None:
        """The assignment aboard cannot be taken up: its outcome says why.

        `flew`: an earlier life began it, and nobody knows where vehicle and parcel are; the mission
        aboard the autopilot ends at home by itself.
        """
        outcome = "FAIL" if flew else "ABRT"
        told = {"delivered": False, "home": not flew, "drop_unproven": flew or None}
        self.tell(EventKind.OUTCOME, f"cannot be flown: {why}", outcome=outcome, **told)
        self.put_ashore()

    # --- out -----------------------------------------------------------------------------------

    def take(self, action: Action) -> None:
        """Tell the desk what the mission does."""
        match action:
            case PhaseChanged():
                self.tell(EventKind.PHASE, f"{action.before} -> {action.now}: {action.why}")
            case Decision():
                words = f"{action.kind}: {action.reason}"
                promise = {"p_home": share(action.p_home), "margin_wh": action.margin_wh}
                self.tell(EventKind.DECISION, words, **promise)
            case Say() if action.severity <= Severity.NOTICE:
                self.member.remark = action.text
                self.tell(EventKind.SAID, action.text)
            case TellPlace():
                self._tell_place(action)
            case Finished():
                self.tell(
                    EventKind.OUTCOME,
                    action.reason,
                    outcome=action.outcome,
                    delivered=action.delivered,
                    home=action.home,
                    margin_wh=action.margin_wh,
                    drop_unproven=action.drop_unproven or None,
                    evidence_nats=action.evidence_nats,
                )
            case _:
                return

    def _tell_place(self, place: TellPlace) -> None:
        north, east, down = place.vel_ned_mps
        track = Track(
            vehicle=self.vehicle,
            gnss_s=place.gnss_s,
            lat_deg=place.lat_deg,
            lon_deg=place.lon_deg,
            alt_amsl_m=place.alt_amsl_m,
            vel_n_mps=north,
            vel_e_mps=east,
            vel_d_mps=down,
            pos_std_m=POS_STD_M,
            alt_std_m=ALT_STD_M,
            vel_std_mps=VEL_STD_MPS,
            aside=place.aside,
            to_lat_deg=place.to_lat_deg,
            to_lon_deg=place.to_lon_deg,
        )
        cell = cell_of(place.lat_deg, place.lon_deg)
        if cell is not None:
            self.link.publish_track(encode(track), cell)

    def neighbours(self, t_s: float) -> list[Event]:
        """What neighbours told since the last call; what is no track of another is left out, and
        counted.
        """
        found: list[Event] = []
        for told in self.link.tracks():
            track = decode_told_track(told)
            if isinstance(track, Refused):
                self.refusals.note(track.reason)
            elif told.fleet or told.speaker != self.vehicle:
                found.append(NeighbourHeard(t_s, track, told.fleet))
        return found

    def winds(self, t_s: float) -> list[Event]:
        """What the desk told of the winds that others feel; what is not for this life, or not of
        now, is left out, and counted.
        """
        found: list[Event] = []
        for raw in self.link.winds():
            winds = decode_winds(raw)
            if isinstance(winds, Refused):
                self.refusals.note(winds.reason)
                continue
            age_s = self.uptime_s - winds.as_of_s
            if winds.vehicle != self.vehicle or winds.life != self.life:
                self.refusals.note("winds: told to another vehicle or life")
            elif not -FUTURE_S <= age_s <= FRESH_S:
                self.refusals.note(f"winds: {age_s:.0f} s old")
            else:
                found.append(WindsTold(t_s, winds, max(age_s, 0.0)))
        return found

    def _say_refused(self) -> None:
        said = self.refusals.due(self.member.clock_s())
        if said is not None:
            self.member.remark = said
            self.tell(EventKind.SAID, said)

    def tell(self, kind: EventKind, text: str, **more: Any) -> None:
        """Have an event written down; it is told once it lies on the disk."""
        here = self.current
        self.member.tell(
            kind,
            text,
            assignment=here.assignment if here else None,
            order=here.order if here else None,
            **more,
        )

    def publish(self, phase: str, now: TelemetryState, pilot: Pilot | None = None) -> None:
        """Tell the state when it is due: once a second, and at once in a new phase. Neighbours are
        listened for about the newest place.
        """
        now_s, position = self.member.clock_s(), now.position
        if position is not None:
            self.link.hear_near(position.lat_deg, position.lon_deg)
        if phase == self._told_phase and not is_due(self._told_s, STATE_S, now_s):
            return
        self._told_phase, self._told_s = phase, now_s
        here, speed = self.current, None
        if position is not None:
            speed = (position.vel_n_mps**2 + position.vel_e_mps**2) ** 0.5
        told = told_of(pilot) if pilot is not None else {}
        if not self.link.wind_cov_is_read():
            told.pop("wind_cov_m2ps2", None)
        self.member.publish(
            self.airframe_name,
            self.max_payload_kg,
            phase,
            assignment=here.assignment if here else None,
            order=here.order if here else None,
            armed=now.state.armed if now.state is not None else None,
            lat_deg=position.lat_deg if position else None,
            lon_deg=position.lon_deg if position else None,
            height_rel_m=position.height_rel_m if position else None,
            ground_speed_mps=speed,
            voltage_v=now.battery.voltage_v if now.battery else None,
            doubt=self.doubt[:500],
            **told,
        )

    def close(self) -> None:
        """Leave the network and end the files."""
        self.member.close()

    def in_mission(
        self, pilot: Pilot, t_s: float, ask: Callable[[Event], Answer]
    ) -> Callable[[Command], Verdict]:
        """How commands are carried out while a mission runs."""

        def carry_out(command: Command) -> Verdict:
            here = self.current.assignment if self.current is not None else None
            deed, by = command.deed, command.by
            if isinstance(deed, TruckDeed):
                return Verdict(Answered.REFUSED, "not what this vehicle can do")
            if isinstance(deed, Assign):
                if deed.assignment == here:
                    return Verdict(Answered.DONE, "aboard")
                return Verdict(Answered.REFUSED, f"busy with {here or 'a mission of its own'}")
            if isinstance(deed, Launch | Withdraw | MoveHome) and deed.assignment != here:
                return Verdict(Answered.REFUSED, f"{here or 'a mission of its own'} is aboard")
            if isinstance(deed, Withdraw) and pilot.phase not in (Phase.IDENTIFY, *GROUND_PHASES):
                return Verdict(Answered.REFUSED, f"in phase {pilot.phase.value}: recall it")
            told = ask(_event_of(deed, t_s, by))
            answer, reason = ANSWER[told.reply], told.reason or f"phase {pilot.phase.value}"
            if isinstance(deed, Withdraw) and pilot.phase is Phase.IDENTIFY:
                return Verdict(Answered.LATER, "no autopilot is heard yet")
            return Verdict(answer, reason)

        return carry_out


def _read_current(path: Path) -> tuple[Assigned | None, str]:
    """The assignment aboard, and what is wrong with the file: then it is moved aside.

    The desk sees that the assignment is not aboard, and asks a person. A companion that ended here
    would end again at every restart.
    """
    try:
        table = read_whole(path, "assignment")
        return (None if table is None else msgspec.convert(table, Assigned)), ""
    except (LeewayError, msgspec.ValidationError) as error:
        path.replace(path.with_suffix(".broken"))
        return None, f"{path.name} is broken and was moved aside: {error}"


def _event_of(deed: Any, t_s: float, by: str) -> Event:
    match deed:
        case Launch():
            return Authorised(t_s, by)
        case Recall() | Withdraw():
            return AbortOrdered(t_s, by)
        case MoveHome():
            return HomeMoved(t_s, by, deed.home)
        case HandsOff():
            return ControlTaken(t_s, by)
        case HandBack():
            return ControlHandedBack(t_s, by)
        case SetLimits():
            return LimitsChanged(t_s, deed.max_loss, deed.reserve_frac)
        case _:
            raise LeewayError(f"{deed!r}: no order to a mission")
