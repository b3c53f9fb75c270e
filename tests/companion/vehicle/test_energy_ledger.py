"""Safety rule 4: the ledger of usable energy."""

import json
from itertools import pairwise

import pytest

from companion.adapters.files.params import read_airframe
from companion.core.base.errors import LeewayError
from companion.core.vehicle.energy_ledger import BatteryObservation, EnergyBelief, EnergyLedger

M100 = read_airframe("m100")
DRAW_W = 550.0
FULL_V = 6 * M100.battery.ocv_cell_v[-1]
FULL_WH = M100.battery.usable_energy_of_full_pack_wh(DRAW_W, 20.0, 1.0)
VOLTS, AMPS = 24.5, 22.0  # in flight: 539 W, 9 Wh a minute
MINUTE_WH = VOLTS * AMPS / 60.0


def ledger(**changes: object) -> EnergyLedger:
    return EnergyLedger(M100, DRAW_W, **changes)


def rested(health: dict[str, object] | None = None, **known: object) -> EnergyLedger:
    """A ledger that has seen its pack at rest, full unless another voltage is known."""
    book = ledger(**(health or {}))
    book.update_from_observation(rest(0.0, **({"voltage_v": FULL_V} | known)))
    return book


def rest(t_s: float, **known: object) -> BatteryObservation:
    return BatteryObservation(t_s, True, **known)


def flight(t_s: float, **known: object) -> BatteryObservation:
    return BatteryObservation(t_s, False, **known)


def fly(book: EnergyLedger, start_s: int, seconds: int, **known: object) -> None:
    for t in range(start_s, start_s + seconds + 1):
        book.update_from_observation(flight(float(t), **known))


def left(book: EnergyLedger) -> EnergyBelief:
    belief = book.energy_belief_or_none()
    assert belief is not None
    return belief


SNAPSHOT = rested().snapshot()


def test_safety_rule_4_the_start_is_the_resting_voltages_charge_of_the_usable_energy() -> None:
    book = rested()
    assert left(book).mean_wh == pytest.approx(FULL_WH)
    assert "resting voltage" in left(book).source
    half = left(rested(voltage_v=6 * 3.87))
    assert 0.44 * FULL_WH < half.mean_wh < 0.5 * FULL_WH  # under half: some is below cut-off


def test_safety_rule_4_cold_and_age_lessen_it() -> None:
    assert left(rested(temperature_c=0.0)).mean_wh == pytest.approx(0.82 * FULL_WH)
    assert left(rested({"health_frac": 0.75})).mean_wh == pytest.approx(0.75 * FULL_WH)


def test_volts_times_amperes_are_integrated() -> None:
    book = rested()
    fly(book, 1, 120, voltage_v=VOLTS, current_a=AMPS, modelled_power_w=500.0)
    assert left(book).mean_wh == pytest.approx(FULL_WH - 2 * MINUTE_WH, abs=0.3)
    assert "voltage x current" in left(book).source
    assert left(book).warnings == ()


def test_what_was_used_is_told_apart_from_what_a_pessimistic_percentage_leaves() -> None:
    book = rested(remaining_frac=0.9)
    assert left(book).used_wh == 0.0
    fly(book, 1, 60, voltage_v=VOLTS, current_a=AMPS, remaining_frac=0.9)
    assert left(book).used_wh == pytest.approx(MINUTE_WH, abs=0.3)
    assert left(book).mean_wh == pytest.approx(0.9 * FULL_WH)


def test_the_autopilots_counters_count_from_where_they_stood() -> None:
    book = rested(consumed_wh=31.0, consumed_mah=1300.0)
    for t in range(1, 101):
        used = {"consumed_wh": 31.0 + 0.14 * t, "consumed_mah": 1300.0 + 5.0 * t}
        book.update_from_observation(flight(float(t), voltage_v=VOLTS, **used))
    assert left(book).mean_wh == pytest.approx(FULL_WH - 14.0)


def test_safety_rule_4_the_lowest_of_disagreeing_sources_counts_and_is_said() -> None:
    book = rested(consumed_wh=0.0, remaining_frac=1.0)
    for t in range(1, 121):
        told = {"consumed_wh": t / 3.0, "remaining_frac": 0.95}
        book.update_from_observation(flight(float(t), voltage_v=VOLTS, current_a=AMPS, **told))
    assert left(book).mean_wh == pytest.approx(FULL_WH - 40.0)
    assert "energy counter" in left(book).source
    assert any("the lowest is used" in w for w in left(book).warnings)


def test_a_percentage_below_the_count_rules() -> None:
    book = rested(remaining_frac=0.6)
    assert left(book).mean_wh == pytest.approx(0.6 * FULL_WH)
    assert left(book).source == "autopilot's percentage"


@pytest.mark.parametrize("unknown", [-1.0, float("nan")])
def test_unknown_fields_are_never_integrated(unknown: float) -> None:
    # PX4 SIH: current -1, consumed 0, energy -1 (docs/reference/autopilots.md).
    book, told = rested(), {"current_a": unknown, "consumed_wh": unknown, "consumed_mah": 0.0}
    fly(book, 1, 60, **told, modelled_power_w=480.0)
    assert left(book).mean_wh == pytest.approx(FULL_WH - 8.0, abs=0.2)
    assert "modelled power" in left(book).source
    assert any("measures no consumption" in w for w in left(book).warnings)


def test_no_current_before_the_motors_turn_is_no_missing_sensor() -> None:
    # ArduCopter's SITL, armed on the ground: 0 A and no consumption for a moment (flown).
    book = rested()
    fly(book, 1, 5, current_a=0.0, consumed_wh=0.0, consumed_mah=0.0, modelled_power_w=480.0)
    assert left(book).warnings == ()


def test_a_percentage_that_is_a_timer_is_no_source_and_is_said() -> None:
    book = rested(remaining_frac=1.0, remaining_is_timer=True)
    fly(book, 1, 60, remaining_frac=0.4, remaining_is_timer=True, modelled_power_w=480.0)
    assert left(book).mean_wh == pytest.approx(FULL_WH - 8.0, abs=0.2)
    assert any("counts time" in w for w in left(book).warnings)


def test_the_modelled_count_is_less_certain_than_a_measured_one() -> None:
    modelled, measured = rested(), rested()
    fly(modelled, 1, 400, modelled_power_w=506.0)
    fly(measured, 1, 400, voltage_v=VOLTS, current_a=AMPS, modelled_power_w=506.0)
    assert left(modelled).std_wh > left(measured).std_wh


def test_a_sensor_that_counts_far_less_than_the_model_is_not_believed() -> None:
    book = rested()
    fly(book, 1, 120, voltage_v=VOLTS, current_a=2.0, modelled_power_w=500.0)
    assert left(book).mean_wh == pytest.approx(FULL_WH - 500.0 / 30.0, abs=0.3)
    assert any("counts less than the power model" in w for w in left(book).warnings)


def test_a_voltage_that_does_not_fit_the_pack_is_not_used() -> None:
    # ArduPilot SITL: a constant 12.6 V (docs/reference/autopilots.md), whatever the airframe.
    book = ledger(configured_charge_frac=0.9)
    book.update_from_observation(rest(0.0, voltage_v=12.6))
    assert 0.85 * FULL_WH < left(book).mean_wh < 0.9 * FULL_WH
    assert any("does not fit 6 cells" in w for w in left(book).warnings)
    assert any("charge as stated" in w for w in left(book).warnings)


def test_a_sagging_voltage_bounds_what_a_wrong_count_believes() -> None:
    # A pack far emptier than counted: 3.5 V a cell under 22 A rests at 3.88 V if its resistance
    # were 1.75 times the model's and the sensor 0.09 V low: 51 % of charge at most.
    book = ledger(configured_charge_frac=1.0)
    book.update_from_observation(rest(0.0))
    fly(book, 1, 180, voltage_v=21.0, current_a=22.0, modelled_power_w=460.0)
    assert left(book).mean_wh < 0.52 * FULL_WH
    assert "loaded voltage" in left(book).source


def test_a_silent_minute_is_counted_at_what_was_drawn() -> None:
    book = rested()
    fly(book, 1, 30, voltage_v=VOLTS, current_a=AMPS, modelled_power_w=500.0)
    before = left(book).mean_wh
    book.update_from_observation(
        flight(91.0, voltage_v=VOLTS, current_a=AMPS, modelled_power_w=500.0)
    )
    assert before - left(book).mean_wh == pytest.approx(MINUTE_WH, rel=0.02)


def test_started_in_the_air_it_reckons_the_resting_voltage_from_the_loaded_one() -> None:
    book = ledger()
    loaded = 6 * 3.94 - AMPS * M100.battery.resistance_ohm
    book.update_from_observation(flight(0.0, voltage_v=loaded, current_a=AMPS))
    assert left(book).mean_wh == pytest.approx(0.59 * FULL_WH, rel=0.03)
    assert left(book).std_wh > 0.03 * FULL_WH


def test_safety_rule_4_a_companion_restart_goes_on_and_never_raises_it() -> None:
    book = rested(consumed_wh=0.0)
    for t in range(1, 121):
        used_wh = 16.0 * t / 120.0
        book.update_from_observation(
            flight(float(t), voltage_v=VOLTS, current_a=AMPS, consumed_wh=used_wh)
        )
    kept = json.loads(json.dumps(book.snapshot()))
    again = ledger()
    again.restore(kept)
    assert left(again) == left(book)
    # The counter continued during the gap.
    again.update_from_observation(flight(160.0, voltage_v=VOLTS, current_a=AMPS, consumed_wh=24.0))
    assert left(again).mean_wh <= FULL_WH - 24.0 + 1e-6


@pytest.mark.parametrize("gap_s", [3000.0, 6.0 * 3600.0, 49.7 * 86400.0])
def test_a_gap_that_would_have_emptied_the_pack_is_a_step_of_the_clock(gap_s) -> None:
    book = rested(consumed_wh=0.0)
    fly(book, 1, 60, voltage_v=VOLTS, current_a=AMPS, consumed_wh=8.0)
    before = left(book)
    fly(book, round(60 + gap_s), 10, voltage_v=VOLTS, current_a=AMPS, consumed_wh=9.0)
    assert before.mean_wh - 5.0 <= left(book).mean_wh <= before.mean_wh
    assert left(book).used_wh < 15.0


def test_safety_rule_4_restoring_an_older_higher_checkpoint_does_not_raise_it() -> None:
    book = rested()
    old = book.snapshot()
    fly(book, 1, 60, voltage_v=VOLTS, current_a=AMPS)
    low = left(book).mean_wh
    book.restore(old)
    assert left(book).mean_wh <= low


def test_safety_rule_4_an_autopilot_reboot_in_flight_never_raises_it() -> None:
    book = rested(consumed_wh=0.0, remaining_frac=1.0)
    fly(book, 1, 120, voltage_v=VOLTS, current_a=AMPS, consumed_wh=20.0, remaining_frac=0.8)
    before = left(book).mean_wh
    # Counters start at 0 again, the percentage at 100.
    fly(book, 121, 5, voltage_v=VOLTS, current_a=AMPS, consumed_wh=0.0, remaining_frac=1.0)
    assert left(book).mean_wh <= before
    fly(book, 130, 5, voltage_v=VOLTS, current_a=AMPS, consumed_wh=3.0, remaining_frac=0.97)
    assert left(book).mean_wh <= before - 3.0 + 1e-6


def test_nothing_known_at_all_is_a_guess_that_says_so() -> None:
    book = ledger()
    assert book.energy_belief_or_none() is None
    book.update_from_observation(flight(0.0))
    assert left(book).mean_wh < 0.85 * FULL_WH
    assert left(book).std_wh > 0.1 * FULL_WH
    assert any("nothing known" in w for w in left(book).warnings)


@pytest.mark.parametrize(
    ("kept", "words"),
    [
        ({}, "energy-ledger/2"),
        ({"format": "energy-ledger/2"}, "energy-ledger/2"),
        ({"format": "energy-ledger/9", "t_s": 1.0}, "energy-ledger/2"),
        ({**SNAPSHOT, "left_wh": "much"}, "left_wh"),
        ({**SNAPSHOT, "left_wh": float("nan")}, "left_wh"),
    ],
)
def test_a_checkpoint_that_is_none_is_refused(kept: dict, words: str) -> None:
    with pytest.raises(LeewayError, match=words):
        ledger().restore(kept)


def percentages(book: EnergyLedger, start_s: float, told: list[tuple[str, float]]) -> None:
    """Process this many messages at 2 Hz, in flight."""
    drawn = {"voltage_v": VOLTS, "current_a": AMPS, "modelled_power_w": VOLTS * AMPS}
    for k, (source, frac) in enumerate(told):
        book.update_from_observation(
            flight(start_s + 0.5 * k, remaining_frac=frac, source=source, **drawn)
        )


def airborne(remaining_frac: float = 0.9) -> EnergyLedger:
    """A ledger two minutes into a flight, at 539 W, with two packs that agree."""
    book = ledger()
    for source in ("pack 0", "pack 1"):
        book.update_from_observation(
            rest(0.0, voltage_v=FULL_V, remaining_frac=remaining_frac, source=source)
        )
    fly(book, 1, 120, voltage_v=VOLTS, current_a=AMPS, modelled_power_w=VOLTS * AMPS)
    return book


@pytest.mark.parametrize("apart", [0.05, 0.2])
def test_safety_rule_4_packs_that_differ_are_no_fall_at_each_message(apart: float) -> None:
    book = ledger()
    for source, frac in (("pack 0", 0.9), ("pack 1", 0.9 - apart)):
        book.update_from_observation(
            rest(0.0, voltage_v=FULL_V, remaining_frac=frac, source=source)
        )
    percentages(book, 1.0, [("pack 0", 0.9), ("pack 1", 0.9 - apart)] * 30)
    assert left(book).mean_wh == pytest.approx((0.9 - apart) * FULL_WH)


@pytest.mark.parametrize("wild", [0.0, 1.0])
def test_one_wild_percentage_is_doubt_and_soon_forgotten(wild: float) -> None:
    calm, struck = airborne(), airborne()
    percentages(calm, 130.0, [("pack 0", 0.9)])
    percentages(struck, 130.0, [("pack 0", wild)])
    assert left(struck).mean_wh == left(calm).mean_wh
    assert (left(struck).std_wh > left(calm).std_wh + 0.5) == (wild == 0.0)
    for book in (calm, struck):
        percentages(book, 130.5, [("pack 0", 0.9)] * 4)
    assert left(struck) == left(calm)


def test_safety_rule_4_a_pack_that_stays_low_is_believed_no_faster_than_physics() -> None:
    book = airborne()
    before = left(book).mean_wh
    percentages(book, 121.5, [("pack 1", 0.3)] * 10)
    # 2,789 W is twice what the m100 draws loaded, climbing at its top airspeed: 3.9 Wh in 5 s.
    assert before - 4.4 - 0.02 * FULL_WH < left(book).mean_wh < before - 2.0
    assert left(book).std_wh > 0.1 * FULL_WH
    percentages(book, 126.5, [("pack 1", 0.3)] * 240)
    assert left(book).mean_wh == pytest.approx(0.3 * FULL_WH)


def counted(book: EnergyLedger, start_s: float, counts_wh: list[float]) -> None:
    for k, wh in enumerate(counts_wh):
        told = {"consumed_wh": wh, "voltage_v": VOLTS, "modelled_power_w": 539.0}
        book.update_from_observation(flight(start_s + 0.5 * k, **told))


@pytest.mark.parametrize("wrong", [0.0, 4.0, 18.2, 5000.0])
def test_one_late_or_wild_count_costs_nothing(wrong: float) -> None:
    steady = [0.075 * k for k in range(240)]  # 540 W at 2 Hz
    calm, struck = rested(consumed_wh=0.0), rested(consumed_wh=0.0)
    counted(calm, 0.5, steady)
    counted(struck, 0.5, [*steady[:200], wrong, *steady[201:]])
    assert left(struck) == left(calm)


def test_a_count_that_starts_anew_anywhere_goes_on_from_there() -> None:
    book = rested(consumed_wh=0.0)
    counted(book, 0.5, [0.075 * k for k in range(200)])
    counted(book, 100.5, [5000.0 + 0.075 * k for k in range(200)])
    # What could be used from the last count before to the first after is at most 0.4 Wh.
    assert left(book).mean_wh == pytest.approx(FULL_WH - 0.075 * 398, abs=0.4)


def test_safety_rule_4_whatever_is_told_the_deviation_is_bounded() -> None:
    book = airborne()
    counted(book, 130.0, [1e6 * k for k in range(20)])
    fly(book, 150, 10, voltage_v=VOLTS, current_a=655.0, consumed_wh=1e7, remaining_frac=0.0)
    assert left(book).std_wh <= FULL_WH / 12**0.5 + 1e-9


def test_one_wild_percentage_before_take_off_does_not_ground_it_for_good() -> None:
    book = rested(remaining_frac=0.0)
    assert left(book).mean_wh == 0.0
    for k in range(4):
        book.update_from_observation(rest(0.5 + 0.5 * k, voltage_v=FULL_V, remaining_frac=1.0))
    assert left(book).mean_wh == pytest.approx(FULL_WH)


def test_safety_rule_4_a_source_far_off_is_doubt_and_no_jump() -> None:
    # A parcel stated but not carried: the model counts 0.62 of its figure, then a minute at idle.
    book = rested()
    fly(book, 1, 300, voltage_v=VOLTS, current_a=14.0, modelled_power_w=550.0)
    seen = [left(book).mean_wh]
    for t in range(302, 362):
        book.update_from_observation(
            flight(float(t), voltage_v=VOLTS, current_a=0.5, modelled_power_w=550.0)
        )
        seen.append(left(book).mean_wh)
    # 2 % of the pack that whole per cents may step by, and a second of the most it can draw.
    assert max(a - b for a, b in pairwise(seen)) < 0.02 * FULL_WH + 0.8
    assert left(book).std_wh <= FULL_WH / 12**0.5
