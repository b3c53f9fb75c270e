"""Airframe model: the strict `airframe/1` schema that planner and gate share.

The simulator's vehicle has its own equations and numbers. Every file in params/airframes gives the
source of each number.
"""

import math
from typing import Literal

import msgspec
import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError, check_range
from companion.core.vehicle.air import REFERENCE_DENSITY_KGPM3

MULTIROTOR = "multirotor"
"""Vehicle type that the models of this package describe, as the log readers name it."""

_GRAVITY_MPS2 = 9.80665
_MAX_TIP_SPEED_MPS = 204.0
"""Mach 0.6 at sea level: above it propeller tips have compressibility losses (Leishman, 7.9), and
no delivery multirotor turns that fast."""

LOW_ABOVE_CUTOFF_V = 0.05
"""Cell voltage above the cut-off at which the autopilot's low-battery action is due."""


class Masses(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Masses of the vehicle and its parcel."""

    empty_kg: float
    """Mass ready to fly, battery in, no parcel."""
    max_payload_kg: float
    """Heaviest parcel."""

    def __post_init__(self) -> None:
        check_range("mass.empty_kg", self.empty_kg, 0.1, 500.0)
        check_range("mass.max_payload_kg", self.max_payload_kg, 0.0, 500.0)


class Speeds(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Speed limits and rates."""

    cruise_airspeed_mps: float
    """Airspeed of the rule `cruise`."""
    max_ground_mps: float
    """Maximum ground speed that may be commanded."""
    climb_mps: float
    """Climb rate."""
    descent_mps: float
    """Descent rate above `land_slow_height_m`."""
    landing_mps: float
    """Descent rate below `land_slow_height_m`."""
    land_slow_height_m: float
    """Height above the ground at which the slow descent begins."""
    max_tilt_deg: float
    """Maximum tilt angle that the autopilot commands."""
    accel_mps2: float
    """Horizontal acceleration between waypoints."""

    def __post_init__(self) -> None:
        check_range("speeds.cruise_airspeed_mps", self.cruise_airspeed_mps, 1.0, 60.0)
        check_range("speeds.max_ground_mps", self.max_ground_mps, 1.0, 60.0)
        check_range("speeds.climb_mps", self.climb_mps, 0.2, 15.0)
        check_range("speeds.descent_mps", self.descent_mps, 0.2, 15.0)
        check_range("speeds.landing_mps", self.landing_mps, 0.1, 5.0)
        check_range("speeds.land_slow_height_m", self.land_slow_height_m, 0.0, 100.0)
        check_range("speeds.max_tilt_deg", self.max_tilt_deg, 5.0, 60.0)
        check_range("speeds.accel_mps2", self.accel_mps2, 0.1, 10.0)

    @property
    def max_tilt_rad(self) -> float:
        """Maximum tilt angle that the autopilot commands."""
        return math.radians(self.max_tilt_deg)


class Drag(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True
):
    """Drag force along body forward and right: `linear * v + quadratic * |v| v`, in newton.

    In air of 1.225 kg/m3. The linear part is rotor drag at empty mass; it grows with the square
    root of mass and of density (rotor mass flow), the quadratic part with density. The other
    numbers give the uncertainty.
    """

    linear_forward_n_per_mps: float
    """Rotor drag along body forward, at empty mass."""
    linear_right_n_per_mps: float
    """Rotor drag along body right, at empty mass."""
    quadratic_forward_n_per_mps2: float
    """Drag of the airframe along body forward."""
    quadratic_right_n_per_mps2: float
    """Drag of the airframe along body right."""
    parcel_quadratic_n_per_mps2: float
    """Added to both axes while a parcel is carried below the vehicle."""
    gain_std_frac: float
    """Relative std of the drag as a whole; estimated in flight."""
    axis_gain_std_frac: float
    """Additional relative std of each axis; estimated in flight."""
    model_std_frac: float
    """Relative std of drag over several seconds that is not estimated: flow angles, vertical
    wind, interference.
    """
    trim_std_deg: float
    """Std of the angle between thrust and reported attitude, in addition to the trims below."""
    vertical_quadratic_n_per_mps2: float | None = None
    """Drag of the rotor flow on the top of the vehicle: about 0.7 of its plan area in m^2 (body,
    arms and packs, half rho Cd A with a plate's 1.1 to 1.2). With it power is computed in body
    axes (`power.multirotor_power_w`). Without it drag is equal in all directions and includes
    the full power of rotor drag.
    """
    trim_forward_deg: float = 0.0
    """Mean angle of the thrust forward of the reported attitude, from the mounting of the
    autopilot and the centre of gravity.
    """
    trim_right_deg: float = 0.0
    """Mean angle of the thrust to the right of the reported attitude."""

    def __post_init__(self) -> None:
        for key in ("linear_forward_n_per_mps", "linear_right_n_per_mps"):
            check_range(f"drag.{key}", getattr(self, key), 0.0, 100.0)
        for key in ("quadratic_forward_n_per_mps2", "quadratic_right_n_per_mps2"):
            check_range(f"drag.{key}", getattr(self, key), 0.0, 50.0)
        check_range("drag.parcel_quadratic_n_per_mps2", self.parcel_quadratic_n_per_mps2, 0.0, 50.0)
        if (vertical := self.vertical_quadratic_n_per_mps2) is not None:
            check_range("drag.vertical_quadratic_n_per_mps2", vertical, 0.0, 50.0)
        check_range("drag.gain_std_frac", self.gain_std_frac, 0.01, 1.0)
        check_range("drag.axis_gain_std_frac", self.axis_gain_std_frac, 0.0, 1.0)
        check_range("drag.model_std_frac", self.model_std_frac, 0.0, 0.5)
        check_range("drag.trim_std_deg", self.trim_std_deg, 0.05, 5.0)
        check_range("drag.trim_forward_deg", self.trim_forward_deg, -5.0, 5.0)
        check_range("drag.trim_right_deg", self.trim_right_deg, -5.0, 5.0)
        if self.linear_forward_n_per_mps + self.quadratic_forward_n_per_mps2 <= 0.0:
            raise LeewayError("drag.linear_forward_n_per_mps: no drag, expected more than 0")
        if self.linear_right_n_per_mps + self.quadratic_right_n_per_mps2 <= 0.0:
            raise LeewayError("drag.linear_right_n_per_mps: no drag, expected more than 0")


class PaperPower(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Parameters of the paper's model, `P = P_c + T V_A / c_T` (arXiv 2604.13441, III-B)."""

    constant_w: float
    """`P_c`, power that does not depend on thrust."""
    thrust_power_coefficient: float
    """`c_T`, the propulsion's efficiency."""

    def __post_init__(self) -> None:
        check_range("power_paper.constant_w", self.constant_w, 0.0, 50_000.0)
        check_range(
            "power_paper.thrust_power_coefficient", self.thrust_power_coefficient, 0.05, 5.0
        )


class RotorPower(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Parameters of the multirotor model: induced, profile, parasite and avionics power."""

    rotor_count: int
    """Number of rotors."""
    rotor_radius_m: float
    """Radius of one rotor."""
    solidity: float
    """Blade area over disc area."""
    blade_drag_coefficient: float
    """Mean profile drag coefficient of the blades."""
    thrust_coefficient: float
    """Thrust of a rotor over rho A (Omega R)^2."""
    induced_factor: float
    """Induced power over that of an ideal rotor."""
    drive_efficiency: float
    """Shaft power over electrical power."""
    avionics_w: float
    """Power of all consumers except the rotors."""
    model_std_frac: float
    """Relative std of the predicted power."""

    def __post_init__(self) -> None:
        check_range("power_rotor.rotor_count", self.rotor_count, 1, 32)
        check_range("power_rotor.rotor_radius_m", self.rotor_radius_m, 0.02, 3.0)
        check_range("power_rotor.solidity", self.solidity, 0.005, 0.5)
        check_range("power_rotor.blade_drag_coefficient", self.blade_drag_coefficient, 0.0, 0.5)
        check_range("power_rotor.thrust_coefficient", self.thrust_coefficient, 1e-4, 0.1)
        check_range("power_rotor.induced_factor", self.induced_factor, 1.0, 2.0)
        check_range("power_rotor.drive_efficiency", self.drive_efficiency, 0.2, 1.0)
        check_range("power_rotor.avionics_w", self.avionics_w, 0.0, 5000.0)
        check_range("power_rotor.model_std_frac", self.model_std_frac, 0.0, 0.5)

    @property
    def disc_area_m2(self) -> float:
        """Swept area of all rotors."""
        return self.rotor_count * math.pi * self.rotor_radius_m**2


class FlownPower(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Measured power over that of `power_rotor` by flight phase, from recorded flights.

    Without this table all ratios are 1, and descent costs as much as level flight.
    """

    climb_frac: float
    """Climbing at 1 m/s or more."""
    level_frac: float
    """Level flight and hover."""
    descent_frac: float
    """Sinking at 1 m/s or more."""

    def __post_init__(self) -> None:
        for key in ("climb_frac", "level_frac", "descent_frac"):
            check_range(f"power_flown.{key}", getattr(self, key), 0.5, 2.0)


PLAUSIBLE_CELL_V = (2.6, 4.6)  # empty under load, full at rest


class BatteryPack(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True
):
    """Battery pack as a whole; `usable_energy_of_full_pack_wh` returns its usable energy."""

    cells: int
    """Cells in series."""
    nominal_wh: float
    """Energy on the label; usable energy is less."""
    ocv_charge_frac: list[float]
    """Charges at which `ocv_cell_v` is given, rising from 0 to 1."""
    ocv_cell_v: list[float]
    """Resting voltage of one cell at each of `ocv_charge_frac`."""
    resistance_ohm: float
    """Internal resistance of the pack."""
    cutoff_cell_v: float
    """Voltage of one cell under load at which the pack is empty."""
    usable_frac: float
    """Usable share of the nominal energy of a new pack until cut-off, at `usable_at_w` and where
    `usable_temperature_frac` is 1.
    """
    usable_at_w: float
    """Draw for which `usable_frac` is given."""
    usable_loss_per_w: float
    """Share of the nominal energy lost for each watt above `usable_at_w`."""
    usable_temperature_c: list[float]
    """Temperatures at which `usable_temperature_frac` is given, rising."""
    usable_temperature_frac: list[float]
    """Share of `usable_frac` that is usable at each of `usable_temperature_c`."""
    usable_std_frac: float
    """Relative std of usable energy between packs."""
    resting_voltage_std_v: float
    """Error of a measured resting voltage of the pack (one sigma)."""
    resistance_activation_k: float = 3131.0
    """Growth of resistance in the cold: exp(K / T), T in kelvin. The default was measured on a
    lithium polymer pack from 0 to 30 degrees C, 7 s under load (rcex.cz, Battery and Temperature,
    2010).
    """

    def __post_init__(self) -> None:
        check_range("battery.cells", self.cells, 1, 200)
        check_range("battery.nominal_wh", self.nominal_wh, 1.0, 1e6)
        check_range("battery.resistance_ohm", self.resistance_ohm, 0.0, 5.0)
        check_range("battery.cutoff_cell_v", self.cutoff_cell_v, 2.0, 3.9)
        check_range("battery.usable_frac", self.usable_frac, 0.3, 1.0)
        check_range("battery.usable_at_w", self.usable_at_w, 1.0, 1e5)
        check_range("battery.usable_loss_per_w", self.usable_loss_per_w, 0.0, 1e-2)
        check_range("battery.usable_std_frac", self.usable_std_frac, 0.001, 0.3)
        check_range("battery.resting_voltage_std_v", self.resting_voltage_std_v, 0.001, 5.0)
        check_range("battery.resistance_activation_k", self.resistance_activation_k, 0.0, 1e4)
        _require_number_list_in_range(
            "battery", "ocv_charge_frac", self.ocv_charge_frac, 0.0, 1.0, must_rise=True
        )
        _require_number_list_in_range(
            "battery", "ocv_cell_v", self.ocv_cell_v, 2.0, 5.0, must_rise=True
        )
        _require_number_list_in_range(
            "battery",
            "usable_temperature_c",
            self.usable_temperature_c,
            -60.0,
            90.0,
            must_rise=True,
        )
        _require_number_list_in_range(
            "battery", "usable_temperature_frac", self.usable_temperature_frac, 0.05, 1.1, False
        )
        if len(self.ocv_charge_frac) != len(self.ocv_cell_v):
            raise LeewayError("battery.ocv_cell_v: expected the length of ocv_charge_frac")
        if len(self.usable_temperature_c) != len(self.usable_temperature_frac):
            raise LeewayError("battery.usable_temperature_frac: one per usable_temperature_c")
        if (self.ocv_charge_frac[0], self.ocv_charge_frac[-1]) != (0.0, 1.0):
            raise LeewayError("battery.ocv_charge_frac: expected to run from 0.0 to 1.0")

    def charge_frac_from_resting_voltage(self, resting_pack_voltage_v: float) -> float:
        """Return the charge (0 to 1) from the pack's resting voltage."""
        cell_v = resting_pack_voltage_v / self.cells
        return float(np.interp(cell_v, self.ocv_cell_v, self.ocv_charge_frac))

    def resting_cell_voltage_v(self, charge_frac: float) -> float:
        """Return the resting voltage of one cell at this charge (0 to 1)."""
        return float(np.interp(charge_frac, self.ocv_charge_frac, self.ocv_cell_v))

    @property
    def plausible_pack_voltage_range_v(self) -> tuple[float, float]:
        """Plausible minimum and maximum voltage of the pack."""
        return PLAUSIBLE_CELL_V[0] * self.cells, PLAUSIBLE_CELL_V[1] * self.cells

    @property
    def low_battery_action_voltage_v(self) -> float:
        """Loaded voltage of the pack at which the autopilot's low-battery action is due."""
        return self.cells * (self.cutoff_cell_v + LOW_ABOVE_CUTOFF_V)

    @property
    def max_power_of_full_pack_at_cutoff_w(self) -> float:
        """Maximum power of a full pack at its cut-off voltage; infinite without resistance."""
        cutoff_v, full_v = self.cells * self.cutoff_cell_v, self.cells * self.ocv_cell_v[-1]
        if self.resistance_ohm == 0.0:
            return math.inf
        return cutoff_v * max(full_v - cutoff_v, 0.0) / self.resistance_ohm

    def usable_energy_of_full_pack_wh(
        self, draw_w: float, temperature_c: float, health_frac: float
    ) -> float:
        """Return the usable energy of a full pack at this draw until cut-off, Wh."""
        loss = self.usable_loss_per_w * max(draw_w - self.usable_at_w, 0.0)
        temperature_frac = float(
            np.interp(temperature_c, self.usable_temperature_c, self.usable_temperature_frac)
        )
        return self.nominal_wh * max(self.usable_frac - loss, 0.05) * temperature_frac * health_frac


class Airframe(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True
):
    """An `airframe/1` file: the airframe model of planner and return budget."""

    format: Literal["airframe/1"]
    """File format and version."""
    name: str
    """The airframe's name."""
    mass: Masses
    """Masses."""
    speeds: Speeds
    """Speed limits and rates."""
    drag: Drag
    """Drag and its uncertainty."""
    power_paper: PaperPower
    """The paper's power model."""
    power_rotor: RotorPower
    """The multirotor power model."""
    battery: BatteryPack
    """The pack."""
    power_flown: FlownPower | None = None
    """Measured power over that of `power_rotor`, by flight phase."""

    def __post_init__(self) -> None:
        self._require_thrust_for_maximum_mass()
        self._require_power_for_empty_hover()

    def _require_thrust_for_maximum_mass(self) -> None:
        """Require rotors that can carry the maximum mass at maximum tilt. Raises LeewayError."""
        mass = self.mass
        if reason := self._insufficient_thrust_reason_or_empty(
            mass.max_payload_kg, REFERENCE_DENSITY_KGPM3
        ):
            raise LeewayError(
                f"mass.empty_kg = {mass.empty_kg:g} with mass.max_payload_kg ="
                f" {mass.max_payload_kg:g}: {reason}"
            )

    def _require_power_for_empty_hover(self) -> None:
        """Require a pack that can supply the empty hover above cut-off. Raises LeewayError."""
        if reason := self._insufficient_hover_power_reason_or_empty(0.0, REFERENCE_DENSITY_KGPM3):
            raise LeewayError(f"mass.empty_kg = {self.mass.empty_kg:g}: {reason}")

    def overload_reason_or_empty(self, payload_kg: float, density_kgpm3: float) -> str:
        """Return the reason that it cannot carry this parcel at this density; `""` if it can."""
        thrust = self._insufficient_thrust_reason_or_empty(payload_kg, density_kgpm3)
        reason = thrust or self._insufficient_hover_power_reason_or_empty(payload_kg, density_kgpm3)
        where = f"{payload_kg:g} kg in air of {density_kgpm3:.2f} kg/m3"
        return f"{where}: {reason}" if reason else ""

    def _insufficient_thrust_reason_or_empty(self, payload_kg: float, density_kgpm3: float) -> str:
        needed_n = (
            self.flying_mass_kg(payload_kg) * _GRAVITY_MPS2 / math.cos(self.speeds.max_tilt_rad)
        )
        rotor = self.power_rotor
        disc_kgpm = density_kgpm3 * rotor.disc_area_m2
        available_n = rotor.thrust_coefficient * disc_kgpm * _MAX_TIP_SPEED_MPS**2
        if needed_n <= available_n:
            return ""
        return (
            f"needs {needed_n:.0f} N of thrust at {self.speeds.max_tilt_deg:g} degrees of tilt,"
            f" expected at most {available_n:.0f} N, the thrust by power_rotor at a tip speed of"
            f" Mach 0.6"
        )

    def _insufficient_hover_power_reason_or_empty(
        self, payload_kg: float, density_kgpm3: float
    ) -> str:
        rotor, battery = self.power_rotor, self.battery
        weight_n = self.flying_mass_kg(payload_kg) * _GRAVITY_MPS2
        # Momentum theory's least power for this thrust (Leishman, 2.2), a lower bound.
        ideal_w = weight_n * math.sqrt(weight_n / (2.0 * density_kgpm3 * rotor.disc_area_m2))
        needed_w = rotor.induced_factor * ideal_w / rotor.drive_efficiency
        if needed_w <= battery.max_power_of_full_pack_at_cutoff_w:
            return ""
        return (
            f"needs at least {needed_w:.0f} W to hover, expected at most"
            f" {battery.max_power_of_full_pack_at_cutoff_w:.0f} W, the power of a full pack above"
            " its cut-off voltage"
        )

    def flying_mass_kg(self, payload_kg: float) -> float:
        """Return the flying mass with this parcel."""
        return self.mass.empty_kg + payload_kg

    def linear_drag_forward_right_n_per_mps(
        self, mass_kg: float, density_kgpm3: float
    ) -> tuple[float, float]:
        """Return linear drag along body forward and right at this mass and density (`Drag`)."""
        scale = math.sqrt(mass_kg / self.mass.empty_kg * density_kgpm3 / REFERENCE_DENSITY_KGPM3)
        return (
            self.drag.linear_forward_n_per_mps * scale,
            self.drag.linear_right_n_per_mps * scale,
        )

    def quadratic_drag_forward_right_n_per_mps2(
        self, mass_kg: float, density_kgpm3: float
    ) -> tuple[float, float]:
        """Return quadratic drag along body forward and right; mass above empty is a parcel."""
        parcel = (
            self.drag.parcel_quadratic_n_per_mps2 if mass_kg > 1.001 * self.mass.empty_kg else 0.0
        )
        drag, ratio = self.drag, density_kgpm3 / REFERENCE_DENSITY_KGPM3
        return (
            ratio * (drag.quadratic_forward_n_per_mps2 + parcel),
            ratio * (drag.quadratic_right_n_per_mps2 + parcel),
        )

    def vertical_flow_drag_n_per_mps2(self, density_kgpm3: float) -> float | None:
        """Return the drag of the flow down through the rotors; None if the file has none."""
        vertical = self.drag.vertical_quadratic_n_per_mps2
        return None if vertical is None else density_kgpm3 / REFERENCE_DENSITY_KGPM3 * vertical


def airframe_from_dict(table: dict[str, object], error_location: str = "airframe") -> Airframe:
    """Convert a parsed TOML table to an `Airframe`. LeewayError states file and key."""
    try:
        return msgspec.convert(table, Airframe)
    except (msgspec.ValidationError, LeewayError) as error:
        raise LeewayError(f"{error_location}: {error}") from error


def _require_number_list_in_range(
    table_name: str, key: str, values: list[float], low: float, high: float, must_rise: bool
) -> None:
    if len(values) < 2:
        raise LeewayError(f"{table_name}.{key}: expected at least two numbers")
    for value in values:
        check_range(f"{table_name}.{key}", value, low, high)
    steps: Floats = np.diff(np.asarray(values, float))
    if must_rise and not bool(np.all(steps > 0.0)):
        raise LeewayError(f"{table_name}.{key}: expected rising numbers")
