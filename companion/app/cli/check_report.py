"""Text report of `companion check`: missing conditions, settings to change, passed checks."""

from companion.core.base.geo import horizontal_distance_m
from companion.core.mission.preflight_checks import PreflightIssue
from companion.core.pilot.pilot import Pilot


def check_report_lines_and_is_ready(pilot: Pilot) -> tuple[list[str], bool]:
    """Return the report lines, most severe first, and whether the vehicle is ready."""
    preflight = pilot.preflight_report()
    if preflight.abort_reason:
        return [f"MISSING  {preflight.abort_reason}", "NOT READY"], False
    findings = preflight.findings
    labelled = [(_issue_label(issue), issue.words) for issue in findings]
    labelled.sort(key=lambda one: ("MISSING", "WAITING", "WARNING").index(one[0]))
    lines = [f"{label}  {words}" for label, words in labelled]
    met = preflight.settings_met
    if met > 0:
        lines.append(f"ok       {met} autopilot parameters are as required")
    lines += [
        f"note     an earlier flight changed {name}: original value {value:g}, restore with"
        " `companion restore`"
        for name, value in sorted(preflight.unrestored_settings.items())
    ]
    lines += [f"DOUBT    {words}" for words in pilot.monitor_corrections.prefixed_findings]
    lines += _certificate_and_envelope_exit_lines(pilot)
    air = pilot.context.estimates.air
    lines += _battery_lines(pilot) + ([] if air is None else [f"ok       {air}"])
    lines += _route_lines(pilot) + _truck_stop_and_rtl_lines(pilot)
    blocked = any(issue.blocks for issue in findings)
    if any(issue.blocks and issue.name[0].isupper() for issue in findings):
        lines.append("set the MISSING parameters, or fly with --configure (for that flight only)")
    lines.append("NOT READY" if blocked else "READY")
    return lines, not blocked


def reason_no_check_ran(pilot: Pilot) -> str:
    """Return the reason that no check ran."""
    state = pilot.context.telemetry.state
    mode = "" if state is None else f" in {state.mode_name}"
    if pilot.context.telemetry.armed:
        return f"the vehicle is armed{mode}: disarm it on the ground, then check again"
    return f"another controller has the vehicle{mode}: end its control, then check again"


def _issue_label(issue: PreflightIssue) -> str:
    return "WAITING" if issue.waits else "MISSING" if issue.blocks else "WARNING"


def _certificate_and_envelope_exit_lines(pilot: Pilot) -> list[str]:
    """Return certificate, limit of evidence, and where this flight is outside the envelope."""
    estimates, certificate = pilot.context.estimates, pilot.certificate
    lines = [] if certificate is None else [f"ok       certificate: {certificate.summary_text}"]
    words = estimates.evidence.missing_support_text(estimates.limits.max_loss)
    lines.append(
        f"WARNING  {words}" if words else f"ok       evidence: {estimates.evidence.summary_text}"
    )
    return lines + [f"DOUBT    {words}" for words in estimates.envelope_exit_texts]


def _battery_lines(pilot: Pilot) -> list[str]:
    energy = pilot.context.estimates.energy
    if energy is None:
        return []
    return [
        f"ok       battery: {energy.mean_wh:.0f} Wh usable, one sigma {energy.std_wh:.0f} Wh"
        f" (by {energy.source})"
    ]


def _route_lines(pilot: Pilot) -> list[str]:
    if pilot.flight_plan is None:
        return []
    plan, energy = pilot.flight_plan.plan, pilot.context.estimates.energy
    line = (
        f"ok       route: {len(plan.outbound_ned_m)} waypoints out, {len(plan.return_ned_m)} back,"
        f" {plan.energy_wh:.0f} Wh estimated for calm air"
    )
    if pilot.preflight_report().plan_refused or energy is None:
        return [line.replace("ok ", "   ", 1)]
    reserve_wh = pilot.context.estimates.limits.reserve_frac * energy.usable_full_wh
    spare_wh = energy.mean_wh - reserve_wh - plan.energy_wh
    return [f"{line}: {spare_wh:.0f} Wh to spare above the reserve of {reserve_wh:.0f} Wh"]


def _truck_stop_and_rtl_lines(pilot: Pilot) -> list[str]:
    """Return the landing site of a flight to a truck stop, and notes on RTL."""
    flown = pilot.flight_plan
    if flown is None or flown.plan.home is None:
        return []
    plan = flown.plan
    distance_m = horizontal_distance_m(plan.return_route_end_ground_ned_m, plan.depot_ned_m)
    others = ", ".join(stop.name for stop in plan.stops) or "none"
    lines = [
        f"ok       home: {plan.home}, {distance_m:.0f} m from here;"
        f" other stops where it may land if the desk says so in flight: {others}"
    ]
    if plan.away_ned_m:
        lines.append("note     RTL by a failsafe lands here, without truck: keep this pad clear")
    return lines
