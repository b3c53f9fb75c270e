// The server's events: a whole picture first, then what changed (RFC 7396).

export function merged(before, patch) {
  if (patch === null || typeof patch !== "object" || Array.isArray(patch)) return patch;
  const plain = before !== null && typeof before === "object" && !Array.isArray(before);
  const after = plain ? { ...before } : {};
  for (const [key, value] of Object.entries(patch)) {
    if (value === null) delete after[key];
    else after[key] = merged(after[key], value);
  }
  return after;
}

// `show(picture, server time in us)` for each picture; `lost()` when the connection breaks.
export function listen(show, lost) {
  let picture = null;
  const source = new EventSource("/events");
  const take = (event, after) => {
    const told = JSON.parse(event.data);
    picture = after(told.content);
    show(picture, told.t_us);
  };
  source.addEventListener("picture", (event) => take(event, (content) => content));
  source.addEventListener("patch", (event) => take(event, (content) => merged(picture, content)));
  source.addEventListener("error", () => {
    lost();
    if (source.readyState !== EventSource.CLOSED) return; // the browser tries again by itself
    setTimeout(() => listen(show, lost), 1000);
  });
}
