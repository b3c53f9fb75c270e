"""Study of `fleet-wind`: drawn fields, each with ordinary wind and with a front."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim_bridge.research.fleet_wind.errors import (
    ALL_CORRECT_ONLY,
    FORECAST_QUANTITIES,
    POSITION_KINDS,
    ErrorSums,
    FleetComposition,
    ForecastQuantity,
    error_sums_key,
    merge_error_sums,
    simulate_and_sum_wind_errors,
)
from sim_bridge.research.fleet_wind.fields import FleetWindSetting, draw_field, read_cases
from sim_bridge.research.fleet_wind.fronts import (
    AlertStatistics,
    detect_front_updates,
    draw_mean_wind_reports,
    evaluate_front_alerts,
    first_detection_of_each_front,
    simulate_detected_fronts,
)
from sim_bridge.research.fleet_wind.missions import (
    MissionSetting,
    MissionsFlown,
    evaluate_missions,
    fly_missions_under_each_policy,
    split_missions_into_work_items,
)
from sim_bridge.research.study.intervals import bootstrap_mean_interval95
from sim_bridge.research.study.run import Experiment, ExperimentRun, Report
from sim_bridge.research.study.sheet import Column, Sheet, format_optional, low_to_high
from sim_bridge.truth.fields.coherent_field import Coherence

ORDINARY, FRONT = "ordinary", "with a front"


@dataclass(frozen=True, slots=True)
class FieldDraw:
    """One draw: wind case (half of a recording), and the quantities to evaluate."""

    setting: FleetWindSetting
    case: int
    number: int
    errors: bool
    alerts: bool


@dataclass(frozen=True, slots=True)
class DrawResult:
    """Results of one draw."""

    ordinary: ErrorSums
    front: ErrorSums
    alerts: AlertStatistics


def evaluate_fleet_wind(
    setting: FleetWindSetting,
    error_draw_count: int,
    alert_draw_count: int,
    missions: MissionSetting,
    run: ExperimentRun,
) -> Report:
    """Evaluate the draws of each case, and the missions if any; return tables and JSON."""
    work = [
        FieldDraw(setting, case, k, k < error_draw_count, k < alert_draw_count)
        for k in range(max(error_draw_count, alert_draw_count))
        for case in range(len(read_cases(setting)))
    ]
    results = run.run_cases_and_return_results(
        Experiment("fields", work, evaluate_field_draw, DrawResult)
    )
    alerts = sum((one.alerts for one in results), AlertStatistics())
    rows = error_sums_to_json_rows(
        merge_error_sums([r.ordinary for r in results]),
        merge_error_sums([r.front for r in results]),
    )
    coherence = read_cases(setting)[0].coherence
    sheets: dict[str, Sheet] = {}
    if rows:
        sheets["error"] = _error_sheet(results, rows, setting, coherence)
        sheets["members"] = _faulty_member_sheet(rows)
    if alerts.fronts:
        sheets["alerts"] = _alert_sheet(alerts)
    document = {
        "format": "fleet-wind/1",
        "drones": setting.drones,
        "hovering": setting.hovering,
        "coherence": {"along": coherence.longitudinal, "across": coherence.across},
        "seed": setting.seed,
        "error": rows,
        "alerts": alert_statistics_to_json(alerts),
    }
    if missions.missions:
        flown = run.run_cases_and_return_results(
            Experiment(
                "missions",
                split_missions_into_work_items(missions),
                fly_missions_under_each_policy,
                MissionsFlown,
            )
        )
        sheets["missions"], results_of_missions = evaluate_missions(flown, missions)
        document |= results_of_missions
    return Report(sheets, document)


def evaluate_field_draw(draw: FieldDraw) -> DrawResult:
    """Evaluate one field: errors in ordinary wind and with a front, alerts with and without one."""
    drawn = draw_field(draw.setting, draw.case, draw.number)
    rng = drawn.rng
    sums: list[ErrorSums] = [{}, {}]
    if draw.errors:
        known_fronts = [
            simulate_detected_fronts(drawn, rng.spawn(1)[0], with_front=front)
            for front in (False, True)
        ]
        for front, compositions in ((False, tuple(FleetComposition)), (True, ALL_CORRECT_ONLY)):
            world = drawn.draw_world_with_reports(rng, with_front=front)
            sums[front] = simulate_and_sum_wind_errors(
                world, rng, compositions, known_fronts[front]
            )
    alerts = AlertStatistics()
    for front in (False, True) if draw.alerts else ():
        wind_reports = draw_mean_wind_reports(drawn, rng, with_front=front)
        found = first_detection_of_each_front(detect_front_updates(wind_reports, drawn))
        alerts += (
            evaluate_front_alerts(drawn.front, wind_reports, found)
            if front
            else AlertStatistics(  # every alert is false
                false_alerts=len(found), hours=float(np.ptp(wind_reports.t_s)) / 3600.0
            )
        )
    return DrawResult(sums[False], sums[True], alerts)


def error_sums_to_json_rows(ordinary: ErrorSums, front: ErrorSums) -> list[dict[str, Any]]:
    """Return the JSON rows of `error`, in the order of the tables."""
    return [
        {
            "wind": wind,
            "members": composition.value,
            "lead_s": quantity.lead_s,
            "averaged_s": quantity.averaged_s,
            "where": where,
            "own_only_rmse_mps": sums.own_rmse_mps,
            "fleet_rmse_mps": sums.fleet_rmse_mps,
            "nees": sums.fleet_nees / sums.count,
            "own_only_nees": sums.own_nees / sums.count,
            "count": sums.count,
        }
        for wind, by_key in ((ORDINARY, ordinary), (FRONT, front))
        for composition in FleetComposition
        for where in POSITION_KINDS
        for quantity in FORECAST_QUANTITIES
        if (sums := by_key.get(error_sums_key(composition, where, quantity))) is not None
    ]


def alert_statistics_to_json(alerts: AlertStatistics) -> dict[str, Any]:
    """Return the JSON object of `alerts`; unknown is None."""
    return {
        "fronts": alerts.fronts,
        "warned": alerts.reported,
        "lead_s_median": _quantile_or_none(alerts.lead_times_s, 0.5),
        "false": alerts.false_alerts,
        "hours_without_fronts": alerts.hours,
        "drones_to_warn": alerts.drones_to_warn,
        "drones_warned": alerts.drones_warned,
        "delay_s_median": _quantile_or_none(alerts.delays_s, 0.5),
        "delay_s_p90": _quantile_or_none(alerts.delays_s, 0.9),
    }


def _quantile_or_none(values: tuple[float, ...], share: float) -> float | None:
    return float(np.quantile(values, share)) if values else None


_RMSE_AND_GAIN: dict[str, Column] = {
    "own data, m/s": "{0[own_only_rmse_mps]:.2f}",
    "fleet, m/s": "{0[fleet_rmse_mps]:.2f}",
    "better by": lambda row: (
        f"{100.0 * (1.0 - row['fleet_rmse_mps'] / row['own_only_rmse_mps']):.1f} %"
    ),
}


def _error_sheet(
    results: Sequence[DrawResult],
    rows: list[dict[str, Any]],
    setting: FleetWindSetting,
    coherence: Coherence,
) -> Sheet:
    """Return the table of own data against fleet data, with all members correct."""
    columns: dict[str, Column] = {
        "wind": "{0[wind]}",
        "where": "{0[where]}",
        "what": _lead_time_text,
        **_RMSE_AND_GAIN,
        "95 %": lambda row: low_to_high(
            bootstrap_mean_interval95(_gains_percent(results, row), np.random.default_rng(0)), ".0f"
        ),
        "NEES own": "{0[own_only_nees]:.2f}",
        "NEES fleet": "{0[nees]:.2f}",
    }
    note = (
        f"RMSE by component; NEES of two axes, ideal 2."
        f" {sum(bool(one.ordinary) for one in results)} fields, {setting.drones} drones,"
        f" {setting.hovering} of them hover; 10 s means with 0.5 m/s of error, reported every 10 s."
        f" Truth: Davenport's decay {coherence.longitudinal:g} along and"
        f" {coherence.across:g} across; the"
        " estimate assumes 4 and 13 in another form. Interval of the gain in %, over fields."
    )
    correct = [row for row in rows if row["members"] == FleetComposition.ALL_CORRECT.value]
    return Sheet.from_objects("The wind known by one, and by the fleet", correct, columns, note)


def _faulty_member_sheet(rows: list[dict[str, Any]]) -> Sheet:
    """Return the table of the fleet with one faulty member, evaluated by the others."""
    key = ORDINARY, 150.0, 150.0
    return Sheet.from_objects(
        "One member with false data, frozen or silent",
        [row for row in rows if (row["wind"], row["lead_s"], row["averaged_s"]) == key],
        {"members": "{0[members]}", "where": "{0[where]}", **_RMSE_AND_GAIN},
        "Mean wind of the next 150 s, as above, evaluated by the other drones. The drone that"
        " reports false data adds 5.8 m/s from ten minutes on.",
    )


def _alert_sheet(alerts: AlertStatistics) -> Sheet:
    """Return the table of front alerts."""
    row = alert_statistics_to_json(alerts)
    cells = [
        ["fronts that a drone felt", f"{alerts.fronts}"],
        ["of these reported", f"{alerts.reported}"],
        ["drones that it had not reached when the first one felt it", f"{alerts.drones_to_warn}"],
        ["of these warned before", f"{alerts.drones_warned}"],
        ["time before, median s", format_optional(row["lead_s_median"], ".0f")],
        [
            "from the first one's feeling it to the alert, median s",
            format_optional(row["delay_s_median"], ".0f"),
        ],
        ["the same, 90 % s", format_optional(row["delay_s_p90"], ".0f")],
        ["false alerts without a front", f"{alerts.false_alerts}"],
        ["hours without a front", f"{alerts.hours:.1f}"],
    ]
    note = "A front is felt where the 10 s mean has changed by 3 m/s because of it."
    return Sheet("Fronts", ["what", "figure"], cells, note)


def _lead_time_text(row: dict[str, Any]) -> str:
    lead, averaged = row["lead_s"], row["averaged_s"]
    return "now" if lead == 0.0 else f"in {lead:g} s" if averaged < lead else f"next {lead:g} s"


def _gains_percent(results: Sequence[DrawResult], row: dict[str, Any]) -> list[float]:
    """Return the gain in each field, %."""
    quantity = ForecastQuantity(row["lead_s"], row["averaged_s"] == row["lead_s"])
    key = error_sums_key(FleetComposition.ALL_CORRECT, row["where"], quantity)
    each = [(r.ordinary if row["wind"] == ORDINARY else r.front).get(key) for r in results]
    return [100.0 * (1.0 - one.fleet_rmse_mps / one.own_rmse_mps) for one in each if one]
