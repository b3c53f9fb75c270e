"""Residual plots of a calibration: what the fit leaves, against what it should not depend on."""

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from companion.core.calibration.airframe_fit import Calibration
from companion.core.calibration.power import air_speeds
from companion.core.calibration.records import Blocks


def plot_residuals(folder: Path, done: Calibration, flights: list[Blocks]) -> None:
    """Write drag.png and power.png: residuals against airspeed and time, a colour a flight."""
    folder.mkdir(parents=True, exist_ok=True)
    drag, drag_axes = plt.subplots(2, 2, figsize=(11, 7), sharey=True, layout="constrained")
    power, power_axes = plt.subplots(1, 2, figsize=(11, 4), sharey=True, layout="constrained")
    for i, blocks in enumerate(flights):
        flown = blocks.pick(blocks.airborne)
        airspeed, _ = air_speeds(blocks, done.drag.winds[i])
        for axis, name in enumerate(("forward", "right")):
            left = done.drag.residual_mps2[i][:, axis]
            drag_axes[axis, 0].plot(airspeed, left, ".", ms=3, label=blocks.name)
            drag_axes[axis, 1].plot(flown.t_s, left, ".", ms=3)
            drag_axes[axis, 0].set_ylabel(f"{name}: measured less fitted, m/s²")
        at = done.power.settled[i]
        left = 100.0 * np.asarray(done.power.residual_frac[i])
        power_axes[0].plot(airspeed[at], left, ".", ms=3, label=blocks.name)
        power_axes[1].plot(flown.t_s[at], left, ".", ms=3)
    power_axes[0].set_ylabel("power: measured over fitted, %")
    for axes in (drag_axes[-1], power_axes):
        axes[0].set_xlabel("airspeed, m/s")
        axes[1].set_xlabel("time in the log, s")
    for figure, axes, name in ((drag, drag_axes.flat, "drag"), (power, power_axes.flat, "power")):
        for each in axes:
            each.axhline(0.0, color="0.6", lw=0.8)
        figure.axes[0].legend(fontsize=7)
        figure.savefig(folder / f"{name}.png", dpi=110)
        plt.close(figure)
