// The server's event stream: a whole picture first, then merge patches (RFC 7396).

import { ask } from "./server.js";

const AGAIN_MS = 1000;

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

// `show(picture, server time in us)` for each picture, `lost()` when the connection breaks;
// `refused()` if the user has no read access; the stream then ends.
export async function listen(show, lost, refused) {
  for (;;) {
    const answer = await ask("/events");
    if (answer?.status === 401) return refused();
    if (answer?.ok) await follow(answer.body, show);
    lost();
    await new Promise((done) => setTimeout(done, AGAIN_MS));
  }
}

async function follow(body, show) {
  const reader = body.pipeThrough(new TextDecoderStream()).getReader();
  let [rest, picture] = ["", null];
  for (;;) {
    const { value, done } = await reader.read().catch(() => ({ done: true }));
    if (done) return;
    const blocks = (rest + value).split("\n\n");
    rest = blocks.pop();
    for (const fields of blocks.map(event)) {
      if (!fields.data) continue;
      const told = JSON.parse(fields.data);
      picture = fields.event === "patch" ? merged(picture, told.content) : told.content;
      show(picture, told.t_us);
    }
  }
}

// Parses one server-sent event; this server sends one data line per event.
function event(block) {
  return Object.fromEntries(block.split("\n").map((line) => {
    const at = line.indexOf(": ");
    return [line.slice(0, at), line.slice(at + 2)];
  }));
}
