"""Frames that the map's page draws, at rest and while it is moved, in software rendering."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from playwright.sync_api import Page

COUNT = """([seconds, moving]) => new Promise((done) => {
  const [began, times] = [performance.now(), []];
  const frame = (now) => {
    times.push(now);
    const key = times.length % 40 < 20 ? 'ArrowLeft' : 'ArrowRight';
    if (moving) document.body.dispatchEvent(new KeyboardEvent('keydown', { key, bubbles: true }));
    if (performance.now() - began < 1000 * seconds) return requestAnimationFrame(frame);
    const apart = times.slice(1).map((time, k) => time - times[k]);
    done([apart.length / (times.at(-1) - times[0]) * 1000, Math.max(...apart)]);
  };
  requestAnimationFrame(frame);
})"""
"""Frames a second and the longest time between two, ms; `moving`: the map is panned each frame."""


@dataclass(frozen=True, slots=True)
class FrameRate:
    """What was drawn. `task_ms`: work of the page's main thread for each frame."""

    frames_hz: float
    longest_ms: float
    task_ms: float


def frame_rate(page: "Page", seconds: float, *, moving: bool) -> FrameRate:
    """Watch the page for so long."""
    session = page.context.new_cdp_session(page)
    session.send("Performance.enable")

    def task_s() -> float:
        found = session.send("Performance.getMetrics")["metrics"]
        return next(one["value"] for one in found if one["name"] == "TaskDuration")

    before_s = task_s()
    frames_hz, longest_ms = page.evaluate(COUNT, [seconds, moving])
    return FrameRate(frames_hz, longest_ms, 1000.0 * (task_s() - before_s) / (frames_hz * seconds))
