"""The picture of a replay: wind, energy and promise over one time axis.

matplotlib is imported only here and only when a picture is asked for: it is no part of the
vehicle's install.
"""

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np

from companion.core.base.errors import LeewayError
from companion.core.replay.flight_replay import Moment, ReplayResult
from companion.core.replay.recorded_flight import RecordedFlight, WindReference

NORTH, EAST, INK, SOFT = "#1b6ca8", "#c2571a", "#222222", "#8a8a8a"
GOOD, BAD = "#2b7a4b", "#b3261e"
SHOWN = {
    "gate_open": (INK, "gate open"),
    "go": (INK, "go"),
    "onward": (SOFT, ""),
    "descend": (INK, "descend"),
    "delivered": (INK, "delivered"),
    "release_unconfirmed": (BAD, "release?"),
    "turn_back": (BAD, "turn back"),
    "divert": (BAD, "divert"),
    "landed": (INK, "landed"),
}
"""Decisions that are drawn: their colour, and their word."""


def require_matplotlib() -> None:
    """Raise LeewayError that names what to install where matplotlib is missing."""
    if importlib.util.find_spec("matplotlib") is None:
        raise LeewayError("--picture needs matplotlib: pip install 'leeway-uas[replay]'")


def draw(path: Path, name: str, log: RecordedFlight, result: ReplayResult) -> None:
    """Draw the flight."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    judged = [m for m in result.moments if m.seen is not None]
    energetic = [m for m in result.moments if m.energy_left_wh is not None]
    heights = [2.2, 2.2, *([1.8] if energetic else []), *([1.6] if judged else [])]
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
    _wind_panel(panels[0], result, 0, log.reference)
    _wind_panel(panels[1], result, 1, log.reference)
    if energetic:
        _energy_panel(panels[2], energetic, result.reserve_wh)
    if judged:
        _promise_panel(panels[-1], judged, 1.0 - result.max_loss)
    for panel in panels:
        _shade_flight(panel, result)
        _mark_decisions(panel, result, words=panel is panels[0])
        panel.grid(visible=True, color="#e4e4e4", linewidth=0.6)
        panel.set_axisbelow(True)
        for side in ("top", "right"):
            panel.spines[side].set_visible(False)
    panels[-1].set_xlabel("time on the log's clock, s")
    panels[0].set_xlim(*_span(log, result))
    what = "What Leeway would have said" if judged else "The wind that Leeway would have known"
    figure.suptitle(f"{what}: {name}", x=0.01, ha="left", fontsize=12)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=130)
    except (OSError, ValueError) as error:
        raise LeewayError(f"{path}: {error}") from error
    finally:
        plt.close(figure)


def _span(log: RecordedFlight, result: ReplayResult) -> tuple[float, float]:
    """The flight with a little before and after: an hour on the bench is not worth its width."""
    start_s, end_s = log.start_s, log.start_s + log.duration_s
    flown = result.wind_t_s[result.in_air]
    if not flown.size:
        return start_s, end_s
    around_s = max(10.0, 0.03 * float(flown[-1] - flown[0]))
    return max(start_s, float(flown[0]) - around_s), min(end_s, float(flown[-1]) + around_s)


def _wind_panel(
    panel: Any, result: ReplayResult, axis: int, reference: WindReference | None
) -> None:
    colour, word = ((NORTH, "north"), (EAST, "east"))[axis]
    t_s, wind = result.wind_t_s, result.wind_to_ne_mps[:, axis]
    band = 2.0 * np.sqrt(result.wind_cov_m2ps2[:, axis, axis])
    panel.fill_between(
        t_s, wind - band, wind + band, color=colour, alpha=0.16, linewidth=0.0, label="2 sigma"
    )
    panel.plot(t_s, wind, color=colour, linewidth=1.3, label="Leeway")
    shown = [wind, *([reference.to_ne_mps[:, axis]] if reference is not None else [])]
    if reference is not None:
        truth = reference.to_ne_mps[:, axis]
        panel.plot(reference.t_s, truth, color=INK, linewidth=1.0, label="anemometer, 10 s mean")
    panel.axhline(0.0, color=SOFT, linewidth=0.7)
    panel.set_ylabel(f"wind to {word}, m/s")
    known = np.concatenate([values[np.isfinite(values)] for values in shown])
    if known.size:
        low, high = np.percentile(known, [0.5, 99.5])
        room = max(1.5, 0.45 * (high - low))
        panel.set_ylim(min(low, 0.0) - room, max(high, 0.0) + room)
    panel.legend(loc="upper right", ncols=3, fontsize=8, frameon=False)


def _energy_panel(panel: Any, moments: list[Moment], reserve_wh: float | None) -> None:
    t_s = np.array([m.t_s for m in moments])
    left = np.array([m.energy_left_wh for m in moments], float)
    std = np.array([m.energy_std_wh for m in moments], float)
    need = np.array([np.nan if m.seen is None else m.seen.energy_need_wh for m in moments])
    panel.fill_between(t_s, left - 2.0 * std, left + 2.0 * std, color=GOOD, alpha=0.16, linewidth=0)
    panel.plot(t_s, left, color=GOOD, linewidth=1.3, label="usable energy left (2 sigma)")
    panel.plot(t_s, need, color=BAD, linewidth=1.1, label="needed for what is ahead (mean)")
    if reserve_wh is not None:
        panel.axhline(reserve_wh, color=SOFT, linewidth=1.0, linestyle="--", label="reserve")
    panel.set_ylim(0.0, 1.25 * float(np.nanmax(left + 2.0 * std)))
    panel.set_ylabel("energy, Wh")
    panel.legend(loc="upper right", ncols=3, fontsize=8, frameon=False)


def _promise_panel(panel: Any, moments: list[Moment], promised: float) -> None:
    t_s = np.array([m.t_s for m in moments])
    policy = np.array([m.seen.p_home for m in moments if m.seen is not None])
    now = np.array([m.seen.p_home_now for m in moments if m.seen is not None])
    panel.plot(t_s, policy, color=INK, linewidth=1.3, label="P(home)")
    panel.plot(t_s, now, color=GOOD, linewidth=1.1, linestyle="--", label="if it turned back now")
    panel.axhline(
        promised, color=BAD, linewidth=0.9, linestyle=":", label=f"promised: {promised:g}"
    )
    panel.set_ylim(-0.03, 1.06)
    panel.set_ylabel("probability")
    panel.legend(loc="lower left", ncols=3, fontsize=8, frameon=False)


def _shade_flight(panel: Any, result: ReplayResult) -> None:
    """On the ground is grey."""
    t_s, ground = result.wind_t_s, ~result.in_air
    if not ground.any():
        return
    edges = np.flatnonzero(np.diff(np.concatenate([[0], ground.astype(int), [0]])))
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        panel.axvspan(t_s[first], t_s[min(last, t_s.size - 1)], color="#f0f0f0", zorder=0)


def _mark_decisions(panel: Any, result: ReplayResult, *, words: bool) -> None:
    for decision in result.decisions:
        if decision.kind not in SHOWN:
            continue
        colour, word = SHOWN[decision.kind]
        panel.axvline(decision.t_s, color=colour, linewidth=0.8, alpha=0.7)
        if words and word:
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
