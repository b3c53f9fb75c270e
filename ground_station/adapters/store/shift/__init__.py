"""What a dispatcher's shift needs: days, hand-over, packs, and drones out of service."""
