"""The rows of the mFSTSP benchmark: each is planned, checked, and kept.

A row is a problem, a vehicle file and a number of drones. Rows that are done are kept in a journal
until all are, so Ctrl-C loses only those under way.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

import ground_station.core
from companion.core.base.errors import LeewayError
from ground_station.adapters.files.compiled_code import keep_compiled_code
from ground_station.adapters.files.mfstsp_files import read_problem, read_vehicles
from ground_station.adapters.workers.side_by_side import PieceLost, Workers, side_by_side
from ground_station.core.benchmark.mfstsp import MfstspData, MfstspDrone, mfstsp_problem
from ground_station.core.benchmark.schedule_check import CheckedDrone, CheckedProblem, violations_of

Row = dict[str, Any]


class RowsLost(LeewayError):
    """Rows whose workers were killed twice; the journal keeps all others."""

    def __init__(self, lost: Sequence[str]) -> None:
        super().__init__("\n".join(f"lost: {row}" for row in lost))


@dataclass(frozen=True, slots=True)
class BenchRow:
    """One row to plan."""

    folder: Path
    vehicles: str
    drones: int


@dataclass(frozen=True, slots=True)
class BenchParams:
    """What decides the rows' values. `seconds` None: the default policy's trials."""

    seconds: float | None
    seed: int
    policy: str = "search"


def rows_to_plan(folders: list[Path], vehicles: list[str], drones: list[int]) -> list[BenchRow]:
    """Problems, then vehicle files, then drones."""
    return [BenchRow(f, v, d) for f in folders for v in vehicles for d in drones]


def settings_of(rows: list[BenchRow], params: BenchParams) -> str:
    """A digest of all that decides the rows: files, parameters and the planner's sources."""
    digest = hashlib.sha256(repr((params, [str(row) for row in rows])).encode())
    folders = sorted({row.folder for row in rows})
    inputs = [path for folder in folders for path in sorted(folder.iterdir()) if path.is_file()]
    core = Path(next(iter(ground_station.core.__path__)))
    inputs += [core / "benchmark" / "mfstsp.py", *sorted((core / "truck_drones").rglob("*.py"))]
    for path in [*inputs, *sorted(folders[0].parent.glob("tbl_vehicles_*.csv"))]:
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def solve_row(row: BenchRow, params: BenchParams) -> Row:
    """Plan one row. LeewayError where the independent checker finds a violation."""
    keep_compiled_code()
    # Imported late: the folder of the compiled code must be set before.
    from ground_station.app.benchmarks.timed_search import plan_row

    data = read_problem(row.folder)
    fleet = read_vehicles(row.folder.parent / f"tbl_vehicles_{row.vehicles}.csv")
    if row.drones > len(fleet.drones):
        raise LeewayError(f"vehicle file {row.vehicles}: has {len(fleet.drones)} drones only")
    drone = fleet.drones[0]
    if any(other != drone for other in fleet.drones[: row.drones]):
        raise LeewayError(f"vehicle file {row.vehicles}: drones that differ are not in the rules")
    problem = mfstsp_problem(data, drone, row.drones, fleet.deliver_s)
    seed = int(hashlib.sha256(f"{params.seed} {row.folder.name}".encode()).hexdigest()[:15], 16)
    schedule, seconds = plan_row(
        problem, np.random.default_rng(seed), params.policy, params.seconds
    )
    report = {
        "problem": row.folder.name,
        "vehicles": row.vehicles,
        "drones": row.drones,
        "makespan_s": schedule.makespan_s,
        "seconds": seconds,
        "truck_route": list(schedule.truck_route),
        "sorties": [_with_number(asdict(sortie)) for sortie in schedule.sorties],
        "driver": [_with_number(asdict(task)) for task in schedule.driver],
        "truck": [asdict(stop) for stop in schedule.stops],
    }
    faults = violations_of(checked_problem(data, drone, fleet.deliver_s, row.drones), report)
    if faults:
        name = f"{row.folder.name}, vehicles {row.vehicles}, {row.drones} drones"
        raise LeewayError(f"{name}: the schedule breaks the rules: {'; '.join(faults[:3])}")
    return report


def _with_number(part: Row) -> Row:
    """Drones are numbered from 1 in reports."""
    if part["drone"] is not None:
        part["drone"] += 1
    return part


def checked_problem(
    data: MfstspData, drone: MfstspDrone, deliver_s: float, drones: int
) -> CheckedProblem:
    """The files' own numbers for the checker."""
    return CheckedProblem(
        places_deg=list(zip(data.lat_deg.tolist(), data.lon_deg.tolist(), strict=True)),
        parcels_lb=data.parcel_lb.tolist(),
        travel_s=data.travel_s.tolist(),
        deliver_s=deliver_s,
        drone=CheckedDrone(**asdict(drone)),
        drones=drones,
    )


class RowJournal:
    """Rows that are done, one JSON line each, below a line with the digest of the settings."""

    def __init__(self, out: Path | None, settings: str) -> None:
        self._path = None if out is None else out.with_name(out.name + ".journal")
        self._head = f"{settings}\n".encode()

    def read(self) -> dict[int, Row]:
        """Rows of the same settings by number; none where the journal is of other settings."""
        if self._path is None or not self._path.exists():
            return {}
        head, _, rest = self._path.read_bytes().partition(b"\n")
        if head + b"\n" != self._head:
            return {}
        done: dict[int, Row] = {}
        for line in rest.splitlines():
            try:
                number, row = msgspec.json.decode(line, type=tuple[int, Row])
            except msgspec.DecodeError:
                break  # cut off in the middle of a line
            done[number] = row
        return done

    def start(self, done: dict[int, Row]) -> None:
        """Begin the file again with the rows that are done."""
        if self._path is not None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            lines = [msgspec.json.encode(item) + b"\n" for item in done.items()]
            fresh = self._path.with_name(self._path.name + ".new")
            fresh.write_bytes(self._head + b"".join(lines))
            fresh.replace(self._path)

    def add(self, number: int, row: Row) -> None:
        """Keep one row."""
        if self._path is not None:
            with self._path.open("ab") as file:
                file.write(msgspec.json.encode((number, row)) + b"\n")

    def remove(self) -> None:
        """Delete it: the rows are in the JSON file now."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)


def run_rows(
    rows: list[BenchRow],
    params: BenchParams,
    jobs: int,
    journal: RowJournal,
    tell: Callable[[int, Row], None],
) -> list[Row]:
    """All rows in order, on `jobs` processes. `tell` is called for each when it is done.

    Raises: RowsLost, when all others are done.
    """
    done = journal.read()
    journal.start(done)
    for number, row in done.items():
        tell(number, row)
    pending = [number for number in range(len(rows)) if number not in done]
    plan, lost = partial(solve_row, params=params), list[str]()
    for ended in side_by_side((rows[number] for number in pending), plan, Workers(jobs)):
        if isinstance(ended, PieceLost):
            row = ended.piece
            name = f"{row.folder.name} {row.vehicles} x{row.drones}"
            lost.append(f"{name}: {ended.why}")
            continue
        number = pending[ended.index]
        journal.add(number, ended.result)
        done[number] = ended.result
        tell(number, ended.result)
    if lost:
        raise RowsLost(lost)
    return [done[number] for number in range(len(rows))]
