"""Safety rule 4: usable energy left, from whatever the autopilot knows; it only ever falls.

Energies are in Wh throughout, as in evaluation.md, battery labels and the checkpoint.
"""

from dataclasses import dataclass

from companion.core.airframe import Airframe


@dataclass(frozen=True, slots=True)
class BatteryObservation:
    """What telemetry says about the battery at one instant; None is unknown (never -1 or 0).

    `at_rest` is True only while disarmed on the ground (voltage is then the resting voltage).
    `modelled_power_w` is what the power model says the vehicle draws now.
    `remaining_is_timer` marks a percentage that is known to count time (PX4 SIH).
    """

    t_s: float
    at_rest: bool
    voltage_v: float | None = None
    current_a: float | None = None
    consumed_mah: float | None = None
    consumed_wh: float | None = None
    remaining_frac: float | None = None
    remaining_is_timer: bool = False
    temperature_c: float | None = None
    modelled_power_w: float | None = None


@dataclass(frozen=True, slots=True)
class EnergyBelief:
    """Usable energy left (Wh, to the cut-off, reserve included), and how sure that is.

    `usable_full_wh` is what a full pack would give (the reserve is a share of it). `source` names
    the source that rules; `warnings` are in words, empty when all is well.
    """

    t_s: float
    mean_wh: float
    std_wh: float
    usable_full_wh: float
    source: str
    warnings: tuple[str, ...] = ()


class EnergyLedger:
    """Counts; one per vehicle and battery."""

    def __init__(
        self,
        airframe: Airframe,
        expected_draw_w: float,
        health_frac: float = 1.0,
        temperature_c: float = 20.0,
        charge_frac_stated: float | None = None,
    ) -> None:
        raise NotImplementedError

    def observe(self, observation: BatteryObservation) -> None:
        """Take one observation (any rate)."""
        raise NotImplementedError

    def belief(self) -> EnergyBelief | None:
        """Energy left, or None while nothing at all is known."""
        raise NotImplementedError

    def snapshot(self) -> dict[str, object]:
        """What the checkpoint keeps (plain numbers and strings, JSON-safe)."""
        raise NotImplementedError

    def restore(self, snapshot: dict[str, object]) -> None:
        """Go on from a checkpoint without ever rising; LeewayError when it is not one."""
        raise NotImplementedError
