"""Wind from arrays: feed the estimator one observation at a time.

python examples/wind_from_arrays.py
"""

# %% Two minutes of hover, nose north, leaning two degrees to the left, into the wind
import math

import numpy as np

import companion

airframe = companion.read_airframe("m100")
t_s = np.arange(0.0, 120.0, 0.1)
roll_rad = np.full_like(t_s, math.radians(-2.0))
rng = np.random.default_rng(1)
velocity_ned_mps = rng.normal(0.0, 0.05, (len(t_s), 3))

# %% The estimator
estimator = companion.WindEstimator(airframe)
for k, now_s in enumerate(t_s):
    seen = companion.WindObservation(
        t_s=float(now_s),
        airborne=True,
        mass_kg=airframe.flying_mass_kg(payload_kg=0.0),
        vel_ned_mps=tuple(velocity_ned_mps[k].tolist()),
        roll_rad=float(roll_rad[k]),
        pitch_rad=0.0,
        yaw_rad=0.0,
    )
    for message in estimator.update(seen):
        print(message)

# %% Its estimate: where the air moves to, and the standard deviations
belief = estimator.belief(float(t_s[-1]))
to_n_mps, to_e_mps = belief.mean_to_ne_mps
std_n_mps, std_e_mps = np.sqrt(np.diag(belief.cov_ne_m2ps2))
print(
    f"to north {to_n_mps:+.1f} +- {std_n_mps:.1f} m/s, to east {to_e_mps:+.1f} +- {std_e_mps:.1f}"
)
