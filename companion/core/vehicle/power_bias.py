"""How much more, or less, the vehicle draws than its model says: learned in flight.

A scalar Kalman filter on the logarithm of measured over modelled power. What it cannot learn is
how the error changes with speed and load, so its standard deviation never falls below
`regime_std_frac`: the model's errors on the way home are not quite those on the way out.
"""

import math
from dataclasses import dataclass

from companion.core.base.errors import LeewayError

SNAPSHOT_FORMAT = "power-scale/1"
_OUTLIER_FRAC = 0.5  # a second that draws so much more or less is a manoeuvre, not the model


@dataclass(frozen=True, slots=True)
class PowerScaleParams:
    """`noise_frac` is one second's error (gusts, throttle), remembered for `memory_s`."""

    noise_frac: float = 0.15
    memory_s: float = 15.0
    walk_frac2ps: float = 0.02**2 / 600.0
    regime_std_frac: float = 0.03  # fit of the M100 logs over 0 to 10 m/s: 3.3 % rms


@dataclass(frozen=True, slots=True)
class ModelError:
    """Energy needed is the model's times `scale`, give or take `std_frac` of it."""

    scale: float
    std_frac: float


class PowerScale:
    """One per vehicle; `prior_std_frac` is the airframe file's `model_std_frac`."""

    def __init__(self, prior_std_frac: float, params: PowerScaleParams | None = None) -> None:
        self._params = params or PowerScaleParams()
        self._log = 0.0
        self._floor = min(self._params.regime_std_frac, prior_std_frac)
        self._variance = prior_std_frac**2 - self._floor**2

    def observe(self, dt_s: float, measured_w: float, modelled_w: float) -> None:
        """Take the mean power of the last `dt_s` in flight; senseless values are ignored."""
        if not (dt_s > 0.0 and measured_w > 0.0 and modelled_w > 0.0):
            return
        ratio = math.log(measured_w / modelled_w)
        if not math.isfinite(ratio) or abs(ratio - self._log) > _OUTLIER_FRAC:
            return
        p = self._params
        self._variance += p.walk_frac2ps * dt_s
        noise = p.noise_frac**2 * 2.0 * p.memory_s / min(dt_s, p.memory_s)
        gain = self._variance / (self._variance + noise)
        self._log += gain * (ratio - self._log)
        self._variance *= 1.0 - gain

    def error(self) -> ModelError:
        """The scale as believed, and how sure that is for the flight that is left."""
        return ModelError(math.exp(self._log), math.sqrt(self._variance + self._floor**2))

    def snapshot(self) -> dict[str, object]:
        """What a checkpoint keeps."""
        return {"format": SNAPSHOT_FORMAT, "log": self._log, "variance": self._variance}

    def restore(self, snapshot: dict[str, object]) -> None:
        """Go on from a checkpoint; LeewayError when it is not one."""
        log, variance = snapshot.get("log"), snapshot.get("variance")
        if not (
            snapshot.get("format") == SNAPSHOT_FORMAT
            and isinstance(log, float)
            and isinstance(variance, float)
            and math.isfinite(log)
            and math.isfinite(variance)
            and variance >= 0.0
        ):
            raise LeewayError(f"checkpoint: expected a {SNAPSHOT_FORMAT} snapshot")
        self._log, self._variance = log, variance
