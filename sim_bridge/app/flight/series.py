"""`sim-bridge series`: the same flight over many seeds, both autopilots, gate on and off.

What is flown is on disk at once, so a series that was stopped goes on where it was.
"""

import hashlib
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

from companion.adapters.files.params import params_dir
from companion.core.base.errors import LeewayError
from ground_station.adapters.workers.side_by_side import PieceLost, Workers, side_by_side
from sim_bridge.app.flight.fly import FlyOptions, fly
from sim_bridge.app.flight.report import slim_table

PROGRAM = Path(__file__).parents[3]
NOT_SETTINGS = {"autopilot", "seed", "gate", "run_root", "picture", "lockstep_limit_s"}
"""What a row says itself, and what changes no decision."""

OUTCOMES = ("SUC", "DEL", "FAIL", "ABRT", "TAKEN")

Row = dict[str, Any]
Key = tuple[str, int, bool]


def planned(
    base: FlyOptions, *, seeds: list[int], autopilots: list[str], gates: list[bool]
) -> list[FlyOptions]:
    """The flights of a series, in a fixed order."""
    return [
        replace(base, autopilot=autopilot, seed=seed, gate=gate)
        for gate in gates
        for autopilot in autopilots
        for seed in seeds
    ]


def settings_of(base: FlyOptions) -> str:
    """A digest of all that decides a flight but autopilot, seed and gate: the options, the files
    that they name, every parameter file and the program itself."""
    options = {k: str(v) for k, v in asdict(base).items() if k not in NOT_SETTINGS}
    digest = hashlib.sha256(json.dumps(options, sort_keys=True).encode())
    named = [value for value in asdict(base).values() if isinstance(value, Path)]
    for path in [*(p for p in named if p.is_file()), *_program_files()]:
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def _program_files() -> Iterator[Path]:
    for package in ("companion", "sim_bridge"):
        yield from sorted((PROGRAM / package).rglob("*.py"))
    yield from sorted(path for path in params_dir().rglob("*") if path.is_file())


@dataclass(slots=True)
class SeriesFile:
    """The rows on disk; each flight is in the file as soon as it has been flown."""

    path: Path | None
    settings: str
    flown: dict[Key, list[Row]] = field(default_factory=dict)

    @classmethod
    def open(cls, path: Path | None, settings: str) -> "SeriesFile":
        """Take up what the file has of flights with the same settings; others are flown anew."""
        made = cls(path, settings)
        if path is None or not path.exists():
            return made
        try:
            rows = json.loads(path.read_text())["flights"]
            for row in rows:
                if row.get("settings") == settings:
                    key = (row["flavours"], row["seed"], row["gate"])
                    made.flown.setdefault(key, []).append(row)
        except (json.JSONDecodeError, KeyError, TypeError, AttributeError) as error:
            raise LeewayError(f"{path}: not the JSON of a series; name another file") from error
        return made

    def has(self, options: FlyOptions) -> bool:
        """True where this flight need not be flown."""
        return _key(options) in self.flown

    def add(self, options: FlyOptions, rows: list[Row]) -> None:
        """Keep a flight's rows and write the file, whole or not at all."""
        said = {
            "flavours": options.autopilot,
            "seed": options.seed,
            "gate": options.gate,
            "settings": self.settings,
        }
        self.flown[_key(options)] = [row | said for row in rows]
        self.write()

    def write(self) -> None:
        """Write all rows as `{"flights": [...]}`."""
        if self.path is None:
            return
        fresh = self.path.with_name(self.path.name + ".new")
        fresh.write_text(json.dumps({"flights": list(_rows(self.flown.values()))}, indent=1) + "\n")
        fresh.replace(self.path)

    def rows_of(self, flights: list[FlyOptions]) -> list[Row]:
        """The rows of these flights in their order."""
        return list(_rows(self.flown.get(_key(options), []) for options in flights))


def _key(options: FlyOptions) -> Key:
    return options.autopilot, options.seed, options.gate


def _rows(groups: Iterable[list[Row]]) -> Iterator[Row]:
    for group in groups:
        yield from group


@dataclass(frozen=True, slots=True)
class SeriesRun:
    """One row a flight and vehicle, in the flights' order, and the flights that were lost."""

    rows: list[Row]
    lost: list[str]
    """By name, and why: their workers were killed twice."""


def run_series(flights: list[FlyOptions], file: SeriesFile, jobs: int) -> SeriesRun:
    """Fly what is not in the file yet.

    Whatever stops it, Ctrl-C and SIGTERM too, ends the workers, and each of those its companion.
    """
    left = [options for options in flights if not file.has(options)]
    lost = []
    workers = Workers(min(jobs, max(len(left), 1)))
    with Bar(transient=True) as bar:
        task = bar.add_task(f"{len(left)} flights", total=len(left))
        for ended in side_by_side(left, _fly_one, workers, bar.console.print):
            options = left[ended.index]
            if isinstance(ended, PieceLost):
                gate = "on" if options.gate else "OFF"
                lost.append(f"{options.autopilot}, seed {options.seed}, gate {gate}: {ended.why}")
            else:
                file.add(options, ended.result)
            bar.advance(task)
    return SeriesRun(file.rows_of(flights), lost)


def _fly_one(options: FlyOptions) -> list[Row]:
    return fly(options)["flights"]


def summary(rows: list[Row]) -> Table:
    """What the flights came to, by autopilot and gate."""
    table = slim_table(
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
        could = [row for row in group if row["clairvoyant"] == "SUC"]
        did = sum(row["delivered"] and row["home"] for row in could)
        rmse = [row["wind_rmse_mps"] for row in group if row["wind_rmse_mps"] is not None]
        nees = [row["wind_nees"] for row in group if row["wind_nees"] is not None]
        table.add_row(
            f"{autopilot} {'on' if gate else 'OFF'}",
            "/".join(str(counts[name]) for name in OUTCOMES),
            f"{sum(row['home'] for row in group)} of {len(group) - counts['TAKEN']}",
            f"{did} of {len(could)}",
            f"{_mean(rmse)}, {max(rmse, default=0.0):.2f}",
            _mean(nees),
            f"{min(row['margin_wh'] for row in group):+.1f}",
        )
    table.caption = (
        "could: a clairvoyant delivers there and comes home; home: of those that nobody took over"
        " and landed elsewhere; wind in m/s, margin in Wh"
    )
    return table


def _mean(values: list[float]) -> str:
    return f"{statistics.fmean(values):.2f}" if values else "-"


def report(console: Console, rows: list[Row]) -> None:
    """Print the summary and every flight that did not end at home."""
    console.print(summary(rows))
    for row in rows:
        if not row["home"]:
            gate = "" if row["gate"] else " (gate off)"
            what = "landed by a person" if row["outcome"] == "TAKEN" else "not home"
            console.print(
                f"{what}: {row['autopilot']} seed {row['seed']}{gate}: {row['outcome']},"
                f" {row['margin_wh']:+.1f} Wh, {row['run']}",
                highlight=False,
            )
