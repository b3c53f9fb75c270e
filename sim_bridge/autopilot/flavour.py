"""Which autopilot the simulated vehicle pretends to be."""

from enum import Enum


class Flavour(Enum):
    """ArduCopter 4.7-dev or PX4 1.18, as far as they were measured."""

    ARDUPILOT = "ardupilot"
    PX4 = "px4"


class LinkKind(Enum):
    """What a MAVLink instance of PX4 was started for; it decides what is sent unasked."""

    ONBOARD = "onboard"
    GCS = "gcs"


class BatterySensing(Enum):
    """Where the autopilot's battery figures come from.

    `POWER_MODULE` measures volts and amperes; `SIH_TIMER` is what PX4's SIH simulator reports: a
    percentage that is a timer, and nothing else known.
    """

    POWER_MODULE = "power_module"
    SIH_TIMER = "sih_timer"
