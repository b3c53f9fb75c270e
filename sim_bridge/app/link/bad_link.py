"""A link with the faults of real links (repeats, damage, delay, garbage); the vehicle is healthy.

Some datagrams of the vehicle are doubled, truncated, delayed or reordered. The link adds garbage,
frames of other systems and components, and frames of the vehicle that hold NaN, unknown fields or
an invalid time. The same generator gives the same faults.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from sim_bridge.app.link.client_messages import heartbeat
from sim_bridge.autopilot.mavlink.codec import Encoder, Message

GARBAGE_BYTES = 400
DELAY_STEPS = (1, 4)  # delay of a frame in exchanges of 0.1 s
FAULT_FRAC = 0.15  # of the datagrams, for each of: doubled, truncated, delayed
INVALID_TIME_MS = 2_000_000_000
NEIGHBOUR_SYSTEM = 2  # another vehicle's system id

SYS_STATUS_COUNTS = (
    *(f"onboard_control_sensors_{kind}" for kind in ("present", "enabled", "health")),
    *("load", "drop_rate_comm", "errors_comm"),
    *(f"errors_count{k}" for k in range(1, 5)),
)


@dataclass(slots=True)
class FaultyLink:
    """Faulty link between one vehicle (`system`) and its companion."""

    system: int
    rng: np.random.Generator
    disturbed_exchange_count: int = 0
    _delayed: list[tuple[int, bytes]] = field(default_factory=list)
    _encoders: dict[tuple[int, int], Encoder] = field(default_factory=dict)

    def apply_random_faults_to_exchange(
        self, datagrams: list[bytes], time_since_boot_ms: int
    ) -> list[bytes]:
        """Return the datagrams of one exchange after faults, with added unwanted frames."""
        self.disturbed_exchange_count += 1
        due = [data for step, data in self._delayed if step <= self.disturbed_exchange_count]
        self._delayed = [
            (step, data) for step, data in self._delayed if step > self.disturbed_exchange_count
        ]
        out: list[bytes] = []
        for data in datagrams:
            doubled, torn, late = self.rng.random(3) < FAULT_FRAC
            if late:
                self._delayed.append(
                    (self.disturbed_exchange_count + int(self.rng.integers(*DELAY_STEPS)), data)
                )
            else:
                out.append(data)
            if doubled:
                out.append(data)
            if torn:
                out.append(data[: int(self.rng.integers(1, len(data)))])
        out += due
        out += self._other_sender_frames(time_since_boot_ms) + self._unusable_frames(
            time_since_boot_ms
        )
        out.append(self.rng.bytes(int(self.rng.integers(1, GARBAGE_BYTES))))
        order = self.rng.permutation(len(out))
        return [out[int(k)] for k in order]

    def _encode_frame(self, component: int, message: Message, system: int | None = None) -> bytes:
        sender = (self.system if system is None else system, component)
        encoder = self._encoders.setdefault(sender, Encoder(*sender))
        return encoder.encode_next_frame(message)

    def _other_sender_frames(self, time_since_boot_ms: int) -> list[bytes]:
        """Return frames of another vehicle, of this vehicle's gimbal and of a ground station."""
        return [
            self._encode_frame(1, heartbeat(2, 12, 129, 4 << 16 | 5 << 24), NEIGHBOUR_SYSTEM),
            self._encode_frame(1, heartbeat(2, 3, 129, 6), NEIGHBOUR_SYSTEM),
            self._encode_frame(1, _position(time_since_boot_ms, 10.0, 20.0), NEIGHBOUR_SYSTEM),
            self._encode_frame(1, Message("MISSION_CURRENT", seq=1), NEIGHBOUR_SYSTEM),
            self._encode_frame(154, heartbeat(26, 8, 129, 0)),
            self._encode_frame(154, _attitude(time_since_boot_ms, 1.2)),
            self._encode_frame(190, heartbeat(6, 8, 129, 0), 255),
        ]

    def _unusable_frames(self, time_since_boot_ms: int) -> list[bytes]:
        """Return frames of the vehicle without usable content."""
        return [
            self._encode_frame(1, message)
            for message in (
                _attitude(time_since_boot_ms, math.nan),
                _attitude(INVALID_TIME_MS + self.disturbed_exchange_count % 2_000 * 1_000_000, 1.0),
                _position(time_since_boot_ms, 0.0, 0.0),
                Message(
                    "SYS_STATUS",
                    voltage_battery=65535,
                    current_battery=-1,
                    battery_remaining=-1,
                    **dict.fromkeys(SYS_STATUS_COUNTS, 0),
                ),
                Message(
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
                ),
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


def _attitude(time_since_boot_ms: int, roll_rad: float) -> Message:
    rates = dict.fromkeys(("rollspeed", "pitchspeed", "yawspeed"), 0.0)
    return Message(
        "ATTITUDE", time_boot_ms=time_since_boot_ms, roll=roll_rad, pitch=0.0, yaw=0.0, **rates
    )


def _position(time_since_boot_ms: int, lat_deg: float, lon_deg: float) -> Message:
    return Message(
        "GLOBAL_POSITION_INT",
        time_boot_ms=time_since_boot_ms,
        lat=round(lat_deg * 1e7),
        lon=round(lon_deg * 1e7),
        hdg=65535,
        **dict.fromkeys(("alt", "relative_alt", "vx", "vy", "vz"), 0),
    )
