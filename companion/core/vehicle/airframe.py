"""What we believe about an airframe: the strict `airframe/1` schema that planner and gate share.

Belief, not truth: the simulator's vehicle has its own equations and its own numbers. Every
shipped file (params/airframes) names the source of each number beside it.
"""

import math
from typing import Literal

import msgspec
import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError, check_range
from companion.core.vehicle.air import REFERENCE_DENSITY_KGPM3

MULTIROTOR = "multirotor"
"""The kind of vehicle that the models in this room describe, in the words of the log readers."""

_GRAVITY_MPS2 = 9.80665
_MOST_TIP_MPS = 204.0
"""Mach 0.6 at sea level: beyond it a propeller's tips meet compressibility (Leishman, 7.9), and no
delivery multirotor is geared to turn that fast."""

LOW_ABOVE_CUTOFF_V = 0.05
"""A cell's voltage at the autopilot's low-battery action, above the cut-off."""


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
    """How it is flown."""

    cruise_airspeed_mps: float
    """Airspeed of the rule `cruise`."""
    max_ground_mps: float
    """The most that the autopilot may be told to fly, over the ground."""
    climb_mps: float
    """Climb rate."""
    descent_mps: float
    """Descent rate above `land_slow_height_m`."""
    landing_mps: float
    """Descent rate below `land_slow_height_m`."""
    land_slow_height_m: float
    """Height above the ground at which the slow descent begins."""
    max_tilt_deg: float
    """Largest lean angle that the autopilot commands."""
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
        """Largest lean angle the autopilot commands."""
        return math.radians(self.max_tilt_deg)


class Drag(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True
):
    """Drag force along body forward and right: `linear * v + quadratic * |v| v`, in newton.

    In air of 1.225 kg/m3. The linear part is rotor drag at empty mass; it grows with the square
    root of mass and of density (rotor mass flow), the quadratic part with density. The other
    numbers say how wrong this may be.
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
    """Added to both axes while a parcel hangs below."""
    gain_std_frac: float
    """How wrong all drag may be together; learned in flight."""
    axis_gain_std_frac: float
    """How wrong either axis may be beside that; learned in flight."""
    model_std_frac: float
    """How wrong drag may be for seconds on end, in ways that are not learned: flow angles,
    vertical wind, interference.
    """
    trim_std_deg: float
    """How far the reported attitude may lean against the thrust, beside the mean trims below."""
    vertical_quadratic_n_per_mps2: float | None = None
    """Drag of the flow down through the rotors, upon the vehicle's top: about 0.7 of its plan
    area in m^2 (body, arms and packs, half rho Cd A with a plate's 1.1 to 1.2). With it power
    is priced along the body's axes (`power.multirotor_power_w`). Without it the vehicle drags
    alike from all sides and the rotors' own drag is paid for in full.
    """
    trim_forward_deg: float = 0.0
    """How far the thrust leans forward of where the reported attitude puts it, the mean over
    flights: how autopilot and centre of gravity sit in the airframe.
    """
    trim_right_deg: float = 0.0
    """The same to the right."""

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
            raise LeewayError("drag.linear_forward_n_per_mps: some drag expected, all are 0")
        if self.linear_right_n_per_mps + self.quadratic_right_n_per_mps2 <= 0.0:
            raise LeewayError("drag.linear_right_n_per_mps: some drag expected, all are 0")


class PaperPower(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Numbers of the paper's model, `P = P_c + T V_A / c_T` (arXiv 2604.13441, III-B)."""

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
    """Numbers of the multirotor model: induced, profile, parasite and avionics power."""

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
    """Power of everything that does not turn a rotor."""
    model_std_frac: float
    """How wrong the predicted power may be."""

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
    """Measured power over that of `power_rotor`, by what the vehicle does; from recorded flights.

    Without this table all of it is 1, and descent is priced as level flight.
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


class BatteryPack(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One pack as a whole; `usable_wh` says what it gives."""

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
    """Voltage of one cell under load at which the pack counts as empty."""
    usable_frac: float
    """What a new pack gives until cut-off, of its label, at `usable_at_w` and where
    `usable_temperature_frac` is 1.
    """
    usable_at_w: float
    """The draw that `usable_frac` belongs to."""
    usable_loss_per_w: float
    """Share of the label that is lost for each watt above `usable_at_w`."""
    usable_temperature_c: list[float]
    """Temperatures at which `usable_temperature_frac` is given, rising."""
    usable_temperature_frac: list[float]
    """What is usable at each of `usable_temperature_c`, of `usable_frac`."""
    usable_std_frac: float
    """How much usable energy differs from pack to pack (one sigma)."""
    resting_voltage_std_v: float
    """Error of a measured resting voltage of the pack (one sigma)."""

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
        _check_table("battery", "ocv_charge_frac", self.ocv_charge_frac, 0.0, 1.0, rising=True)
        _check_table("battery", "ocv_cell_v", self.ocv_cell_v, 2.0, 5.0, rising=True)
        _check_table(
            "battery", "usable_temperature_c", self.usable_temperature_c, -60.0, 90.0, rising=True
        )
        _check_table(
            "battery", "usable_temperature_frac", self.usable_temperature_frac, 0.05, 1.1, False
        )
        if len(self.ocv_charge_frac) != len(self.ocv_cell_v):
            raise LeewayError("battery.ocv_cell_v: expected as many as ocv_charge_frac")
        if len(self.usable_temperature_c) != len(self.usable_temperature_frac):
            raise LeewayError("battery.usable_temperature_frac: as many as usable_temperature_c")
        if (self.ocv_charge_frac[0], self.ocv_charge_frac[-1]) != (0.0, 1.0):
            raise LeewayError("battery.ocv_charge_frac: expected to run from 0.0 to 1.0")

    def charge_frac_at_rest(self, voltage_v: float) -> float:
        """Charge (0 to 1 of the pack's content) from its resting voltage."""
        cell_v = voltage_v / self.cells
        return float(np.interp(cell_v, self.ocv_cell_v, self.ocv_charge_frac))

    @property
    def plausible_v(self) -> tuple[float, float]:
        """Least and greatest voltage of the pack."""
        return PLAUSIBLE_CELL_V[0] * self.cells, PLAUSIBLE_CELL_V[1] * self.cells

    @property
    def low_v(self) -> float:
        """Loaded voltage of the pack at which an autopilot should act by itself."""
        return self.cells * (self.cutoff_cell_v + LOW_ABOVE_CUTOFF_V)

    @property
    def most_power_w(self) -> float:
        """What a full pack gives at its cut-off voltage; infinite without resistance."""
        cutoff_v, full_v = self.cells * self.cutoff_cell_v, self.cells * self.ocv_cell_v[-1]
        if self.resistance_ohm == 0.0:
            return math.inf
        return cutoff_v * max(full_v - cutoff_v, 0.0) / self.resistance_ohm

    def usable_wh(self, draw_w: float, temperature_c: float, health_frac: float) -> float:
        """What a full pack gives at this draw until cut-off, Wh."""
        loss = self.usable_loss_per_w * max(draw_w - self.usable_at_w, 0.0)
        warm = float(
            np.interp(temperature_c, self.usable_temperature_c, self.usable_temperature_frac)
        )
        return self.nominal_wh * max(self.usable_frac - loss, 0.05) * warm * health_frac


class Airframe(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True
):
    """An `airframe/1` file: what planner and return budget believe about an airframe."""

    format: Literal["airframe/1"]
    """The kind of file and its version."""
    name: str
    """The airframe's name."""
    mass: Masses
    """Masses."""
    speeds: Speeds
    """How it is flown."""
    drag: Drag
    """Drag, and how wrong it may be."""
    power_paper: PaperPower
    """The paper's power model."""
    power_rotor: RotorPower
    """The multirotor power model."""
    battery: BatteryPack
    """The pack."""
    power_flown: FlownPower | None = None
    """What flights drew over what `power_rotor` says, by phase."""

    def __post_init__(self) -> None:
        self._check_thrust()
        self._check_hover_power()

    def _check_thrust(self) -> None:
        """Rotors of this size must carry all of it, leant as far as the autopilot commands."""
        mass = self.mass
        if trouble := self._thrust_trouble(mass.max_payload_kg, REFERENCE_DENSITY_KGPM3):
            raise LeewayError(
                f"mass.empty_kg = {mass.empty_kg:g} with mass.max_payload_kg ="
                f" {mass.max_payload_kg:g}: {trouble}"
            )

    def _check_hover_power(self) -> None:
        """A full pack must carry the hover without a parcel above its cut-off voltage."""
        if trouble := self._hover_trouble(0.0, REFERENCE_DENSITY_KGPM3):
            raise LeewayError(f"mass.empty_kg = {self.mass.empty_kg:g}: {trouble}")

    def lift_trouble(self, payload_kg: float, density_kgpm3: float) -> str:
        """Say why it cannot carry this parcel in air so thin; `""` where it can."""
        thrust = self._thrust_trouble(payload_kg, density_kgpm3)
        trouble = thrust or self._hover_trouble(payload_kg, density_kgpm3)
        where = f"{payload_kg:g} kg in air of {density_kgpm3:.2f} kg/m3"
        return f"{where}: {trouble}" if trouble else ""

    def _thrust_trouble(self, payload_kg: float, density_kgpm3: float) -> str:
        needed_n = self.mass_kg(payload_kg) * _GRAVITY_MPS2 / math.cos(self.speeds.max_tilt_rad)
        rotor = self.power_rotor
        disc_kgpm = density_kgpm3 * rotor.disc_area_m2
        available_n = rotor.thrust_coefficient * disc_kgpm * _MOST_TIP_MPS**2
        if needed_n <= available_n:
            return ""
        return (
            f"needs {needed_n:.0f} N of thrust at {self.speeds.max_tilt_deg:g} degrees, expected"
            f" at most {available_n:.0f} N, which rotors by power_rotor give at Mach 0.6 at the"
            f" tips"
        )

    def _hover_trouble(self, payload_kg: float, density_kgpm3: float) -> str:
        rotor, battery = self.power_rotor, self.battery
        weight_n = self.mass_kg(payload_kg) * _GRAVITY_MPS2
        # Momentum theory's least power for this thrust (Leishman, 2.2): no vehicle needs less.
        ideal_w = weight_n * math.sqrt(weight_n / (2.0 * density_kgpm3 * rotor.disc_area_m2))
        needed_w = rotor.induced_factor * ideal_w / rotor.drive_efficiency
        if needed_w <= battery.most_power_w:
            return ""
        return (
            f"needs at least {needed_w:.0f} W to hover, expected at most"
            f" {battery.most_power_w:.0f} W, which a full pack by battery gives above its cut-off"
        )

    def mass_kg(self, payload_kg: float) -> float:
        """Flying mass with this parcel."""
        return self.mass.empty_kg + payload_kg

    def drag_linear_n_per_mps(self, mass_kg: float, density_kgpm3: float) -> tuple[float, float]:
        """Linear drag along body forward and right at this mass, in this air (`Drag`)."""
        scale = math.sqrt(mass_kg / self.mass.empty_kg * density_kgpm3 / REFERENCE_DENSITY_KGPM3)
        return (
            self.drag.linear_forward_n_per_mps * scale,
            self.drag.linear_right_n_per_mps * scale,
        )

    def drag_quadratic_n_per_mps2(
        self, mass_kg: float, density_kgpm3: float
    ) -> tuple[float, float]:
        """Quadratic drag along body forward and right; a mass above empty means a parcel."""
        parcel = (
            self.drag.parcel_quadratic_n_per_mps2 if mass_kg > 1.001 * self.mass.empty_kg else 0.0
        )
        drag, ratio = self.drag, density_kgpm3 / REFERENCE_DENSITY_KGPM3
        return (
            ratio * (drag.quadratic_forward_n_per_mps2 + parcel),
            ratio * (drag.quadratic_right_n_per_mps2 + parcel),
        )

    def drag_vertical_n_per_mps2(self, density_kgpm3: float) -> float | None:
        """Drag of the flow down through the rotors; `None` where the file states none."""
        vertical = self.drag.vertical_quadratic_n_per_mps2
        return None if vertical is None else density_kgpm3 / REFERENCE_DENSITY_KGPM3 * vertical


def airframe_from_dict(table: dict[str, object], where: str = "airframe") -> Airframe:
    """Check a parsed TOML table against `airframe/1`; LeewayError names file and key."""
    try:
        return msgspec.convert(table, Airframe)
    except (msgspec.ValidationError, LeewayError) as error:
        raise LeewayError(f"{where}: {error}") from error


def _check_table(
    table: str, key: str, values: list[float], low: float, high: float, rising: bool
) -> None:
    if len(values) < 2:
        raise LeewayError(f"{table}.{key}: expected at least two numbers")
    for value in values:
        check_range(f"{table}.{key}", value, low, high)
    steps: Floats = np.diff(np.asarray(values, float))
    if rising and not bool(np.all(steps > 0.0)):
        raise LeewayError(f"{table}.{key}: expected rising numbers")
