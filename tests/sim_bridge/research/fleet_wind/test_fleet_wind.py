"""The study of shared wind: its drones, its figures, its false alerts, and the command itself."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from companion.core.base.errors import LeewayError
from companion.core.wind_field.fronts import FrontWithdrawn, WindChange, WindFront
from sim_bridge.main import app
from sim_bridge.research.fleet_wind.errors import (
    FORECAST_QUANTITIES,
    FREE_POSITION,
    FleetComposition,
    SquareSums,
    error_sums_key,
    merge_error_sums,
)
from sim_bridge.research.fleet_wind.fields import (
    GROUND_SPEED_MPS,
    SITE_M,
    draw_patrols,
    split_recording_in_cross_fitted_halves,
)
from sim_bridge.research.fleet_wind.fronts import (
    AlertStatistics,
    WindReports,
    evaluate_front_alerts,
    first_detection_of_each_front,
    front_update_time_and_front,
    latest_front,
)
from sim_bridge.research.fleet_wind.study import error_sums_to_json_rows
from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.fields.field_file import load_wind_field
from sim_bridge.truth.fields.front import LinearFront
from tests.companion.wind_field.made_front import made_front
from tests.sim_bridge.research.study_command import run_study

ROOT = Path(__file__).parents[4]
SHIPPED = ROOT / "params" / "fields" / "front.toml"


def test_drones_fly_orders_on_the_site_at_their_speed_and_others_hover() -> None:
    ways = draw_patrols(8, 3, 3600.0, np.random.default_rng(1))
    t_s = np.arange(0.0, 3600.0)
    for number, way in enumerate(ways):
        place = way.positions_ne_m_at(t_s)
        assert np.abs(place).max() <= SITE_M
        speed = np.hypot(*np.diff(place, axis=0).T)
        assert speed.max() <= GROUND_SPEED_MPS + 1e-6
        assert (speed.max() == 0.0) == (number >= 5)
        if number < 5:
            assert speed.mean() > 0.5 * GROUND_SPEED_MPS


@pytest.mark.sample
def test_halves_are_fitted_to_one_another(tmp_path: Path) -> None:
    """The first half is steady and the second gusty: each has the process of the other."""
    rng = np.random.default_rng(1)
    gust, rows = 0.0, ["t_s,wind_speed_mps,wind_from_deg"]
    for t_s in range(2600):
        gust = 0.9 * gust + (0.1 if t_s < 1300 else 0.9) * float(rng.standard_normal())
        rows.append(f"{t_s},{max(8.0 + gust, 0.0):.3f},270")
    path = tmp_path / "site.csv"
    path.write_text("\n".join(rows))
    first, second = split_recording_in_cross_fitted_halves(path)
    assert len(first.half_ne_mps) == 1300
    assert sum(first.process.variance_m2ps2) > 4.0 * sum(second.process.variance_m2ps2)
    path.write_text("\n".join(rows[:2000]))
    with pytest.raises(LeewayError, match="expected 2400 s or more"):
        split_recording_in_cross_fitted_halves(path)


def test_sums_of_squares_become_errors_by_component_and_gains() -> None:
    sums = {
        error_sums_key(
            FleetComposition.ALL_CORRECT, FREE_POSITION, FORECAST_QUANTITIES[2]
        ): SquareSums(2, 16.0, 4.0, 8.0, 4.0)
    }
    (row,) = error_sums_to_json_rows(merge_error_sums([sums, sums]), {})
    assert row["own_only_rmse_mps"] == pytest.approx(2.0)
    assert row["fleet_rmse_mps"] == pytest.approx(1.0)
    assert row["nees"] == pytest.approx(2.0)
    assert row["count"] == 4
    assert (row["lead_s"], row["averaged_s"], row["where"]) == (150.0, 150.0, FREE_POSITION)


def beliefs_of(places: list[tuple[float, float]]) -> WindReports:
    t_s = np.arange(1000.0)
    here = np.stack([np.tile(place, (t_s.size, 1)) for place in places])
    return WindReports(t_s, here, np.zeros_like(here))


def alert(t_s: float) -> WindFront:
    felt = WindChange("drone-1", t_s, (0.0, 0.0), (8.0, 0.0), (16.0, 0.0), 40.0)
    return made_front(t_s, felt)


def test_an_alert_is_worth_what_was_still_to_come_when_it_was_told() -> None:
    """A front of 12 m/s from the south: felt at 0, 600 and 1200 m some 17 s after it starts."""
    front = LinearFront(500.0, 0.0, 12.0, (8.0, 0.0), 30.0)
    told = beliefs_of([(0.0, 0.0), (600.0, 0.0), (1200.0, 0.0)])
    found = evaluate_front_alerts(front, told, [alert(530.0)])
    assert (found.fronts, found.reported) == (1, 1)
    assert (found.drones_to_warn, found.drones_warned) == (2, 2)
    first_s = 530.0 - found.delays_s[0]
    assert 510.0 < first_s < 525.0
    assert found.lead_times_s == pytest.approx(
        (first_s + 50.0 - 530.0, first_s + 100.0 - 530.0), abs=1.5
    )
    late = evaluate_front_alerts(front, told, [alert(580.0)])
    assert (late.drones_to_warn, late.drones_warned) == (2, 1)
    never = evaluate_front_alerts(front, told, [])
    assert (never.reported, never.drones_to_warn, never.drones_warned) == (0, 2, 0)
    weak = LinearFront(500.0, 0.0, 12.0, (2.0, 0.0), 30.0)
    assert evaluate_front_alerts(weak, told, [alert(530.0)]) == AlertStatistics()


def test_news_of_a_front_are_one_alert_that_stands_until_it_is_withdrawn() -> None:
    first, second = alert(530.0), alert(900.0)
    better = replace(
        first,
        detections=(*first.detections, replace(first.detections[0], member="drone-2", t_s=541.0)),
    )
    news = [first, better, FrontWithdrawn(better, 562.0), second]
    assert first_detection_of_each_front(news) == [first, second]
    told = tuple(front_update_time_and_front(each) for each in news)
    assert [known_s for known_s, _ in told] == [530.0, 541.0, 562.0, 900.0]
    assert latest_front(told, 529.0) is None
    assert latest_front(told, 545.0) == better
    assert latest_front(told, 570.0) is None
    assert latest_front(told, 900.0) == second


def test_the_shipped_field_is_read_and_a_mistake_in_one_is_named(tmp_path: Path) -> None:
    assert load_wind_field(SHIPPED).coherence.across == 13.0
    broken = tmp_path / "field.toml"
    for old, new, words in (
        ("mean_mps = 8.0", "mean_mps = 0.1", "mean_mps"),
        ("seconds = 3600", "seconds = 60", "seconds"),
        ("front_most_mps = 10.0", "front_most_mps = 2.0", "front_most_mps"),
        ("name", "nome", "nome"),
    ):
        broken.write_text(SHIPPED.read_text().replace(old, new))
        with pytest.raises(TruthError, match=words):
            load_wind_field(broken)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "either --wind-log or --field"),
        (["--field", str(SHIPPED), "--wind-log", "x.csv"], "either --wind-log or --field"),
        (["--field", str(SHIPPED), "--drones", "2", "--hovering", "3"], "at most --drones"),
        (["--field", "absent.toml"], "cannot be read"),
    ],
)
def test_options_that_do_not_go_together_are_refused(words: list[str], message: str) -> None:
    result = CliRunner().invoke(app, ["research", "fleet-wind", *words])
    assert isinstance(result.exception, LeewayError)
    assert message in str(result.exception)


def command(folder: Path, *words: str) -> dict[str, Any]:
    """Return the command's JSON for half an hour of a synthetic field with two hovering drones."""
    short = folder / "field.toml"
    short.write_text(SHIPPED.read_text().replace("seconds = 3600", "seconds = 1800"))
    found, printed = run_study(
        folder, "fleet-wind", "--field", str(short), "--drones", "2", "--hovering", "2", *words
    )
    assert "# Fronts" in printed
    return found


@pytest.mark.sample
def test_the_command_judges_a_made_field(tmp_path: Path) -> None:
    one = command(tmp_path, "--draws", "1", "--alert-draws", "1")
    assert {"fronts", "warned", "lead_s_median", "false"} <= set(one["alerts"])
    honest = [r for r in one["error"] if (r["wind"], r["members"]) == ("ordinary", "all honest")]
    assert len(honest) == 2 * len(FORECAST_QUANTITIES)
    for row in one["error"]:
        assert 0.1 < row["fleet_rmse_mps"] < 10.0
        assert math.isfinite(row["nees"])


@pytest.mark.night
def test_the_same_seed_judges_the_same_and_another_another(tmp_path: Path) -> None:
    found: list[dict[str, Any]] = []
    for name, seed in (("one", "1"), ("two", "1"), ("three", "2")):
        folder = tmp_path / name
        folder.mkdir()
        found.append(command(folder, "--draws", "1", "--alert-draws", "1", "--seed", seed))
    assert found[0] == found[1]
    assert found[0]["error"] != found[2]["error"]
