"""`sim-bridge fly`: simulated vehicles and their companions fly a mission to its end."""

import contextlib
import os
import shutil
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import msgspec
import numpy as np

from companion.adapters.files.params import (
    params_dir,
    read_airframe,
    read_flight,
    read_obstacle_document,
    read_obstacles,
)
from companion.core.base.errors import LeewayError
from companion.core.base.geo import moved_deg
from companion.core.base.place import Place
from companion.core.mission.flight_file import Flight
from companion.core.vehicle.airframe import Airframe
from sim_bridge.adapters.endpoint import EndpointSet
from sim_bridge.adapters.fork_server import ForkServer
from sim_bridge.adapters.lockstep import Lockstep
from sim_bridge.adapters.realtime import Pacer
from sim_bridge.adapters.wall_clock import signing_10us, wall_s
from sim_bridge.app.flight.clairvoyant import Foresight
from sim_bridge.app.flight.clairvoyant_flight import foresee_flight
from sim_bridge.app.flight.companion_process import CompanionProcess
from sim_bridge.app.flight.faults import FaultPlan
from sim_bridge.app.flight.judge import FlightVerdict, NearestGround, judge, nearest_ground
from sim_bridge.app.flight.operator import Operator
from sim_bridge.app.flight.run_folder import new_run_dir, saved_on_interrupt
from sim_bridge.app.flight.scenario import read_faults, read_wind
from sim_bridge.app.flight.vehicle_process import (
    COMPANION_LINK,
    OPERATOR_LINK,
    PHYSICS_STEP_S,
    Craft,
    build_terrain,
    place_ne_m,
)
from sim_bridge.autopilot.autopilot import Autopilot
from sim_bridge.autopilot.kinds import AutopilotKind, LinkKind
from sim_bridge.autopilot.mavlink.parameters import read_parameters
from sim_bridge.autopilot.mavlink.signing import LinkSigning, Signing
from sim_bridge.truth.battery import Battery
from sim_bridge.truth.params import AirframeTruth, load_airframe
from sim_bridge.truth.vehicle import Vehicle
from sim_bridge.truth.wind_params import build_wind_field

STEP_S = 0.1
STEPS = round(STEP_S / PHYSICS_STEP_S)
COMPANION_BOOT_LIMIT_S = 60.0
HOME_DEFAULT = Place(lat_deg=55.47, lon_deg=8.45, alt_amsl_m=12.0)
VEHICLE_SPACING_M = 40.0
AUTOPILOTS = ("px4", "ardupilot")


@dataclass(frozen=True, slots=True)
class FlyOptions:
    """What the command line asks. `speedup` None flies as fast as the machine can.

    `believed` is the airframe that the companion is told, a name or a file; None: the true one's.
    `told` is the flight file that a single vehicle's companion is given; None: the world's own.
    With `signing_key` (a file of 32 bytes) the companion's link is signed; the companion is then
    authorised on its command line, since the operator's own frames are not. `before_companion` is
    Python that its process runs before its `main`: a slow disk, a computer without memory.
    """

    flight_file: Path
    autopilot: str = "px4"
    seed: int = 1
    wind_log: Path | None = None
    gate: bool = True
    vehicles: int = 1
    speedup: float | None = None
    run_root: Path = Path("logs")
    picture: bool = True
    lockstep_limit_s: float = 20.0
    believed: str | None = None
    told: Path | None = None
    signing_key: Path | None = None
    before_companion: str = ""
    companion_arguments: tuple[str, ...] = ()
    """More of `companion run`, as its operator would choose them."""
    settings: Mapping[str, float] = field(default_factory=dict)
    """Parameters of the autopilot that differ from its defaults."""
    forks: ForkServer | None = None
    """Of companions, for suites of many flights; None: each is started as a user's is."""


@dataclass(slots=True)
class Progress:
    """What a live view shows; `fly` calls `update` some times a simulated second."""

    crafts: list[Craft] = field(default_factory=list)

    def update(self, crafts: list[Craft], t_s: float) -> None:
        """Nothing, unless a view is attached (see report.py)."""

    def exchanged(self, wall_s: float) -> None:
        """A step's telemetry went out and every companion's answer came back in `wall_s`."""

    def ended(self, crafts: list[Craft], faults: FaultPlan) -> None:
        """All are down and judged."""

    def goes_on(self, t_s: float) -> bool:
        """False stops the run there (benchmarks do)."""
        return True


class Script(Protocol):
    """What happens to the vehicles of a run beside the faults of its flight file."""

    def apply(self, crafts: list[Craft], t_s: float, lockstep: Lockstep) -> None:
        """Called ten times a simulated second, after physics and before the companions answer."""
        ...

    def end(self) -> None:
        """The run is over: put back what must not outlast it."""
        ...


def fly(
    options: FlyOptions, progress: Progress | None = None, script: Script | None = None
) -> dict[str, Any]:
    """Fly to the end and judge; `{"flights": [...]}` as in docs/reference/flight-json.md."""
    progress = progress or Progress()
    flight = read_flight(options.flight_file)
    airframe = read_airframe(flight.vehicle.airframe)
    seeds = np.random.SeedSequence(options.seed)
    wind_seed, *vehicle_seeds = seeds.spawn(1 + options.vehicles)
    wind, mean = read_wind(
        flight, options.flight_file, np.random.default_rng(wind_seed), options.wind_log
    )
    faults = read_faults(flight, options.flight_file)
    gate = "" if options.gate else "-gate-off"
    stem = f"{flight.name}-{options.autopilot}-seed{options.seed}{gate}"
    run_dir = new_run_dir(options.run_root, stem)
    with contextlib.ExitStack() as stack:
        endpoints = stack.enter_context(EndpointSet(["udpin:127.0.0.1:0"] * options.vehicles))
        crafts: list[Craft] = []
        for index in range(options.vehicles):
            port = endpoints.urls[index].rsplit(":", 1)[1]
            craft = build_craft(
                options,
                flight,
                wind,
                mean,
                index,
                vehicle_seeds[index],
                f"udpout:127.0.0.1:{port}",
                run_dir,
                killed=any(fault.kind == "companion_kill" for fault in faults),
            )
            crafts.append(craft)
            stack.callback(craft.companion.end)
        plan = FaultPlan(faults)
        scripts = [plan] if script is None else [plan, script]
        for each in scripts:
            stack.callback(each.end)
        with saved_on_interrupt(run_dir):
            _run(options, crafts, endpoints, scripts, progress)
        for craft in crafts:
            craft.companion.end()
    rows = [_conclude(options, craft, airframe) for craft in crafts]
    progress.ended(crafts, plan)
    result = {"flights": rows}
    (run_dir / "flights.json").write_bytes(msgspec.json.format(msgspec.json.encode(result)))
    return result


def _autopilot_kind_of(options: FlyOptions, index: int) -> str:
    return AUTOPILOTS[index % 2] if options.autopilot == "mixed" else options.autopilot


def build_craft(
    options: FlyOptions,
    flight: Flight,
    wind: Any,
    mean: Any,
    index: int,
    seed: np.random.SeedSequence,
    link: str,
    run_dir: Path,
    *,
    killed: bool = False,
) -> Craft:
    """Build one vehicle of a run; its companion, not started yet, will call on `link`."""
    gust_seed, sensor_seed, charge_seed = seed.spawn(3)
    charge_frac = _drawn_charge(flight, np.random.default_rng(charge_seed))
    autopilot_kind = _autopilot_kind_of(options, index)
    number = index + 1
    depot = _shifted(flight.site.depot or HOME_DEFAULT, VEHICLE_SPACING_M * index)
    own_dir = run_dir if options.vehicles == 1 else run_dir / f"vehicle{number}"
    own_dir.mkdir(exist_ok=True)
    mission_file = options.told or options.flight_file
    if index > 0:  # a depot of its own, so that vehicles of one call never share a path
        mission_file = _write_own_flight(options.flight_file, depot, own_dir)
    terrain = build_terrain(flight.site.terrain, options.flight_file.parent)
    vehicle = Vehicle(
        _true_airframe(flight),
        build_wind_field(wind, mean, np.random.default_rng(gust_seed)),
        np.random.default_rng(sensor_seed),
        terrain=terrain,
        payload_kg=flight.vehicle.payload_kg,
        charge_frac=charge_frac,
        temperature_c=flight.vehicle.temperature_c,
        air_temperature_c=flight.site.air_temperature_c,
        battery_health_frac=flight.vehicle.battery_health_frac,
        depot_alt_amsl_m=depot.alt_amsl_m or 0.0,
        pitot=flight.vehicle.pitot,
    )
    autopilot = Autopilot(
        AutopilotKind(autopilot_kind),
        (depot.lat_deg or 0.0, depot.lon_deg or 0.0, depot.alt_amsl_m or 0.0),
        read_parameters(
            params_dir() / "autopilots" / f"{autopilot_kind}.toml", dict(options.settings)
        ),
        system_id=number,
    )
    autopilot.add_link(COMPANION_LINK, LinkKind.ONBOARD, signing=_signer(options.signing_key))
    autopilot.add_link(OPERATOR_LINK, LinkKind.GCS)
    companion = CompanionProcess(
        run_dir=own_dir,
        arguments=[
            f"--link={link}",
            f"--airframe={options.believed or flight.vehicle.airframe}",
            f"--mission={mission_file}",
            f"--gate={'on' if options.gate else 'off'}",
            "--configure",
            f"--vehicle-settings={own_dir / 'vehicle_settings'}",
            f"--monitor={own_dir / 'monitor'}",
            *_signed_arguments(options.signing_key),
            "--lockstep",
            *(["--record-at-once"] if killed else []),
            *options.companion_arguments,
        ],
        before=options.before_companion,
        forks=options.forks,
    )
    return Craft(
        number=number,
        autopilot_kind=autopilot_kind,
        flight=flight,
        charge_frac=charge_frac,
        depot=depot,
        vehicle=vehicle,
        autopilot=autopilot,
        terrain=terrain,
        operator=Operator(number),
        companion=companion,
        run_dir=own_dir,
    )


def _true_airframe(flight: Flight) -> AirframeTruth:
    """What is simulated of the flight's vehicle; LeewayError names those that can be."""
    folder, name = params_dir() / "truth", flight.vehicle.airframe
    if not (folder / f"{name}.toml").exists():
        known = ", ".join(sorted(path.stem for path in folder.glob("*.toml")))
        raise LeewayError(
            f"vehicle.airframe {name}: expected one that is simulated here ({known}); somebody"
            " else's vehicle is flown with --link"
        )
    return load_airframe(folder / f"{name}.toml")


def _signer(key: Path | None) -> LinkSigning | None:
    return None if key is None else Signing(key.read_bytes(), signing_10us()).on_link(0)


def _signed_arguments(key: Path | None) -> list[str]:
    return [] if key is None else [f"--signing-key={key}", "--authorise", "--no-operator"]


def _drawn_charge(flight: Flight, rng: np.random.Generator) -> float:
    charge = flight.vehicle.charge_frac
    return float(rng.uniform(charge[0], charge[1])) if isinstance(charge, list) else charge


def _shifted(depot: Place, north_m: float) -> Place:
    if north_m == 0.0:
        return depot
    lat_deg, _ = moved_deg(depot.lat_deg or 0.0, depot.lon_deg or 0.0, north_m, 0.0)
    return msgspec.structs.replace(depot, lat_deg=float(lat_deg))


def _write_own_flight(flight_file: Path, depot: Place, own_dir: Path) -> Path:
    table = tomllib.loads(flight_file.read_text())
    table["site"]["depot"] = {
        "lat_deg": depot.lat_deg,
        "lon_deg": depot.lon_deg,
        "alt_amsl_m": depot.alt_amsl_m,
    }
    for holder, key in ((table["site"], "obstacles"), (table["site"].get("terrain", {}), "grid")):
        if key in holder:
            holder[key] = os.path.abspath(flight_file.parent / holder[key])
    path = own_dir / "flight.toml"
    path.write_bytes(msgspec.toml.encode(table))
    return path


def _run(
    options: FlyOptions,
    crafts: list[Craft],
    endpoints: EndpointSet,
    scripts: Sequence[Script],
    progress: Progress,
) -> None:
    lockstep = Lockstep(
        endpoints,
        range(len(crafts)),
        lambda number, t_ns: crafts[number].ask(t_ns),
        limit_s=options.lockstep_limit_s,
        is_alive=lambda number: crafts[number].companion.running,
    )
    pacer = Pacer(options.speedup) if options.speedup else None
    stall_pacer: Pacer | None = None
    for craft in crafts:
        craft.companion.start()
    first = lockstep.await_clients(1, COMPANION_BOOT_LIMIT_S)
    for number in first.died:
        words = crafts[number].companion.last_words()
        raise LeewayError(f"companion {number + 1} did not come up; its last words:\n{words}")
    _deliver(crafts, first.received)
    step = 0
    limit_s = 120.0 + crafts[0].flight.mission.time_limit_s * 1.5
    while not all(craft.finished for craft in crafts):
        step += 1
        t_s = step * STEP_S
        if t_s > limit_s:
            return
        for craft in crafts:
            if not craft.finished:
                craft.advance(STEPS)
        for script in scripts:
            script.apply(crafts, t_s, lockstep)
        _await_returned(crafts, lockstep, t_s)
        sent_s = wall_s()
        gathered = lockstep.exchange(round(t_s * 1e9))
        progress.exchanged(wall_s() - sent_s)
        _deliver(crafts, gathered.received)
        stall_pacer = _stall_pacer(crafts, stall_pacer)
        if (pace := pacer or stall_pacer) is not None:
            _deliver(crafts, pace.wait_until(t_s, endpoints))
        progress.update(crafts, t_s)
        if not progress.goes_on(t_s):
            return


def _stall_pacer(crafts: list[Craft], before: Pacer | None) -> Pacer | None:
    """Real time while a companion stands still: its own clock must tell it for how long."""
    stalled = any(craft.companion.stalled for craft in crafts)
    return (before or Pacer(1.0)) if stalled else None


def _await_returned(crafts: list[Craft], lockstep: Lockstep, t_s: float) -> None:
    """Time stands still while a restarted companion boots, or a stalled one hears what it missed,
    so that runs repeat."""
    numbers = [index for index, craft in enumerate(crafts) if craft.companion_returns]
    if numbers:
        gathered = lockstep.await_clients(round(t_s * 1e9), COMPANION_BOOT_LIMIT_S, only=numbers)
        for number in numbers:
            crafts[number].companion_returns = False
        _deliver(crafts, gathered.received)


def _deliver(crafts: list[Craft], received: list[tuple[int, bytes]]) -> None:
    for number, datagram in received:
        crafts[number].receive(datagram)


def _conclude(options: FlyOptions, craft: Craft, airframe: Airframe) -> dict[str, Any]:
    flight, site = craft.flight, craft.flight.site
    truth_airframe = _true_airframe(flight)
    reserve_wh = _reserve_wh(craft, truth_airframe)
    result = craft.companion.result()
    np.save(craft.run_dir / "truth.npy", np.asarray(craft.record.rows, float))
    homes = [craft.home_ne_m, *(place_ne_m(place, craft.depot) for place in site.rally)]
    customer = place_ne_m(site.customer, craft.depot)
    verdict = judge(
        craft.record,
        homes_ne_m=homes,
        customer_ne_m=customer,
        drop_height_m=flight.mission.drop_height_m,
        reserve_wh=reserve_wh,
        wind_estimates=result.get("wind", []),
    )
    document = read_obstacle_document(flight, options.flight_file)
    nearest = nearest_ground(craft.record, craft.terrain, _low_places(craft))
    foresight = foresee_flight(
        craft, airframe, truth_airframe, reserve_wh, result.get("plan"), document
    )
    if options.picture:
        _draw(options, craft, verdict, result, reserve_wh, airframe)
    return _row(craft, verdict, foresight, result, nearest)


def _low_places(craft: Craft) -> list[tuple[float, float]]:
    """Where a vehicle may be low: the pad, the customer, and every declared landing place."""
    site = craft.flight.site
    places = (site.customer, *site.rally, *site.stops)
    return [(0.0, 0.0), *(place_ne_m(place, craft.depot) for place in places)]


def _reserve_wh(craft: Craft, truth_airframe: AirframeTruth) -> float:
    """The reserve by truth: its share of what the full pack gives at hover draw."""
    vehicle = craft.flight.vehicle
    pack = Battery(
        truth_airframe.battery,
        temperature_c=vehicle.temperature_c,
        health_frac=vehicle.battery_health_frac,
    )
    return craft.flight.mission.reserve_frac * pack.usable_wh(craft.vehicle.reference_draw_w)


def _row(
    craft: Craft,
    verdict: FlightVerdict,
    foresight: Foresight,
    result: dict[str, Any],
    nearest: NearestGround | None,
) -> dict[str, Any]:
    assessed = [a["p_home"] for a in result.get("assessments", []) if a.get("p_home") is not None]
    keys = ("t_s", "kind", "p_home", "p_home_now", "p_success", "margin_wh", "reason")
    return {
        "vehicle": f"{craft.flight.vehicle.airframe}-{craft.number}",
        "autopilot": craft.autopilot_kind,
        "judged_by": "truth",
        "charge_frac": round(craft.charge_frac, 3),
        "outcome": verdict.outcome,
        "delivered": verdict.delivered,
        "home": verdict.home,
        "energy_used_wh": round(verdict.energy_used_wh, 3),
        "margin_wh": round(verdict.margin_wh, 3),
        "flight_time_s": round(verdict.flight_time_s, 2),
        "wind_rmse_mps": _rounded(verdict.wind_rmse_mps),
        "wind_nees": _rounded(verdict.wind_nees),
        "p_home_min": min(assessed) if assessed else None,
        "least_clearance_m": None if nearest is None else round(nearest.clearance_m, 1),
        "least_clearance_at": None if nearest is None else nearest.place,
        "clairvoyant": foresight.outcome,
        "clairvoyant_margin_wh": round(foresight.margin_wh, 3),
        "decisions": [{key: d.get(key) for key in keys} for d in result.get("decisions", [])],
        "run": os.path.relpath(craft.run_dir),
    }


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 4)


def _draw(
    options: FlyOptions,
    craft: Craft,
    verdict: FlightVerdict,
    result: dict[str, Any],
    reserve_wh: float,
    airframe: Airframe,
) -> None:
    from sim_bridge.app.flight.picture import NAME, draw_flight, true_course

    site = craft.flight.site
    places = {"depot": (0.0, 0.0)}
    shown = [("customer", site.customer), *((p.name or "rally", p) for p in site.rally)]
    for name, place in [*shown, *((stop.name, stop) for stop in site.stops)]:
        north, east = place_ne_m(place, craft.depot)
        places[name] = (east, north)
    obstacles = read_obstacles(craft.flight, options.flight_file, craft.depot)
    hills = craft.terrain if site.terrain.kind == "grid" else None
    gate = "" if options.gate else ", gate off"
    what = f"{craft.flight.name}, {airframe.name} on {craft.autopilot_kind}"
    came = f"{verdict.outcome} in {verdict.flight_time_s:.0f} s"
    left = f"{verdict.margin_wh:+.1f} Wh above the reserve at the end"
    draw_flight(
        craft.run_dir / NAME,
        title=f"{what}, seed {options.seed}{gate}: {came}, {left}",
        course=true_course(craft.record, reserve_wh, hills),
        result=result,
        places_en_m=places,
        polygons_en_m=[np.array([(e, n) for n, e in o.ring_ne_m]) for o in obstacles],
        max_loss=craft.flight.mission.max_loss,
        clearance_m=craft.flight.mission.clearance_m,
    )
    with contextlib.suppress(OSError):
        shutil.copy(options.flight_file, craft.run_dir / "flight.source.toml")
