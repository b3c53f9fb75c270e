"""Wind estimator, wind forecast and wind process. Imports vehicle and base."""

from typing import TYPE_CHECKING

from companion.core.base.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from companion.core.wind.ekf import WindEstimatorParams
    from companion.core.wind.estimator import WindEstimator
    from companion.core.wind.forecast import WindForecast, WindOutlook
    from companion.core.wind.observation import WindBelief, WindObservation
    from companion.core.wind.process import WindProcessParams, wind_process_from_dict

__all__ = [
    "WindBelief",
    "WindEstimator",
    "WindEstimatorParams",
    "WindForecast",
    "WindObservation",
    "WindOutlook",
    "WindProcessParams",
    "wind_process_from_dict",
]

__getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "WindBelief": ".observation",
        "WindEstimator": ".estimator",
        "WindEstimatorParams": ".ekf",
        "WindForecast": ".forecast",
        "WindObservation": ".observation",
        "WindOutlook": ".forecast",
        "WindProcessParams": ".process",
        "wind_process_from_dict": ".process",
    },
)
