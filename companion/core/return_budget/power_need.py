"""Energy that must remain for the power of each leg: the pack's limit, as part of the need.

A leg of power P can only be flown while the pack holds more energy than `PackPower` states as
unusable at P. Where that is above the reserve, the need of a route grows so that this energy still
remains at the end of each of its legs. A warm, healthy pack adds nothing.
"""

from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.vehicle.pack_model import PackPower


@dataclass(frozen=True, slots=True)
class PowerNeed:
    """Power limit of a pack for the legs of one assessment.

    `scale` is the ratio of real to modelled energy; `deviates` (K,) select each sample's resistance
    (standard normal).
    """

    pack: PackPower
    reserve_wh: float
    scale: float
    deviates: Floats

    def remaining_need_by_leg_wh(
        self, energy_wh: Floats, time_s: Floats, samples: slice = slice(None)
    ) -> Floats | None:
        """Return the modelled energy above the reserve that must remain after each leg, (legs, K),
        at least 0. None if it is 0 for all legs. `samples` selects the samples of the columns.
        """
        power_w = self.scale * 3600.0 * energy_wh / np.maximum(time_s, 1e-3)
        unusable_wh = self.pack.unusable_energy_wh(power_w, self.deviates[samples])
        above_wh = np.maximum(unusable_wh - self.reserve_wh, 0.0) / self.scale
        return above_wh if bool(np.any(above_wh > 0.0)) else None


def additional_need_wh(energy_wh: Floats, remaining_need_wh: Floats) -> Floats:
    """Return the energy (K,) by which the need of these legs, in order, exceeds their sum."""
    after_wh = np.cumsum(energy_wh[::-1], axis=0)[::-1] - energy_wh
    return np.maximum((remaining_need_wh - after_wh).max(axis=0, initial=0.0), 0.0)
