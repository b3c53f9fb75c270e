"""Safety rules that flights, days and trials check in the same way."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from sim_bridge.app.link.client_messages import heartbeat_custom_mode
from sim_bridge.autopilot.mavlink.codec import Decoder

MODE_REPORT_DELAY_S = 0.3
"""Time until the companion has processed a new mode: its exchange and the next one."""

ROUNDING_WH = 2e-5

SentCommand = tuple[float, str, int]
"""Time since power-up, message name, command number (0 without one)."""


@dataclass(slots=True)
class TakeOver:
    """Safety rule 1: no command once the companion can know that another party has control.

    `known_s`: that time, `MODE_REPORT_DELAY_S` after the first report of another mode. Faults and
    trials that withhold or alter reports pass their own time; the earliest time counts.
    """

    start_s: float | None = None
    """Start of the take-over, if the simulation caused one."""
    known_s: float = math.inf
    ended_s: float = math.inf
    """Time at which control was handed back to the companion."""

    def record_known(self, t_s: float, delay_s: float = MODE_REPORT_DELAY_S) -> None:
        """Record a report at `t_s`, which the companion has processed after `delay_s`."""
        self.known_s = min(self.known_s, t_s + delay_s)

    def record_reported_mode(self, t_s: float, autopilot_kind: str, custom_mode: int) -> None:
        """Record the mode in a heartbeat that reaches the companion at `t_s`."""
        if custom_mode != heartbeat_custom_mode(autopilot_kind, "mission"):
            self.record_known(t_s)

    def record_reported_modes(
        self, t_s: float, autopilot_kind: str, datagrams: list[bytes]
    ) -> None:
        """Record the modes of the heartbeats in datagrams for the companion."""
        if math.isfinite(self.known_s):
            return  # later reports change nothing
        decoder = Decoder()
        for message in (one for data in datagrams for one in decoder.decode_bytes(data)):
            if message.msg_name == "HEARTBEAT":
                self.record_reported_mode(t_s, autopilot_kind, message.custom_mode)

    def find_late_commands(self, commands: list[SentCommand]) -> list[SentCommand]:
        """Return the commands that were sent after `known_s`, until `ended_s`."""
        return [command for command in commands if self.known_s < command[0] <= self.ended_s]


def format_sent_command(command: SentCommand) -> str:
    """Format a sent command for results."""
    t_s, name, number = command
    return f"{name} {number or ''} at {t_s:.1f} s".replace("  ", " ")


@dataclass(slots=True)
class RemainingEnergyRule:
    """Safety rule 4: the estimated remaining energy of a vehicle never rises in flight."""

    least_wh: float = math.inf
    """Lowest estimate so far."""

    def describe_rise(self, t_s: float, recorded_wh: float | None) -> str:
        """Process an estimate and return its violation of the rule, empty if there is none.

        An estimate that is not a number, recorded as None, is a violation, too.
        """
        left_wh = math.nan if recorded_wh is None else recorded_wh
        least_wh, self.least_wh = self.least_wh, min(self.least_wh, left_wh)
        if math.isfinite(left_wh) and left_wh <= least_wh + ROUNDING_WH:
            return ""
        return f"energy left rose from {least_wh:.2f} to {left_wh:.2f} Wh at {t_s:.1f} s"


def find_energy_rise_after_takeoff(
    decisions: Iterable[dict[str, Any]], energy: Iterable[dict[str, Any]]
) -> str:
    """Return the violation of safety rule 4 in a companion's record, empty if there is none."""
    rule = RemainingEnergyRule()
    takeoff_s = min((d["t_s"] for d in decisions if d["kind"] == "take_off"), default=math.inf)
    rises = (rule.describe_rise(e["t_s"], e["left_wh"]) for e in energy if e["t_s"] >= takeoff_s)
    return next(filter(None, rises), "")
