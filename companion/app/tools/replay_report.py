"""Text report of a replay, for a terminal."""

from collections import Counter
from pathlib import Path

from companion.analysis.replay.autopilot_faults import autopilot_faults
from companion.analysis.replay.flight_replay import ReplayResult
from companion.analysis.replay.recorded_flight import RecordedFlight
from companion.analysis.replay.summary import MIN_FLIGHT_TIME_S, WindScore, WindSummary
from companion.core.mission.actions import mask_numbers

OMITTED_KINDS = ("looked_again",)
"""Decisions that only the JSON record contains."""

MAX_NOTES, MAX_NOTES_OF_KIND = 20, 2
"""Most notes in all, and of those that differ in numbers only."""


def replay_report_lines(
    log_path: Path,
    log: RecordedFlight,
    airframe_name: str,
    result: ReplayResult,
    wind_summary: WindSummary | None,
    wind_score: WindScore | None,
    cpu_s: float,
) -> list[str]:
    """Return the lines that `companion replay` prints; times are since the log's start."""
    kind = ", ".join(
        word
        for word in (
            log.source,
            log.autopilot_kind.value if log.autopilot_kind is not None else None,
            log.firmware,
            log.vehicle,
        )
        if word
    )
    lines = [
        f"{log_path.name}: {kind}; {log.duration_s:.0f} s, {result.air_time_s:.0f} s in the air;"
        f" airframe {airframe_name}"
    ]
    lines += [
        f"  ! {log_issue.format_with_time_since(log.start_s)}" for log_issue in result.findings
    ]
    kinds, printed = Counter[str](), list[str]()
    for t_s, text in result.notes:
        note_kind = mask_numbers(text)
        kinds[note_kind] += 1
        if kinds[note_kind] <= MAX_NOTES_OF_KIND and len(printed) < MAX_NOTES:
            printed.append(f"  {t_s - log.start_s:9.1f} s  {text}")
    lines += printed
    if len(result.notes) > len(printed):
        lines.append(f"  and {len(result.notes) - len(printed)} more such notes (--json has them)")
    lines += _wind_lines(wind_summary, wind_score)
    lines += _decision_lines(result, log.start_s)
    if faults := autopilot_faults(log):
        lines.append("reported by the autopilot; the margin above assumes an intact vehicle:")
        lines += [f"  {t_s - log.start_s:9.1f} s  {text}" for t_s, text in faults]
    lines.append(f"{log.duration_s / max(cpu_s, 1e-9):.0f} times real time ({cpu_s:.2f} s of CPU)")
    return lines


def _wind_lines(wind_summary: WindSummary | None, wind_score: WindScore | None) -> list[str]:
    if wind_summary is None:
        return ["wind: not observable from this log"]
    lines = [
        f"wind in flight: mean {wind_summary.mean_speed_mps:.1f} m/s from"
        f" {wind_summary.mean_from_deg:.0f} deg,"
        f" at most {wind_summary.most_mps:.1f} m/s, known to {wind_summary.mean_std_mps:.1f} m/s"
        " (1 sigma)"
    ]
    if wind_score is not None:
        lines.append(
            f"against the reference, from {MIN_FLIGHT_TIME_S:.0f} s in the air on"
            f" ({wind_score.rows} rows): RMSE {wind_score.rmse_mps:.2f} m/s, NEES"
            f" {wind_score.nees:.1f} (2 is ideal); the best constant wind has"
            f" {wind_score.constant_rmse_mps:.2f} m/s"
        )
    return lines


def _decision_lines(result: ReplayResult, start_s: float) -> list[str]:
    shown = [d for d in result.decisions if d.kind not in OMITTED_KINDS]
    if not shown:
        return []
    lines = ["decisions of Leeway:"]
    for decision in shown:
        promise = "" if (p_home := decision.p_home_text) is None else f"  P(home): {p_home}"
        if decision.margin_wh is not None and p_home is not None:
            promise += f", margin {decision.margin_wh:+.1f} Wh"
        lines.append(
            f"  {decision.t_s - start_s:9.1f} s  {decision.kind}: {decision.reason}{promise}"
        )
    omitted_count = len(result.decisions) - len(shown)
    if omitted_count:
        lines.append(
            f"  and {omitted_count} re-evaluations on changed wind or margin (--json has them)"
        )
    return lines
