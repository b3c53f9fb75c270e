"""What `fleet-wind` prints, writes and draws."""

import math
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from sim_bridge.research.fleet_wind.alert_study import FALSE_ONCE_IN_H, AlertFigures
from sim_bridge.research.fleet_wind.error_study import (
    NOBODY,
    PLACES,
    QUESTIONS,
    ErrorTally,
    Members,
    Question,
    SquareSums,
    key_of,
)
from sim_bridge.research.fleet_wind.front_bound import LOG_ODDS, AlertBounds
from sim_bridge.research.fleet_wind.front_stages import FrontStage
from sim_bridge.research.fleet_wind.study import DrawResult, FleetWindSetting
from sim_bridge.research.results.sheet import Sheet, interval95

ORDINARY, FRONT = "ordinary", "with a front"
IDEAL_NEES = 2.0
"""Of two axes."""
FRONT_HOURS = 0.1
"""Share of the hours, as missions have it. Stated by us."""
_SHOWN_STAGES = tuple(one for one in QUESTIONS if one.lead_s >= 60.0)
_OF_WHOLE = ("all_else_right_nees", "as_they_come_nees")
_SHOWN_BAD = Question(150.0, True)


def error_rows(ordinary: ErrorTally, front: ErrorTally) -> list[dict[str, Any]]:
    """JSON-safe rows of `error`, in the order of the tables."""
    rows: list[dict[str, Any]] = []
    for wind, tally in ((ORDINARY, ordinary), (FRONT, front)):
        for kind in Members:
            for where in PLACES:
                for question in QUESTIONS:
                    sums = tally.sums.get(key_of(kind, where, question))
                    if sums is not None:
                        rows.append(_error_row(wind, kind, where, question, sums))
    return rows


def _error_row(
    wind: str, kind: Members, where: str, question: Question, sums: SquareSums
) -> dict[str, Any]:
    return {
        "wind": wind,
        "members": kind.value,
        "lead_s": question.lead_s,
        "averaged_s": question.averaged_s,
        "where": where,
        "own_only_rmse_mps": sums.own_rmse_mps,
        "fleet_rmse_mps": sums.fleet_rmse_mps,
        "nees": sums.fleet_nees / sums.count,
        "own_only_nees": sums.own_nees / sums.count,
        "count": sums.count,
    }


def stage_rows(ordinary: ErrorTally, front: ErrorTally) -> list[dict[str, Any]]:
    """JSON-safe rows of `stages`: hours with a front, by what was known of it; and as they come."""
    rows: list[dict[str, Any]] = []
    for where in PLACES:
        for question in _SHOWN_STAGES:
            whole = front.sums.get(key_of(Members.HONEST, where, question))
            calm = ordinary.sums.get(key_of(Members.HONEST, where, question))
            if whole is None or calm is None:
                continue
            others_right = IDEAL_NEES
            for stage in (FrontStage.NONE, FrontStage.UNTOLD, FrontStage.TOLD, FrontStage.PASSED):
                sums = front.sums.get(key_of(Members.HONEST, where, question, stage))
                if sums is not None:
                    row = _error_row(FRONT, Members.HONEST, where, question, sums)
                    share = sums.count / whole.count
                    rows.append(row | {"stage": stage.value, "share": share})
                    if stage is FrontStage.UNTOLD:
                        others_right = share * row["nees"] + (1.0 - share) * IDEAL_NEES
            come = FRONT_HOURS * whole.fleet_nees / whole.count
            come += (1.0 - FRONT_HOURS) * calm.fleet_nees / calm.count
            rows.append(
                _error_row(FRONT, Members.HONEST, where, question, whole)
                | {"stage": FrontStage.WHOLE.value, "share": 1.0, "as_they_come_nees": come}
                | {"all_else_right_nees": others_right}
            )
    return rows


def stage_sheet(rows: list[dict[str, Any]]) -> Sheet:
    """Hours with a front by what was known of it, all members honest."""
    head = ["where", "what", "of the front", "share", "own data, m/s", "fleet, m/s", "NEES own",
            "NEES fleet", "all else right", "as they come"]  # fmt: skip
    cells: list[list[str]] = []
    for row in rows:
        own, fleet, _, *nees = _figures(row)
        whole = [
            f"{row[k]:.2f}" if k in row else ""
            for k in ("all_else_right_nees", "as_they_come_nees")
        ]
        share = f"{100.0 * row['share']:.0f} %"
        cells.append([*_words(row)[1:], row["stage"], share, own, fleet, *nees, *whole])
    note = (
        "All else right: NEES of the whole hour for a fleet that knows nothing of a front before it"
        f" is told, and whose covariance is right ({IDEAL_NEES:g}) everywhere else. As they come:"
        " one hour in ten has a front. Own data knows of no front that is told."
    )
    return Sheet("Hours with a front, by what was known of it", head, cells, note)


def alert_row(alerts: AlertFigures) -> dict[str, Any]:
    """JSON-safe `alerts`; unknown is None."""
    return {
        "fronts": alerts.fronts,
        "warned": alerts.noticed,
        "lead_s_median": _quantile(alerts.leads_s, 0.5),
        "false": alerts.false,
        "hours_without_fronts": alerts.hours,
        "false_withdrawn": len(alerts.false_for_s),
        "false_for_s_median": _quantile(alerts.false_for_s, 0.5),
        "fronts_withdrawn": alerts.withdrawn,
        "drones_to_warn": alerts.drones_to_warn,
        "drones_warned": alerts.drones_warned,
        "delay_s_median": _quantile(alerts.delays_s, 0.5),
        "delay_s_p90": _quantile(alerts.delays_s, 0.9),
        "least_delay_s_median": _median_of_all(alerts.least_delays_s, alerts.never_told_apart),
        "least_delay_never": alerts.never_told_apart,
        "arrival_error_s_median": _quantile(tuple(map(abs, alerts.arrival_errors_s)), 0.5),
        "arrival_error_s_p90": _quantile(tuple(map(abs, alerts.arrival_errors_s)), 0.9),
    }


def _quantile(values: tuple[float, ...], share: float) -> float | None:
    return float(np.quantile(values, share)) if values else None


def _median_of_all(values: tuple[float, ...], never: int) -> float | None:
    """With so many more that are never; None: so is the median."""
    found = sorted([*values, *[math.inf] * never])
    median = found[(len(found) - 1) // 2] if found else math.inf
    return median if math.isfinite(median) else None


def error_sheet(
    results: list[DrawResult], rows: list[dict[str, Any]], setting: FleetWindSetting
) -> Sheet:
    """Own data only against the fleet, all members honest."""
    cells: list[list[str]] = []
    for row in rows:
        if row["members"] == Members.HONEST.value:
            low, high = _gain_interval(results, row)
            cells.append([*_words(row), *_figures(row), f"{low:.0f} to {high:.0f}"])
    head = ["wind", "where", "what", "own data, m/s", "fleet, m/s", "better by", "95 %",
            "NEES own", "NEES fleet"]  # fmt: skip
    cells = [[*c[:6], c[8], *c[6:8]] for c in cells]
    judged = sum(bool(one.ordinary.sums) for one in results)
    note = (
        f"RMSE by component; NEES of two axes, ideal 2. {judged} fields, {setting.drones} drones,"
        f" {setting.hovering} of them hover; 10 s beliefs off by 0.5 m/s, told every 10 s. Truth:"
        f" Davenport's decay {setting.along:g} along and {setting.across:g} across; the belief"
        " assumes 4 and 13 in another form. Interval of the gain in %, over fields."
    )
    return Sheet("The wind known by one, and by the fleet", head, cells, note)


def member_sheet(rows: list[dict[str, Any]], ordinary: ErrorTally) -> Sheet:
    """The fleet with one bad member, judged by the others."""
    cells: list[list[str]] = []
    for row in rows:
        shown = row["lead_s"] == _SHOWN_BAD.lead_s and row["averaged_s"] == _SHOWN_BAD.averaged_s
        if row["wind"] == ORDINARY and shown:
            name = row["members"]
            settled, out = ordinary.settled[name], ordinary.left_out[name]
            cells.append([name, row["where"], *_figures(row)[:3], f"{out / settled:.3f}"])
    head = ["members", "where", "own data, m/s", "fleet, m/s", "better by", "left out"]
    note = (
        f"Mean wind of the next {_SHOWN_BAD.lead_s:g} s, as above, judged by the honest ones. The"
        " liar adds 5.8 m/s from ten minutes on. Left out: members in the mean belief."
    )
    return Sheet("One member that lies, is frozen or mute", head, cells, note)


def alert_sheet(alerts: AlertFigures) -> Sheet:
    """Fronts told ahead."""
    row = alert_row(alerts)
    cells = [
        ["fronts that somebody felt", f"{alerts.fronts}"],
        ["of these told", f"{alerts.noticed}"],
        ["drones that it had not reached when the first one felt it", f"{alerts.drones_to_warn}"],
        ["of these told before", f"{alerts.drones_warned}"],
        ["time before, median s", _shown(row["lead_s_median"])],
        ["from the first one's feeling it to the alert, median s", _shown(row["delay_s_median"])],
        ["the same, 90 % s", _shown(row["delay_s_p90"])],
        ["least delay of a test of one drone alone, median s", _shown(row["least_delay_s_median"])],
        ["fronts that such a test never tells from gusts", f"{row['least_delay_never']}"],
        ["error of the arrival first told, median s", _shown(row["arrival_error_s_median"])],
        ["the same, 90 % s", _shown(row["arrival_error_s_p90"])],
        ["alerts withdrawn though there was a front", f"{alerts.withdrawn}"],
        ["false alerts without a front", f"{alerts.false} in {alerts.hours:.1f} h"],
        ["of these withdrawn", f"{len(alerts.false_for_s)}"],
        ["they stood for, median s", _shown(row["false_for_s_median"])],
    ]
    note = (
        "A front is felt where the 10 s mean has changed by 3 m/s because of it. The least delay is"
        " of a test that knows the front's own change without noise, in Gaussian gusts, with one"
        f" false alert in {FALSE_ONCE_IN_H:g} h."
    )
    return Sheet("Fronts", ["what", "figure"], cells, note)


def bound_rows(alerts: AlertFigures, bounds: AlertBounds) -> list[dict[str, Any]]:
    """JSON-safe rows of `bounds`: the fleet's watch and ideal tests, over the same fronts."""
    rows = [
        _bound_row("the fleet's watch", None, alerts.delays_s, alerts.fronts, alerts.false)
        | {"hours_without_fronts": alerts.hours}
    ]
    each = (
        ("ideal, knows how fronts are drawn", bounds.law_known),
        ("ideal, knows this front but its time", bounds.front_known),
    )
    for who, found in each:
        for k, limit in enumerate(LOG_ODDS):
            fronts = len(found.delays_s[k]) + found.missed[k]
            row = _bound_row(who, limit, found.delays_s[k], fronts, found.false[k])
            rows.append(row | {"hours_without_fronts": found.hours})
    return rows


def _bound_row(
    who: str, log_odds: float | None, delays_s: tuple[float, ...], fronts: int, false: int
) -> dict[str, Any]:
    return {
        "who": who,
        "log_odds": log_odds,
        "fronts": fronts,
        "told": len(delays_s),
        "delay_s_median": _quantile(delays_s, 0.5),
        "delay_s_p90": _quantile(delays_s, 0.9),
        "false": false,
    }


def bound_sheet(rows: list[dict[str, Any]]) -> Sheet:
    """How soon a front could be told at all."""
    head = ["who", "from odds", "told", "from 3 m/s to the alert, s", "90 %, s", "false alerts",
            "in 10 h, 95 %"]  # fmt: skip
    cells: list[list[str]] = []
    for row in rows:
        odds, hours = row["log_odds"], row["hours_without_fronts"]
        low, high = _counted(row["false"])
        cells.append([
            row["who"],
            "" if odds is None else f"e^{odds:g}",
            f"{row['told']} of {row['fronts']}",
            _shown(row["delay_s_median"]),
            _shown(row["delay_s_p90"]),
            f"{row['false']} in {hours:.1f} h",
            f"{10.0 * low / hours:.1f} to {10.0 * high / hours:.1f}",
        ])  # fmt: skip
    note = (
        "The same fronts and tellings. An ideal test knows the covariance of the wind and of what"
        " is told; its odds are the mean of the likelihood ratios of all times at which a front may"
        " have begun (Shiryaev-Roberts), looked at every 2 s. Gusts of the recording itself, in the"
        " middle, are not Gaussian."
    )
    return Sheet("How soon a front could be told at all", head, cells, note)


def _counted(count: int) -> tuple[float, float]:
    """95 % of a Poisson count's mean (Garwood, Biometrika 28, 1936)."""
    low = float(chi2.ppf(0.025, 2 * count)) / 2.0 if count else 0.0
    return low, float(chi2.ppf(0.975, 2 * count + 2)) / 2.0


def _shown(value: float | None) -> str:
    return "" if value is None else f"{value:.0f}"


def _words(row: dict[str, Any]) -> list[str]:
    lead, averaged = row["lead_s"], row["averaged_s"]
    what = "now" if lead == 0.0 else f"in {lead:g} s" if averaged < lead else f"next {lead:g} s"
    return [row["wind"], row["where"], what]


def _figures(row: dict[str, Any]) -> list[str]:
    own, fleet = row["own_only_rmse_mps"], row["fleet_rmse_mps"]
    return [
        f"{own:.2f}",
        f"{fleet:.2f}",
        f"{100.0 * (1.0 - fleet / own):.1f} %",
        f"{row['own_only_nees']:.2f}",
        f"{row['nees']:.2f}",
    ]


def _gain_interval(results: list[DrawResult], row: dict[str, Any]) -> tuple[float, float]:
    """95 % interval of the mean over fields of each field's own gain, %."""
    gains: list[float] = []
    for one in results:
        tally = one.ordinary if row["wind"] == ORDINARY else one.front
        for question in QUESTIONS:
            asked = question.lead_s == row["lead_s"] and question.averaged_s == row["averaged_s"]
            sums = tally.sums.get(key_of(Members.HONEST, row["where"], question))
            if asked and sums is not None:
                gains.append(100.0 * (1.0 - sums.fleet_rmse_mps / sums.own_rmse_mps))
    return interval95(gains)


def as_document(setting: FleetWindSetting, whole: DrawResult) -> dict[str, Any]:
    """The command's JSON."""
    ordinary, front, alerts = whole.ordinary, whole.front, whole.alerts
    bounds = {"bounds": bound_rows(alerts, whole.bounds)} if whole.bounds.law_known.hours else {}
    return bounds | {
        "format": "fleet-wind/1",
        "drones": setting.drones,
        "hovering": setting.hovering,
        "coherence": {"along": setting.along, "across": setting.across},
        "seed": setting.seed,
        "error": error_rows(ordinary, front),
        "stages": stage_rows(ordinary, front),
        "alerts": alert_row(alerts),
    }


def draw_field(path: Path, setting: FleetWindSetting) -> None:
    """The field believed beside the field that was, at one moment of the first draw."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    from sim_bridge.research.fleet_wind.moment import field_moment

    seen = field_moment(setting)
    figure, axes = plt.subplots(
        1, 3, figsize=(11.0, 3.9), sharex=True, sharey=True, layout="constrained"
    )
    most = max(float(seen.speed_mps(wind).max()) for wind in (seen.actual, seen.believed))
    least = min(float(seen.speed_mps(wind).min()) for wind in (seen.actual, seen.believed))
    titles = ("the field that was", "the field believed", "known by one drone (x) alone")
    for axis, title, wind in zip(
        axes, titles, (seen.actual, seen.believed, seen.alone), strict=True
    ):
        axis.pcolormesh(
            seen.east_m, seen.north_m, seen.speed_mps(wind), vmin=least, vmax=most, cmap="viridis"
        )
        step = slice(None, None, 3)
        axis.quiver(
            seen.east_m[step],
            seen.north_m[step],
            wind[step, step, 1],
            wind[step, step, 0],
            color="white",
            scale=250.0,
        )
        axis.plot(seen.drones[:, 1], seen.drones[:, 0], "o", color="tab:red", markersize=4)
        axis.plot(seen.drones[:1, 1], seen.drones[:1, 0], "x", color="black", markersize=9)
        axis.set_title(title)
        axis.set_xlabel("east, m")
        axis.set_aspect("equal")
    axes[0].set_ylabel("north, m")
    label = "wind over the next minute, m/s"
    figure.colorbar(axes[0].collections[0], ax=axes, label=label, shrink=0.85)
    figure.savefig(path, dpi=100)
    plt.close(figure)


def headline(rows: list[dict[str, Any]]) -> str:
    """One line: means where nobody flies."""
    gains = [
        100.0 * (1.0 - row["fleet_rmse_mps"] / row["own_only_rmse_mps"])
        for row in rows
        if row["where"] == NOBODY
        and row["members"] == Members.HONEST.value
        and row["wind"] == ORDINARY
        and row["averaged_s"] == row["lead_s"]
    ]
    return f"means of 60 to 300 s where nobody is: {min(gains):.0f} to {max(gains):.0f} % better"
