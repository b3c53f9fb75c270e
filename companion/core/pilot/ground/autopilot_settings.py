"""Settings of the autopilot: read, compared with the flight's requirements, set, and restored."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from companion.core.mission.actions import LogNote, RequestParameters, SetParameters
from companion.core.mission.alerts import Alert
from companion.core.mission.checkpoint import Checkpoint
from companion.core.mission.events import (
    AutopilotKind,
    AutopilotParameters,
    Event,
    ParametersAwaited,
    ParametersSet,
    UnrestoredSettings,
)
from companion.core.mission.flight_plan import route_properties
from companion.core.mission.preflight_checks import (
    ParameterRequirement,
    PreflightIssue,
    RouteProperties,
    required_parameter_names,
    settings_to_correct,
    unmet_requirement_issues,
)
from companion.core.pilot.context import FlightContext
from companion.core.pilot.transitions import Phase, Trigger

RequirementsFunction = Callable[[AutopilotKind, RouteProperties], tuple[ParameterRequirement, ...]]
"""Required autopilot settings for a route."""


@dataclass(frozen=True, slots=True)
class SettingChange:
    """One parameter of the autopilot that this flight changed, or found changed by an earlier one.

    `original_value` is the vehicle's own value. `value_set`: `None` if the autopilot did not accept
    it, or another run set it. `restored`: the autopilot has confirmed its own value again.
    """

    name: str
    original_value: float
    value_set: float | None
    restored: bool


@dataclass(slots=True)
class SettingsState:
    """Values that were read or changed."""

    values: dict[str, float | None] = field(default_factory=dict)
    original_values: dict[str, float] = field(default_factory=dict)
    """The vehicle's own values of settings still to be restored."""
    changed: dict[str, tuple[float, float | None]] = field(default_factory=dict)
    """The vehicle's own value, and the value set by this run."""
    unrestored_values: dict[str, float] = field(default_factory=dict)
    """The vehicle's own values, changed by an earlier flight and not restored."""
    restore_ordered: bool = False
    configured: bool = False
    requirements: tuple[ParameterRequirement, ...] = ()
    findings: tuple[PreflightIssue, ...] = ()
    findings_known: bool = False


class AutopilotSettings:
    """Owns the autopilot settings that this flight knows and changes."""

    def __init__(self, requirements: RequirementsFunction) -> None:
        self._state = SettingsState()
        self._requirements = requirements

    @property
    def unmet_setting_issues(self) -> tuple[PreflightIssue, ...]:
        """Autopilot settings that do not meet the promise's requirements."""
        return self._state.findings

    @property
    def are_settings_compared(self) -> bool:
        """Whether the settings were compared with this plan's requirements."""
        return self._state.findings_known

    @property
    def met_requirement_count(self) -> int:
        """Number of required settings that are met."""
        return len(self._state.requirements) - len(self._state.findings)

    @property
    def is_rtl_known_safe(self) -> bool:
        """Whether RTL is known to clear every obstacle."""
        unsafe = [f for f in self._state.findings if f.name.startswith("RTL")]
        return not unsafe and self._state.findings_known

    @property
    def original_values_to_restore(self) -> dict[str, float]:
        """Original values of settings still to be restored."""
        return self._state.original_values

    @property
    def original_values_of_earlier_flight(self) -> dict[str, float]:
        """Original values of settings that an earlier flight did not restore."""
        return dict(self._state.unrestored_values)

    @property
    def setting_changes(self) -> tuple[SettingChange, ...]:
        """Every changed setting of the autopilot, sorted by name."""
        state = self._state
        return tuple(
            SettingChange(name, before, value, restored=name not in state.original_values)
            for name, (before, value) in sorted(state.changed.items())
        )

    @property
    def is_restore_unconfirmed(self) -> bool:
        """Whether a restore was ordered and is not confirmed yet."""
        return self._state.restore_ordered and bool(self._state.original_values)

    def order_settings_restore(self, context: FlightContext) -> None:
        """Order the restore of the autopilot's settings."""
        context.queue_actions(SetParameters(dict(self._state.original_values)))
        self._state.restore_ordered = True

    def to_dict(self) -> dict[str, Any]:
        """Return the checkpoint keys of this part."""
        return {"settings_before": dict(self._state.original_values)}

    def restore(self, checkpoint: Checkpoint) -> None:
        """Restore from a checkpoint."""
        self._state.original_values = dict(checkpoint.settings_before)
        self._record_original_values(checkpoint.settings_before)

    def invalidate_settings_comparison(self) -> None:
        """Invalidate the comparison: a new plan is made."""
        self._state.findings_known = False

    def request_required_parameters(self, context: FlightContext) -> None:
        """Request the settings on which the plan depends."""
        flown = context.flight_plan
        if flown is None or context.telemetry.autopilot_kind is None:
            return
        route = route_properties(
            context.flight,
            context.airframe,
            flown,
            with_separation=context.options.separation_enabled,
        )
        route = replace(route, battery_monitor=context.telemetry.pack.monitor)
        self._state.requirements = self._requirements(context.telemetry.autopilot_kind, route)
        context.queue_actions(RequestParameters(required_parameter_names(self._state.requirements)))

    def on_event(self, context: FlightContext, event: Event) -> None:
        """Process settings that were read or set."""
        match event:
            case AutopilotParameters():
                self._store_and_evaluate_parameters(context, event)
            case ParametersAwaited():
                _report_awaited(context, event.names)
            case ParametersSet():
                if event.failed:
                    context.report_alert(Alert.PARAMETERS_NOT_SET, names=", ".join(event.failed))
                if self._state.restore_ordered:
                    self._record_restored_settings(context, event)
                else:
                    changed = self._state.changed
                    for name in changed.keys() & set(event.failed):
                        changed[name] = (changed[name][0], None)
            case UnrestoredSettings():
                self._record_settings_of_earlier_flight(context, event)
            case _:
                return

    def _store_and_evaluate_parameters(
        self, context: FlightContext, event: AutopilotParameters
    ) -> None:
        state = self._state
        state.values.update(event.values)
        if event.unanswered and not context.options.check_only:
            _report_awaited(context, event.unanswered)  # they are requested again
            return
        if context.phase is Phase.PLAN and context.flight_plan is not None:
            self._set_or_compare_parameters(context)
        elif not state.findings_known and state.requirements:
            state.findings = unmet_requirement_issues(state.requirements, state.values)
            state.findings_known = True

    def _set_or_compare_parameters(self, context: FlightContext) -> None:
        state = self._state
        required_values = settings_to_correct(state.requirements, state.values)
        is_setting_allowed = context.options.configure and not context.options.check_only
        if required_values and is_setting_allowed and not state.configured:
            state.configured = True
            before = {
                name: value for name in required_values if (value := state.values[name]) is not None
            }
            # Values set by an earlier interrupted run are not the autopilot's original values.
            state.original_values = before | state.original_values
            context.request_checkpoint()
            for name, value in required_values.items():
                state.changed[name] = (state.original_values[name], value)
                context.queue_actions(
                    LogNote(f"setting {name}: {before[name]:g} to {value:g}", in_run=True)
                )
            context.queue_actions(SetParameters(required_values))
            return
        state.findings = unmet_requirement_issues(state.requirements, state.values)
        state.findings_known = True
        for requirement_failure in state.findings:
            severity_text = "MISSING" if requirement_failure.blocks else "WARNING"
            context.queue_actions(
                LogNote(f"pre-flight: {severity_text}: {requirement_failure.words}", in_run=True)
            )
        if not context.options.check_only:
            context.apply_phase_trigger(Trigger.PLANNED)

    def _record_restored_settings(self, context: FlightContext, event: ParametersSet) -> None:
        """Process the restore; settings that could not be set remain to be restored."""
        state = self._state
        unrestored = {
            name: value for name, value in state.original_values.items() if name in event.failed
        }
        for name, value in sorted(state.original_values.items()):
            if name not in unrestored:
                context.queue_actions(
                    LogNote(f"setting {name}: restored to {value:g}", in_run=True)
                )
        state.original_values = unrestored
        context.request_checkpoint()

    def _record_original_values(self, values: dict[str, float]) -> None:
        """Record the vehicle's own values of settings changed by another run."""
        for name, value in values.items():
            self._state.changed.setdefault(name, (value, None))

    def _record_settings_of_earlier_flight(
        self, context: FlightContext, event: UnrestoredSettings
    ) -> None:
        """An earlier flight restored no settings: this one does so if it may set any."""
        state = self._state
        state.unrestored_values = event.values
        original_text = ", ".join(
            f"{name} {value:g}" for name, value in sorted(event.values.items())
        )
        context.queue_actions(
            LogNote(f"an earlier flight changed settings; original values: {original_text}")
        )
        if context.options.check_only:
            return
        if context.options.configure:
            state.original_values = state.original_values | event.values
            self._record_original_values(event.values)
            context.request_checkpoint()
        else:
            context.report_alert(Alert.EARLIER_SETTINGS_IN_FORCE)
            context.queue_actions(
                LogNote("`companion restore` restores the vehicle's own settings")
            )


def _report_awaited(context: FlightContext, names: tuple[str, ...]) -> None:
    context.report_alert(Alert.PARAMETERS_AWAITED, count=len(names), names=", ".join(names))
