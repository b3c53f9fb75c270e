"""Faults in a PX4 ULog: flags of failsafe, failure detector and estimator."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

TopicRows = dict[str, NDArray[Any]]

ARMED = 2
"""vehicle_status.arming_state."""

FAULT_TOPICS = ("failsafe_flags", "failure_detector_status", "estimator_status")
FAULT_FIELDS = (
    *("attitude_invalid", "angular_velocity_invalid", "local_altitude_invalid"),
    *("fd_critical_failure", "fd_motor_failure", "fd_imbalanced_prop", "fd_roll", "fd_pitch"),
    *("battery_unhealthy", "navigator_failure", "flight_time_limit_exceeded"),
    *("filter_fault_flags", "failure_detector_status"),
)
"""Fields that are 0 in a normal flight; other flags tell which modes cannot run."""


def fault_starts(topics: dict[str, list[TopicRows]]) -> tuple[tuple[float, str], ...]:
    """Return time and name of each fault flag that is set while armed."""
    found: list[tuple[float, str]] = []
    status = topics.get("vehicle_status", [])
    if not status or "arming_state" not in status[0]:
        return ()
    status_s, is_armed = status[0]["t_s"], status[0]["arming_state"] == ARMED
    for topic in ("vehicle_status", *FAULT_TOPICS):
        for rows in topics.get(topic, [])[:1]:
            at = np.searchsorted(status_s, rows["t_s"], side="right") - 1
            in_flight = (at >= 0) & is_armed[np.maximum(at, 0)]
            for name in FAULT_FIELDS:
                is_set = in_flight & (rows.get(name, np.zeros(at.size)) != 0)
                starts = is_set & ~np.concatenate([[False], is_set[:-1]])
                found += [(t_s, f"{topic}: {name}") for t_s in rows["t_s"][starts].tolist()]
    return tuple(found)
