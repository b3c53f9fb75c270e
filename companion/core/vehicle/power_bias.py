"""How much more, or less, the vehicle draws than its model says: learned in flight.

A scalar Kalman filter on the logarithm of measured over modelled power. What it cannot learn is
how the error changes with speed and load, so its standard deviation never falls below
`regime_std_frac`: the model's errors on the way home are not quite those on the way out.

A single second far off is a manoeuvre and teaches nothing. Many in a row are a change of the
vehicle (`draw_change`): then the filter starts anew, as unsure as `change_std_log`, with what was
measured since.
"""

import math
from dataclasses import dataclass

from companion.core.base.errors import LeewayError
from companion.core.vehicle.draw_change import Departure, DrawChange

SNAPSHOT_FORMAT = "power-scale/1"
_OUTLIER_FRAC = 0.5  # a second that draws so much more or less is a manoeuvre, not the model


@dataclass(frozen=True, slots=True)
class PowerScaleParams:
    """`noise_frac` is one second's error (gusts, throttle), remembered for `memory_s`."""

    noise_frac: float = 0.15
    memory_s: float = 15.0
    walk_frac2ps: float = 0.02**2 / 600.0
    regime_std_frac: float = 0.03  # fit of the M100 logs over 0 to 10 m/s: 3.3 % rms
    change_std_log: float = 0.5  # after a change 1.65 times is likely, 2.7 times is not ruled out


@dataclass(frozen=True, slots=True)
class ModelError:
    """Energy needed is the model's times `scale`, give or take `std_frac` of it."""

    scale: float
    std_frac: float

    @property
    def std(self) -> float:
        """The same of the scale itself."""
        return self.scale * self.std_frac


class PowerScale:
    """One per vehicle; `prior_std_frac` is the airframe file's `model_std_frac`.

    `prior_log`: the log of the scale before anything is learned.
    """

    def __init__(
        self,
        prior_std_frac: float,
        params: PowerScaleParams | None = None,
        *,
        prior_log: float = 0.0,
    ) -> None:
        self._params = params or PowerScaleParams()
        self._log = prior_log
        self._floor = min(self._params.regime_std_frac, prior_std_frac)
        self._variance = prior_std_frac**2 - self._floor**2
        self._change = DrawChange()

    def observe(
        self, dt_s: float, measured_w: float, modelled_w: float, age_s: float = 0.0
    ) -> bool:
        """Take the mean power of the last `dt_s` in flight; senseless values are ignored.

        `age_s`: how long ago it was measured. True where the draw has changed for good by now.
        """
        if not (dt_s > 0.0 and measured_w > 0.0 and modelled_w > 0.0):
            return False
        ratio = math.log(measured_w / modelled_w)
        if not math.isfinite(ratio):
            return False
        departure = self._change.observe(dt_s, ratio, self._log, age_s)
        if departure is not None:
            self._start_anew(departure)
            return True
        if abs(ratio - self._log) <= _OUTLIER_FRAC:
            self._learn(ratio, dt_s)
        return False

    def _learn(self, ratio: float, dt_s: float) -> None:
        p = self._params
        self._variance += p.walk_frac2ps * dt_s
        noise = p.noise_frac**2 * 2.0 * p.memory_s / min(dt_s, p.memory_s)
        gain = self._variance / (self._variance + noise)
        self._log += gain * (ratio - self._log)
        self._variance *= 1.0 - gain

    def _start_anew(self, departure: Departure) -> None:
        """As if nothing had been known when the draw changed; never under the model's own draw."""
        p = self._params
        variance = p.change_std_log**2
        noise = p.noise_frac**2 * 2.0 * p.memory_s / departure.for_s
        gain = variance / (variance + noise)
        after = self._log + gain * departure.by_log
        self._log = max(after, 0.0) if departure.by_log < 0.0 else after
        self._variance = variance * (1.0 - gain)

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
