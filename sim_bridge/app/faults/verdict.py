"""Rules for a flight or small day under a fault, checked by truth, messages and commands."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from companion.core.mission.alerts import Alert, parse_alert_text
from ground_station.core.schema.orders import AssignmentRow
from sim_bridge.app.day import rules
from sim_bridge.app.day.drone import DayDrone
from sim_bridge.app.day.judge import find_flight_sample_ranges as flights_of
from sim_bridge.app.flight.stage import FaultContext, describe_missing_effects
from sim_bridge.app.world.safety_rules import find_energy_rise_after_takeoff

EXIT_INTERNAL_ERROR, EXIT_USAGE_ERROR = 1, 2
"""Exit codes of the companion: internal error, invalid options or files."""


@dataclass(frozen=True, slots=True)
class FlownDay:
    """A small day that has ended: result row by truth, drones, run folder, stored assignments."""

    row: dict[str, Any]
    drones: list[DayDrone]
    folder: Path
    assignments: Sequence[AssignmentRow]


@dataclass(frozen=True, slots=True)
class FaultRunResult:
    """A flight or a small day that has ended.

    `row`: the flight by truth; in a day, the flight of the drone with the fault. `messages`:
    messages to the operator or dispatcher with their times. `traceback_count`: in all printed
    and logged text.
    """

    row: dict[str, Any]
    stage: FaultContext
    messages: list[tuple[float, str]]
    traceback_count: int = 0
    p_home_last_go: float | None = None
    day: FlownDay | None = None

    @property
    def message_texts(self) -> list[str]:
        """Message texts in order, without times."""
        return [text for _, text in self.messages]

    @property
    def alerts(self) -> list[tuple[float, Alert, dict[str, str]]]:
        """The companion's alerts with their times and parameters, in order."""
        found = ((at_s, parse_alert_text(text)) for at_s, text in self.messages)
        return [(at_s, *one) for at_s, one in found if one is not None]

    @property
    def command_count_after_takeover(self) -> int:
        """Number of commands sent after the companion could know of the takeover."""
        if self.day is not None:
            return len(self.day.row["commands_after_take_over"])
        if self.stage.craft_and_lockstep is None:
            return 0  # an exception ended the run of a day
        return len(self.stage.craft.link.late_commands)


def p_home_of_last_go_decision(decisions: Iterable[tuple[str, float | None]]) -> float | None:
    """Return P(home) at the last decision to continue outbound; `decisions`: kind, P(home)."""
    go_kinds = ("go", "onward", "descend")
    found = [p_home for kind, p_home in decisions if kind in go_kinds and p_home is not None]
    return found[-1] if found else None


Rule = Callable[[FaultRunResult], str | None]
"""Returns a short text that describes the violation, or None or "" if the rule holds."""


def check_no_exceptions(flown: FaultRunResult) -> str | None:
    """Check that no exception was raised."""
    return f"{flown.traceback_count} exceptions" if flown.traceback_count else None


def check_no_error_exit_code(flown: FaultRunResult) -> str | None:
    """Check that the companion ended without an internal or usage error."""
    code = flown.stage.craft.companion.exit_code
    return f"exit code {code}" if code in (EXIT_INTERNAL_ERROR, EXIT_USAGE_ERROR) else None


def check_energy_never_rises(flown: FaultRunResult) -> str:
    """Check by the companion's record that its energy estimate never rises after take-off."""
    record = flown.stage.craft.companion.read_result_json_or_empty()
    return find_energy_rise_after_takeoff(record.get("decisions", []), record.get("energy", []))


def check_returned_home(flown: FaultRunResult) -> str | None:
    """Check by truth for a landing with the reserve at the depot, a rally point or the stop."""
    has_crashed = flown.stage.craft.vehicle.is_crashed
    if flown.row["home"] and not has_crashed:
        return None
    crashed = ", crashed" if has_crashed else ""
    return f"not home ({flown.row['outcome']}, {flown.row['margin_wh']:+.1f} Wh{crashed})"


def check_delivered(flown: FaultRunResult) -> str | None:
    """Check that the parcel was delivered despite the fault."""
    return None if flown.row["delivered"] else "not delivered"


def check_no_false_delivery(flown: FaultRunResult) -> str | None:
    """Check that the companion did not report a delivery while the parcel was attached."""
    if flown.row["delivered"]:
        return None
    is_delivery_reported = any(alert is Alert.DELIVERED for _, alert, _ in flown.alerts)
    return "delivery reported, parcel still attached" if is_delivery_reported else None


def check_fault_took_effect(flown: FaultRunResult) -> str | None:
    """Check that the fault began and that its injection took effect
    (`sim_bridge.app.flight.stage`): a flight that ends earlier, or without it, proves nothing.
    """
    if flown.stage.start_s is None:
        return "the fault never started"
    missing = describe_missing_effects(flown.stage)
    return f"the fault took no effect: {missing}" if missing else None


def check_no_commands_after_takeover(flown: FaultRunResult) -> str | None:
    """Check that no command was sent after a takeover."""
    link = flown.stage.craft.link
    return "no takeover happened" if link.takeover is None else link.late_commands_text


def check_control_retained(flown: FaultRunResult) -> str | None:
    """Check that the companion kept control to the end: it inferred no false takeover."""
    release_parameters = [
        given for _, alert, given in flown.alerts if alert is Alert.CONTROL_RELEASED
    ]
    return (
        f"released control ({release_parameters[0]['reason']}) without a takeover"
        if release_parameters
        else None
    )


def check_landed_intact_by_pilot(flown: FaultRunResult) -> str | None:
    """Check that a person landed it undamaged, by truth and by the companion's own verdict."""
    return _outcome_issue(flown, ("TAKEN",))


def check_landed_intact_by_pilot_anywhere(flown: FaultRunResult) -> str | None:
    """Check as above, also at home: a return in both, whether or not the delivery is known."""
    at_home = ("ABRT", "SUC")
    return _outcome_issue(flown, at_home if flown.row["outcome"] in at_home else ("TAKEN",))


def _outcome_issue(flown: FaultRunResult, expected: tuple[str, ...]) -> str | None:
    """Return why truth or the companion states another outcome; `None` if neither does."""
    finish_texts = [d["reason"] for d in flown.row["decisions"] if d["kind"] == "finished"]
    outcome = flown.row["outcome"]
    return (
        None
        if outcome in expected and finish_texts and finish_texts[-1].startswith(expected)
        else f"by truth {outcome}, by the companion {finish_texts or 'nothing'}"
    )


def check_disarmed_at_end(flown: FaultRunResult) -> str | None:
    """Check that a vehicle disarmed by a person is still disarmed at the end."""
    return "armed after it was disarmed" if flown.stage.is_armed else None


def check_no_takeoff(flown: FaultRunResult) -> str | None:
    """Check that the vehicle never took off."""
    return None if flown.stage.craft.record.takeoff_s is None else "it took off"


def check_returned_if_p_home_was_high(flown: FaultRunResult) -> str | None:
    """Check that no flight was lost after a go decision with P(home) of 0.99 or more."""
    promised = flown.p_home_last_go
    if promised is None or promised < 0.99 or flown.row["home"] or flown.row["outcome"] == "TAKEN":
        return None
    return f"P(home) {promised:.3f} was stated, and it did not return"


def _has_landed_by(flown: FaultRunResult, deadline_s: float) -> bool:
    landed_s = flown.stage.craft.record.landed_s
    return landed_s is not None and landed_s <= deadline_s


@dataclass(frozen=True, slots=True)
class AlertSent:
    """A rule that requires one of `alerts` (none: any) within `within_s` of the start of the fault,
    with the text `parameter_text` in a parameter. Landing within `exempt_if_landed_within_s`
    exempts a flight.
    """

    alerts: tuple[Alert, ...]
    parameter_text: str
    within_s: float | None
    exempt_if_landed_within_s: float

    def __call__(self, flown: FaultRunResult) -> str | None:
        """Return the violation, or None if the rule holds."""
        start_s, parameter_text = flown.stage.start_s, self.parameter_text
        if start_s is None:
            return "the fault never started"
        limit_s = start_s + (self.within_s if self.within_s is not None else 1e9)
        for at_s, alert, given in flown.alerts:
            matches = not parameter_text or any(
                parameter_text in text.lower() for text in given.values()
            )
            if start_s <= at_s <= limit_s and matches and alert in (self.alerts or (alert,)):
                return None
        exempt_s = self.exempt_if_landed_within_s
        if exempt_s and _has_landed_by(flown, start_s + exempt_s):
            return None
        names = ", ".join(one.identifier for one in self.alerts) or "alert"
        parameter = f" with {parameter_text!r}" if parameter_text else ""
        return f"the operator received no {names}{parameter}"


def check_alert_sent(
    *alerts: Alert,
    parameter_text: str = "",
    within_s: float | None = None,
    exempt_if_landed_within_s: float = 0.0,
) -> AlertSent:
    """Require one of these alerts (default: any)."""
    return AlertSent(alerts, parameter_text, within_s, exempt_if_landed_within_s)


def check_desk_log_contains(required_text: str) -> Rule:
    """Require this text in the desk's log after the start of the fault."""

    def rule(flown: FaultRunResult) -> str | None:
        start_s = flown.stage.start_s
        if start_s is None:
            return "the fault never started"
        found = any(start_s <= at_s and required_text in line for at_s, line in flown.messages)
        return None if found else f"the desk did not log {required_text!r}"

    rule.__doc__ = f"Check that the desk logged {required_text!r}."
    return rule


def check_file_exists_in_run_folder(file_name: str) -> Rule:
    """Require a preserved damaged record of this name in the run folder."""

    def rule(flown: FaultRunResult) -> str | None:
        path = flown.stage.craft.run_dir / file_name
        return None if path.exists() else f"no {file_name} in the run folder"

    rule.__doc__ = f"Check that the run folder holds {file_name}."
    return rule


def check_procedure_made_note(required_note: str) -> Rule:
    """Require this note of the fault procedure."""

    def rule(flown: FaultRunResult) -> str | None:
        return None if required_note in flown.stage.notes else f"not observed: {required_note}"

    rule.__doc__ = f"Check that this was observed: {required_note}."
    return rule


# --- of a small day ----------------------------------------------------------------------------


def _require_flown_day(flown: FaultRunResult) -> FlownDay:
    assert flown.day is not None
    return flown.day


def check_day_rules(flown: FaultRunResult) -> str | None:
    """Check the rules of every day: returns, deliveries, store, promises and takeovers."""
    return "; ".join(rules.describe_day_violations(_require_flown_day(flown).row))


def check_single_flight_per_power_up(flown: FaultRunResult) -> str | None:
    """Check by truth that a drone flew at most once for each time it was put out."""
    tracks = [
        (drone.name, drone.build_vehicle_track(up, 0.0))
        for drone in _require_flown_day(flown).drones
        for up in drone.all_power_cycles
        if up.record.rows
    ]
    return "; ".join(
        f"{name} flew {len(flights)} times, expected one flight each time it is put out"
        for name, track in tracks
        if len(flights := flights_of(track)) > 1
    )


def check_all_delivered(flown: FaultRunResult) -> str | None:
    """Check that all orders were delivered despite the fault."""
    left = [line["order"] for line in _require_flown_day(flown).row["undelivered"]]
    return f"not delivered: {', '.join(left)}" if left else None


def check_each_order_assigned_once(flown: FaultRunResult) -> str | None:
    """Check that each order was assigned once, to one drone."""
    given = Counter(row.order_id for row in _require_flown_day(flown).assignments)
    return "; ".join(
        f"{order} was assigned {times} times" for order, times in given.items() if times > 1
    )
