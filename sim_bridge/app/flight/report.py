"""The flight on the terminal: one live line a vehicle, then the table."""

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
from sim_bridge.app.flight.fly import Progress
from sim_bridge.app.flight.vehicle_process import Craft

REFRESH_WALL_S = 0.25
LINE_EVERY_S = 30.0
COLUMNS: tuple[tuple[str, JustifyMethod, int], ...] = (
    ("\nvehicle", "left", 11),
    ("\nphase", "left", 17),  # "wait for position", the longest
    ("from\ndepot m", "right", 7),
    ("height\nm", "right", 6),
    ("wind m/s\nfrom deg", "right", 13),
    ("margin\nWh", "right", 6),
    ("P\nhome", "right", 5),
)
"""Of the live view: name, justification, least width."""
ROUTINE = {"planned", "read_back", "authorised", "onward", "looked_again", "finished"}


@dataclass(frozen=True, slots=True)
class Shown:
    """One vehicle as the live view shows it; `away_m` from where it started."""

    label: str
    phase: str
    away_m: float
    up_m: float
    named: Mapping[str, float]
    said: Sequence[tuple[float, str]]


@dataclass(slots=True)
class LiveView(Progress):
    """A live table on a terminal; on anything else a line every half minute of flight."""

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

    def tell(self, line: str) -> None:
        """Print a line for good, above the live table where there is one."""
        self.console.print(line, highlight=False, markup=False, soft_wrap=True)

    def update(self, crafts: list[Craft], t_s: float) -> None:
        """Show where everybody is; called ten times a simulated second."""
        if wall_s() >= self._next_wall_s:
            self.show([_shown(craft) for craft in crafts], t_s)

    def show(self, vehicles: list[Shown], t_s: float) -> None:
        """Show these, `t_s` into the flights."""
        now = wall_s()
        if now < self._next_wall_s:
            return
        self._next_wall_s = now + REFRESH_WALL_S
        pace = t_s / max(now - self._started_wall_s, 1e-6)
        if self._live is not None:
            self._live.update(live_view(vehicles, t_s, pace))
        elif t_s >= self._next_line_s:
            self._next_line_s = t_s + LINE_EVERY_S
            for vehicle in vehicles:
                self.console.print(_line(vehicle, t_s), highlight=False, soft_wrap=True)


def _shown(craft: Craft) -> Shown:
    row = craft.record.rows[-1] if craft.record.rows else (0.0,) * 13
    return Shown(
        label=f"{craft.number} {craft.autopilot_kind}",
        phase=craft.phase,
        away_m=math.hypot(row[1], row[2]),
        up_m=-row[3],
        named=craft.operator.named,
        said=craft.operator.said,
    )


def live_view(vehicles: Sequence[Shown], t_s: float, pace: float) -> RenderableType:
    """A line of figures for each vehicle, and below what each said last.

    Made for 80 columns: columns keep their widths while the figures change, and only what a
    vehicle said is cut off.
    """
    table = Table(box=None, pad_edge=False)
    for name, justify, least in COLUMNS:
        table.add_column(name, justify=justify, no_wrap=True, min_width=least)
    for vehicle in vehicles:
        table.add_row(*_cells(vehicle))
    return Group(
        Text(f"{t_s:.0f} s of flight time at {pace:.0f} x real time", no_wrap=True),
        table,
        *(_says(vehicle) for vehicle in vehicles),
    )


def _says(vehicle: Shown) -> Text:
    said = vehicle.said[-1][1] if vehicle.said else "-"
    return Text(f"{vehicle.label} says: {said}", no_wrap=True, overflow="ellipsis")


def _cells(vehicle: Shown) -> list[str]:
    named = vehicle.named
    return [
        vehicle.label,
        vehicle.phase,
        f"{vehicle.away_m:.0f}",
        f"{vehicle.up_m:.0f}",
        _wind(named, ""),
        f"{named['LW_MARGIN']:+.1f}" if "LW_MARGIN" in named else "-",
        f"{named['LW_PHOME']:.3f}" if "LW_PHOME" in named else "-",
    ]


def _wind(named: Mapping[str, float], unit: str) -> str:
    if "LW_WINDN" not in named or "LW_WINDE" not in named:
        return "-"
    north, east = named["LW_WINDN"], named["LW_WINDE"]
    from_deg = math.degrees(math.atan2(-east, -north)) % 360.0
    return f"{math.hypot(north, east):.1f}{unit} from {from_deg:03.0f}"


def _line(vehicle: Shown, t_s: float) -> str:
    label, phase, away, up, _, margin, p_home = _cells(vehicle)
    words = [label, phase, f"out {away} m", f"up {up} m", f"wind {_wind(vehicle.named, ' m/s')}"]
    words.append(f"margin {margin}" if margin == "-" else f"margin {margin} Wh")
    words.append(f"P(home) {p_home}")
    words += [vehicle.said[-1][1]] if vehicle.said else []
    return f"t={t_s:5.0f} s  " + ", ".join(words)


def slim_table(title: str, *columns: tuple[str, JustifyMethod]) -> Table:
    """An empty table without a frame, for terminals of 80 columns."""
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


def results_table(result: dict[str, Any], *, gate: bool) -> RenderableType:
    """The flights of a run: a table of figures, and below it what each decided."""
    title = "gate on" if gate else "GATE OFF: it flies on whatever the budget says"
    if any(row["judged_by"] == "companion" for row in result["flights"]):
        title += "\nby the companion's own record; - is what only the truth could tell"
    table = slim_table(
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
    decided: list[RenderableType] = []
    for row in result["flights"]:
        number = row["vehicle"].rpartition("-")[2]
        table.add_row(
            f"{number} {row['autopilot']}",
            row["outcome"] or "-",
            _number(row["energy_used_wh"], 1),
            _number(row["margin_wh"], 1, sign="+"),
            _number(row["flight_time_s"], 0),
            _number(row["wind_rmse_mps"], 2),
            _number(row["wind_nees"], 2),
            _number(row["p_home_min"], 3),
            _clairvoyant(row),
        )
        words = ", ".join(_decision_words(row["decisions"])) or "nothing"
        decided.append(Text(f"{number} decided: {words}"))
    return Group(table, "", *decided)


def grounded_words(row: dict[str, Any]) -> list[str]:
    """What is missing on a vehicle of somebody else's that stayed on the ground, and what would
    help; or how its companion died.
    """
    if row.get("died"):
        return [row["died"]]
    if row["judged_by"] != "companion" or row["flight_time_s"] != 0.0:
        return []
    findings = row["findings"]
    words = [f"{'MISSING' if f['blocks'] else 'off    '}  {f['words']}" for f in findings]
    if any(f["blocks"] for f in findings):
        words.append("--configure sets these and puts the old values back after landing")
    return words


def ending_words(row: dict[str, Any]) -> list[str]:
    """Why the flight ended, in its companion's words, and what became of the vehicle's settings."""
    number = row["vehicle"].rpartition("-")[2]
    reasons = {d["kind"]: d["reason"] for d in row["decisions"]}
    reason = reasons.get("grounded") or reasons.get("finished") or row.get("reason")
    ended = "no take-off" if row["flight_time_s"] == 0.0 else "ended"
    words = [f"{number} {ended}: {reason}"] if reason else []
    settings = row.get("settings", [])
    restored = ", ".join(_setting_words(s) for s in settings if s["restored"])
    left = ", ".join(_setting_words(s) for s in settings if not s["restored"])
    if restored:
        words.append(f"{number} settings changed and put back: {restored}")
    if left:
        words.append(
            f"{number} settings NOT put back: {left}; `companion restore` puts them back once it is"
            " disarmed"
        )
    return words


def _setting_words(setting: dict[str, Any]) -> str:
    value = setting["set"]
    now = "as an earlier flight left it" if value is None else f"{value:g}"
    return f"{setting['name']} ({setting['before']:g}, set {now})"


def _decision_words(decisions: list[dict[str, Any]]) -> list[str]:
    words: list[str] = []
    for decision in decisions:
        if decision["kind"] in ROUTINE:
            continue
        word = decision["kind"].replace("_", " ")
        if not words or words[-1].split(" x")[0] != word:
            words.append(word)
        else:
            count = int(words[-1].split(" x")[1]) if " x" in words[-1] else 1
            words[-1] = f"{word} x{count + 1}"
    return words


def _clairvoyant(row: dict[str, Any]) -> str:
    if row["clairvoyant"] is None:
        return "-"
    return f"{row['clairvoyant']} {row['clairvoyant_margin_wh']:+.1f}"


def _number(value: float | None, digits: int, sign: str = "") -> str:
    return "-" if value is None else f"{value:{sign}.{digits}f}"
