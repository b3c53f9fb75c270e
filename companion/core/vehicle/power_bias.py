"""Ratio of measured to modelled power, estimated in flight.

A scalar Kalman filter on the logarithm of measured over modelled power. It does not model how the
error changes with speed and load, so its standard deviation never falls below `regime_std_frac`:
the model's errors on the return differ slightly from those on the outbound route.

A single outlier is a manoeuvre and is ignored. Many in a row are a change of the vehicle
(`draw_change`): the filter restarts with the std `change_std_log` and the measurements since the
change.
"""

import math
from dataclasses import dataclass

from companion.core.base.errors import LeewayError
from companion.core.vehicle.draw_change import DetectedChange, DrawChangeDetector

SNAPSHOT_FORMAT = "power-scale/1"
_OUTLIER_FRAC = 0.5  # a larger deviation of the log ratio is a manoeuvre, not a model error


@dataclass(frozen=True, slots=True)
class PowerScaleParams:
    """`noise_frac` is the error of one second (gusts, throttle), correlated over `memory_s`."""

    noise_frac: float = 0.15
    memory_s: float = 15.0
    drift_frac2ps: float = 0.02**2 / 600.0
    regime_std_frac: float = 0.03  # fit of the M100 logs over 0 to 10 m/s: 3.3 % rms
    change_std_log: float = 0.5  # after a change: factor 1.65 at one sigma, 2.7 at two


@dataclass(frozen=True, slots=True)
class ModelError:
    """Ratio of real to modelled energy, with its relative standard deviation `std_frac`."""

    scale: float
    std_frac: float

    @property
    def scale_std(self) -> float:
        """Standard deviation of `scale`."""
        return self.scale * self.std_frac


class PowerScale:
    """Filter of one vehicle's power ratio; `prior_std_frac` is the file's `model_std_frac`.

    `prior_log`: the log of the scale before the first measurement.
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
        self._regime_std = min(self._params.regime_std_frac, prior_std_frac)
        self._variance = prior_std_frac**2 - self._regime_std**2
        self._change = DrawChangeDetector()

    def update_and_report_draw_change(
        self, dt_s: float, measured_w: float, modelled_w: float, age_s: float = 0.0
    ) -> bool:
        """Process the mean power of the last `dt_s` in flight; ignore non-positive values.

        `age_s`: age of the measurement. Returns True if it confirmed a lasting change of the draw.
        """
        if not (dt_s > 0.0 and measured_w > 0.0 and modelled_w > 0.0):
            return False
        ratio = math.log(measured_w / modelled_w)
        if not math.isfinite(ratio):
            return False
        change = self._change.update_and_detect_change(dt_s, ratio, self._log, age_s)
        if change is not None:
            self._restart_filter_at_change(change)
            return True
        if abs(ratio - self._log) <= _OUTLIER_FRAC:
            self._update_log_ratio_filter(ratio, dt_s)
        return False

    def _update_log_ratio_filter(self, log_power_ratio: float, dt_s: float) -> None:
        p = self._params
        self._variance += p.drift_frac2ps * dt_s
        noise = p.noise_frac**2 * 2.0 * p.memory_s / min(dt_s, p.memory_s)
        gain = self._variance / (self._variance + noise)
        self._log += gain * (log_power_ratio - self._log)
        self._variance *= 1.0 - gain

    def _restart_filter_at_change(self, change: DetectedChange) -> None:
        """Restart at the change with the measurements since; a fall ends at the model's power."""
        p = self._params
        variance = p.change_std_log**2
        noise = p.noise_frac**2 * 2.0 * p.memory_s / change.duration_s
        gain = variance / (variance + noise)
        after = self._log + gain * change.deviation_log
        self._log = max(after, 0.0) if change.deviation_log < 0.0 else after
        self._variance = variance * (1.0 - gain)

    def model_error(self) -> ModelError:
        """Return the estimated scale and its uncertainty for the remaining flight."""
        return ModelError(math.exp(self._log), math.sqrt(self._variance + self._regime_std**2))

    def snapshot(self) -> dict[str, object]:
        """Return the state for a checkpoint."""
        return {"format": SNAPSHOT_FORMAT, "log": self._log, "variance": self._variance}

    def restore(self, snapshot: dict[str, object]) -> None:
        """Restore a checkpoint. Raises LeewayError for an invalid one."""
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
