"""Terminal output of a flight: one live line for each vehicle, then the results table."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from rich import box
from rich.console import Console, Group, JustifyMethod, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from sim_bridge.adapters.wall_clock import wall_s
from sim_bridge.app.flight.stage import Script
from sim_bridge.app.flight.vehicle_process import Craft

REFRESH_WALL_S = 0.25
LINE_INTERVAL_S = 30.0
COLUMNS: tuple[tuple[str, JustifyMethod, int], ...] = (
    ("\nvehicle", "left", 11),
    ("\nphase", "left", 17),  # "wait for position", the longest
    ("from\ndepot m", "right", 7),
    ("height\nm", "right", 6),
    ("wind m/s\nfrom deg", "right", 13),
    ("margin\nWh", "right", 6),
    ("P\nhome", "right", 6),
)
"""Columns of the live view: name, justification, minimum width."""
ROUTINE_DECISIONS = {"planned", "read_back", "authorised", "onward", "looked_again", "finished"}


@dataclass(frozen=True, slots=True)
class VehicleStatus:
    """State of one vehicle in the live view; `distance_m` is the distance from its start."""

    label: str
    phase: str
    distance_m: float
    up_m: float
    named_values: Mapping[str, float]
    status_texts: Sequence[tuple[float, str]]


@dataclass(slots=True)
class LiveView(Script):
    """A live table on a terminal; on other outputs, one line for each 30 s of flight."""

    console: Console = field(default_factory=Console)
    _live: Live | None = None
    _next_wall_s: float = 0.0
    _next_line_s: float = 0.0
    _started_wall_s: float = field(default_factory=wall_s)

    def __enter__(self) -> "LiveView":
        if self.console.is_terminal:
            self._live = Live(console=self.console, refresh_per_second=4, transient=True)
            self._live.__enter__()
        return self

    def __exit__(self, *exc_info: Any) -> None:
        if self._live is not None:
            self._live.__exit__(*exc_info)

    def print_line(self, line: str) -> None:
        """Print a permanent line, above the live table if one is shown."""
        self.console.print(line, highlight=False, markup=False, soft_wrap=True)

    def on_step_completed(self, crafts: list[Craft], t_s: float, reply_wall_s: float) -> None:
        """Show the state of all vehicles; called ten times per simulated second."""
        if wall_s() >= self._next_wall_s:
            self.show_vehicles_at_limited_rate([_vehicle_status(craft) for craft in crafts], t_s)

    def show_vehicles_at_limited_rate(self, vehicles: list[VehicleStatus], t_s: float) -> None:
        """Show these vehicles at flight time `t_s`, at most every REFRESH_WALL_S."""
        now = wall_s()
        if now < self._next_wall_s:
            return
        self._next_wall_s = now + REFRESH_WALL_S
        pace = t_s / max(now - self._started_wall_s, 1e-6)
        if self._live is not None:
            self._live.update(render_vehicles(vehicles, t_s, pace))
        elif t_s >= self._next_line_s:
            self._next_line_s = t_s + LINE_INTERVAL_S
            for vehicle in vehicles:
                self.console.print(
                    _format_status_line(vehicle, t_s), highlight=False, soft_wrap=True
                )


def _vehicle_status(craft: Craft) -> VehicleStatus:
    row = craft.record.rows[-1] if craft.record.rows else (0.0,) * 13
    return VehicleStatus(
        label=f"{craft.number} {craft.autopilot_kind}",
        phase=craft.true_flight_phase,
        distance_m=math.hypot(row[1], row[2]),
        up_m=-row[3],
        named_values=craft.operator.named_values,
        status_texts=craft.operator.received_texts,
    )


def render_vehicles(
    vehicles: Sequence[VehicleStatus], t_s: float, speedup_factor: float
) -> RenderableType:
    """Return a table row for each vehicle and, below, the last text from each.

    The table fits 80 columns. Column widths stay constant while the figures change; only the
    texts are truncated.
    """
    table = Table(box=None, pad_edge=False)
    for name, justify, least in COLUMNS:
        table.add_column(name, justify=justify, no_wrap=True, min_width=least)
    for vehicle in vehicles:
        table.add_row(*_live_view_cells(vehicle))
    return Group(
        Text(f"{t_s:.0f} s of flight time at {speedup_factor:.0f} x real time", no_wrap=True),
        table,
        *(_last_text_line(vehicle) for vehicle in vehicles),
    )


def _last_text_line(vehicle: VehicleStatus) -> Text:
    last_text = vehicle.status_texts[-1][1] if vehicle.status_texts else "-"
    return Text(f"{vehicle.label} reports: {last_text}", no_wrap=True, overflow="ellipsis")


def _live_view_cells(vehicle: VehicleStatus) -> list[str]:
    named_values = vehicle.named_values
    return [
        vehicle.label,
        vehicle.phase,
        f"{vehicle.distance_m:.0f}",
        f"{vehicle.up_m:.0f}",
        _format_wind(named_values, ""),
        f"{named_values['LW_MARGIN']:+.1f}" if "LW_MARGIN" in named_values else "-",
        _p_home_cell(named_values.get("LW_PHOME"), named_values.get("LW_PSTATED")),
    ]


def _p_home_cell(p_home: float | None, p_home_stated: float | None) -> str:
    """Return P(home) as stated to people in a narrow column; * where the evidence limits it."""
    if p_home is None or p_home_stated is None:
        return "-"
    return f"{math.floor(1e3 * p_home_stated) / 1e3:.3f}{'*' if p_home_stated < p_home else ''}"


def _format_wind(named_values: Mapping[str, float], unit: str) -> str:
    if "LW_WINDN" not in named_values or "LW_WINDE" not in named_values:
        return "-"
    north, east = named_values["LW_WINDN"], named_values["LW_WINDE"]
    from_deg = math.degrees(math.atan2(-east, -north)) % 360.0
    return f"{math.hypot(north, east):.1f}{unit} from {from_deg:03.0f}"


def _format_status_line(vehicle: VehicleStatus, t_s: float) -> str:
    label, phase, away, up, _, margin, p_home = _live_view_cells(vehicle)
    messages = [
        label,
        phase,
        f"out {away} m",
        f"up {up} m",
        f"wind {_format_wind(vehicle.named_values, ' m/s')}",
    ]
    messages.append(f"margin {margin}" if margin == "-" else f"margin {margin} Wh")
    messages.append(f"P(home) {p_home}")
    messages += [vehicle.status_texts[-1][1]] if vehicle.status_texts else []
    return f"t={t_s:5.0f} s  " + ", ".join(messages)


def borderless_table(title: str, *columns: tuple[str, JustifyMethod]) -> Table:
    """Return an empty table without a frame, for terminals of 80 columns."""
    table = Table(
        title=title,
        title_justify="left",
        caption_justify="left",
        box=box.SIMPLE_HEAD,
        show_edge=False,
        pad_edge=False,
    )
    for name, justify in columns:
        table.add_column(name, justify=justify, no_wrap=True)
    return table


def results_table(result: dict[str, Any], *, gate_enabled: bool) -> RenderableType:
    """Return the flights of a run: a table of figures, then the decisions of each flight."""
    title = "gate on" if gate_enabled else "GATE OFF: the return budget does not end a flight"
    if any(row["judged_by"] == "companion" for row in result["flights"]):
        title += "\nfrom the companion's record; - needs ground truth"
    table = borderless_table(
        title,
        ("\nvehicle", "left"),
        ("\nend", "left"),
        ("used\nWh", "right"),
        ("above\nreserve", "right"),
        ("time\ns", "right"),
        ("wind\nRMSE", "right"),
        ("\nNEES", "right"),
        ("least\nP(home)", "right"),
        ("clair-\nvoyant", "right"),
    )
    decision_lines: list[RenderableType] = []
    for row in result["flights"]:
        number = row["vehicle"].rpartition("-")[2]
        table.add_row(
            f"{number} {row['autopilot']}",
            row["outcome"] or "-",
            _format_number(row["energy_used_wh"], 1),
            _format_number(row["margin_wh"], 1, sign="+"),
            _format_number(row["flight_time_s"], 0),
            _format_number(row["wind_rmse_mps"], 2),
            _format_number(row["wind_nees"], 2),
            _p_home_cell(row["p_home_min"], row["p_home_stated_min"]),
            _format_clairvoyant(row),
        )
        messages = ", ".join(_notable_decision_names_with_counts(row["decisions"])) or "nothing"
        decision_lines.append(Text(f"{number} decided: {messages}"))
    return Group(table, "* limit of evidence; flights.json has the model's", *decision_lines)


def grounding_findings_or_kill_messages(row: dict[str, Any]) -> list[str]:
    """Return the findings that kept an external vehicle on the ground, and the remedy; or how its
    companion process was killed.
    """
    if row.get("died"):
        return [row["died"]]
    if row["judged_by"] != "companion" or row["flight_time_s"] != 0.0:
        return []
    findings = row["findings"]
    messages = [f"{'MISSING' if f['blocks'] else 'off    '}  {f['words']}" for f in findings]
    if any(f["blocks"] for f in findings):
        messages.append("--configure sets these and restores the old values after landing")
    return messages


def end_reason_and_settings_messages(row: dict[str, Any]) -> list[str]:
    """Return the companion's reason for the end of a flight, and the state of changed settings."""
    number = row["vehicle"].rpartition("-")[2]
    reason_by_kind = {d["kind"]: d["reason"] for d in row["decisions"]}
    reason = reason_by_kind.get("grounded") or reason_by_kind.get("finished") or row.get("reason")
    ended = "no take-off" if row["flight_time_s"] == 0.0 else "ended"
    by_truth = row["judged_by"] == "truth" and row["flight_time_s"] != 0.0
    differs = by_truth and reason and not reason.startswith(f"{row['outcome']}: ")
    note = " (the companion's estimate; the table is by truth)" if differs else ""
    messages = [f"{number} {ended}: {reason}{note}"] if reason else []
    settings = row.get("settings", [])
    restored = ", ".join(_format_setting(s) for s in settings if s["restored"])
    left = ", ".join(_format_setting(s) for s in settings if not s["restored"])
    if restored:
        messages.append(f"{number} settings changed and restored: {restored}")
    if left:
        messages.append(
            f"{number} settings NOT restored: {left}; run `companion restore` once the vehicle is"
            " disarmed"
        )
    return messages


def _format_setting(setting: dict[str, Any]) -> str:
    value = setting["set"]
    now = "as an earlier flight left it" if value is None else f"{value:g}"
    return f"{setting['name']} ({setting['before']:g}, set {now})"


def _notable_decision_names_with_counts(decisions: list[dict[str, Any]]) -> list[str]:
    messages: list[str] = []
    for decision in decisions:
        if decision["kind"] in ROUTINE_DECISIONS:
            continue
        decision_name = decision["kind"].replace("_", " ")
        if not messages or messages[-1].split(" x")[0] != decision_name:
            messages.append(decision_name)
        else:
            count = int(messages[-1].split(" x")[1]) if " x" in messages[-1] else 1
            messages[-1] = f"{decision_name} x{count + 1}"
    return messages


def _format_clairvoyant(row: dict[str, Any]) -> str:
    if row["clairvoyant"] is None:
        return "-"
    return f"{row['clairvoyant']} {row['clairvoyant_margin_wh']:+.1f}"


def _format_number(value: float | None, digits: int, sign: str = "") -> str:
    return "-" if value is None else f"{value:{sign}.{digits}f}"
