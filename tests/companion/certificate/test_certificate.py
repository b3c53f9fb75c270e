"""Days, bounds and envelopes: by hand, by simulation, and by published figures."""

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy.stats import beta

from companion.adapters.files.params import read_airframe
from companion.core.base.errors import LeewayError
from companion.core.certificate.certificate import certificate_from_dict
from companion.core.certificate.certify import MeasuredFlight, Scatter, create_certificate
from companion.core.certificate.support import (
    days_needed_for_loss,
    loss_free_days_needed,
    loss_upper_confidence_limit,
    supported_loss_probability,
)
from companion.core.certificate.watch import MIN_OUTSIDE_S, EnvelopeMonitor
from companion.core.vehicle.power_bias import ModelError

M100 = read_airframe("m100")
USUAL = Scatter(0.01, 0.03)


def flight(
    day, ratio=1.0, wind=5.0, airspeed=12.0, payload=0.25, celsius=None, name="f", worst=None
):
    return MeasuredFlight(
        name=name,
        date=f"2026-05-{day:02d}",
        measured_wh=20.0 * ratio,
        predicted_wh=20.0,
        decision_points=150,
        worst_ratio=worst or ratio,
        wind_mps=wind,
        airspeed_mps=airspeed,
        payload_kg=payload,
        air_temperature_c=celsius,
    )


def certificate(flights=None, left_out=()):
    flights = flights or [flight(day, 1.0 + 0.01 * day) for day in range(1, 12)]
    return create_certificate(M100, flights, USUAL, list(left_out))


def test_eleven_days_support_a_twelfth_and_a_quarter_with_confidence():
    assert supported_loss_probability(11) == pytest.approx(1 / 12)
    # Clopper and Pearson's upper limit of 0 in n, by scipy's beta.
    for days in (3, 11, 299):
        assert loss_upper_confidence_limit(days) == pytest.approx(beta.ppf(0.95, 1, days))
    assert days_needed_for_loss(0.01) == 99
    assert loss_free_days_needed(0.01) == 299


@pytest.mark.parametrize("loss", [0.0, 1.0, -0.1, math.nan])
def test_a_loss_that_is_none_is_refused(loss):
    for asked in (days_needed_for_loss, loss_free_days_needed):
        with pytest.raises(LeewayError, match="expected more than 0 and less than 1"):
            asked(loss)


def test_a_new_day_is_over_the_bound_as_often_as_is_said():
    """Exchangeable days of correlated flights; counting flights, not days, would give 1 in 67."""
    rng = np.random.default_rng(3)
    days, flights, over, tries = 11, 6, 0, 4000
    for _ in range(tries):
        of_day = rng.normal(0.0, 0.02, days + 1)
        worst = (of_day[:, None] + rng.normal(0.0, 0.01, (days + 1, flights))).max(axis=1)
        over += worst[-1] > worst[:-1].max()
    expected = supported_loss_probability(days)
    assert over / tries == pytest.approx(expected, abs=4.0 * math.sqrt(expected / tries))


def test_the_bound_is_the_worst_flight_of_all_days():
    found = certificate([flight(1), flight(1, 1.2), flight(2, 0.9), flight(3, 1.1)])
    assert [(day.date[-2:], day.flights) for day in found.days] == [("01", 2), ("02", 1), ("03", 1)]
    assert found.max_measured_to_predicted_ratio == pytest.approx(1.2)
    assert "with these 3 (4 flights, 600 decision points)" in found.summary_text
    assert "energy to home exceeds 1.200 of what m100 predicts" in found.summary_text
    assert "any flight, with at most 25 % (with 95 % confidence at most 63 %)" in found.summary_text


def test_the_worst_moment_of_a_flight_counts_and_not_its_whole():
    found = certificate([flight(1), flight(2, 1.02, worst=1.25), flight(3, 1.1)])
    assert [day.worst_ratio for day in found.days] == pytest.approx([1.0, 1.25, 1.1])
    assert found.max_measured_to_predicted_ratio == pytest.approx(1.25)


def test_two_days_or_a_log_of_another_vehicle_certify_nothing():
    with pytest.raises(LeewayError, match="flights on 2 days, at least 3 expected"):
        certificate([flight(1), flight(2)])
    with pytest.raises(LeewayError, match=r"odd\.csv: 50\.0 Wh measured, 20\.0 predicted"):
        certificate([flight(1), flight(2), flight(3, 2.5, name="odd.csv")])


def test_the_envelope_is_what_two_days_have_reached():
    days = [flight(1, wind=3.0, payload=0.75), flight(2, wind=9.0), flight(3, wind=6.0)]
    envelope = certificate(days).envelope
    assert (envelope.wind_mps, envelope.payload_kg) == (6.0, 0.25)
    assert envelope.air_temperature_c is None
    warm = [replace(f, air_temperature_c=c) for f, c in zip(days, (4.0, 21.0, 12.0), strict=True)]
    assert certificate(warm).envelope.air_temperature_c == (12.0, 12.0)
    unknown_once = [*warm, flight(4)]
    assert certificate(unknown_once).envelope.air_temperature_c is None


def test_a_file_with_a_mistake_is_named_with_its_key():
    table = msgspec.to_builtins(certificate())
    assert certificate_from_dict(table, "c.json") == certificate()
    for key, value in (("days", table["days"][:2]), ("draw_factor", 9.0), ("format", "x/1")):
        with pytest.raises(LeewayError, match=r"^c\.json: .*" + key):
            certificate_from_dict({**table, key: value}, "c.json")


def test_a_certificate_of_whole_flights_says_that_it_is_to_be_made_again():
    table = msgspec.to_builtins(certificate()) | {"format": "certificate/1"}
    with pytest.raises(LeewayError, match=r"^c\.json: certificate/1 judged whole .*certify again"):
        certificate_from_dict(table, "c.json")


INSIDE = {"t_s": 0.0, "wind_ne_mps": (0.0, 4.0), "airspeed_mps": 11.0}


def test_inside_nothing_is_said_and_nothing_changes():
    watch = EnvelopeMonitor(certificate())
    assert watch.record_exits_on_ground(0.25, 20.0) == ()
    for t_s in range(100):
        assert watch.record_exits_in_flight(**{**INSIDE, "t_s": float(t_s)}) == ()
    error = ModelError(1.02, 0.03)
    assert watch.model_error_widened_outside(error) is error


def test_wind_and_airspeed_outside_are_said_once_after_their_hold():
    for key, words in (
        ("wind_ne_mps", "wind of 8.0 m/s"),
        ("airspeed_mps", "airspeed of 14.0 m/s"),
    ):
        watch, said = EnvelopeMonitor(certificate()), []
        outside = {**INSIDE, key: 14.0 if "air" in key else (8.0, 0.0)}
        for t_s in range(40):
            said += [
                (t_s, one) for one in watch.record_exits_in_flight(**{**outside, "t_s": float(t_s)})
            ]
        assert [t_s for t_s, _ in said] == [MIN_OUTSIDE_S]
        assert words in said[0][1]
        assert watch.envelope_exit_texts == (f"certificate: {said[0][1]}",)


def test_a_gust_shorter_than_the_hold_leaves_nothing():
    watch = EnvelopeMonitor(certificate())
    for t_s in range(60):
        gust = 8.0 if t_s % 10 < 9 else 4.0
        assert watch.record_exits_in_flight(float(t_s), (0.0, gust), None) == ()
    assert watch.record_exits_in_flight(61.0, None, None) == ()


def test_a_parcel_or_an_air_that_nobody_flew_is_said_on_the_ground():
    warm = [flight(day, celsius=10.0 + day) for day in range(1, 12)]
    watch = EnvelopeMonitor(certificate(warm))
    assert watch.record_exits_on_ground(0.25, None) == ()
    (words,) = watch.record_exits_on_ground(0.6, 15.0)
    assert "parcel of 0.6 kg (certified: 0.25)" in words
    (words,) = watch.record_exits_on_ground(0.25, 30.0)
    assert "air of 30 C (certified: 12 to 20)" in words
    assert watch.record_exits_on_ground(0.6, 30.0) == ()


def test_outside_the_gate_counts_with_a_tenth_more_and_never_with_less_than_was_learned():
    watch = EnvelopeMonitor(certificate())
    watch.record_exits_on_ground(5.0, None)
    careful = watch.model_error_widened_outside(ModelError(1.0, 0.03))
    assert careful.scale == pytest.approx(1.10)
    assert careful.std_frac == pytest.approx(math.hypot(0.03, 0.05))
    assert watch.model_error_widened_outside(ModelError(1.3, 0.03)).scale == 1.3


def test_a_restarted_companion_stays_outside_and_without_a_certificate_nothing_is_watched():
    watch = EnvelopeMonitor(certificate())
    watch.record_exits_on_ground(5.0, None)
    again = EnvelopeMonitor(certificate())
    again.restore(watch.snapshot())
    assert again.envelope_exit_texts == watch.envelope_exit_texts
    unwatched = EnvelopeMonitor(None)
    assert (
        unwatched.record_exits_on_ground(5.0, 90.0)
        == unwatched.record_exits_in_flight(0.0, (99.0, 0.0), 99.0)
        == ()
    )
    unwatched.restore(watch.snapshot())
    assert unwatched.envelope_exit_texts == ()
