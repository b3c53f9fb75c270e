"""Fleet faults: desks, their store, the network, the truck and clocks."""

from collections.abc import Callable, Iterator

from sim_bridge.app.day.desk import LOG_FILE
from sim_bridge.app.day.truck import DayTruck
from sim_bridge.app.faults.day.fleet_day import FAULTED_DRONE, SmallDay
from sim_bridge.app.faults.day.small_day import OffsetClock, TimedOutage
from sim_bridge.app.faults.fault import (
    AIRBORNE_PHASES,
    FLEET_GROUP,
    PHASES,
    FaultGroup,
)
from sim_bridge.app.faults.verdict import (
    check_all_delivered,
    check_desk_log_contains,
    check_each_order_assigned_once,
)
from sim_bridge.app.flight.stage import FaultContext
from sim_bridge.app.world.flight_phase import FlightPhase

FAULTS = FaultGroup(FLEET_GROUP)
DayFaultProcedure = Callable[[FaultContext, SmallDay], Iterator[None]]
LEFT_AND_JOINED_RULES = (
    check_desk_log_contains(f"{FAULTED_DRONE}: left the network"),
    check_desk_log_contains(f"{FAULTED_DRONE}: joined the network"),
)

DESK_OUTAGE_S = (5.0, 60.0)
"""Restart delay of the desk: seconds by a service manager, a minute by a person."""

NETWORK_OUTAGE_S = (90.0, 240.0)
"""Outage of the network or the store: longer than a flight of this day."""

TRUCK_DELAY_S = (60.0, 300.0)
"""Delay of the truck; from 120 s the desk makes a new plan."""

ONE_HOUR_S = 3600.0
SWITCH_OFF_DELAY_S = 60.0
"""Time from landing to power-off: the companion detects the landing and closes its record."""

REJOIN_WAIT_S = 60.0
"""Time for the drone to boot, join and resend the events that the desk has missed."""


@FAULTS.register_procedure(
    56, "desk-killed", PHASES, (check_all_delivered, check_desk_log_contains("STARTED AGAIN"))
)
def kill_and_restart_desk(stage: FaultContext, day: SmallDay) -> Iterator[None]:
    """The desk is killed and restarted on its store up to a minute later."""
    yield from stage.wait_for_phase_and_record_fault_start()
    yield from _kill_and_restart_desk(stage, day)


def _kill_and_restart_desk(stage: FaultContext, day: SmallDay) -> Iterator[None]:
    first = day.desks.first_desk
    stage.expect_effect("the desk is down", lambda: first.desk is None)
    day.desks.kill()
    yield from stage.wait(stage.rng.uniform(*DESK_OUTAGE_S))
    stage.expect_effect("the desk is up again", lambda: first.desk is not None)
    day.desks.restart()


@FAULTS.register_procedure(57, "network-cut", PHASES, (check_all_delivered, *LEFT_AND_JOINED_RULES))
def cut_fleet_network(stage: FaultContext, day: SmallDay) -> Iterator[None]:
    """The fleet's network is down for 1.5 to 4 minutes."""
    yield from stage.wait_for_phase_and_record_fault_start()
    duration_s = stage.rng.uniform(*NETWORK_OUTAGE_S)
    stage.expect_change("lost messages", lambda: day.bus.lost)
    day.bus.cut_network(duration_s)
    yield from stage.wait(duration_s)


@FAULTS.register_procedure(
    58,
    "away-for-an-hour",
    AIRBORNE_PHASES,
    LEFT_AND_JOINED_RULES,
    day_s=4500.0,
)
def cut_off_drone_for_one_hour(stage: FaultContext, day: SmallDay) -> Iterator[None]:
    """One drone is not received for an hour, then returns to the network with its stored events.

    It lands without contact and is switched off on the spot. After an hour it is switched on there
    with a working radio.
    """
    yield from stage.wait_for_phase_and_record_fault_start()
    drone, return_at_s = day.faulted_drone, stage.t_s + ONE_HOUR_S
    stage.expect_change("lost messages", lambda: day.bus.lost)
    day.bus.cut_member(FAULTED_DRONE, ONE_HOUR_S)
    yield from stage.wait_until(lambda: day.faulted_drone_flight_phase is FlightPhase.DOWN)
    yield from stage.wait(SWITCH_OFF_DELAY_S)
    assert drone.power_cycle is not None
    north, east, _ = drone.power_cycle.vehicle.pos_ned_m
    drone.switch_off_and_end_power_cycle()
    yield from stage.wait(return_at_s - stage.t_s)
    drone.switch_on_at_pad(stage.t_s, (north, east), 0.0, None)
    yield from stage.wait(REJOIN_WAIT_S)


@FAULTS.register_procedure(59, "truck-late", PHASES, (check_all_delivered,))
def delay_truck_drive(stage: FaultContext, day: SmallDay) -> Iterator[None]:
    """The truck arrives one to five minutes late at the drones' landing stop."""
    yield from stage.wait_for_phase_and_record_fault_start()
    driver = day.world.ground_handling
    assert isinstance(driver, DayTruck)
    stage.expect_change("a longer drive", lambda: driver.added_delay_s)
    driver.delay_current_or_next_drive(stage.rng.uniform(*TRUCK_DELAY_S))


def start_second_desk(clock_offset_s: float = 0.0) -> DayFaultProcedure:
    """Return a procedure: a second desk, with a clock error of `clock_offset_s`, starts on the same
    store.

    In phase ready it runs from the first cycle: both desks put drones out and launch them.
    """

    def procedure(stage: FaultContext, day: SmallDay) -> Iterator[None]:
        if stage.phase is FlightPhase.READY:
            stage.record_fault_start()
        else:
            yield from stage.wait_for_phase_and_record_fault_start()
        stage.expect_effect(
            "a second desk runs", lambda: any(desk.desk is not None for desk in day.desks.desks[1:])
        )
        day.desks.start_second_desk(OffsetClock(day.world.clock, clock_offset_s))

    return procedure


@FAULTS.register_procedure(
    61,
    "store-away",
    PHASES,
    (
        check_all_delivered,
        check_desk_log_contains("store unreachable"),
        check_desk_log_contains("store reachable again"),
    ),
)
def make_store_unreachable(stage: FaultContext, day: SmallDay) -> Iterator[None]:
    """The desk's store is unreachable for 1.5 to 4 minutes."""
    yield from stage.wait_for_phase_and_record_fault_start()
    database, clock = day.desks.first_desk.database.database, day.world.clock
    duration_s = stage.rng.uniform(*NETWORK_OUTAGE_S)
    outage, until_s = database.outage, stage.t_s + duration_s
    log_path = day.desks.first_desk.folder / LOG_FILE
    stage.expect_effect(
        "the store is unreachable", lambda: "store unreachable" in log_path.read_text()
    )
    database.outage = TimedOutage(clock.monotonic_s, reason="no route to host", until_s=until_s)
    yield from stage.wait(duration_s)
    database.outage = outage


def restart_desk_with_clock_offset(clock_offset_s: float) -> DayFaultProcedure:
    """Return a procedure: the desk's computer restarts with a clock error. A clock set while the
    desk runs does not change its time stamps (`ground_station.adapters.clock`).
    """

    def procedure(stage: FaultContext, day: SmallDay) -> Iterator[None]:
        yield from stage.wait_for_phase_and_record_fault_start()
        day.desks.clock.offset_s = clock_offset_s
        yield from _kill_and_restart_desk(stage, day)

    return procedure


def set_vehicle_clock_offset(clock_offset_s: float) -> DayFaultProcedure:
    """Return a procedure: the wall clock of one companion is set to an error of
    `clock_offset_s`.
    """

    def procedure(stage: FaultContext, day: SmallDay) -> Iterator[None]:
        yield from stage.wait_for_phase_and_record_fault_start()
        states = day.bus.states

        def offset_s() -> float:
            state = states.get(FAULTED_DRONE)
            return 0.0 if state is None else 1e-6 * (state.epoch_us - day.world.clock.epoch_us())

        stage.expect_effect("an hour off in its state", lambda: abs(offset_s()) > ONE_HOUR_S / 2.0)
        day.faulted_drone.wall_clock_offset_s = clock_offset_s

    return procedure


FAULTS.add_case(
    60,
    "two-desks",
    "A second desk starts on the same store and keeps running.",
    start_second_desk(),
    PHASES,
    (check_all_delivered, check_each_order_assigned_once),
)
for name, vehicle_suffix, direction, clock_offset_s in (
    ("ahead", "ahead", "ahead", ONE_HOUR_S),
    ("behind", "back", "behind", -ONE_HOUR_S),
):
    FAULTS.add_case(
        62,
        f"desk-back-{name}",
        f"The desk is killed and restarted with a wall clock an hour {direction}.",
        restart_desk_with_clock_offset(clock_offset_s),
        PHASES,
        (check_all_delivered,),
    )
    FAULTS.add_case(
        62,
        f"vehicle-clock-{vehicle_suffix}",
        f"A drone's wall clock is an hour {direction} relative to the desk's.",
        set_vehicle_clock_offset(clock_offset_s),
        PHASES,
        (
            check_all_delivered,
            check_desk_log_contains(f"its clock is off by {clock_offset_s:.0f} s"),
        ),
    )
    FAULTS.add_case(
        62,
        f"second-desk-{name}",
        f"A second desk on the same store with a wall clock an hour {direction}.",
        start_second_desk(clock_offset_s),
        PHASES,
        (check_all_delivered, check_each_order_assigned_once),
    )
