"""Picture of a replay: wind, energy and probabilities over one time axis.

matplotlib is imported only here and only for a requested picture: it is not part of the vehicle's
installation.
"""

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np

from companion.analysis.replay.flight_replay import ReplayResult, ReplayState
from companion.analysis.replay.recorded_flight import RecordedFlight, WindReference
from companion.core.base.errors import LeewayError

NORTH, EAST, PRIMARY_COLOUR, SECONDARY_COLOUR = "#1b6ca8", "#c2571a", "#222222", "#8a8a8a"
GOOD, BAD = "#2b7a4b", "#b3261e"
DECISION_STYLES = {
    "gate_open": (PRIMARY_COLOUR, "gate open"),
    "go": (PRIMARY_COLOUR, "go"),
    "onward": (SECONDARY_COLOUR, ""),
    "descend": (PRIMARY_COLOUR, "descend"),
    "delivered": (PRIMARY_COLOUR, "delivered"),
    "release_unconfirmed": (BAD, "release?"),
    "turn_back": (BAD, "turn back"),
    "divert": (BAD, "divert"),
    "landed": (PRIMARY_COLOUR, "landed"),
}
"""Drawn decisions: colour and label."""


def require_matplotlib() -> None:
    """Raise LeewayError with the install command if matplotlib is missing."""
    if importlib.util.find_spec("matplotlib") is None:
        raise LeewayError("--picture needs matplotlib: pip install 'leeway-uas[replay]'")


def save_replay_picture(
    picture_path: Path, log_name: str, log: RecordedFlight, result: ReplayResult
) -> None:
    """Draw the replay and save it to `picture_path`."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    assessed_states = [m for m in result.states if m.assessment is not None]
    energy_states = [m for m in result.states if m.energy_left_wh is not None]
    heights = [2.2, 2.2, *([1.8] if energy_states else []), *([1.6] if assessed_states else [])]
    figure, axes = plt.subplots(
        len(heights),
        1,
        sharex=True,
        figsize=(10.0, 1.0 + 1.2 * sum(heights)),
        height_ratios=heights,
        layout="constrained",
        squeeze=False,
    )
    panels: list[Any] = list(axes[:, 0])
    _draw_wind_panel(panels[0], result, 0, log.reference)
    _draw_wind_panel(panels[1], result, 1, log.reference)
    if energy_states:
        _draw_energy_panel(panels[2], energy_states, result.reserve_wh)
    if assessed_states:
        _draw_p_home_panel(panels[-1], assessed_states, 1.0 - result.max_loss)
    for panel in panels:
        _shade_times_on_ground(panel, result)
        _mark_decisions(panel, result, with_labels=panel is panels[0])
        panel.grid(visible=True, color="#e4e4e4", linewidth=0.6)
        panel.set_axisbelow(True)
        for side in ("top", "right"):
            panel.spines[side].set_visible(False)
    panels[-1].set_xlabel("time on the log's clock, s")
    panels[0].set_xlim(*_plotted_time_range_s(log, result))
    title = "Leeway's decisions" if assessed_states else "Leeway's wind estimate"
    figure.suptitle(f"{title}: {log_name}", x=0.01, ha="left", fontsize=12)
    try:
        picture_path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(picture_path, dpi=130)
    except (OSError, ValueError) as error:
        raise LeewayError(f"{picture_path}: {error}") from error
    finally:
        plt.close(figure)


def _plotted_time_range_s(log: RecordedFlight, result: ReplayResult) -> tuple[float, float]:
    """Return the time range of the flight with a margin; long ground times are cut."""
    start_s, end_s = log.start_s, log.start_s + log.duration_s
    flown = result.wind_t_s[result.in_air]
    if not flown.size:
        return start_s, end_s
    margin_s = max(10.0, 0.03 * float(flown[-1] - flown[0]))
    return max(start_s, float(flown[0]) - margin_s), min(end_s, float(flown[-1]) + margin_s)


def _draw_wind_panel(
    panel: Any, result: ReplayResult, ne_component_index: int, reference: WindReference | None
) -> None:
    colour, word = ((NORTH, "north"), (EAST, "east"))[ne_component_index]
    t_s, wind = result.wind_t_s, result.wind_to_ne_mps[:, ne_component_index]
    band = 2.0 * np.sqrt(result.wind_cov_m2ps2[:, ne_component_index, ne_component_index])
    panel.fill_between(
        t_s, wind - band, wind + band, color=colour, alpha=0.16, linewidth=0.0, label="2 sigma"
    )
    panel.plot(t_s, wind, color=colour, linewidth=1.3, label="Leeway")
    shown = [wind, *([reference.to_ne_mps[:, ne_component_index]] if reference is not None else [])]
    if reference is not None:
        truth = reference.to_ne_mps[:, ne_component_index]
        panel.plot(
            reference.t_s, truth, color=PRIMARY_COLOUR, linewidth=1.0, label="anemometer, 10 s mean"
        )
    panel.axhline(0.0, color=SECONDARY_COLOUR, linewidth=0.7)
    panel.set_ylabel(f"wind to {word}, m/s")
    known = np.concatenate([values[np.isfinite(values)] for values in shown])
    if known.size:
        low, high = np.percentile(known, [0.5, 99.5])
        y_margin = max(1.5, 0.45 * (high - low))
        panel.set_ylim(min(low, 0.0) - y_margin, max(high, 0.0) + y_margin)
    panel.legend(loc="upper right", ncols=3, fontsize=8, frameon=False)


def _draw_energy_panel(panel: Any, states: list[ReplayState], reserve_wh: float | None) -> None:
    t_s = np.array([m.t_s for m in states])
    left = np.array([m.energy_left_wh for m in states], float)
    std = np.array([m.energy_std_wh for m in states], float)
    need = np.array(
        [np.nan if m.assessment is None else m.assessment.energy_need_wh for m in states]
    )
    panel.fill_between(t_s, left - 2.0 * std, left + 2.0 * std, color=GOOD, alpha=0.16, linewidth=0)
    panel.plot(t_s, left, color=GOOD, linewidth=1.3, label="usable energy left (2 sigma)")
    panel.plot(t_s, need, color=BAD, linewidth=1.1, label="needed for the remaining mission (mean)")
    if reserve_wh is not None:
        panel.axhline(
            reserve_wh, color=SECONDARY_COLOUR, linewidth=1.0, linestyle="--", label="reserve"
        )
    panel.set_ylim(0.0, 1.25 * float(np.nanmax(left + 2.0 * std)))
    panel.set_ylabel("energy, Wh")
    panel.legend(loc="upper right", ncols=3, fontsize=8, frameon=False)


def _draw_p_home_panel(panel: Any, states: list[ReplayState], promised_probability: float) -> None:
    t_s = np.array([m.t_s for m in states])
    policy = np.array([m.assessment.p_home for m in states if m.assessment is not None])
    now = np.array([m.assessment.p_home_now for m in states if m.assessment is not None])
    panel.plot(t_s, policy, color=PRIMARY_COLOUR, linewidth=1.3, label="P(home), by the model")
    panel.plot(t_s, now, color=GOOD, linewidth=1.1, linestyle="--", label="if it turned back now")
    panel.axhline(
        promised_probability,
        color=BAD,
        linewidth=0.9,
        linestyle=":",
        label=f"promised: {promised_probability:g}",
    )
    panel.set_ylim(-0.03, 1.06)
    panel.set_ylabel("probability")
    panel.legend(loc="lower left", ncols=3, fontsize=8, frameon=False)


def _shade_times_on_ground(panel: Any, result: ReplayResult) -> None:
    """Shade times on the ground grey."""
    t_s, ground = result.wind_t_s, ~result.in_air
    if not ground.any():
        return
    edges = np.flatnonzero(np.diff(np.concatenate([[0], ground.astype(int), [0]])))
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        panel.axvspan(t_s[first], t_s[min(last, t_s.size - 1)], color="#f0f0f0", zorder=0)


def _mark_decisions(panel: Any, result: ReplayResult, *, with_labels: bool) -> None:
    for decision in result.decisions:
        if decision.kind not in DECISION_STYLES:
            continue
        colour, word = DECISION_STYLES[decision.kind]
        panel.axvline(decision.t_s, color=colour, linewidth=0.8, alpha=0.7)
        if with_labels and word:
            panel.annotate(
                word,
                (decision.t_s, 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(2, -2),
                textcoords="offset points",
                rotation=90,
                va="top",
                fontsize=8,
                color=colour,
            )
