"""`sim-bridge fly --link URL`: the same flight on vehicles that we do not simulate.

ArduPilot's SITL, PX4's SIH, a Pixhawk on the bench: one companion process for each link, and
nothing else. No lockstep: the companions live on the autopilots' clocks, whatever their speed-up.
The verdict is each companion's own (own_record.py).
"""

import contextlib
import os
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from companion.adapters.files.atomic_file import read_whole
from companion.adapters.files.checkpoint_file import NAME as CHECKPOINT
from companion.adapters.files.params import read_airframe, read_flight, read_obstacles
from companion.core.base.errors import LeewayError
from companion.core.mission.flight_file import Flight
from companion.core.mission.flight_plan import frame_at
from sim_bridge.app.flight.companion_process import CompanionProcess
from sim_bridge.app.flight.overheard import Overheard
from sim_bridge.app.flight.own_record import own_row
from sim_bridge.app.flight.report import Shown
from sim_bridge.app.flight.run_folder import new_run_dir, saved_on_interrupt

LOOK_EVERY_S = 0.2  # of the wall's time
EXIT_USAGE, EXIT_NO_LINK, EXIT_LINK_CLOSED = 2, 4, 6
"""The companion's exit codes for a mistake, for nobody there, and for a link that did not open."""

PHASE_MARK = " -> "
"""In a line of the companion's that tells a change of phase: the live view shows the phase."""

Show = Callable[[list[Shown], float], None]
Tell = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class ForeignOptions:
    """What the command line asks. `here`: the site lies about where each vehicle stands.

    `steady_wind`: of the simulator behind the link, towards north and east (m/s).
    """

    flight_file: Path
    links: tuple[str, ...]
    gate: bool = True
    configure: bool = False
    here: bool = False
    run_root: Path = Path("logs")
    picture: bool = True
    steady_wind: tuple[float, float] | None = None


@dataclass(slots=True)
class _Guest:
    """One vehicle of somebody else's, with our companion on its link."""

    number: int
    link: str
    companion: CompanionProcess
    heard: Overheard
    began_s: float | None = field(default=None)

    def shown(self) -> Shown:
        heard = self.heard
        return Shown(
            label=f"{self.number} {heard.autopilot_kind or '-'}",
            phase=self.companion.phase or "looking for it",
            away_m=heard.away_m,
            up_m=heard.up_m,
            named=heard.named,
            said=heard.said or [(0.0, f"(nothing yet, on {self.link})")],
        )

    def flown_s(self) -> float:
        """The autopilot's time since it was first heard."""
        if self.began_s is None and self.heard.t_s > 0.0:
            self.began_s = self.heard.t_s
        return max(0.0, self.heard.t_s - (self.began_s or 0.0))


def fly_foreign(
    options: ForeignOptions, show: Show, tell: Tell = lambda line: None
) -> dict[str, Any]:
    """Fly to the end; `{"flights": [...]}` as the companions saw it.

    `show` is given the vehicles several times a second; `tell` each decision with its reason, what
    the companion says, and each setting of the vehicle that it changes, once, as it falls.

    Raises LeewayError for a mistake in the input, and where no link brought an autopilot.
    """
    flight = read_flight(options.flight_file)
    read_airframe(flight.vehicle.airframe)
    _check(options, flight)
    gate = "" if options.gate else "-gate-off"
    run_dir = new_run_dir(options.run_root, f"{flight.name}-link{gate}")
    with contextlib.ExitStack() as stack:
        guests = [_guest(options, number, run_dir) for number in range(1, len(options.links) + 1)]
        for guest in guests:
            stack.callback(guest.companion.end)
            guest.companion.start()
        with saved_on_interrupt(run_dir):
            _watch(guests, show, tell)
    for guest in guests:
        _complain(guest)
    rows = [
        own_row(
            guest.companion.result(),
            vehicle=f"{flight.vehicle.airframe}-{guest.number}",
            autopilot=guest.heard.autopilot_kind or "-",
            run=os.path.relpath(guest.companion.run_dir),
            steady_wind=options.steady_wind,
        )
        | {"died": _how_it_died(guest)}
        for guest in guests
    ]
    if options.picture:
        for guest, row in zip(guests, rows, strict=True):
            _draw(options, flight, guest, row)
    result = {"flights": rows}
    (run_dir / "flights.json").write_bytes(msgspec.json.format(msgspec.json.encode(result)))
    return result


def _check(options: ForeignOptions, flight: Flight) -> None:
    if flight.faults:
        raise LeewayError(
            f"{options.flight_file}: [[faults]] happen in the simulated world: take them out to fly"
            " somebody else's vehicle (--link)"
        )
    twice = {link for link in options.links if options.links.count(link) > 1}
    if twice:
        raise LeewayError(f"--link {', '.join(sorted(twice))}: named twice")
    if len(options.links) > 1 and flight.site.depot is not None and not options.here:
        raise LeewayError(
            "several --link and one site.depot: their paths would be one; --here lays the site"
            " about each vehicle"
        )


def _guest(options: ForeignOptions, number: int, run_dir: Path) -> _Guest:
    link = options.links[number - 1]
    own_dir = run_dir if len(options.links) == 1 else run_dir / f"vehicle{number}"
    arguments = [
        f"--link={link}",
        f"--mission={options.flight_file}",
        f"--gate={'on' if options.gate else 'off'}",
        "--authorise",  # whoever types --link has said that this vehicle is to fly this mission
        "--no-operator",  # and watches it here
    ]
    arguments += ["--configure"] if options.configure else []
    arguments += ["--here"] if options.here else []
    companion = CompanionProcess(run_dir=own_dir, arguments=arguments)
    return _Guest(number, link, companion, Overheard(own_dir / "stream.tlog"))


def _watch(guests: list[_Guest], show: Show, tell: Tell) -> None:
    """Look on until every companion has ended by itself."""
    several = len(guests) > 1
    running = True
    while running:
        running = any(guest.companion.running for guest in guests)
        for guest in guests:
            guest.heard.listen()
            for line in guest.companion.new_lines():
                if PHASE_MARK not in line:
                    tell(f"{guest.number} {line}" if several else line)
        show([guest.shown() for guest in guests], max(guest.flown_s() for guest in guests))
        next((g for g in guests if g.companion.running), guests[0]).companion.wait(LOOK_EVERY_S)


def _draw(options: ForeignOptions, flight: Flight, guest: _Guest, row: dict[str, Any]) -> None:
    """What its companion heard and believed; a picture that cannot be drawn costs no result."""
    from sim_bridge.app.flight.picture import NAME, draw_flight, heard_course

    result = guest.companion.result()
    depot = flight.site.depot
    frame = None if depot is None or options.here else frame_at(depot)
    try:
        course = heard_course(guest.heard.path, result, frame)
    except (LeewayError, OSError) as error:
        print(f"no picture: {error}", file=sys.stderr)
        return
    if course is None:
        return
    obstacles = [] if depot is None else read_obstacles(flight, options.flight_file, depot)
    came = f"{row['outcome'] or 'no verdict'} in {course.end_s:.0f} s"
    left = "" if row["margin_wh"] is None else f", {row['margin_wh']:+.1f} Wh above the reserve"
    draw_flight(
        guest.companion.run_dir / NAME,
        title=f"{flight.name}, {row['vehicle']} on {row['autopilot']}: {came}{left}",
        course=course,
        result=result,
        places_en_m=_places_en_m(result.get("plan") or {}),
        polygons_en_m=[np.array([(e, n) for n, e in o.ring_ne_m]) for o in obstacles],
        max_loss=flight.mission.max_loss,
    )


def _places_en_m(plan: dict[str, Any]) -> dict[str, tuple[float, float]]:
    """The plan's places, east and north of the depot."""
    found = {name: plan.get(f"{name}_ned_m") for name in ("depot", "customer")}
    found |= {plan["home"]: plan.get("home_ned_m")} if plan.get("home") else {}
    found |= {spot["name"] or "rally": spot["ground_ned_m"] for spot in plan.get("rally", [])}
    return {name: (ned[1], ned[0]) for name, ned in found.items() if ned is not None}


def _complain(guest: _Guest) -> None:
    """A mistake in the input, or an empty link, is an error and no flight."""
    code = guest.companion.exit_code
    if code in (EXIT_USAGE, EXIT_LINK_CLOSED):
        raise LeewayError(f"companion {guest.number}: {guest.companion.last_words(1)}")
    if code == EXIT_NO_LINK and guest.heard.autopilot_kind is None:
        raise LeewayError(f"--link {guest.link}: no autopilot heard")


def _how_it_died(guest: _Guest) -> str | None:
    """Where a companion was killed from outside: by which signal, where, and what that leaves."""
    code = guest.companion.exit_code
    if code is None or code >= 0:
        return None
    try:
        by = signal.Signals(-code).name
    except ValueError:
        by = f"signal {-code}"
    heard = guest.heard
    kept = read_whole(guest.companion.run_dir / CHECKPOINT, "checkpoint") or {}
    words = f"the companion died ({by}) with the vehicle {heard.away_m:.0f} m away"
    words += f" and {heard.up_m:.0f} m up"
    if kept.get("flying"):
        words += ": the mission aboard brings it home"
    settings = kept.get("settings_before") or {}
    if settings:
        before = ", ".join(f"{name} {value:g}" for name, value in sorted(settings.items()))
        words += f"; settings not put back, they were: {before}"
    return words
