"""Fly and plot: one simulated flight, its outcome by truth, and P(home) over time.

python examples/fly_and_plot.py
"""

# %%
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

import sim_bridge

(flight,) = sim_bridge.fly("default", autopilot="px4", seed=1)
print(f"{flight.outcome}, {flight.margin_wh:+.1f} Wh above the reserve, run folder {flight.run}")

# %% What the companion computed, from its decision log
assessment, wind = flight.table("assessment"), flight.table("wind")
print(f"{len(assessment['t_s'])} assessments, least P(home) {flight.p_home_min:.3f}")

figure, (above, below) = plt.subplots(2, sharex=True, layout="constrained")
above.plot(assessment["t_s"], assessment["margin_wh"])
above.set_ylabel("margin (Wh)")
below.plot(wind["t_s"], wind["to_n_mps"], label="to north")
below.plot(wind["t_s"], wind["to_e_mps"], label="to east")
below.set(xlabel="autopilot's time (s)", ylabel="wind (m/s)")
below.legend()
figure.savefig("flight.png", dpi=100)
print("wrote flight.png")
