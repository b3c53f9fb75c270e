"""Recorded winds as scenarios read them."""

import csv
import math
from pathlib import Path

from companion.core.errors import LeewayError
from companion.core.scenario import LogWind

COLUMNS = ("t_s", "wind_speed_mps", "wind_from_deg")


def read_wind_log(path: Path, longest_mission_s: float) -> LogWind:
    """A CSV of `t_s, wind_speed_mps, wind_from_deg` as a scenario's wind (to east, to north).

    Missions start early enough to end within the recording.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            reader = csv.DictReader(file)
            if tuple(reader.fieldnames or ()) != COLUMNS:
                raise LeewayError(
                    f"{path}: columns {', '.join(reader.fieldnames or ())},"
                    f" expected {', '.join(COLUMNS)}"
                )
            samples = [tuple(float(row[c]) for c in COLUMNS) for row in reader]
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from None
    except (TypeError, ValueError):
        raise LeewayError(f"{path}: a cell is not a number") from None
    if not samples:
        raise LeewayError(f"{path}: no samples")
    times = [t for t, _, _ in samples]
    winds = [
        (-speed * math.sin(math.radians(origin)), -speed * math.cos(math.radians(origin)))
        for _, speed, origin in samples
    ]
    last = max(times[0], times[-1] - longest_mission_s)
    return LogWind(t_s=times, wind_en_mps=winds, start_s=(times[0], last))
