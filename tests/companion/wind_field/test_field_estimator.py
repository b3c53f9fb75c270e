"""The wind field estimate, against direct conditioning and draws from its covariance."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.adapters.files.params import read_wind_process
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import WindOutlook
from companion.core.wind_field.field_estimator import FieldEstimator
from companion.core.wind_field.field_process import FieldPoints, FieldProcess
from companion.core.wind_field.settled_field import FieldEstimate, WindPrior
from companion.core.wind_field.wind_reports import REPORT_AVERAGING_S, MemberWindReport

COAST = read_wind_process("coast")
PROCESS = FieldProcess(COAST)
NORTH_WIND = np.array([-8.0, 0.0])
HEIGHT_M = 40.0


def told(
    member: str,
    t_s: float,
    place: tuple[float, float] = (0.0, 0.0),
    wind: tuple[float, float] = (-8.0, 0.0),
    std_mps: float = 0.4,
    height_m: float = HEIGHT_M,
) -> MemberWindReport:
    moved = wind[0] + 1e-7 * t_s, wind[1]  # a frozen estimate is rejected
    return MemberWindReport(member, t_s, place, height_m, moved, (std_mps**2, 0.0, std_mps**2))


def points(*where: tuple[float, float, float], height_m: float = HEIGHT_M) -> FieldPoints:
    """Points (north, east, t)."""
    table = np.array(where, float)
    return FieldPoints(table[:, :2], np.full(len(where), height_m), table[:, 2])


def settled(tellings: list[MemberWindReport], now_s: float, always: str = "") -> FieldEstimate:
    belief = FieldEstimator(PROCESS)
    for one in sorted(tellings, key=lambda telling: telling.t_s):
        assert belief.add_report_or_rejection_reason(one, one.t_s) == ""
    return belief.prune_learn_and_estimate_field(now_s, always)


def north_std_mps(field: FieldEstimate, *where: tuple[float, float, float]) -> float:
    return float(np.sqrt(field.forecast_at_points(points(*where)).north_cov_m2ps2[0, 0]))


def test_at_a_fixed_place_the_distance_of_two_times_is_the_time() -> None:
    here = FieldPoints(np.zeros((2, 2)), np.full(2, HEIGHT_M), np.array([3.0, 95.0]))
    one, other = PROCESS.eddy_distance_coordinates_s(here, NORTH_WIND)
    assert np.linalg.norm(other - one) == pytest.approx(92.0)


@settings(max_examples=40)
@given(
    st.lists(
        st.tuples(*[st.floats(-2000.0, 2000.0)] * 2, st.floats(-900.0, 900.0)),
        min_size=2,
        max_size=12,
    ),
    st.floats(0.0, 15.0),
)
def test_the_covariance_of_any_points_in_any_wind_is_one(
    where: list[tuple[float, float, float]], wind_mps: float
) -> None:
    at_s = PROCESS.eddy_distance_coordinates_s(points(*where), np.array([wind_mps, -0.3]))
    left = PROCESS.averaging_std_factor_by_part(np.full(len(where), REPORT_AVERAGING_S))
    cov = PROCESS.covariance_within(at_s, left)
    assert np.allclose(cov, cov.T)
    assert np.linalg.eigvalsh(cov).min() > -1e-9
    assert np.allclose(np.diag(cov), np.diag(PROCESS.covariance_between(at_s, left, at_s, left)))


def test_what_one_member_tells_is_conditioned_on_as_the_textbook_does() -> None:
    """Three reports of a static member: Kriging written out (Rasmussen and Williams 2.19)."""
    winds = [(-9.0, 1.0), (-7.0, 0.5), (-8.5, -1.0)]
    field = settled([told("a", 10.0 * k, wind=w) for k, w in enumerate(winds)], 20.0)
    asked = np.array([20.0, 80.0, 320.0])
    said = field.forecast_at_points(points(*((0.0, 0.0, t) for t in asked)))

    memory, variance = np.array(COAST.memory_s), np.array(COAST.variance_m2ps2)
    ratio = memory / REPORT_AVERAGING_S  # a mean over ten seconds, in closed form
    left = 2.0 * ratio * (1.0 - ratio * (1.0 - np.exp(-1.0 / ratio)))
    speed = np.hypot(*np.mean(winds, axis=0))
    scale = np.clip(speed / COAST.reference_wind_mps, COAST.least_scale, COAST.most_scale) ** 2

    def cov(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        apart = np.abs(np.subtract.outer(a, b))[..., None]
        gusts = scale * (left * variance * np.exp(-apart / memory)).sum(-1)
        return gusts + COAST.level_std_mps**2

    at = np.array([-5.0, 5.0, 15.0])  # each is the mean of the seconds before it
    inverse = np.linalg.inv(cov(at, at) + COAST.seen_noise_std_mps**2 * np.eye(3))
    expected = cov(asked, at) @ inverse @ np.array(winds)
    left_over = cov(asked, asked) - cov(asked, at) @ inverse @ cov(at, asked)
    assert np.allclose(said.mean_to_ne_mps, expected, atol=1e-4)
    assert np.allclose(said.north_cov_m2ps2, left_over, atol=1e-4)


def test_a_member_alone_forecasts_as_its_own_outlook_does() -> None:
    """Ten minutes of wind, joined to minutes here and filtered each 5 s there."""
    rng = np.random.default_rng(7)
    outlook, belief = WindOutlook(COAST), FieldEstimator(PROCESS)
    cov = np.eye(2) * COAST.seen_noise_std_mps**2
    slow = np.array([-8.0, 2.0]) + np.cumsum(0.15 * rng.standard_normal((61, 2)), axis=0)
    now = None
    for k in range(61):
        now = WindBelief(10.0 * k, slow[k] + 0.4 * rng.standard_normal(2), cov, ("tilt",), True)
        outlook.update_from_estimate(now)
        north, east = now.mean_to_ne_mps
        belief.add_report_or_rejection_reason(
            told("a", 10.0 * k, wind=(float(north), float(east))), 10.0 * k
        )
    assert now is not None
    ahead = np.array([30.0, 150.0, 300.0, 600.0])
    own = outlook.forecast(now, ahead)
    field = belief.prune_learn_and_estimate_field(600.0)
    said = field.forecast_at_points(
        points(*((0.0, 0.0, 600.0 + h) for h in ahead)), averaging_time_s=60.0
    )
    assert np.abs(said.mean_to_ne_mps - own.mean_to_ne_mps).max() < 0.3
    ratio = np.sqrt(np.diag(said.north_cov_m2ps2) / np.diag(own.change_cov_m2ps2))
    assert ratio == pytest.approx(np.ones(4), abs=0.15)


def test_without_tellings_the_field_is_the_forecast() -> None:
    field = FieldEstimator(
        PROCESS, WindPrior((3.0, -4.0), 2.0, HEIGHT_M)
    ).prune_learn_and_estimate_field(0.0)
    said = field.forecast_at_points(points((0.0, 0.0, 0.0), (500.0, 900.0, 300.0)))
    assert np.allclose(said.mean_to_ne_mps, [3.0, -4.0])
    least = 2.0**2 + 0.75**2 * sum(COAST.variance_m2ps2) * 0.5
    assert np.diag(said.north_cov_m2ps2).min() > least
    assert field.accepted_members == ()


def test_a_forecast_pulls_the_field_and_is_overruled_by_what_is_felt() -> None:
    prior = WindPrior((0.0, 10.0), 1.0, HEIGHT_M)
    belief = FieldEstimator(PROCESS, prior)
    for k in range(60):
        belief.add_report_or_rejection_reason(told("a", 10.0 * k, wind=(0.0, 5.0)), 10.0 * k)
    east = belief.prune_learn_and_estimate_field(590.0).forecast_at_points(
        points((0.0, 0.0, 590.0), (0.0, 0.0, 3600.0))
    )
    now, later = east.mean_to_ne_mps[:, 1]
    assert now < 6.0 < later < 10.0


def test_the_wind_brings_what_was_felt_upstream() -> None:
    """Two members 800 m away: one upstream, one to the side. At 8 m/s air needs 100 s."""
    upstream = settled([told("a", 10.0 * k, (800.0, 0.0)) for k in range(4)], 30.0)
    beside = settled([told("a", 10.0 * k, (0.0, 800.0)) for k in range(4)], 30.0)
    later = (0.0, 0.0, 130.0)
    assert north_std_mps(upstream, later) < 0.9 * north_std_mps(beside, later)
    downstream = (1600.0, 0.0, 130.0)  # the same distance against the wind
    assert north_std_mps(upstream, later) < 0.9 * north_std_mps(upstream, downstream)


def test_waiting_and_distance_never_make_us_more_certain() -> None:
    field = settled([told("a", 10.0 * k) for k in range(10)], 90.0)
    by_time = [north_std_mps(field, (0.0, 0.0, 90.0 + h)) for h in (0.0, 30.0, 120.0, 600.0)]
    by_place = [north_std_mps(field, (0.0, d, 90.0)) for d in (0.0, 100.0, 400.0, 2000.0)]
    assert by_time == sorted(by_time)
    assert by_place == sorted(by_place)


def test_more_members_make_it_more_certain_where_nobody_is() -> None:
    one = [told("a", 10.0 * k, (300.0, 0.0)) for k in range(10)]
    other = [told("b", 10.0 * k, (-300.0, 0.0)) for k in range(10)]
    asked = (0.0, 0.0, 150.0)
    assert north_std_mps(settled(one + other, 90.0), asked) < 0.98 * north_std_mps(
        settled(one, 90.0), asked
    )


def test_wind_is_told_on_to_other_heights_with_a_doubt() -> None:
    field = settled([told("a", 10.0 * k) for k in range(10)], 90.0)
    low, high = (
        field.forecast_at_points(points((0.0, 0.0, 90.0), height_m=h)) for h in (40.0, 120.0)
    )
    grown = float(high.mean_to_ne_mps[0, 0] / low.mean_to_ne_mps[0, 0])
    assert grown == pytest.approx(3.0 ** (1.0 / 7.0), rel=0.01)  # and a little of the prior
    assert high.north_cov_m2ps2[0, 0] > low.north_cov_m2ps2[0, 0] * grown**2 + 0.5


def test_a_lasting_error_is_not_averaged_away() -> None:
    """A member with an error of 1.5 m/s that it states: a hundred reports do not make it exact."""
    many = settled([told("a", 10.0 * k, std_mps=1.5) for k in range(80)], 790.0)
    assert north_std_mps(many, (0.0, 0.0, 790.0)) > 1.4
    exact = settled([told("a", 10.0 * k, std_mps=0.4) for k in range(80)], 790.0)
    assert north_std_mps(exact, (0.0, 0.0, 790.0)) < 0.7


@pytest.mark.sample
def test_the_error_stated_is_the_error_made_in_winds_drawn_from_the_covariance() -> None:
    """Six members that hover for seven minutes, eighty draws: NEES of two axes is 2."""
    rng = np.random.default_rng(3)
    where = rng.uniform(-600.0, 600.0, (6, 2))
    times = 10.0 * np.arange(42)
    truth_at = [(n, e, t - 5.0) for n, e in where for t in times]
    asked = [(0.0, 0.0, 410.0), (0.0, 0.0, 560.0)]
    at_s = PROCESS.eddy_distance_coordinates_s(points(*truth_at, *asked), NORTH_WIND)
    cov = PROCESS.covariance_within(
        at_s, PROCESS.averaging_std_factor_by_part(np.full(at_s.shape[0], REPORT_AVERAGING_S))
    )
    root = np.linalg.cholesky(cov + 1e-9 * np.eye(cov.shape[0]))
    nees: list[float] = []
    for _ in range(80):
        wind = NORTH_WIND + root @ rng.standard_normal((cov.shape[0], 2))
        noisy = wind[:-2] + 0.4 * rng.standard_normal((len(truth_at), 2))
        tellings = [
            told(f"d{i // 42}", float(times[i % 42]), tuple(where[i // 42]), tuple(w))
            for i, w in enumerate(noisy)
        ]
        field = settled(tellings, 410.0)
        assert field.excluded == {}
        said = field.forecast_at_points(points(*asked))
        error = (wind[-2:] - said.mean_to_ne_mps) ** 2
        nees += (error.sum(axis=1) / np.diag(said.north_cov_m2ps2)).tolist()
    assert 1.6 < np.mean(nees) < 2.5


def test_in_air_gustier_than_the_process_says_the_error_stated_grows() -> None:
    rng = np.random.default_rng(11)
    stds: list[float] = []
    for gusts_mps in (0.3, 3.0):
        tellings = [
            told(name, 10.0 * k, place, tuple(NORTH_WIND + gusts_mps * rng.standard_normal(2)))
            for k in range(60)
            for name, place in (("a", (0.0, 0.0)), ("b", (500.0, 200.0)))
        ]
        field = settled(tellings, 590.0)
        assert (field.variance_misfit_ratio() > 1.05) == (gusts_mps == 3.0)
        stds.append(north_std_mps(field, (0.0, 800.0, 700.0)))
    assert stds[1] > 1.3 * stds[0]
