"""A replay in words, for a terminal."""

from pathlib import Path

from companion.core.replay.flight_replay import ReplayResult
from companion.core.replay.recorded_flight import RecordedFlight
from companion.core.replay.summary import SETTLED_S, WindScore, WindSummary

QUIET = ("looked_again",)
"""Decisions that only the JSON record has."""

MOST_NOTES = 8


def report(
    path: Path,
    log: RecordedFlight,
    airframe: str,
    result: ReplayResult,
    wind: WindSummary | None,
    score: WindScore | None,
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
        f"{path.name}: {kind}; {log.duration_s:.0f} s, {result.air_time_s:.0f} s in the air;"
        f" airframe {airframe}"
    ]
    lines += [f"  ! {finding.since(log.start_s)}" for finding in result.findings]
    notes = result.notes
    lines += [f"  {t_s - log.start_s:9.1f} s  {text}" for t_s, text in notes[:MOST_NOTES]]
    if len(notes) > MOST_NOTES:
        lines.append(f"  and {len(notes) - MOST_NOTES} more such notes (--json has them)")
    lines += _wind(wind, score)
    lines += _decisions(result, log.start_s)
    lines.append(f"{log.duration_s / max(cpu_s, 1e-9):.0f} times real time ({cpu_s:.2f} s of CPU)")
    return lines


def _wind(wind: WindSummary | None, score: WindScore | None) -> list[str]:
    if wind is None:
        return ["wind: nothing in this log tells it"]
    lines = [
        f"wind in flight: mean {wind.mean_speed_mps:.1f} m/s from {wind.mean_from_deg:.0f} deg,"
        f" at most {wind.most_mps:.1f} m/s, known to {wind.mean_std_mps:.1f} m/s (1 sigma)"
    ]
    if score is not None:
        lines.append(
            f"against the reference, from {SETTLED_S:.0f} s in the air on ({score.rows} rows):"
            f" RMSE {score.rmse_mps:.2f} m/s, NEES {score.nees:.1f} (2 is ideal);"
            f" the best constant wind has {score.constant_rmse_mps:.2f} m/s"
        )
    return lines


def _decisions(result: ReplayResult, start_s: float) -> list[str]:
    shown = [d for d in result.decisions if d.kind not in QUIET]
    if not shown:
        return []
    lines = ["what Leeway would have said:"]
    for decision in shown:
        promise = "" if decision.p_home is None else f"  P(home) {decision.p_home:.3f}"
        if decision.margin_wh is not None and decision.p_home is not None:
            promise += f", margin {decision.margin_wh:+.1f} Wh"
        lines.append(
            f"  {decision.t_s - start_s:9.1f} s  {decision.kind}: {decision.reason}{promise}"
        )
    quiet = len(result.decisions) - len(shown)
    if quiet:
        lines.append(f"  and {quiet} looks again as wind or margin moved (--json has them)")
    return lines
