// Formatting of times and numbers. Server times are microseconds since 1970, by its clock.

export const clock = (us) => new Date(us / 1000).toLocaleTimeString();

export const moment = (us) => new Date(us / 1000).toLocaleString();

export function minutes(seconds) {
  const whole = Math.max(0, Math.round(seconds));
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
}

export const figure = (value, digits) => (value === undefined ? "-" : value.toFixed(digits));

// Formats a number with its unit, or "-" if unknown.
export const measure = (value, digits, unit) => (value === undefined ? "-" : `${value.toFixed(digits)} ${unit}`);

// P(home) as stated to people: at most the limit of evidence, and never rounded up.
export function homeWords(value, limit = 1) {
  if (value === undefined) return "-";
  if (limit < value) return `risk at most 1 in ${Math.floor(1 / (1 - limit) + 1e-6)} (limit of evidence)`;
  return value > 0.9999 ? "above 0.9999" : (Math.floor(1e4 * value + 1e-9) / 1e4).toFixed(4);
}

export function ago(us, nowUs) {
  return us === undefined ? "never" : `${Math.max(0, (nowUs - us) / 1e6).toFixed(0)} s ago`;
}

export function truckWords(truck, nowUs) {
  if (truck.stop === undefined) return truck.phase;
  if (truck.phase === "driving") return `drives to ${truck.stop}${byPlan(truck.drive, nowUs)}`;
  const left = truck.leaves_us === undefined ? "" : (truck.leaves_us - nowUs) / 1e6;
  const leaves = left === "" ? "" : left >= 0 ? `, leaves in ${minutes(left)}` : `, due ${minutes(-left)} ago`;
  const waits = (truck.waits_for ?? []).map((why) => why.split(" ")[0]);
  return `at ${truck.stop}${leaves}${waits.length ? `, waits for ${[...new Set(waits)].join(", ")}` : ""}`;
}

function byPlan(drive, nowUs) {
  if (!drive) return "";
  const left = (drive.arrive_us - nowUs) / 1e6;
  return left >= 0 ? `, planned arrival in ${minutes(left)}` : `, planned arrival ${minutes(-left)} ago`;
}

export function windWords({ to_ne_mps: [north, east], source }) {
  const from = (Math.atan2(-east, -north) * 180) / Math.PI;
  const bearing = String(Math.round(from + 360) % 360).padStart(3, "0");
  return `${Math.hypot(north, east).toFixed(1)} m/s from ${bearing}°: ${source}`;
}
