// Places labels without overlaps: by rank, at eight anchors about their symbol, then further away. A
// label without room is shortened to its name, and left out if that has none either.

const CELL = 64;
const pen = document.createElement("canvas").getContext("2d");
const family = getComputedStyle(document.documentElement).fontFamily;
const widths = new Map();
const DISTANCES = [0, 14, 30, 48];

export function widthOf(words, font) {
  const key = `${font}|${words}`;
  if (!widths.has(key)) {
    if (widths.size > 5000) widths.clear();
    pen.font = `${font} ${family}`;
    widths.set(key, pen.measureText(words).width + 2);
  }
  return widths.get(key);
}

class Boxes {
  cells = new Map();
  * #keys([left, top, right, low]) {
    for (let x = Math.floor(left / CELL); x <= Math.floor(right / CELL); x++)
      for (let y = Math.floor(top / CELL); y <= Math.floor(low / CELL); y++) yield x * 65536 + y;
  }
  add(box) {
    for (const key of this.#keys(box)) this.cells.has(key) ? this.cells.get(key).push(box) : this.cells.set(key, [box]);
  }
  hits(box) {
    for (const key of this.#keys(box))
      for (const [left, top, right, low] of this.cells.get(key) ?? [])
        if (left < box[2] && right > box[0] && top < box[3] && low > box[1]) return true;
    return false;
  }
}

// `wanted`: { id, rank, x, y, r, words, more, tag, must }; `hard`, `soft`: boxes of symbols, of which a label
// that must be shown may cover soft ones; `bounds`: the visible area. Returns labels with `left`, `top`, `width`.
export function placeLabels(wanted, hard, soft, bounds, before) {
  const [taken, symbols] = [new Boxes(), new Boxes()];
  for (const box of hard) taken.add(box);
  for (const box of soft) symbols.add(box);
  const inside = (box) => box[0] > bounds[0] && box[1] > bounds[1] && box[2] < bounds[2] && box[3] < bounds[3];
  const found = [];
  for (const one of [...wanted].sort((a, b) => a.rank - b.rank)) {
    const high = one.tag ? 20 : 18;
    const short = widthOf(one.words, one.tag ? "bold 12px" : "600 11.5px") + (one.tag ? 12 : 2);
    const full = one.more ? short + widthOf(one.more, "12px") + 6 : short;
    const fits = (box, covers) => inside(box) && !taken.hits(box) && (covers || !symbols.hits(box));
    const spot = (wide, covers) => {
      const start = before.get(one.id) ?? 0;
      for (const far of one.must ? DISTANCES : [0])
        for (let k = 0; k < 8; k++) {
          const anchor = (start + k) % 8;
          const [dx, dy] = anchorAt(anchor, one.r + far, wide, high);
          const box = [one.x + dx - 1, one.y + dy, one.x + dx + wide + 1, one.y + dy + high];
          if (fits(box, covers)) return { box, anchor };
        }
      return null;
    };
    let [wide, at] = [full, spot(full, false)];
    if (!at) [wide, at] = [short, spot(short, false)];
    if (!at && one.must) at = spot(short, true);
    if (!at) continue;
    taken.add(at.box);
    before.set(one.id, at.anchor);
    found.push({ ...one, left: at.box[0] + 1, top: at.box[1], width: wide, height: high, more: wide === full ? one.more : "" });
  }
  return found;
}

function anchorAt(k, r, wide, high) {
  const near = 0.7 * r;
  return [[r, -high / 2], [-r - wide, -high / 2], [-wide / 2, -r - high], [-wide / 2, r],
    [near, -near - high], [-near - wide, -near - high], [near, near], [-near - wide, near]][k];
}
