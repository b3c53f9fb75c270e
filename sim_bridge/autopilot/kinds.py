"""What a user chooses about a simulated autopilot: which one, its links, its battery sensing."""

from enum import Enum


class AutopilotKind(Enum):
    """ArduCopter 4.7-dev or PX4 1.18."""

    ARDUPILOT = "ardupilot"
    PX4 = "px4"


class LinkKind(Enum):
    """What a MAVLink instance of PX4 was started for. It decides what is streamed by default."""

    ONBOARD = "onboard"
    GCS = "gcs"


class BatterySensing(Enum):
    """Where the autopilot's battery figures come from.

    `POWER_MODULE` measures volts and amperes. `SIH_TIMER` is what PX4's SIH simulator reports: a
    percentage from a timer, and nothing else.
    """

    POWER_MODULE = "power_module"
    SIH_TIMER = "sih_timer"
