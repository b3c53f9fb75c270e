"""Selection of the battery monitor that measures the pack: the one with a voltage.

Expected energies are those of the same pack reported as the only monitor, number 0.
"""

import math

import pytest

from companion.adapters.files.params import read_airframe, read_wind_process
from companion.core.base.location import Location
from companion.core.mission import events as ev
from companion.core.mission.actions import OperatorResponse, ResponseStatus
from companion.core.mission.flight_file import Flight, Mission, Site, Vehicle
from companion.core.pilot.context import PilotOptions
from companion.core.pilot.estimates import FlightEstimates
from companion.core.pilot.telemetry_state import PackTelemetry, TelemetryState
from companion.core.pilot.transitions import Phase
from companion.core.routing.leg_energy import RouteEnergy
from tests.companion.pilot.fake_vehicle import World, start, world

AIRFRAME = read_airframe("m100")
V_RANGE = (15.6, 27.6)  # six cells of 2.6 V (empty, under load) to 4.6 V
FULL = {"voltage_v": 25.6, "current_a": 0.5}
LOW = {"voltage_v": 21.9, "current_a": 0.5, "remaining_frac": 0.09}
KINDS = [ev.AutopilotKind.PX4, ev.AutopilotKind.ARDUPILOT]


def judgement(charge_frac=None):
    vehicle = Vehicle(airframe="m100", charge_frac=charge_frac or [0.05, 1.0])
    site = Site(customer=Location(east_m=0.0, north_m=0.0))
    flight = Flight(format="flight/1", site=site, vehicle=vehicle, mission=Mission())
    return FlightEstimates(flight, AIRFRAME, RouteEnergy(AIRFRAME), read_wind_process("coast"))


def stood(messages, kind, judge=None, seconds=10):
    """Return energy and telemetry after standing with these monitors reporting at 2 Hz."""
    now, judge = TelemetryState(pack=PackTelemetry(V_RANGE)), judge or judgement()
    warnings = []
    for k in range(2 * seconds):
        t_s = 1.0 + 0.5 * k
        now.store_event(ev.VehicleState(t_s, ev.Mode.HOLD, "HOLD", armed=False))
        for pack, fields in messages:
            now.store_event(ev.Battery(t_s, **fields, pack=pack))
        now.store_event(ev.Tick(t_s))
        warnings += [found.text for found in judge.update_from_telemetry(now, kind)]
    return judge.energy, now, warnings


def wh(energy):
    return None if energy is None else (energy.mean_wh, energy.std_wh)


EMPTY_0 = [
    {"remaining_frac": 1.0},
    {"remaining_frac": 0.0},
    {"remaining_frac": 0.5, "consumed_ah": 3.0, "consumed_j": 2e5},
    {"voltage_v": 0.3, "current_a": 0.0, "remaining_frac": 1.0},  # an open input
    {"voltage_v": 5.1, "current_a": 0.4, "remaining_frac": 0.0},  # the avionics' supply
    {},
]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("pack", [FULL, LOW])
@pytest.mark.parametrize("empty", EMPTY_0)
def test_a_monitor_without_a_pack_changes_nothing_of_the_packs_energy(kind, pack, empty):
    alone, _, _ = stood([(0, pack)], kind)
    for others in ([(0, empty), (1, pack)], [(1, pack), (0, empty)], [(2, empty), (3, pack)]):
        for whole in ([], [(None, empty)]):
            energy, now, warnings = stood(whole + others, kind)
            assert wh(energy) == wh(alone)
            assert now.battery is not None
            assert now.battery.voltage_v == pack["voltage_v"]
            assert sum("monitor in use: battery" in words for words in warnings) == 1


def test_what_speaks_of_the_whole_vehicle_counts_where_it_is_about_the_pack():
    # PX4's SYS_STATUS reports the connected battery with the lowest charge.
    told = [(0, {"remaining_frac": 1.0}), (1, LOW), (None, LOW | {"remaining_frac": 0.05})]
    _, now, _ = stood(told, ev.AutopilotKind.PX4)
    assert [one.pack for one in now.pack.latest_messages] == [1, None]


@pytest.mark.parametrize("kind", KINDS)
def test_without_a_voltage_no_stated_charge_becomes_energy(kind):
    for messages in (
        [(0, {"remaining_frac": 1.0}), (None, {"remaining_frac": 1.0})],
        [(1, {"remaining_frac": 0.9})],
        [],
    ):
        energy, now, _ = stood(messages, kind, judgement(charge_frac=1.0))
        assert energy is None
        assert "expected a monitor that measures the pack" in now.pack.missing_reason(now.t_s)
        for pack, _ in messages:
            assert ("SYS_STATUS" if pack is None else f"battery {pack}") in now.pack.missing_reason(
                now.t_s
            )


def test_two_real_packs_are_reported_by_the_first_and_the_lower_charge_counts():
    first = {"voltage_v": 25.0, "current_a": 0.5, "remaining_frac": 0.9}
    second = {"voltage_v": 24.8, "current_a": 0.6, "remaining_frac": 0.7}
    energy, now, warnings = stood([(0, first), (1, second)], ev.AutopilotKind.ARDUPILOT)
    assert now.battery is not None
    assert now.battery.voltage_v == 25.0
    assert energy is not None
    assert energy.mean_wh == pytest.approx(0.7 * energy.usable_full_wh, rel=1e-6)
    assert not any("monitor in use:" in words for words in warnings)


def test_in_flight_another_monitor_does_not_take_the_packs_place():
    now = TelemetryState(pack=PackTelemetry(V_RANGE))
    now.store_event(ev.Battery(1.0, voltage_v=25.0, pack=0))  # no current sensor, as PX4's SIH
    now.store_event(ev.VehicleState(1.0, ev.Mode.MISSION, "AUTO", armed=True))
    now.store_event(ev.Battery(1.5, voltage_v=24.0, current_a=10.0, pack=7))
    assert now.battery is not None
    assert now.battery.voltage_v == 25.0
    now.store_event(ev.Tick(math.nextafter(9.0, 10.0)))
    now.store_event(ev.Battery(9.0, voltage_v=24.0, current_a=10.0, pack=7))
    assert now.battery is not None
    assert now.battery.t_s == 1.0


class Unmeasured(World):
    """While `measures` is false its battery monitor states a charge without measurements."""

    measures = True

    def telemetry(self):
        return [
            ev.Battery(self.t_s, remaining_frac=1.0, pack=0)
            if isinstance(event, ev.Battery) and not self.measures
            else event
            for event in super().telemetry()
        ]


@pytest.mark.parametrize("until", [None, Phase.READY])
def test_no_measured_pack_no_take_off_and_the_operator_reads_why(until):
    made = world(options=PilotOptions(configure=True))
    w = Unmeasured(made.pilot, made.judge)
    w.measures = until is not None
    w.judge.known = until is not None  # the ledger starts with a measured pack only
    start(w)
    if until is not None:
        w.until(until)
        w.measures = False
    w.steps(300)
    assert OperatorResponse(ResponseStatus.LATER) in w.tell(ev.MissionAuthorised(w.t_s, "255/190"))
    w.steps(100)
    assert not w.armed
    assert "no battery voltage: received battery 0 at 100%; expected a monitor" in w.said


def flown_with(change, seconds=40, *, rate_hz=2.0):
    """Return telemetry after a flight in which `change(t_s)` alters the monitor's values."""
    now = TelemetryState(pack=PackTelemetry(V_RANGE))
    now.store_event(ev.VehicleState(0.0, ev.Mode.MISSION, "AUTO", armed=True))
    now.store_event(ev.GroundState(0.0, ev.VehicleLandedState.IN_AIR))
    for k in range(round(seconds * rate_hz)):
        t_s = 1.0 + k / rate_hz
        fields = {"voltage_v": 24.0 - 0.003 * k, "current_a": 20.0 + math.sin(k)}
        fields |= {"consumed_ah": 0.003 * k, "remaining_frac": 0.8} | change(t_s)
        counted = {k: v for k, v in fields.items() if k != "consumed_ah"}
        now.store_event(ev.Battery(t_s, **fields, pack=0))
        now.store_event(ev.Battery(t_s, **counted))
    return now


@pytest.mark.parametrize(
    ("change", "frozen"),
    [
        (lambda t_s: {}, False),
        (lambda t_s: {"voltage_v": 24.0}, False),  # constant from power-up, as in SITL
        (lambda t_s: {"current_a": 20.0} if 12.0 < t_s < 20.0 else {}, False),
        (lambda t_s: {"current_a": 20.0} if t_s > 12.0 else {}, True),
        (lambda t_s: {"current_a": 20.0}, False),  # a synthetic log
        (lambda t_s: {"current_a": 20.0 if t_s > 1.0 else 0.5}, False),  # one with an idle current
        (lambda t_s: {"voltage_v": 23.9} if t_s > 12.0 else {}, True),
    ],
)
def test_a_measurement_that_freezes_in_flight_is_found_and_no_longer_used(change, frozen):
    now = flown_with(change)
    assert now.pack.has_frozen == frozen
    still = change(40.0)
    if frozen:
        assert now.battery is not None
        assert all(getattr(now.battery, name) is None for name in still)
        assert now.battery.consumed_ah is None or "current_a" not in still


@pytest.mark.parametrize("factor", [10 / 12, 10 / 14, 1.04])
def test_two_voltages_of_one_pack_that_differ_are_reported_and_the_lower_counts(factor):
    messages = [(0, FULL | {"voltage_v": 25.6 * factor}), (None, FULL)]
    _, now, texts = stood(messages, ev.AutopilotKind.PX4)
    assert sum("lower used" in text for text in texts) == 1
    assert now.battery is not None
    assert now.battery.voltage_v == pytest.approx(25.6 * min(factor, 1.0))
    _, same, texts = stood([(0, FULL | {"voltage_v": 25.3}), (None, FULL)], ev.AutopilotKind.PX4)
    assert same.pack.differing_voltages_v is None
    assert not any("lower used" in text for text in texts)
