"""What kind of vehicle a MAV_TYPE is, in the words that every log reader uses."""

from companion.adapters.autopilots.codec import mavlink
from companion.core.replay.recorded_flight import MULTIROTOR

MULTIROTORS = (
    mavlink.MAV_TYPE_QUADROTOR,
    mavlink.MAV_TYPE_HEXAROTOR,
    mavlink.MAV_TYPE_OCTOROTOR,
    mavlink.MAV_TYPE_TRICOPTER,
    mavlink.MAV_TYPE_COAXIAL,
    mavlink.MAV_TYPE_DECAROTOR,
    mavlink.MAV_TYPE_DODECAROTOR,
)
WORDS = {"surface boat": "boat", "ground rover": "rover"}


def vehicle_of(mav_type: int) -> str | None:
    """The vehicle's kind; `None` where the number says nothing (generic, or unknown to MAVLink)."""
    if mav_type in MULTIROTORS:
        return MULTIROTOR
    entry = mavlink.enums["MAV_TYPE"].get(mav_type)
    if entry is None or mav_type == mavlink.MAV_TYPE_GENERIC:
        return None
    name = entry.name.removeprefix("MAV_TYPE_").lower().replace("_", " ")
    return "VTOL" if name.startswith("vtol") else WORDS.get(name, name)
