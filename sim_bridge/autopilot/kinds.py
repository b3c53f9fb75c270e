"""User options of a simulated autopilot: its type, links and battery sensing."""

from enum import Enum


class AutopilotKind(Enum):
    """ArduCopter 4.7-dev or PX4 1.18."""

    ARDUPILOT = "ardupilot"
    PX4 = "px4"


AUTOPILOTS = (AutopilotKind.PX4.value, AutopilotKind.ARDUPILOT.value)
"""Names of the autopilots in options and files, in the order of a mixed fleet."""


class LinkKind(Enum):
    """Purpose of a PX4 MAVLink instance. It selects the default streams."""

    ONBOARD = "onboard"
    GCS = "gcs"


class BatterySensing(Enum):
    """Source of the autopilot's battery data.

    `POWER_MODULE` measures volts and amperes. `SIH_TIMER` is the battery of PX4's SIH simulator:
    only a percentage, from a timer.
    """

    POWER_MODULE = "power_module"
    SIH_TIMER = "sih_timer"
