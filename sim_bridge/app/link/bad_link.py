"""A link with the faults of real links (repeats, damage, delay, garbage); the vehicle is healthy.

Of what the vehicle sends, some is doubled, torn, late or out of order. Between it come garbage,
other systems and components, and frames of the vehicle itself that hold NaN, unknown fields or a
wild time. The same generator gives the same faults.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from sim_bridge.autopilot.mavlink.codec import Encoder, Message

GARBAGE_BYTES = 400
LATE_STEPS = (1, 4)  # a held-back frame comes so many exchanges later, of 0.1 s each
SHARE = 0.15  # of the datagrams, for each of: doubled, torn, held back
WILD_MS = 2_000_000_000
NEIGHBOUR = 2  # another vehicle's system id


@dataclass(slots=True)
class BadLink:
    """Between one vehicle (`system`) and its companion."""

    system: int
    rng: np.random.Generator
    _step: int = 0
    _late: list[tuple[int, bytes]] = field(default_factory=list)
    _senders: dict[tuple[int, int], Encoder] = field(default_factory=dict)

    def spoil(self, datagrams: list[bytes], boot_ms: int) -> list[bytes]:
        """What arrives of one exchange's datagrams, and what should not have come."""
        self._step += 1
        due = [data for step, data in self._late if step <= self._step]
        self._late = [(step, data) for step, data in self._late if step > self._step]
        out: list[bytes] = []
        for data in datagrams:
            doubled, torn, late = self.rng.random(3) < SHARE
            if late:
                self._late.append((self._step + int(self.rng.integers(*LATE_STEPS)), data))
            else:
                out.append(data)
            if doubled:
                out.append(data)
            if torn:
                out.append(data[: int(self.rng.integers(1, len(data)))])
        out += due
        out += self._strangers(boot_ms) + self._unknowns(boot_ms)
        out.append(self.rng.bytes(int(self.rng.integers(1, GARBAGE_BYTES))))
        order = self.rng.permutation(len(out))
        return [out[int(k)] for k in order]

    def _frame(self, component: int, message: Message, system: int | None = None) -> bytes:
        sender = (self.system if system is None else system, component)
        encoder = self._senders.setdefault(sender, Encoder(*sender))
        return encoder.encode(message)

    def _strangers(self, boot_ms: int) -> list[bytes]:
        """Another vehicle in another mode and place, this one's gimbal, a ground station."""
        return [
            self._frame(1, _heartbeat(kind=2, autopilot=12, custom=4 << 16 | 5 << 24), NEIGHBOUR),
            self._frame(1, _heartbeat(kind=2, autopilot=3, custom=6), NEIGHBOUR),
            self._frame(1, _position(boot_ms, 10.0, 20.0), NEIGHBOUR),
            self._frame(1, Message("MISSION_CURRENT", seq=1), NEIGHBOUR),
            self._frame(154, _heartbeat(kind=26, autopilot=8, custom=0)),
            self._frame(154, _attitude(boot_ms, 1.2)),
            self._frame(190, _heartbeat(kind=6, autopilot=8, custom=0), 255),
        ]

    def _unknowns(self, boot_ms: int) -> list[bytes]:
        """The vehicle's own messages with nothing usable in them."""
        return [
            self._frame(1, message)
            for message in (
                _attitude(boot_ms, math.nan),
                _attitude(WILD_MS + self._step % 2_000 * 1_000_000, 1.0),
                _position(boot_ms, 0.0, 0.0),
                _sys_status_unknown(),
                _battery_unknown(),
                Message(
                    "VFR_HUD",
                    airspeed=math.nan,
                    groundspeed=math.nan,
                    alt=math.nan,
                    climb=math.nan,
                    heading=-1,
                    throttle=65535,
                ),
            )
        ]


def _heartbeat(*, kind: int, autopilot: int, custom: int) -> Message:
    return Message(
        "HEARTBEAT",
        type=kind,
        autopilot=autopilot,
        base_mode=129,
        custom_mode=custom,
        system_status=4,
        mavlink_version=3,
    )


def _attitude(boot_ms: int, roll_rad: float) -> Message:
    rates = dict.fromkeys(("rollspeed", "pitchspeed", "yawspeed"), 0.0)
    return Message("ATTITUDE", time_boot_ms=boot_ms, roll=roll_rad, pitch=0.0, yaw=0.0, **rates)


def _position(boot_ms: int, lat_deg: float, lon_deg: float) -> Message:
    return Message(
        "GLOBAL_POSITION_INT",
        time_boot_ms=boot_ms,
        lat=round(lat_deg * 1e7),
        lon=round(lon_deg * 1e7),
        hdg=65535,
        **dict.fromkeys(("alt", "relative_alt", "vx", "vy", "vz"), 0),
    )


def _sys_status_unknown() -> Message:
    zero = ("onboard_control_sensors_present", "onboard_control_sensors_enabled")
    zero += ("onboard_control_sensors_health", "load", "drop_rate_comm", "errors_comm")
    zero += tuple(f"errors_count{k}" for k in range(1, 5))
    return Message(
        "SYS_STATUS",
        voltage_battery=65535,
        current_battery=-1,
        battery_remaining=-1,
        **dict.fromkeys(zero, 0),
    )


def _battery_unknown() -> Message:
    return Message(
        "BATTERY_STATUS",
        current_consumed=-1,
        energy_consumed=-1,
        temperature=32767,
        voltages=(65535,) * 10,
        current_battery=-1,
        id=0,
        battery_function=0,
        type=0,
        battery_remaining=-1,
    )
