// Keyboard shortcuts for all mouse actions.

const STEP_PX = 80;

export function bindKeys(deeds, { view, past }) {
  const all = {
    ...deeds,
    " ": () => past()?.toggle(),
    ",": () => past()?.step(-1),
    ".": () => past()?.step(1),
    "<": () => past()?.faster(-1),
    ">": () => past()?.faster(1),
    m: () => past()?.nextMark(),
    "+": () => view.zoomBy(0.5),
    "=": () => view.zoomBy(0.5),
    "-": () => view.zoomBy(-0.5),
    ArrowLeft: () => view.pan(-STEP_PX, 0),
    ArrowRight: () => view.pan(STEP_PX, 0),
    ArrowUp: () => view.pan(0, -STEP_PX),
    ArrowDown: () => view.pan(0, STEP_PX),
  };
  document.addEventListener("keydown", (event) => {
    const deed = all[event.key];
    if (!deed || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key !== "Escape" && event.target.closest?.("input:not([type=range], [type=radio], [type=file])")) return;
    if (event.key.startsWith("Arrow") && document.activeElement?.closest("#list, #attention, #past, #day, #card, #board")) return;
    if ([" ", "Enter"].includes(event.key) && document.activeElement?.closest("button, select, a, summary, input")) return;
    event.preventDefault();
    deed();
  });
}
