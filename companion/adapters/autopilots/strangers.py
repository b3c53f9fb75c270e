"""Packets at a UDP port from elsewhere than the vehicle: a few may speak, a flood may not.

Others may have something to say (a ground station that signs, a second onboard computer), so they
are not shut out. But everything that waits to be heard delays the vehicle's own word, and while the
companion is behind it decides nothing.
"""

from dataclasses import dataclass

PACKETS_HZ = 100
"""Of all strangers together: a ground station that uploads a mission sends 20 to 50 a second."""

LARGEST_BYTES = 2048
"""MAVLink over UDP keeps to Ethernet frames of 1500."""


@dataclass(slots=True)
class StrangerLimit:
    """Counts by the second. `refused`: packets that were not taken, ever."""

    refused: int = 0
    _second: float | None = None
    _taken: int = 0

    def takes(self, size_bytes: int, now_s: float, *, is_limited: bool) -> bool:
        """Whether a packet is taken. Not `is_limited`: no vehicle is known yet, its size counts."""
        if self._second is None or not 0.0 <= now_s - self._second < 1.0:
            self._second, self._taken = now_s, 0
        self._taken += 1
        if size_bytes <= LARGEST_BYTES and (not is_limited or self._taken <= PACKETS_HZ):
            return True
        self.refused += 1
        return False
