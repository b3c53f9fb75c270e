"""`companion check` as its user reads it: what is missing, what to set, what is well."""

from companion.core.base.geo import horizontal_m
from companion.core.mission.preflight_checks import Finding
from companion.core.pilot.pilot import Pilot


def report(pilot: Pilot) -> tuple[list[str], bool]:
    """The lines of the finished check, worst first, and whether the vehicle is ready."""
    preflight = pilot.preflight()
    if preflight.gave_up:
        return [f"MISSING  {preflight.gave_up}", "NOT READY"], False
    findings = preflight.findings
    lines = [f"{_word(finding)}  {finding.words}" for finding in sorted(findings, key=_rank)]
    met = preflight.settings_met
    if met > 0:
        lines.append(f"ok       {met} settings of the autopilot are as the promise needs them")
    lines += [
        f"note     an earlier flight changed {name}: the vehicle's own is {value:g}, put back by"
        " `companion restore`"
        for name, value in sorted(preflight.settings_left.items())
    ]
    lines += [f"DOUBT    {words}" for words in pilot.doubts.words]
    lines += _certificate(pilot)
    lines += _battery(pilot) + _air(pilot) + _route(pilot) + _home(pilot)
    blocked = any(finding.blocks for finding in findings)
    if any(finding.blocks and finding.name[0].isupper() for finding in findings):
        lines.append("set them yourself, or fly with --configure: it sets them for the flight only")
    lines.append("NOT READY" if blocked else "READY")
    return lines, not blocked


def why_not_checked(pilot: Pilot) -> str:
    """Why a check has ended before its first finding."""
    state = pilot.telemetry.state
    mode = "" if state is None else f" in {state.mode_name}"
    if pilot.telemetry.armed:
        return f"the vehicle is armed{mode}: it is checked disarmed, on the ground"
    return f"somebody else has the vehicle{mode}: nothing was checked"


def _word(finding: Finding) -> str:
    return "WAITING" if finding.waits else "MISSING" if finding.blocks else "off    "


def _rank(finding: Finding) -> int:
    return ("MISSING", "WAITING", "off    ").index(_word(finding))


def _certificate(pilot: Pilot) -> list[str]:
    """What recorded days support of the draw, and where this flight is not among them."""
    certificate = pilot.certificate
    if certificate is None:
        return []
    lines = [f"ok       certificate: {certificate.statement}"]
    if words := certificate.support_of(pilot.estimates.limits.max_loss):
        lines.append(f"note     certificate: {words}")
    return lines + [f"DOUBT    {words}" for words in pilot.estimates.outside_envelope]


def _battery(pilot: Pilot) -> list[str]:
    energy = pilot.estimates.energy
    if energy is None:
        return []
    return [
        f"ok       battery: {energy.mean_wh:.0f} Wh usable, one sigma {energy.std_wh:.0f} Wh"
        f" (by {energy.source})"
    ]


def _air(pilot: Pilot) -> list[str]:
    air = pilot.estimates.air
    return [] if air is None else [f"ok       {air}"]


def _route(pilot: Pilot) -> list[str]:
    if pilot.flight_plan is None:
        return []
    plan, energy = pilot.flight_plan.plan, pilot.estimates.energy
    line = (
        f"ok       route: {len(plan.outbound_ned_m)} waypoints out, {len(plan.return_ned_m)} back,"
        f" {plan.energy_wh:.0f} Wh in calm air as believed"
    )
    if pilot.preflight().plan_refused or energy is None:
        return [line.replace("ok ", "   ", 1)]
    reserve_wh = pilot.estimates.limits.reserve_frac * energy.usable_full_wh
    spare_wh = energy.mean_wh - reserve_wh - plan.energy_wh
    return [f"{line}: {spare_wh:.0f} Wh to spare above the reserve of {reserve_wh:.0f} Wh"]


def _home(pilot: Pilot) -> list[str]:
    """Where a flight to a promised stop ends, and what is no promise."""
    if pilot.flight_plan is None or pilot.flight_plan.plan.home is None:
        return []
    plan = pilot.flight_plan.plan
    away_m = horizontal_m(plan.landing_ned_m, plan.depot_ned_m)
    others = ", ".join(stop.name for stop in plan.stops) or "none"
    lines = [
        f"ok       home: {plan.home}, {away_m:.0f} m from here;"
        f" other stops aboard, to be promised in flight: {others}"
    ]
    if plan.away_ned_m:
        lines.append("note     a failsafe's RTL comes back here, where nobody promises to be")
    return lines
