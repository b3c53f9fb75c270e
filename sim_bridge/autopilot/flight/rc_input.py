"""Radio control as the autopilot receives it: sticks, mode switch, loss of signal."""

from collections.abc import Sequence
from dataclasses import dataclass

_CHANNELS = 18
_KEEP_CHANNEL = 65535
_RELEASE_OVERRIDE = 0


@dataclass(frozen=True, slots=True)
class Sticks:
    """Stick positions, -1 to 1 (throttle 0 to 1); pitch forward is negative, as its servo pulse."""

    roll: float
    pitch: float
    throttle: float
    yaw: float


def normalized_stick_position(pulse_us: int) -> float:
    """-1 to 1 from a servo pulse of 1100 to 1900 us; the middle 40 us are the dead zone."""
    offset = pulse_us - 1500
    if abs(offset) <= 20:
        return 0.0
    return max(-1.0, min(1.0, offset / 400.0))


class RcInput:
    """Channels of a receiver, or overridden over MAVLink for a while."""

    def __init__(self) -> None:
        self._receiver: list[int] | None = None
        self._override = [_RELEASE_OVERRIDE] * _CHANNELS
        self._override_until_s: list[float | None] = [None] * _CHANNELS
        self.lost_since_s: float | None = None
        self.was_present = False
        self.channels: list[int] | None = None

    def clear_signal_history(self) -> None:
        """A signal that was present before the boot is not missed."""
        self.was_present = False

    def set_receiver_channels(self, channel_pulses_us: Sequence[int] | None) -> None:
        """Set the receiver's output from now on, in microseconds; None is no signal."""
        if channel_pulses_us is None:
            self._receiver = None
            return
        values = [int(value) for value in channel_pulses_us][:_CHANNELS]
        self._receiver = values + [0] * (_CHANNELS - len(values))

    def store_channel_overrides(
        self, channel_pulses_us: Sequence[int], expiry_time_s: float
    ) -> None:
        """RC_CHANNELS_OVERRIDE: 65535 leaves a channel, 0 gives it back to the receiver."""
        for index, value in enumerate(channel_pulses_us[:_CHANNELS]):
            if value == _KEEP_CHANNEL:
                continue
            self._override[index] = value
            self._override_until_s[index] = expiry_time_s if value != _RELEASE_OVERRIDE else None

    def update_channels_and_signal_loss(self, t_s: float) -> None:
        """Merge receiver and overrides into `channels`; note when both are lost."""
        live = [until is not None and until > t_s for until in self._override_until_s]
        if self._receiver is None and not any(live):
            self.channels = None
            if self.was_present and self.lost_since_s is None:
                self.lost_since_s = t_s
            return
        base = self._receiver or [0] * _CHANNELS
        self.channels = [
            over if on else value
            for over, on, value in zip(self._override, live, base, strict=True)
        ]
        self.was_present = True
        self.lost_since_s = None

    def time_since_signal_loss_s(self, t_s: float) -> float:
        """Seconds since the signal was lost; 0 while it is present or never was."""
        return 0.0 if self.lost_since_s is None else t_s - self.lost_since_s

    def stick_positions(self) -> Sticks | None:
        """The four sticks in the usual order of channels (roll, pitch, throttle, yaw)."""
        channels = self.channels
        if channels is None or channels[2] == 0:
            return None
        throttle = max(0.0, min(1.0, (channels[2] - 1100) / 800.0))
        return Sticks(
            normalized_stick_position(channels[0] or 1500),
            normalized_stick_position(channels[1] or 1500),
            throttle,
            normalized_stick_position(channels[3] or 1500),
        )

    def switch_position(self, channel_number: int, position_edges_us: Sequence[int]) -> int | None:
        """Position of a mode switch on a channel (1 is the first), counted from 0."""
        if self.channels is None or not 1 <= channel_number <= _CHANNELS:
            return None
        pulse = self.channels[channel_number - 1]
        if not 800 <= pulse <= 2200:
            return None
        return sum(pulse > edge for edge in position_edges_us)
