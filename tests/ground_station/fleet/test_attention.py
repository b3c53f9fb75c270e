"""The attention list: causes, levels, hysteresis and words."""

import msgspec
import pytest

from ground_station.app.map.attention_facts import fleet_facts
from ground_station.app.map.flight_decisions import FlightDecisions
from ground_station.app.map.map_snapshot import MapSnapshot, StoreSnapshot
from ground_station.app.map.picture import DroneShown, SiteShown
from ground_station.core.fleet.attention import (
    AttentionLimits,
    FleetFacts,
    LaunchFacts,
    Level,
    VehicleFacts,
    attention_items,
)
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.fleet.risk_words import format_decision, format_loss, format_reason
from tests.ground_station.store.test_order_store import an_order

LIMITS = AttentionLimits(low_spare_wh=10.0, contact_timeout_s=15.0, max_loss=0.01)


def titles(facts: FleetFacts, active: tuple[str, ...] = ()) -> list[str]:
    return [item.title for item in attention_items(facts, LIMITS, active)]


def flying(name: str = "d1", **more: object) -> VehicleFacts:
    facts = {"contact_age_s": 0.5, "is_airborne": True, "is_on_flight": True, "spare_wh": 30.0}
    return VehicleFacts(name, **(facts | more))


def test_a_fleet_without_a_cause_has_no_item():
    assert titles(FleetFacts(vehicles=[flying(), VehicleFacts("d2", contact_age_s=1.0)])) == []


@pytest.mark.parametrize(
    ("spare_wh", "was_listed", "level"),
    [
        (-0.1, False, Level.WARNING),
        (9.9, False, Level.CAUTION),
        (10.0, False, None),
        (11.9, True, Level.CAUTION),
        (12.0, True, None),
    ],
)
def test_spare_energy_has_a_hysteresis_of_a_fifth(spare_wh, was_listed, level):
    facts = FleetFacts(vehicles=[flying(spare_wh=spare_wh)])
    items = attention_items(facts, LIMITS, ("spare d1",) if was_listed else ())
    assert [item.level for item in items] == ([] if level is None else [level])


@pytest.mark.parametrize(("age_s", "count"), [(15.0, 0), (15.1, 1)])
def test_no_contact_begins_after_its_limit_and_hides_outdated_energy(age_s, count):
    facts = FleetFacts(vehicles=[flying(contact_age_s=age_s, spare_wh=-5.0)])
    items = attention_items(facts, LIMITS)
    assert len(items) == 1
    assert items[0].key == ("contact d1" if count else "spare d1")


def test_a_late_order_is_an_item_with_its_actions():
    text = "arrives 13 min after its window, 14:43 by d2; move its window"
    (item,) = attention_items(FleetFacts(late={"T-135": text}), LIMITS)
    assert (item.level, item.title) == (Level.CAUTION, "T-135 arrives 13 min after its window")
    assert (item.text, item.actions[:2]) == (
        "14:43 by d2; move its window.",
        ("call", "edit T-135"),
    )


@pytest.mark.parametrize(
    ("late_s", "delivered", "is_late"), [(60, False, True), (60, True, False), (-1, False, False)]
)
def test_an_order_in_the_air_is_late_by_its_expected_drop(late_s, delivered, is_late):
    order = msgspec.structs.replace(an_order("o1"), latest_us=10**15)
    store = StoreSnapshot(orders={"o1": order})
    snapshot = MapSnapshot(0.0, FleetStatus(), {}, FlightDecisions(), store)
    drone = DroneShown(
        phase="outbound", order="o1", drop_us=10**15 + late_s * 10**6, delivered=delivered
    )
    assert ("o1" in fleet_facts(snapshot, {"d1": drone}, SiteShown()).late) is is_late


def test_a_drone_that_is_expected_to_be_silent_is_no_item():
    silent = flying(contact_age_s=None, is_expected=False, is_online=False)
    assert titles(FleetFacts(vehicles=[silent])) == []


def test_the_worst_is_first_and_each_cause_is_one_item():
    facts = FleetFacts(
        vehicles=[flying("d2", spare_wh=5.0), flying("d1", contact_age_s=24.0)],
        launches=[LaunchFacts("T-1", "d6", "1 in 2,400")],
        stuck=[("T-2", "drop not proven"), ("T-2", "drop not proven")],
        idle_reasons={"d7": "34 m from the depot's pad", "d8": "d8 is held"},
        out_of_service={"d8": "d8 is held by anna: out of service: motor"},
        desk_silence_s=20.0,
        desk_alarm="no heartbeat of desk for 20 s",
    )
    items = attention_items(facts, LIMITS)
    assert [item.level for item in items] == sorted(item.level for item in items)
    assert [item.title for item in items] == [
        "Desk not responding for 20 s",
        "No contact with d1 for 24 s",
        "d2 has 5 Wh to spare",
        "d6 waits for your launch",
        "T-2 is stuck",
        "d8 is out of service",
        "d7 gets no orders",
    ]
    assert items[3].text == "Order T-1. Risk 1 in 2,400 (limit 1 in 100)."


@pytest.mark.parametrize(
    ("loss", "text"),
    [
        (1 / 2400, "1 in 2,400"),
        (0.0013, "1 in 770"),
        (0.01, "1 in 100"),
        (0.1, "1 in 10"),
        (0.25, "25 %"),
        (1e-5, "1 in 100,000"),
        (0.0, "below 1 in 100,000"),
    ],
)
def test_a_risk_has_two_figures_and_never_more_than_the_evidence(loss, text):
    assert format_loss(loss) == text


@pytest.mark.parametrize(
    ("gate", "text"),
    [
        (
            "divert: to quay: P(home) from the next point 0.962 is below 0.990",
            "Diverts to quay: risk from the next point 1 in 26 is above the limit 1 in 100",
        ),
        (
            "turn_back: P(success) 0.310 is below 0.5",
            "Turns back: chance to deliver 31 % is below 50 %",
        ),
        (
            "turn_back: P(home) 0.962 is below the accepted 0.99",
            "Turns back: risk 1 in 26 is above the limit 1 in 100",
        ),
        (
            "divert: to quay: the depot is out of reach",
            "Diverts to quay: the depot is out of reach",
        ),
        (
            "divert: to field: at stop-1: P(home) 0.91 below 0.99; field 0.998",
            "Diverts to field: at stop-1: risk 1 in 11 above the limit 1 in 100; field 1 in 500",
        ),
    ],
)
def test_a_decision_names_the_quantity_that_decided_it_in_words(gate, text):
    assert format_decision(gate) == text


def test_no_probability_of_return_is_left_in_a_reason():
    reason = "P(home) 0.97 is below 0.99, but turning back here is no better"
    assert "P(" not in format_reason(reason)
    other = "P(success) 0.400 does not justify flying on at P(home) 0.991"
    assert (
        format_reason(other) == "chance to deliver 40 % does not justify flying on at risk 1 in 110"
    )
