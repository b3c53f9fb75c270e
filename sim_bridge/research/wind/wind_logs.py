"""Recorded winds as scenarios read them."""

from pathlib import Path

from companion.core.base.errors import LeewayError
from companion.core.routing.scenario import LogWind
from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.wind_log import load_wind_log


def read_wind_log(path: Path, longest_mission_s: float) -> LogWind:
    """A CSV of `t_s, wind_speed_mps, wind_from_deg` as a scenario's wind (to east, to north).

    Missions start early enough to end within the recording.
    """
    try:
        log = load_wind_log(path)
    except TruthError as error:
        raise LeewayError(str(error)) from error
    first, last = log.t_s[0], log.t_s[-1]
    return LogWind(
        t_s=list(log.t_s),
        wind_en_mps=list(zip(log.to_east_mps, log.to_north_mps, strict=True)),
        start_s=(first, max(first, last - longest_mission_s)),
    )
