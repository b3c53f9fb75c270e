"""A truck and its drones as plain state machines on a bus in memory, for desk tests.

The world holds the ground truth (positions, landings) and enforces the rules: `wrong` lists every
violation. It shares only the command book and the truck's terminal with the product.
"""

import math
from dataclasses import dataclass, field

import msgspec
import numpy as np

from companion.fleet.command_log import CommandLog, CommandReply
from companion.fleet.messages import (
    Assign,
    Command,
    CommandStatus,
    EventKind,
    FleetEvent,
    Launch,
    MoveHome,
    Result,
    State,
    Withdraw,
)
from ground_station.core.fleet.fleet_link import (
    CommandResponse,
    EventsReceived,
    FleetInput,
    LivelinessChanged,
    StateReceived,
)
from ground_station.core.fleet.truck_state import (
    TaskKind,
    TruckState,
    apply_command,
    confirm_task,
    reject_task,
)

FULL_V = 25.2
SWITCHED_ON_S, READY_S, TASK_S, DRIVE_S = 8.0, 20.0, 10.0, 90.0


@dataclass
class WorldClock:
    t_s: float = 0.0
    off_s: float = 0.0

    def monotonic_s(self) -> float:
        return self.t_s

    def epoch_us(self) -> int:
        return 1_000_000_000_000_000 + round((self.t_s + self.off_s) * 1e6)


@dataclass
class Member:
    """A member on the bus: a command book and an event log."""

    name: str
    clock: WorldClock
    on: bool = True
    book: CommandLog = field(default_factory=CommandLog)
    events: list[FleetEvent] = field(default_factory=list)
    clock_off_us: int = 0

    def tell(self, kind: EventKind, text: str, **more: object) -> None:
        self.events.append(
            FleetEvent(
                vehicle=self.name,
                log=self.name,
                seq=len(self.events) + 1,
                epoch_us=self.clock.epoch_us() + self.clock_off_us,
                kind=kind,
                text=text,
                **more,
            )
        )

    def answer(self, command: Command) -> Result:
        verdict = self.book.reply_without_execution_or_none(command, self.name, self.clock.t_s)
        if verdict is None:
            self.book.record_start(command)
            verdict = self.carry_out(command)
            self.book.record_final_reply_or_remove_command(command, verdict)
        return Result(
            id=command.id, vehicle=self.name, instance_id=self.name, status=verdict.status,
            reason=verdict.reason,
        )  # fmt: skip

    def carry_out(self, command: Command) -> CommandReply:
        raise NotImplementedError

    def state(self) -> State:
        raise NotImplementedError


@dataclass
class Drone(Member):
    """On the truck (`on` False), on a pad, or in the air; `place`: current (lat, lon)."""

    on: bool = False
    place: tuple[float, float] = (0.0, 0.0)
    flight: Assign | None = None
    assigned_s: float = 0.0
    launched_s: float | None = None
    home: str | None = None
    asked: tuple[str, float] | None = None
    lost: bool = False
    flies_s: float = 200.0
    mood: str = "good"
    loaded: bool = False
    down_at: str | None = None
    """Stop where it landed; None: no flight since it was placed."""
    wind_ne_mps: tuple[float, float] | None = None

    @property
    def in_air(self) -> bool:
        return self.launched_s is not None

    @property
    def cut_off(self) -> bool:
        """Return whether the link is lost: from the mission upload until it is switched off."""
        return self.mood == "cut off" and self.flight is not None

    def carry_out(self, command: Command) -> CommandReply:
        match command.action:
            case Assign() if self.flight is None:
                if self.mood == "refuses":
                    self.mood = "good"
                    return CommandReply(CommandStatus.REFUSED, "the gate says stay")
                self.flight, self.assigned_s = command.action, self.clock.t_s
                self.home = command.action.flight["site"]["home"]
            case Launch() if self.flight and self.flight.assignment == command.action.assignment:
                if self.clock.t_s - self.assigned_s < READY_S:
                    return CommandReply(CommandStatus.LATER, "not ready")
                self.launched_s = self.clock.t_s
            case MoveHome() if self.in_air and self.mood == "too busy to move":
                return CommandReply(CommandStatus.LATER, "not yet")
            case MoveHome() if self.in_air and self.mood != "refuses to move":
                self.asked = (command.action.home, self.clock.t_s + 3.0)
            case Withdraw() if not self.in_air:
                self.end("ABRT", False)
            case _:
                return CommandReply(CommandStatus.REFUSED, "not now")
        return CommandReply(CommandStatus.DONE)

    def end(self, outcome: str, delivered: bool, *, unproven: bool = False) -> None:
        if self.flight is not None:
            self.tell(
                EventKind.OUTCOME, "down", assignment=self.flight.assignment,
                order=self.flight.order, outcome=outcome, delivered=delivered,
                home=outcome not in ("FAIL", "TAKEN"), drop_unproven=unproven or None,
            )  # fmt: skip
            self.book.prevent_relaunch_of_assignment(self.flight.assignment)
        self.flight = self.launched_s = self.home = self.asked = None

    def state(self) -> State:
        phase = "standby"
        north = east = None
        if self.in_air and self.wind_ne_mps is not None:  # an estimate always varies
            wobble_mps = 0.1 * math.sin(self.clock.t_s / 7.0)
            north, east = (part + wobble_mps for part in self.wind_ne_mps)
        if self.in_air:
            phase = "outbound"
        elif self.flight is not None:
            ready = self.clock.t_s - self.assigned_s >= READY_S
            phase = "ready" if ready else "checks"
        return State(
            vehicle=self.name, instance_id=self.name, uptime_s=self.clock.t_s,
            epoch_us=self.clock.epoch_us(), airframe="m100", max_payload_kg=1.0, phase=phase,
            log=self.name, last_seq=len(self.events), armed=self.in_air, voltage_v=FULL_V,
            assignment=self.flight.assignment if self.flight else None,
            lat_deg=self.place[0], lon_deg=self.place[1],
            height_rel_m=40.0 if self.in_air else 0.0, home=self.home,
            wind_to_n_mps=north, wind_to_e_mps=east,
        )  # fmt: skip


@dataclass
class Driver(Member):
    """The truck with its driver: one task at a time, each with a duration."""

    truck: TruckState = field(default_factory=lambda: TruckState(stop="depot"))
    begun_s: float | None = None
    late_s: float = 0.0

    def carry_out(self, command: Command) -> CommandReply:
        self.truck, verdict = apply_command(self.truck, command.action)
        return verdict

    def state(self) -> State:
        return State(
            vehicle=self.name, instance_id=self.name, uptime_s=self.clock.t_s,
            epoch_us=self.clock.epoch_us(), airframe="truck", max_payload_kg=0.0,
            phase=self.truck.phase, log=self.name, last_seq=len(self.events),
            stop=self.truck.stop,
        )  # fmt: skip


class World:
    """Ground truth; acts as the desk's `Fleet`."""

    def __init__(self, drones: list[str], rng: np.random.Generator, loss: float = 0.0) -> None:
        self.clock = WorldClock(1.0)
        self.rng, self.loss = rng, loss
        self.drones = {name: Drone(name, self.clock) for name in drones}
        self.driver = Driver("truck", self.clock)
        self.on_truck = set(drones)
        self.switch_on_s: dict[str, float] = {}
        self.delivered: list[str] = []
        self.flown: list[str] = []
        self.wrong: list[str] = []
        self.left_s: list[float] = []
        self.waiting: list[FleetInput] = []
        self.told_seq: dict[str, int] = {}
        self.quits: set[str] = set()
        self.slow_s: dict[str, float] = {}

    # --- Fleet ---------------------------------------------------------------------------------

    def receive(self, wait_s: float) -> list[FleetInput]:
        del wait_s
        waiting, self.waiting = self.waiting, []
        return waiting

    def request_states(self, wait_s: float) -> None:
        del wait_s
        self.waiting += [StateReceived(member.state()) for member in self.heard()]

    def join(self) -> None:
        """Start a desk: it receives the present members and no earlier messages."""
        self.waiting = [
            LivelinessChanged(member.name, member.name, True) for member in self.heard()
        ]

    def request_events(self, vehicle: str, after: int, wait_s: float) -> None:
        del wait_s
        member = next(m for m in self.everybody() if m.name == vehicle)
        if member in self.heard() and not self.lost():
            self.waiting.append(EventsReceived(vehicle, member.events[after:], replayed=True))

    def neighbour_keys(self, fleet: str) -> dict[str, str]:
        del fleet
        return {}

    def publish(self, message: object) -> None:
        del message

    def send(self, command: Command, wait_s: float) -> None:
        del wait_s
        member = next(m for m in self.everybody() if m.name == command.vehicle)
        result = None
        dies = isinstance(member, Drone) and member.mood == "dies at its launch"
        if dies and isinstance(command.action, Launch):
            member.on, self.drones[member.name].lost = False, True
            self.waiting.append(LivelinessChanged(member.name, member.name, False))
        if member in self.heard() and not self.lost():
            before = self.driver.truck
            answer = member.answer(command)
            result = None if self.lost() else answer
            if isinstance(command.action, Launch) and answer.status is CommandStatus.DONE:
                self.note_launch(command.vehicle)
            if self.driver.truck.is_en_route and not before.is_en_route:
                self.check_departure(before.stop)
        self.waiting.append(CommandResponse(command.id, result))

    def close(self) -> None:
        pass

    def lost(self) -> bool:
        return bool(self.rng.random() < self.loss)

    # --- rules enforced by the world -----------------------------------------------------------

    def note_launch(self, name: str) -> None:
        drone = self.drones[name]
        if drone.flight is None or drone.launched_s != self.clock.t_s:
            return
        order = drone.flight.order
        if order in self.delivered:
            self.wrong.append(f"{order} flown again")
        if any(task.vehicle == name for task in self.driver.truck.tasks):
            self.wrong.append(f"{name} launched while the driver is at it")
        self.flown.append(drone.flight.assignment)
        if self.driver.truck.is_en_route:
            self.wrong.append(f"{name} launched from a truck that has gone")

    def check_departure(self, stop: str) -> None:
        self.left_s.append(self.clock.t_s)
        for drone in self.drones.values():
            if drone.lost:
                continue
            if drone.in_air and stop in (drone.home, drone.asked and drone.asked[0]):
                self.wrong.append(f"the truck leaves {stop}, promised to {drone.name}")
            here = drone.down_at in (None, stop)
            if not drone.in_air and drone.name not in self.on_truck and here:
                self.wrong.append(f"the truck leaves {drone.name} behind at {stop}")

    # --- time ----------------------------------------------------------------------------------

    def everybody(self) -> list[Member]:
        return [self.driver, *self.drones.values()]

    def members(self) -> list[Member]:
        return [m for m in self.everybody() if m.on]

    def heard(self) -> list[Member]:
        return [m for m in self.members() if not (isinstance(m, Drone) and m.cut_off)]

    def step(self) -> None:
        """Advance one second."""
        self.clock.t_s += 1.0
        for drone in self.drones.values():
            self.fly(drone)
        self.drive()
        for member in self.heard():
            if isinstance(member, Drone) and member.mood == "unheard":
                continue
            if not self.lost():
                self.waiting.append(StateReceived(member.state()))
            seq = self.told_seq.get(member.name, 0)
            if seq < len(member.events):
                self.told_seq[member.name] = len(member.events)
                if not self.lost():
                    self.waiting.append(EventsReceived(member.name, member.events[seq:]))

    def fly(self, drone: Drone) -> None:
        t_s = self.clock.t_s
        if self.switch_on_s.get(drone.name, math.inf) <= t_s:
            del self.switch_on_s[drone.name]
            drone.on = True
            self.waiting.append(LivelinessChanged(drone.name, drone.name, True))
        if drone.asked is not None and drone.asked[1] <= t_s:
            drone.home, drone.asked = drone.asked[0], None
        if drone.launched_s is None or drone.flight is None:
            return
        up_s = t_s - drone.launched_s
        drone.place = (55.51, 8.52)  # some kilometres from every pad
        if drone.mood == "lost" and up_s > drone.flies_s / 2.0:
            drone.lost, drone.on = True, False
            drone.launched_s = None
            self.waiting.append(LivelinessChanged(drone.name, drone.name, False))
        elif drone.mood == "landed by a pilot" and up_s > drone.flies_s / 2.0:
            drone.launched_s, drone.lost = None, True  # lost for the truck: it is in a field
            drone.end("TAKEN", False)
        elif up_s >= drone.flies_s:
            self.land(drone, drone.flight)

    def land(self, drone: Drone, flight: Assign) -> None:
        stops = {stop["name"]: stop for stop in flight.flight["site"]["stops"]}
        pad, drone.down_at = stops[drone.home or ""], drone.home
        drone.place = (pad["lat_deg"], pad["lon_deg"])
        kept = drone.mood in ("turns", "holds on")
        unproven = drone.mood in ("holds on", "drops unseen")
        stays = drone.mood.endswith("to move")
        drone.mood, drone.loaded = drone.mood if stays else "good", kept
        if not kept:
            if flight.order in self.delivered:
                self.wrong.append(f"{flight.order} delivered twice")
            self.delivered.append(flight.order)
        seen = not (kept or unproven)
        drone.end("SUC" if seen else "ABRT", seen, unproven=unproven)

    def drive(self) -> None:
        driver, t_s = self.driver, self.clock.t_s
        if not driver.truck.tasks:
            driver.begun_s = None
            return
        if driver.begun_s is None:
            driver.begun_s = t_s
        task = driver.truck.tasks[0]
        takes_s = self.slow_s.get(task.order or task.vehicle or "", TASK_S)
        if task.kind is TaskKind.ARRIVE:
            takes_s = DRIVE_S + driver.late_s
        if t_s - driver.begun_s < takes_s:
            return
        driver.begun_s = None
        if task.kind is TaskKind.ARRIVE:
            driver.late_s = 0.0
        drone = self.drones.get(task.vehicle or "")
        if task.kind is TaskKind.RECOVER and drone is not None and drone.in_air:
            self.wrong.append(f"the driver is told to take {drone.name} aboard from the air")
        if task.kind is TaskKind.SERVE and task.order in self.quits:
            self.end_task(reject_task(driver.truck, task, "nobody at home"))
            return
        if task.kind is TaskKind.SERVE:
            if task.order in self.delivered:
                self.wrong.append(f"{task.order} delivered twice")
            self.delivered.append(task.order or "")
        gone = drone is None or not drone.loaded if task.parcel else None
        self.end_task(confirm_task(driver.truck, task, is_parcel_dropped=gone))
        if task.kind is TaskKind.PUT_OUT and drone is not None:
            self.on_truck.discard(drone.name)
            drone.down_at = None
            drone.place = (task.lat_deg or 0.0, task.lon_deg or 0.0)
            self.switch_on_s[drone.name] = t_s + SWITCHED_ON_S
        if task.kind is TaskKind.RECOVER and drone is not None:
            self.on_truck.add(drone.name)
            self.switch_on_s.pop(drone.name, None)
            if drone.cut_off:
                drone.mood = "good"  # it keeps its mission, which was not withdrawn
            else:
                drone.end("ABRT", False)
            drone.on = False
            self.waiting.append(LivelinessChanged(drone.name, drone.name, False))

    def end_task(self, after: tuple[TruckState, object]) -> None:
        self.driver.truck, told = after
        fields = msgspec.structs.asdict(told)
        kind, text = fields.pop("kind"), fields.pop("text")
        self.driver.tell(kind, text, **fields)
