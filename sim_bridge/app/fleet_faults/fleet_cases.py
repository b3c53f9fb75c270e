"""The rows of the group `fleet`: desks, their store, the network, the truck, and clocks."""

from collections.abc import Iterator

from sim_bridge.app.day.truck import DayTruck
from sim_bridge.app.faults.case import FLYING
from sim_bridge.app.fleet_faults.desks import OwnClock, StoreAway
from sim_bridge.app.fleet_faults.fleet_case import FleetCase, FleetPlay
from sim_bridge.app.fleet_faults.fleet_stage import STRUCK, FleetStage
from sim_bridge.app.fleet_faults.fleet_verdict import assigns_once, brings_all, tells

DESK_AWAY_S = (5.0, 60.0)
"""A service starts it again within seconds; a person takes a minute."""

MINUTES_S = (90.0, 240.0)
"""How long the network is cut or the store is away: longer than a flight of this day."""

LATE_S = (60.0, 300.0)
"""How much later the truck comes; from 120 s on the desk makes a new plan."""

HOUR_S = 3600.0
FOUND_S = 60.0
"""By then its companion has seen the landing and closed its record."""

SETTLED_S = 60.0
"""It boots, joins, and is asked for what the desk has missed."""


def desk_killed(stage: FleetStage) -> Iterator[None]:
    """SIGKILL; started again on its store after a while."""
    yield from stage.reached()
    stage.desks.kill()
    yield from stage.wait(stage.rng.uniform(*DESK_AWAY_S))
    stage.desks.start()


def network_cut(stage: FleetStage) -> Iterator[None]:
    """Nothing passes between the desk and any member for minutes."""
    yield from stage.reached()
    for_s = stage.rng.uniform(*MINUTES_S)
    stage.bus.cut(for_s)
    yield from stage.wait(for_s)


def away_for_an_hour(stage: FleetStage) -> Iterator[None]:
    """One drone's radio is dead. It lands unheard, who finds it switches it off; after an hour it
    is switched on where it stood, its radio works, and all that it has kept arrives at once.
    """
    yield from stage.reached()
    drone, back_s = stage.drone, stage.t_s + HOUR_S
    stage.bus.cut_off(STRUCK, HOUR_S)
    yield from stage.until(lambda: stage.where == "down")
    yield from stage.wait(FOUND_S)
    assert drone.up is not None
    north, east, _ = drone.up.vehicle.pos_ned_m
    drone.switch_off()
    yield from stage.wait(back_s - stage.t_s)
    drone.switch_on(stage.t_s, (north, east), 0.0, None)
    yield from stage.wait(SETTLED_S)


def truck_late(stage: FleetStage) -> Iterator[None]:
    """The truck stands in traffic on its way to where it is promised."""
    yield from stage.reached()
    driver = stage.built.crew
    assert isinstance(driver, DayTruck)
    driver.hold_up(stage.rng.uniform(*LATE_S))


def two_desks(off_s: float = 0.0) -> FleetPlay:
    """A second desk is started on the same store; its wall clock may be off.

    In phase ready it is there from the first turn on: both put drones out, and both launch.
    """

    def play(stage: FleetStage) -> Iterator[None]:
        if stage.phase == "ready":
            stage.begin()
        else:
            yield from stage.reached()
        stage.desks.join(OwnClock(stage.built.clock, off_s))

    return play


def store_away(stage: FleetStage) -> Iterator[None]:
    """The store cannot be reached for minutes."""
    yield from stage.reached()
    database, clock = stage.desks.first.books.database, stage.built.clock
    for_s = stage.rng.uniform(*MINUTES_S)
    outage, until_s = database.outage, stage.t_s + for_s
    database.outage = StoreAway(clock.monotonic_s, why="no route to it", until_s=until_s)
    yield from stage.wait(for_s)
    database.outage = outage


def desk_clock(off_s: float) -> FleetPlay:
    """The desk's computer is started again, and its wall clock is off: set while a desk works, it
    moves no running desk's stamps (`ground_station.adapters.clock`).
    """

    def play(stage: FleetStage) -> Iterator[None]:
        yield from stage.reached()
        stage.desks.kill()
        stage.desks.clock.off_s = off_s
        yield from stage.wait(stage.rng.uniform(*DESK_AWAY_S))
        stage.desks.start()

    return play


def vehicle_clock(off_s: float) -> FleetPlay:
    """The wall clock of one companion is set."""

    def play(stage: FleetStage) -> Iterator[None]:
        yield from stage.reached()
        stage.drone.wall_off_s = off_s

    return play


CASES = (
    FleetCase(
        56,
        "desk-killed",
        "the desk is killed, and started again on its store up to a minute later",
        desk_killed,
        (brings_all, tells("STARTED AGAIN")),
    ),
    FleetCase(
        57,
        "network-cut",
        "the fleet's network is cut for one and a half to four minutes",
        network_cut,
        (brings_all, tells(f"{STRUCK}: left the network"), tells(f"{STRUCK}: joined the network")),
    ),
    FleetCase(
        58,
        "away-for-an-hour",
        "one drone is not heard for an hour, and then is back with all that it has kept",
        away_for_an_hour,
        (tells(f"{STRUCK}: left the network"), tells(f"{STRUCK}: joined the network")),
        (*FLYING, "land"),
        day_s=4500.0,
    ),
    FleetCase(
        59,
        "truck-late",
        "the truck comes one to five minutes late to where the drones will land",
        truck_late,
        (brings_all,),
    ),
    FleetCase(
        60,
        "two-desks",
        "a second desk is started on the same store and stays",
        two_desks(),
        (brings_all, assigns_once),
    ),
    FleetCase(
        61,
        "store-away",
        "the desk's store cannot be reached for one and a half to four minutes",
        store_away,
        (brings_all, tells("STORE AWAY"), tells("store back")),
    ),
    FleetCase(
        62,
        "desk-back-ahead",
        "the desk is killed, and back with a wall clock that is an hour ahead",
        desk_clock(HOUR_S),
        (brings_all,),
    ),
    FleetCase(
        62,
        "desk-back-behind",
        "the desk is killed, and back with a wall clock that is an hour behind",
        desk_clock(-HOUR_S),
        (brings_all,),
    ),
    FleetCase(
        62,
        "vehicle-clock-ahead",
        "a drone's wall clock is set an hour ahead of the desk's",
        vehicle_clock(HOUR_S),
        (brings_all, tells("its clock is off by 3600 s")),
    ),
    FleetCase(
        62,
        "vehicle-clock-back",
        "a drone's wall clock is set an hour behind the desk's",
        vehicle_clock(-HOUR_S),
        (brings_all, tells("its clock is off by -3600 s")),
    ),
    FleetCase(
        62,
        "second-desk-ahead",
        "a second desk on the same store, whose wall clock is an hour ahead of the first's",
        two_desks(HOUR_S),
        (brings_all, assigns_once),
    ),
    FleetCase(
        62,
        "second-desk-behind",
        "a second desk on the same store, whose wall clock is an hour behind the first's",
        two_desks(-HOUR_S),
        (brings_all, assigns_once),
    ),
)
