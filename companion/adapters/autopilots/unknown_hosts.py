"""Rate limit for UDP packets from other hosts than the vehicle's.

Other hosts (a ground station that signs, a second onboard computer) are legitimate, so they are not
blocked. But queued packets delay the vehicle's telemetry, and the companion takes no decisions
while it processes a backlog.
"""

from dataclasses import dataclass

PACKETS_HZ = 100
"""For all other hosts together: a ground station uploads a mission with 20 to 50 a second."""

MAX_PACKET_BYTES = 2048
"""MAVLink over UDP fits Ethernet frames of 1500 bytes."""


@dataclass(slots=True)
class UnknownHostLimit:
    """Counts packets per second. `refused`: total of rejected packets."""

    refused: int = 0
    _second_start_s: float | None = None
    _accepted: int = 0

    def accepts_after_counting_packet(
        self, size_bytes: int, now_s: float, *, is_rate_limited: bool
    ) -> bool:
        """Return True to accept a packet. Unless `is_rate_limited` (vehicle known), only size
        counts.
        """
        if self._second_start_s is None or not 0.0 <= now_s - self._second_start_s < 1.0:
            self._second_start_s, self._accepted = now_s, 0
        self._accepted += 1
        if size_bytes <= MAX_PACKET_BYTES and (not is_rate_limited or self._accepted <= PACKETS_HZ):
            return True
        self.refused += 1
        return False
