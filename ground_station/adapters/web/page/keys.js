// Keyboard shortcuts for all mouse actions.

const STEP_PX = 80;

export function bindKeys({ view, nextDrone, nextAlarm, fit, centre, reach, theme, close, help, past }) {
  const deeds = {
    j: () => nextDrone(1),
    k: () => nextDrone(-1),
    a: nextAlarm,
    f: fit,
    c: centre,
    r: reach,
    t: theme,
    "?": help,
    " ": () => past()?.toggle(),
    ",": () => past()?.step(-1),
    ".": () => past()?.step(1),
    "<": () => past()?.faster(-1),
    ">": () => past()?.faster(1),
    m: () => past()?.nextMark(),
    Escape: close,
    "+": () => view.zoomBy(0.5),
    "=": () => view.zoomBy(0.5),
    "-": () => view.zoomBy(-0.5),
    ArrowLeft: () => view.pan(-STEP_PX, 0),
    ArrowRight: () => view.pan(STEP_PX, 0),
    ArrowUp: () => view.pan(0, -STEP_PX),
    ArrowDown: () => view.pan(0, STEP_PX),
  };
  document.addEventListener("keydown", (event) => {
    const deed = deeds[event.key];
    if (!deed || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.closest?.("input:not([type=range])")) return;
    if (event.key.startsWith("Arrow") && document.activeElement?.closest("#lists, #attention, #past")) return;
    if (event.key === " " && document.activeElement?.closest("button, select")) return;
    event.preventDefault();
    deed();
  });
}
