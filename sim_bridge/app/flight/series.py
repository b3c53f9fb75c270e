"""`sim-bridge fly --seeds`: the same flight over many seeds, both autopilots, gate on and off.

Each flight is written to disk when it ends, so a stopped series resumes at the next flight.
"""

import json
import statistics
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress as Bar
from rich.table import Table

from companion.adapters.files.atomic_file import write_text_atomically
from companion.core.base.errors import LeewayError
from ground_station.adapters.workers.side_by_side import ItemLost, WorkerOptions, run_parallel
from sim_bridge.app.flight.fly import FlyOptions, fly_vehicles_and_evaluate
from sim_bridge.app.flight.report import borderless_table
from sim_bridge.app.flight.run_folder import compute_inputs_digest

OPTIONS_NOT_HASHED = {"autopilot", "seed", "gate", "run_root", "picture", "lockstep_limit_s"}
"""Options that a row states itself, or that change no decision."""

OUTCOMES = ("SUC", "DEL", "FAIL", "ABRT", "TAKEN")

Row = dict[str, Any]
Key = tuple[str, int, bool]


def list_flights(
    base_options: FlyOptions, *, seeds: list[int], autopilots: list[str], gate_states: list[bool]
) -> list[FlyOptions]:
    """Return the flights of a series, in a fixed order."""
    return [
        replace(base_options, autopilot=autopilot, seed=seed, gate=gate)
        for gate in gate_states
        for autopilot in autopilots
        for seed in seeds
    ]


def compute_flight_inputs_digest(base_options: FlyOptions) -> str:
    """Return a digest of all inputs of a flight except autopilot, seed and gate."""
    options = {k: v for k, v in asdict(base_options).items() if k not in OPTIONS_NOT_HASHED}
    return compute_inputs_digest(options, [v for v in options.values() if isinstance(v, Path)])


@dataclass(slots=True)
class SeriesFile:
    """Rows of a series on disk; the file is written after each flight."""

    path: Path | None
    settings: str
    rows_by_flight: dict[Key, list[Row]] = field(default_factory=dict)

    @classmethod
    def open_with_matching_rows(cls, path: Path | None, expected_digest: str) -> "SeriesFile":
        """Read the rows of flights with the same settings; other flights are flown again."""
        series = cls(path, expected_digest)
        if path is None or not path.exists():
            return series
        try:
            rows = json.loads(path.read_text())["flights"]
            for row in rows:
                if row.get("settings") == expected_digest:
                    key = (row["flavours"], row["seed"], row["gate"])
                    series.rows_by_flight.setdefault(key, []).append(row)
        except (json.JSONDecodeError, KeyError, TypeError, AttributeError) as error:
            raise LeewayError(
                f"{path}: expected the JSON of a series; name another file"
            ) from error
        return series

    def has_flight(self, options: FlyOptions) -> bool:
        """Return True if the file already has the rows of this flight."""
        return _flight_key(options) in self.rows_by_flight

    def store_flight_and_write_file(self, options: FlyOptions, rows: list[Row]) -> None:
        """Store the rows of a flight and write the file atomically."""
        flight_keys = {
            "flavours": options.autopilot,
            "seed": options.seed,
            "gate": options.gate,
            "settings": self.settings,
        }
        self.rows_by_flight[_flight_key(options)] = [row | flight_keys for row in rows]
        self.write_all_rows()

    def write_all_rows(self) -> None:
        """Write all rows as `{"flights": [...]}`."""
        if self.path is None:
            return
        text = json.dumps({"flights": list(_flatten_rows(self.rows_by_flight.values()))}, indent=1)
        write_text_atomically(self.path, text + "\n", sync_folder=False)

    def rows_of(self, flights: list[FlyOptions]) -> list[Row]:
        """Return the rows of these flights, in their order."""
        return list(
            _flatten_rows(self.rows_by_flight.get(_flight_key(options), []) for options in flights)
        )


def _flight_key(options: FlyOptions) -> Key:
    return options.autopilot, options.seed, options.gate


def _flatten_rows(groups: Iterable[list[Row]]) -> Iterator[Row]:
    for group in groups:
        yield from group


@dataclass(frozen=True, slots=True)
class SeriesRun:
    """One row for each flight and vehicle, in the order of the flights, and the lost flights."""

    rows: list[Row]
    lost_flights: list[str]
    """Name and reason of each; its worker was killed twice."""


def fly_missing_flights(
    flights: list[FlyOptions], series_file: SeriesFile, worker_count: int
) -> SeriesRun:
    """Fly the flights that are not in the file.

    Any stop, including Ctrl-C and SIGTERM, ends the workers; each worker ends its companion.
    """
    remaining = [options for options in flights if not series_file.has_flight(options)]
    lost = []
    workers = WorkerOptions(min(worker_count, max(len(remaining), 1)))
    with Bar(transient=True) as bar:
        task = bar.add_task(f"{len(remaining)} flights", total=len(remaining))
        for ended in run_parallel(remaining, _fly_one, workers, bar.console.print):
            options = remaining[ended.index]
            if isinstance(ended, ItemLost):
                gate = "on" if options.gate else "OFF"
                lost.append(
                    f"{options.autopilot}, seed {options.seed}, gate {gate}: {ended.reason}"
                )
            else:
                series_file.store_flight_and_write_file(options, ended.result)
            bar.advance(task)
    return SeriesRun(series_file.rows_of(flights), lost)


def _fly_one(options: FlyOptions) -> list[Row]:
    return fly_vehicles_and_evaluate(options)["flights"]


def outcomes_by_autopilot_and_gate_table(rows: list[Row]) -> Table:
    """Return the outcomes of the flights, by autopilot and gate."""
    table = borderless_table(
        "flights by autopilot and gate",
        ("autopilot\ngate", "left"),
        ("SUC/DEL/FAIL/\nABRT/TAKEN", "right"),
        ("\nhome", "right"),
        ("delivered\nof could", "right"),
        ("wind RMSE\nmean, most", "right"),
        ("\nNEES", "right"),
        ("least\nmargin", "right"),
    )
    groups: dict[tuple[str, bool], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["autopilot"], row["gate"]), []).append(row)
    for (autopilot, gate), group in groups.items():
        counts = Counter(row["outcome"] for row in group)
        feasible = [row for row in group if row["clairvoyant"] == "SUC"]
        successes = sum(row["delivered"] and row["home"] for row in feasible)
        rmse = [row["wind_rmse_mps"] for row in group if row["wind_rmse_mps"] is not None]
        nees = [row["wind_nees"] for row in group if row["wind_nees"] is not None]
        table.add_row(
            f"{autopilot} {'on' if gate else 'OFF'}",
            "/".join(str(counts[name]) for name in OUTCOMES),
            f"{sum(row['home'] for row in group)} of {len(group) - counts['TAKEN']}",
            f"{successes} of {len(feasible)}",
            f"{_format_mean(rmse)}, {max(rmse, default=0.0):.2f}",
            _format_mean(nees),
            f"{min(row['margin_wh'] for row in group):+.1f}",
        )
    table.caption = (
        "could: a clairvoyant delivers there and returns home; home: of flights that no pilot"
        " landed elsewhere; wind in m/s, margin in Wh"
    )
    return table


def _format_mean(values: list[float]) -> str:
    return f"{statistics.fmean(values):.2f}" if values else "-"


def print_summary_and_flights_not_home(console: Console, rows: list[Row]) -> None:
    """Print the summary and every flight that did not end at home."""
    console.print(outcomes_by_autopilot_and_gate_table(rows))
    for row in rows:
        if not row["home"]:
            gate = "" if row["gate"] else " (gate off)"
            label = "landed by a pilot" if row["outcome"] == "TAKEN" else "not home"
            console.print(
                f"{label}: {row['autopilot']} seed {row['seed']}{gate}: {row['outcome']},"
                f" {row['margin_wh']:+.1f} Wh, {row['run']}",
                highlight=False,
            )
