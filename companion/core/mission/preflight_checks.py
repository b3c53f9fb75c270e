"""Pre-flight checks: parameters, failsafes and batteries that would break the promise.

Each autopilot's requirements are in its adapter; their evaluation is here.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from companion.core.vehicle.airframe import BatteryPack

ParameterValues = Mapping[str, float | None]

MIN_HEIGHT_TOLERANCE_M, MAX_HEIGHT_TOLERANCE_M = 0.8, 3.0
"""Height tolerance for a reached item: PX4's default, and the maximum."""


@dataclass(frozen=True, slots=True)
class RouteProperties:
    """Route properties for checks of the autopilot's settings; heights above the depot."""

    highest_obstacle_m: float
    cruise_height_m: float
    farthest_m: float
    first_waypoint_m: float
    max_ground_mps: float
    max_tilt_deg: float
    climb_mps: float
    descent_mps: float
    landing_mps: float
    battery_cutoff_v: float
    battery_low_v: float
    battery_cells: int
    battery_capacity_mah: float
    carries_parcel: bool
    uses_setpoints: bool = False
    ground_clear_height_m: float = 0.0
    """Height clear of known ground, with the clearance; 0 if the ground is unknown."""
    ceiling_m: float = math.inf
    """Lower limit of geo-zones under which the flight passes, less the clearance."""
    is_sloped: bool = False
    """Whether consecutive waypoints are at different heights."""
    battery_monitor: int = 0
    """Number of the monitor that measures the pack (BATTERY_STATUS.id)."""

    @property
    def waypoint_height_tolerance_m(self) -> float:
        """Height tolerance for a reached item: the descent in two seconds.

        The hold at the drop then lasts WEIGH_S (5 s), so the release is at its height. A leg may
        begin that far below its height; plans keep 8 m more than the clearance.
        """
        return min(max(2.0 * self.descent_mps, MIN_HEIGHT_TOLERANCE_M), MAX_HEIGHT_TOLERANCE_M)

    @property
    def min_clear_rtl_height_m(self) -> float:
        """Minimum height at which a straight line home is clear of everything on the site."""
        obstacle_clear_height_m = (
            self.highest_obstacle_m + 10.0 if self.highest_obstacle_m > 0.0 else 0.0
        )
        return max(obstacle_clear_height_m, self.ground_clear_height_m)

    @property
    def rtl_requirement_text(self) -> str:
        """Text of the requirement on the RTL height."""
        if math.isinf(self.min_clear_rtl_height_m):
            return (
                "an RTL around no-fly areas: a straight line home from the route crosses one at"
                " every height; move depot or customer"
            )
        description = (
            f"an RTL above every obstacle and the ground ({self.min_clear_rtl_height_m:.0f} m)"
        )
        if math.isinf(self.ceiling_m):
            return description
        return f"{description} and under geo-zones ({self.ceiling_m:.0f} m)"

    @property
    def rtl_height_to_set_m(self) -> float | None:
        """RTL height to set; `None` if none is clear of everything."""
        height_m = self.min_clear_rtl_height_m
        return None if math.isinf(height_m) else float(math.ceil(height_m))

    @property
    def fence_height_to_set_m(self) -> float:
        """Height of a fence above the route and the RTL."""
        return math.ceil(max(self.cruise_height_m, self.rtl_height_to_set_m or 0.0) + 30.0)

    def is_clear_rtl_height(self, height_m: float) -> bool:
        """Return whether an RTL at this height is clear of everything on the site."""
        return self.min_clear_rtl_height_m <= height_m <= self.ceiling_m


@dataclass(frozen=True, slots=True)
class PreflightIssue:
    """A pre-flight finding. `blocks`: no takeoff with it; `waits`: may clear on its own."""

    name: str
    words: str
    blocks: bool
    waits: bool = False


@dataclass(frozen=True, slots=True)
class ParameterRequirement:
    """A requirement on the autopilot's parameters.

    `names` are all parameters that it reads. `is_met` evaluates their values (`None`: unknown),
    `required_values` returns the values to set. `required`: no takeoff without it. `needs_reboot`:
    without effect until a reboot, so `--configure` does not set it.
    """

    names: tuple[str, ...]
    description: str
    is_met: Callable[[ParameterValues], bool | None]
    required_values: Callable[[ParameterValues], dict[str, float]]
    required: bool
    needs_reboot: bool = False


def evaluate_parameter(
    values: ParameterValues, name: str, is_acceptable: Callable[[float], bool]
) -> bool | None:
    """Apply a test to a parameter's value; `None` if the autopilot does not report it."""
    value = values.get(name)
    return None if value is None else bool(is_acceptable(value))


def single_parameter_requirement(
    parameter_name: str,
    description: str,
    is_acceptable: Callable[[float], bool],
    required_value: float,
    *,
    is_blocking: bool = True,
) -> ParameterRequirement:
    """Require of one parameter that its value passes the test, or set `required_value`."""
    return ParameterRequirement(
        (parameter_name,),
        description,
        lambda v: evaluate_parameter(v, parameter_name, is_acceptable),
        lambda v: {parameter_name: required_value},
        is_blocking,
    )


def battery_capacity_requirement(
    parameter_name: str, route: RouteProperties
) -> ParameterRequirement:
    """Require that the reported percentage is relative to the pack's capacity."""
    capacity_mah = route.battery_capacity_mah
    description = f"a percentage that counts from the pack's {capacity_mah:.0f} mAh"
    return single_parameter_requirement(
        parameter_name,
        description,
        lambda x: abs(x / capacity_mah - 1.0) < 0.1,
        capacity_mah,
        is_blocking=False,
    )


CELL_TOLERANCE_V = 0.1
"""Tolerance of a cell's voltage about its table: sensor error, or a charge that just ended."""


def pack_mismatch_text(battery: BatteryPack, resting_v: float) -> str:
    """Return why the fitted pack cannot be the airframe's, from its voltage; `""` if it can."""
    cell_v = resting_v / battery.cells
    empty_v, full_v = battery.ocv_cell_v[0], battery.ocv_cell_v[-1]
    if not empty_v - CELL_TOLERANCE_V <= cell_v <= full_v + CELL_TOLERANCE_V:
        return (
            f"{resting_v:.1f} V does not fit a pack of {battery.cells} cells"
            f" ({cell_v:.2f} V each; empty is {empty_v:g}, full is {full_v:g}):"
            " check pack, airframe and cells"
        )
    return ""


def battery_pack_error_text(battery: BatteryPack, resting_v: float | None) -> str:
    """Return why the fitted pack cannot be the airframe's or is empty; `""` if it may fly.

    `resting_v` is the whole pack's voltage while disarmed, `None` if it is not measured.
    """
    if resting_v is None:
        return ""
    if mismatch_text := pack_mismatch_text(battery, resting_v):
        return mismatch_text
    if resting_v <= battery.low_battery_action_voltage_v:
        return (
            f"the battery is empty: {resting_v:.1f} V at rest,"
            f" {resting_v / battery.cells:.2f} V a cell"
            f" (low is {battery.low_battery_action_voltage_v / battery.cells:.2f} in flight)"
        )
    return ""


def unmet_requirement_issues(
    requirements: Iterable[ParameterRequirement], parameter_values: ParameterValues
) -> tuple[PreflightIssue, ...]:
    """Return the failed requirements, required ones first."""
    found: list[PreflightIssue] = []
    for requirement in requirements:
        is_met = requirement.is_met(parameter_values)
        if is_met:
            continue
        name = requirement.names[0]
        if is_met is None:
            is_absent = name in parameter_values
            lack = "this autopilot does not report" if is_absent else "no response about"
            description = f"{requirement.description}: {lack} {name}"
        else:
            description = (
                f"{requirement.description}: {_correction_text(requirement, parameter_values)}"
            )
        found.append(PreflightIssue(name, description, blocks=requirement.required))
    return tuple(sorted(found, key=lambda f: not f.blocks))


def _correction_text(requirement: ParameterRequirement, parameter_values: ParameterValues) -> str:
    """Format the values to set, or those read: `COM_LOW_BAT_ACT is 0, set 3`."""
    required_value = requirement.required_values(parameter_values)
    reported = {n: v for n in requirement.names if (v := parameter_values.get(n)) is not None}
    corrections = [
        f"{name} is {value:g}, set {required_value[name]:g}"
        for name, value in reported.items()
        if required_value.get(name, value) != value
    ]
    if requirement.needs_reboot:
        corrections.append("reboot")
    return ", ".join(corrections or [f"{name} is {value:g}" for name, value in reported.items()])


def settings_to_correct(
    requirements: Iterable[ParameterRequirement], parameter_values: ParameterValues
) -> dict[str, float]:
    """Return the values to set so that every requirement with known parameters is met."""
    required_value: dict[str, float] = {}
    for requirement in requirements:
        if not requirement.needs_reboot and requirement.is_met(parameter_values) is False:
            required_value |= requirement.required_values(parameter_values)
    return {
        name: value
        for name, value in required_value.items()
        if parameter_values.get(name) is not None
    }


def required_parameter_names(requirements: Iterable[ParameterRequirement]) -> tuple[str, ...]:
    """Return every parameter that the requirements read, once each."""
    return tuple(dict.fromkeys(n for requirement in requirements for n in requirement.names))
