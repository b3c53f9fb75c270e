"""Reports of wind stations and desks: each counts only if its sender itself signed it."""

from collections.abc import Callable, Iterable

from companion.core.base.desk_heartbeat import DeskHeartbeat
from companion.fleet.messages import Refused, decode_message
from ground_station.core.fleet.fleet_link import DeskHeartbeatReceived, StationWindReceived
from ground_station.core.fleet.station_message import decode_station_wind

Report = StationWindReceived | DeskHeartbeatReceived


def newest_valid_report(
    kind: str, name: str, raws: Iterable[bytes | Refused], reject: Callable[[str], None]
) -> Report | None:
    """Return the newest report of the sender with this name; `reject` receives reasons."""
    newest, newest_us = None, 0
    for raw in raws:
        report = raw if isinstance(raw, Refused) else _decode_report(kind, raw)
        if isinstance(report, Refused):
            reject(f"{name}: {report.reason}")
            continue
        sender, epoch_us, received = report
        if sender != name:
            reject(f"{name} sent a report of {sender}")
        elif newest is None or epoch_us > newest_us:
            newest, newest_us = received, epoch_us
    return newest


def _decode_report(kind: str, raw: bytes) -> tuple[str, int, Report] | Refused:
    """Return the sender, its time and the input; or the reason for the rejection."""
    if kind == "desk":
        heartbeat = decode_message(DeskHeartbeat, raw)
        if isinstance(heartbeat, Refused):
            return heartbeat
        return heartbeat.desk, heartbeat.epoch_us, DeskHeartbeatReceived(heartbeat)
    wind = decode_station_wind(raw)
    if isinstance(wind, Refused):
        return wind
    return wind.station, wind.epoch_us, StationWindReceived(wind)
