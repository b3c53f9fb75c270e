"""The study of shared wind: its drones, its figures, its false alerts, and the command itself."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from companion.adapters.files.params import read_wind_process
from companion.core.base.errors import LeewayError
from companion.core.wind_field.fronts import (
    FeltChange,
    FrontAhead,
    FrontWithdrawn,
    chance_m2ps2,
)
from sim_bridge.research.cli.main import app
from sim_bridge.research.fleet_wind.alert_study import (
    Alert,
    AlertFigures,
    Beliefs,
    alerts_in,
    judge_front,
    least_delay_s,
)
from sim_bridge.research.fleet_wind.error_study import (
    NOBODY,
    QUESTIONS,
    ErrorTally,
    Members,
    SquareSums,
    key_of,
)
from sim_bridge.research.fleet_wind.front_stages import (
    FrontsOfWorld,
    FrontStage,
    front_known,
    fronts_of_world,
)
from sim_bridge.research.fleet_wind.patrols import GROUND_SPEED_MPS, SITE_M, patrols
from sim_bridge.research.fleet_wind.sheets import error_rows, headline, stage_rows, stage_sheet
from sim_bridge.research.fleet_wind.worlds import halves_of
from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.fields.coherent_field import Coherence, CoherentField
from sim_bridge.truth.fields.field_file import load_wind_field
from sim_bridge.truth.fields.front import PassingFront
from sim_bridge.truth.fields.site_wind import SiteWind
from tests.companion.wind_field.made_front import made_front

ROOT = Path(__file__).parents[4]
COAST = read_wind_process("coast")
SHIPPED = ROOT / "params" / "fields" / "front.toml"


def test_drones_fly_orders_on_the_site_at_their_speed_and_others_hover() -> None:
    ways = patrols(8, 3, 3600.0, np.random.default_rng(1))
    t_s = np.arange(0.0, 3600.0)
    for number, way in enumerate(ways):
        place = way.at(t_s)
        assert np.abs(place).max() <= SITE_M
        speed = np.hypot(*np.diff(place, axis=0).T)
        assert speed.max() <= GROUND_SPEED_MPS + 1e-6
        assert (speed.max() == 0.0) == (number >= 5)
        if number < 5:
            assert speed.mean() > 0.5 * GROUND_SPEED_MPS


def test_halves_are_fitted_to_one_another(tmp_path: Path) -> None:
    """The first half is steady and the second one gusty: each has the process of the other."""
    rng = np.random.default_rng(1)
    gust, rows = 0.0, ["t_s,wind_speed_mps,wind_from_deg"]
    for t_s in range(2600):
        gust = 0.9 * gust + (0.1 if t_s < 1300 else 0.9) * float(rng.standard_normal())
        rows.append(f"{t_s},{max(8.0 + gust, 0.0):.3f},270")
    path = tmp_path / "site.csv"
    path.write_text("\n".join(rows))
    first, second = halves_of(path)
    assert first.wind_ne_mps.shape[0] == 1300
    assert sum(first.process.variance_m2ps2) > 4.0 * sum(second.process.variance_m2ps2)
    path.write_text("\n".join(rows[:2000]))
    with pytest.raises(LeewayError, match="expected 2400 s or more"):
        halves_of(path)


def test_sums_of_squares_become_errors_by_component_and_gains() -> None:
    tally = ErrorTally.empty()
    key = key_of(Members.HONEST, NOBODY, QUESTIONS[2])
    tally.add(key, SquareSums(2, 16.0, 4.0, 8.0, 4.0))
    both = tally.joined(tally)
    (row,) = error_rows(both, ErrorTally.empty())
    assert row["own_only_rmse_mps"] == pytest.approx(2.0)
    assert row["fleet_rmse_mps"] == pytest.approx(1.0)
    assert row["nees"] == pytest.approx(2.0)
    assert row["count"] == 4
    assert (row["lead_s"], row["averaged_s"], row["where"]) == (150.0, 150.0, NOBODY)
    assert "50 to 50 %" in headline([row])


def beliefs_of(places: list[tuple[float, float]]) -> Beliefs:
    t_s = np.arange(1000.0)
    here = np.stack([np.tile(place, (t_s.size, 1)) for place in places])
    return Beliefs(t_s, here, np.zeros_like(here))


def alert(t_s: float) -> FrontAhead:
    felt = FeltChange("drone-1", t_s, (0.0, 0.0), (8.0, 0.0), (16.0, 0.0), 40.0)
    return made_front(t_s, felt)


def test_an_alert_is_worth_what_was_still_to_come_when_it_was_told() -> None:
    """A front of 12 m/s from the south: felt at 0, 600 and 1200 m some 17 s after it begins."""
    front = PassingFront(500.0, 0.0, 12.0, (8.0, 0.0), 30.0)
    told = beliefs_of([(0.0, 0.0), (600.0, 0.0), (1200.0, 0.0)])
    found = judge_front(front, told, [Alert(alert(530.0))], COAST)
    assert (found.fronts, found.noticed) == (1, 1)
    assert (found.drones_to_warn, found.drones_warned) == (2, 2)
    first_s = 530.0 - found.delays_s[0]
    assert 510.0 < first_s < 525.0
    assert found.leads_s == pytest.approx(
        (first_s + 50.0 - 530.0, first_s + 100.0 - 530.0), abs=1.5
    )
    assert max(map(abs, found.arrival_errors_s)) < 20.0
    late = judge_front(front, told, [Alert(alert(580.0))], COAST)
    assert (late.drones_to_warn, late.drones_warned) == (2, 1)
    assert found.withdrawn == late.withdrawn == 0
    taken_back = judge_front(front, told, [Alert(alert(530.0), 560.0)], COAST)
    assert (taken_back.noticed, taken_back.withdrawn) == (1, 1)
    never = judge_front(front, told, [], COAST)
    assert (never.noticed, never.drones_to_warn, never.drones_warned) == (0, 2, 0)
    weak = PassingFront(500.0, 0.0, 12.0, (2.0, 0.0), 30.0)
    assert judge_front(weak, told, [Alert(alert(530.0))], COAST) == AlertFigures()


def test_news_of_a_front_are_one_alert_that_stands_until_it_is_withdrawn() -> None:
    first, second = alert(530.0), alert(900.0)
    better = replace(first, felt=(*first.felt, replace(first.felt[0], member="drone-2", t_s=541.0)))
    news = [first, better, FrontWithdrawn(better, 562.0), second]
    one, other = alerts_in(news)
    assert (one.front, one.stood_s) == (first, 32.0)
    assert (other.front, other.stood_s) == (second, None)
    told = tuple(front_known(each) for each in news)
    assert [known_s for known_s, _ in told] == [530.0, 541.0, 562.0, 900.0]
    fronts = FrontsOfWorld(told)
    assert fronts.newest(545.0) == better
    assert fronts.newest(570.0) is None
    assert fronts.newest(900.0) == second


def test_a_front_is_told_apart_the_later_the_weaker_it_is_and_never_below_the_gusts() -> None:
    """By hand: the change that chance makes once in 4,800 looks is sqrt(16.95 variance)."""
    told = beliefs_of([(0.0, 0.0), (600.0, 0.0), (1200.0, 0.0)])
    delays = [
        least_delay_s(PassingFront(500.0, 0.0, 12.0, (jump, 0.0), 40.0), told, COAST)
        for jump in (16.0, 9.0, 7.0, 3.5)
    ]
    assert delays == sorted(delays)
    assert math.isfinite(delays[0])
    assert math.isinf(delays[-1])
    looks = 3 * 60.0 * 10.0
    blown = float(np.hypot(*told.winds[0].mean(axis=0)))
    variance = COAST.variance_scale(blown) * chance_m2ps2(COAST) + 0.25
    least_mps = math.sqrt(-2.0 * math.log(1.0 / looks) * variance)
    hardly = PassingFront(500.0, 0.0, 12.0, (0.97 * least_mps, 0.0), 20.0)
    surely = PassingFront(500.0, 0.0, 12.0, (1.1 * least_mps, 0.0), 20.0)
    assert math.isinf(least_delay_s(hardly, told, COAST))
    assert math.isfinite(least_delay_s(surely, told, COAST))


def test_a_wind_is_judged_before_while_and_after_a_front_is_told() -> None:
    """A front of 10 m/s from the south that begins at the middle at 500 s, told 20 s later."""
    real = PassingFront(500.0, 0.0, 10.0, (8.0, 0.0), 30.0)
    told = (200.0, alert(200.0)), (520.0, alert(520.0)), (560.0, alert(560.0))
    fronts = FrontsOfWorld(told, real, told_s=520.0)
    ahead = np.array([1000.0, 0.0])  # it begins there at 600 s
    stages = [
        (200.0, 300.0, FrontStage.NONE),
        (510.0, 660.0, FrontStage.UNTOLD),
        (510.0, 570.0, FrontStage.NONE),
        (530.0, 680.0, FrontStage.TOLD),
        (620.0, 680.0, FrontStage.TOLD),
        (640.0, 700.0, FrontStage.PASSED),
        (1600.0, 1700.0, FrontStage.NONE),
    ]
    for now_s, until_s, stage in stages:
        assert fronts.stage(ahead, now_s, until_s) is stage
    assert fronts.newest(199.0) is None
    newest = fronts.newest(545.0)
    assert newest is not None
    assert newest.noticed_s == 520.0
    assert FrontsOfWorld(fronts.told).stage(ahead, 530.0, 680.0) is FrontStage.NONE


def test_an_alert_of_before_the_front_is_not_of_it() -> None:
    """Two fronts, 350 s apart: only one is judged, and told is what was noticed once it began."""
    drones = patrols(3, 3, 900.0, np.random.default_rng(1))
    rng = np.random.default_rng(2)
    blow = CoherentField(6.0 + 0.3 * rng.standard_normal((900, 2)), Coherence(), rng)
    angle = math.radians(45.0)
    jump = 9.0 * math.cos(angle), 9.0 * math.sin(angle)
    early, real = (PassingFront(t_s, 45.0, 12.0, jump, 30.0) for t_s in (250.0, 600.0))
    truth = SiteWind(blow, [early, real])
    found = fronts_of_world(truth, drones, 899.0, COAST, real, rng)
    first_s = found.told[0][0]
    assert 150.0 < first_s < 400.0, "the earlier one is told, and is not this one"
    assert found.told_s > first_s + 100.0
    assert fronts_of_world(truth, drones, 899.0, COAST, early, rng).told_s < 400.0


def test_hours_with_a_front_are_also_said_by_stage_and_as_they_come() -> None:
    """By hand: a tenth of the winds untold at NEES 22, the rest at 3; ordinary hours at 2."""
    question, ordinary, front = QUESTIONS[3], ErrorTally.empty(), ErrorTally.empty()
    ordinary.add(key_of(Members.HONEST, NOBODY, question), SquareSums(10, 1.0, 1.0, 20.0, 20.0))
    untold, rest = SquareSums(1, 50.0, 50.0, 22.0, 22.0), SquareSums(9, 9.0, 9.0, 27.0, 27.0)
    for stage, sums in ((FrontStage.UNTOLD, untold), (FrontStage.NONE, rest)):
        for key in (stage, FrontStage.WHOLE):
            front.add(key_of(Members.HONEST, NOBODY, question, key), sums)
    rows = stage_rows(ordinary, front)
    assert [row["stage"] for row in rows] == [
        s.value for s in (FrontStage.NONE, FrontStage.UNTOLD, FrontStage.WHOLE)
    ]
    assert [row["share"] for row in rows] == pytest.approx([0.9, 0.1, 1.0])
    assert rows[-1]["nees"] == pytest.approx(4.9)
    assert rows[-1]["all_else_right_nees"] == pytest.approx(0.1 * 22.0 + 0.9 * 2.0)
    assert rows[-1]["as_they_come_nees"] == pytest.approx(0.1 * 4.9 + 0.9 * 2.0)
    assert stage_sheet(rows).rows[-1][-2:] == ["4.00", "2.29"]


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
    result = CliRunner().invoke(app, ["fleet-wind", *words])
    assert isinstance(result.exception, LeewayError)
    assert message in str(result.exception)


def command(folder: Path, *words: str) -> dict[str, Any]:
    """The command's JSON for half an hour of a made field with two drones that hover."""
    short = folder / "field.toml"
    short.write_text(SHIPPED.read_text().replace("seconds = 3600", "seconds = 1800"))
    given = ["--field", str(short), "--drones", "2", "--hovering", "2", "--jobs", "1"]
    given += ["--out", str(folder), "--json", str(folder / "out.json"), *words]
    result = CliRunner().invoke(app, ["fleet-wind", *given], catch_exceptions=False)
    assert result.exit_code == 0
    assert "# Fronts" in result.stdout
    assert (folder / "fleet_wind.png").stat().st_size > 10_000
    assert not list(folder.glob("*.partial"))
    return json.loads((folder / "out.json").read_text())


def test_the_command_judges_a_made_field(tmp_path: Path) -> None:
    one = command(tmp_path, "--draws", "1", "--alert-draws", "1")
    assert {"fronts", "warned", "lead_s_median", "false"} <= set(one["alerts"])
    honest = [r for r in one["error"] if (r["wind"], r["members"]) == ("ordinary", "all honest")]
    assert len(honest) == 2 * len(QUESTIONS)
    assert {row["stage"] for row in one["stages"]} >= {
        FrontStage.WHOLE.value,
        FrontStage.NONE.value,
    }
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
