"""A flight under a certificate: outside its envelope the gate adds a tenth to the need."""

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from companion.adapters.files.params import read_airframe, read_flight, read_wind_process
from companion.core.certificate.certificate import (
    Certificate,
    CertifiedDay,
    FlownEnvelope,
    airframe_digest,
)
from companion.core.mission import events as ev
from companion.core.mission.actions import AlertReport
from companion.core.mission.alerts import Alert
from companion.core.pilot.estimates import FlightEstimates
from companion.core.pilot.telemetry_state import TelemetryState
from companion.core.return_budget.remaining_from_plan import remaining_outbound
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.routing.route_planner import Plan
from companion.core.vehicle.air import Air

FLIGHT = read_flight(Path(__file__).parents[3] / "params" / "flights" / "default.toml")
AIRFRAME = read_airframe("m100")
# Without internal resistance: a pack's limit of power would add to the energy need.
AIRFRAME = replace(AIRFRAME, battery=replace(AIRFRAME.battery, resistance_ohm=0.0))
WIND_PROCESS = read_wind_process("coast")
DEPOT, CUSTOMER, LEVEL = (0.0, 0.0, 0.0), (0.0, -400.0, 0.0), -40.0
PLAN = Plan(
    depot_ned_m=DEPOT, customer_ned_m=CUSTOMER,
    outbound_ned_m=((0.0, -200.0, LEVEL), (0.0, -400.0, LEVEL)),
    return_ned_m=((0.0, -200.0, LEVEL), (0.0, 0.0, LEVEL)),
    entry=(1, 0), rally=(), home_ground_speed_mps=9.0,
    energy_wh=0.0, time_s=0.0, route_std_wh=0.0,
)  # fmt: skip


def certified(*, wind_mps=9.0, celsius=None, factor=1.0, std_frac=0.0) -> Certificate:
    days = [
        CertifiedDay(date=f"2026-05-0{d}", flights=9, decision_points=900, worst_ratio=1.1)
        for d in (1, 2, 3)
    ]
    return Certificate(
        format="certificate/2",
        airframe="m100",
        airframe_digest=airframe_digest(AIRFRAME),
        pack="6 cells, 130 Wh",
        days=days,
        draw_factor=factor,
        draw_std_frac=std_frac,
        envelope=FlownEnvelope(
            wind_mps=wind_mps, airspeed_mps=25.0, payload_kg=0.8, air_temperature_c=celsius
        ),
        left_out=[],
    )


def estimates(certificate: Certificate | None) -> FlightEstimates:
    flight = replace(FLIGHT, vehicle=replace(FLIGHT.vehicle, autopilot_wind=True))
    energy = RouteEnergy(AIRFRAME)
    return FlightEstimates(flight, AIRFRAME, energy, WIND_PROCESS, certificate=certificate)


def need_wh(judge: FlightEstimates, wind_mps: float) -> float:
    """Fly for 30 s in a wind reported by the autopilot; return the mission's energy need."""
    now = TelemetryState()
    now.store_event(ev.Battery(0.0, voltage_v=25.2, current_a=0.5))
    judge.update_from_telemetry(now, ev.AutopilotKind.ARDUPILOT)
    for tick in range(1, 301):
        t_s = 0.1 * tick
        now.store_event(ev.VehicleState(t_s, ev.Mode.MISSION, "AUTO", armed=True))
        now.store_event(ev.Battery(t_s, voltage_v=25.0))
        now.store_event(ev.AutopilotWind(t_s, wind_mps, 0.0, 0.3))
        now.store_event(ev.Position(t_s, 55.0, 8.0, 50.0, 40.0, 0.0, 0.0, 0.0))
        now.store_event(ev.Tick(t_s))
        judge.update_from_telemetry(now, ev.AutopilotKind.ARDUPILOT)
    answer = judge.assess(
        remaining_outbound(PLAN, (0.0, 0.0, LEVEL), 0, judge.payload_kg, 6.0, 12.0)
    )
    assert answer is not None
    return answer.energy_need_wh


@pytest.mark.parametrize(("certified_mps", "factor"), [(9.0, 1.0), (3.0, 1.10)])
def test_in_a_wind_that_nobody_flew_the_gate_counts_with_a_tenth_more(certified_mps, factor):
    plain, watched = estimates(None), estimates(certified(wind_mps=certified_mps))
    more = need_wh(watched, 6.0) / need_wh(plain, 6.0)
    assert more == pytest.approx(factor, abs=3e-5)  # the draws depend on the model's spread
    assert len(watched.envelope_exit_texts) == (factor > 1.0)


def test_air_that_was_measured_is_watched_and_the_standard_atmosphere_is_not():
    for source, outside in (("temperature stated", 1), ("standard temperature", 0)):
        judge = estimates(certified(celsius=(5.0, 25.0)))
        judge.fix_air_properties(Air(101_000.0, -10.0, f"barometer, {source}"))
        found = judge.update_from_telemetry(TelemetryState(), ev.AutopilotKind.PX4)
        reported = [a for a in found if isinstance(a, AlertReport)]
        assert [a.alert for a in reported] == [Alert.ENVELOPE_LEFT] * outside
        assert len(reported) == len(judge.envelope_exit_texts) == outside


def test_days_that_drew_more_are_believed_over_the_airframe_file_and_days_that_drew_less_are_not():
    usual = estimates(None).snapshot()["scale"]
    for factor, log in ((1.04, np.log(1.04)), (0.95, 0.0)):
        kept = estimates(certified(factor=factor, std_frac=0.06)).snapshot()["scale"]
        assert kept["log"] == pytest.approx(log)
        own_std = AIRFRAME.power_rotor.model_std_frac
        assert kept["variance"] - usual["variance"] == pytest.approx(0.06**2 - own_std**2)


def test_a_checkpoint_keeps_what_was_outside():
    judge = estimates(certified(wind_mps=3.0))
    need_wh(judge, 6.0)
    kept = judge.snapshot()["outside_envelope"]
    assert list(kept) == ["wind"]
