"""Frames that the map's page draws, at rest, panned and zoomed, in software rendering."""

from dataclasses import dataclass
from enum import Enum
from statistics import median
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from playwright.sync_api import Page

RUN_S = 4.0

COUNT = """([seconds, motion]) => new Promise((done) => {
  const [began, times, place] = [performance.now(), [], document.querySelector('#place')];
  const { left, top, width, height } = place.getBoundingClientRect();
  const middle = { clientX: left + width / 2, clientY: top + height / 2, bubbles: true };
  const deeds = {
    'at rest': () => {},
    panned: (there) => document.body.dispatchEvent(new KeyboardEvent('keydown',
      { key: there ? 'ArrowLeft' : 'ArrowRight', bubbles: true })),
    zoomed: (there) => place.dispatchEvent(new WheelEvent('wheel',
      { ...middle, deltaY: there ? -30 : 30, cancelable: true })),
  };
  const frame = (now) => {
    times.push(now);
    deeds[motion](times.length % 40 < 20);
    if (performance.now() - began < 1000 * seconds) return requestAnimationFrame(frame);
    done((times.length - 1) / (times.at(-1) - times[0]) * 1000);
  };
  requestAnimationFrame(frame);
})"""
"""Frames a second. Each frame pans by a key's step, or zooms by a tenth of a level: 20 frames
there, 20 back."""


class Motion(Enum):
    """What is done to the map in each frame."""

    AT_REST = "at rest"
    PANNED = "panned"
    ZOOMED = "zoomed"


@dataclass(frozen=True, slots=True)
class FrameRate:
    """Median, least and most of some runs. `main_ms`, `page_ms`: processor time for each frame, of
    the page's main thread and of its process, which has the raster threads too; it hardly goes
    with the machine's load, as frames a second do.
    """

    frames_hz: float
    least_hz: float
    most_hz: float
    main_ms: float
    page_ms: float


def median_rate(page: "Page", motion: Motion, runs: int) -> FrameRate:
    """Watch the page for so many runs of `RUN_S`."""
    session = page.context.new_cdp_session(page)
    session.send("Performance.enable")

    def cpu_s() -> tuple[float, float]:
        found = session.send("Performance.getMetrics")["metrics"]
        told = {one["name"]: one["value"] for one in found}
        return told["ThreadTime"], told["ProcessTime"]

    def run() -> tuple[float, float, float]:
        main_s, page_s = cpu_s()
        frames_hz: float = page.evaluate(COUNT, [RUN_S, motion.value])
        main_after_s, page_after_s = cpu_s()
        ms = 1000.0 / (frames_hz * RUN_S)
        return frames_hz, ms * (main_after_s - main_s), ms * (page_after_s - page_s)

    rates, main, whole = zip(*(run() for _ in range(runs)), strict=True)
    return FrameRate(median(rates), min(rates), max(rates), median(main), median(whole))
