// Formatting of times and figures. Server times are microseconds since 1970, by its clock.

const TIME = new Intl.DateTimeFormat("en-GB", { hour: "2-digit", minute: "2-digit" });
const SECONDS = new Intl.DateTimeFormat("en-GB", { hour: "2-digit", minute: "2-digit", second: "2-digit" });
const DATE = new Intl.DateTimeFormat("en-GB", { weekday: "short", day: "numeric", month: "short" });
const SOON_S = 600;
export const SILENT_S = 5; // an older state is shown as outdated
export const UNKNOWN = "not reported yet";
const COMPASS = ["N", "NNE", "NE", "ENE", "E", "ESE", "SE", "SSE", "S", "SSW", "SW", "WSW", "W", "WNW", "NW", "NNW"];

export const clock = (us) => TIME.format(us / 1000);
export const seconds = (us) => SECONDS.format(us / 1000);
export const date = (us) => DATE.format(us / 1000);
export const moment = (us) => `${date(us)} ${seconds(us)}`;

export function span(s) {
  const whole = Math.max(0, Math.round(s));
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
}

// "in 3:02" within ten minutes, else the time.
export function inTime(us, nowUs) {
  const left = (us - nowUs) / 1e6;
  return left >= 0 && left < SOON_S ? `in ${span(left)}` : clock(us);
}

export function age(s) {
  if (s < 9.95) return `${Math.max(0, s).toFixed(1)} s`;
  return s < 120 ? `${Math.round(s)} s` : `${Math.round(s / 60)} min`;
}

// The delivery window, with its date unless it is today's.
export function windowWords({ earliest_us: from, latest_us: to }, nowUs) {
  const first = from ?? to;
  if (first === undefined) return "";
  const day = date(first) === date(nowUs) ? "" : `${date(first)} `;
  return day + (from === undefined ? `by ${clock(to)}` : to === undefined ? `from ${clock(from)}` : `${clock(from)}\u2013${date(from) === date(to) ? "" : `${date(to)} `}${clock(to)}`);
}

const signed = (value) => (Math.round(value) < 0 ? `\u2212${Math.abs(Math.round(value))}` : `+${Math.round(value)}`);
export const wattHours = (value) => `${signed(value)} Wh`;
export const spare = (drone) => (drone.margin_wh === undefined ? "" : wattHours(drone.margin_wh)
  + (drone.spare_min === undefined ? "" : `, ${Math.round(drone.spare_min)} min`));
export const number = (value, digits, unit) => (value === undefined ? UNKNOWN : `${value.toFixed(digits)} ${unit}`);

export const fromDeg = ([north, east]) => (((Math.atan2(-east, -north) * 180) / Math.PI) + 360) % 360;
export const fromWords = (to) => `from ${COMPASS[Math.round(fromDeg(to) / 22.5) % 16]}`;

// Replaces {name} by the time of that name.
export const timed = (words, times) => words.replace(/\{(\w+)\}/g, (_, name) => (times?.[name] ? clock(times[name]) : UNKNOWN));

const PHASES = {
  standby: "Standing by", configure: "Starting", plan: "Planning", upload: "Loading the mission", ready: "Ready", arm: "Starting motors",
  climb: "Climbing", measure: "Measuring the wind", outbound: "Flying out", deliver: "Dropping", release: "Dropping", return: "Flying back",
  divert: "Diverting", land: "Landing", suspended: "Pilot flies", done: "Landed", grounded: "Landed",
  driving: "Driving", at_stop: "At a stop",
};
export const phaseWords = (phase) => PHASES[phase] ?? phase.charAt(0).toUpperCase() + phase.slice(1);

const GLYPHS = { climb: "out", measure: "out", outbound: "out", deliver: "drop", release: "drop", return: "back", divert: "back", land: "back", "last resort": "back", ready: "ready" };
export const kindOf = (drone) => GLYPHS[drone.phase] ?? (drone.armed ? "out" : "load");
export const isFlying = (drone) => ["out", "drop", "back"].includes(kindOf(drone));

export const ageOf = (one, nowUs) => (one.heard_us === undefined ? Infinity : (nowUs - one.heard_us) / 1e6);
// In contact before, and silent now.
export const isSilent = (drone, nowUs) => drone.heard_us !== undefined && (ageOf(drone, nowUs) > SILENT_S || !drone.present);

export const ORDER_WORDS = { stuck: "Stuck", air: "In the air", van: "Loaded", open: "Waiting", delivered: "Delivered", cancelled: "Cancelled", returned: "To sender" };
export const CLOSED = ["delivered", "cancelled", "returned"];
export function orderKind(order, drones) {
  if (order.state !== "assigned") return order.state;
  const drone = drones?.[order.vehicle];
  return drone && isFlying(drone) && !drone.delivered ? "air" : drone?.delivered ? "air" : "van";
}

export const shortId = (id) => id.slice(id.lastIndexOf("-") + 1) || id;
export const byName = new Intl.Collator("en", { numeric: true }).compare;
export const plural = (n, word) => `${n} ${word}${n === 1 ? "" : "s"}`;
