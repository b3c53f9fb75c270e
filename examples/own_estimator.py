"""Own wind estimator: score it beside ours on flights with an anemometer.

The flights are the closed-form log of wind_from_a_log.py, with the airspeed that an anemometer
would read; use a folder of your own flights.

    python examples/own_estimator.py
"""

# %%
import tempfile
from pathlib import Path

import numpy as np
import wind_from_a_log

import companion
import sim_bridge


# --8<-- [start:estimator]
class StillAir:
    """Estimates no wind at all, with a standard deviation of 3 m/s."""

    def __init__(self, airframe: companion.Airframe) -> None:
        self.airframe = airframe

    def update(self, observation: companion.WindObservation) -> tuple[str, ...]:
        return ()

    def belief(self, t_s: float) -> companion.WindBelief:
        return companion.WindBelief(t_s, np.zeros(2), 9.0 * np.eye(2), ("tilt",), True)


# --8<-- [end:estimator]


# %%
if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        wind_from_a_log.write_log(Path(folder) / "1.csv", companion.read_airframe("m100"))
        for score in sim_bridge.score_wind(folder, ["own_estimator:StillAir"]):
            print(f"{score.estimator:45} {score.score_mps:6.2f} m/s")
