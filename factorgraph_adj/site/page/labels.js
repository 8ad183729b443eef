// Places of texts on a drawing where nothing is covered: beside their point, in one of its corners.
const CELL = 4, HIGH = 14, POINT = 3; // pixels: of the raster, of a text, of half a point
const BESIDE = 8; // pixels of an arrow beside its point that its own name may cover
// Sides of the point, and rows of text above or below it, in the order in which they are tried.
const SIDES = {
  above: [[1, -1], [-1, -1], [1, 1], [-1, 1], [-1, -2], [1, -2]],
  below: [[1, 1], [1, 2], [-1, 1], [1, -1], [-1, 2], [-1, -1]],
};

export class Labels {
  constructor(width, height) { Object.assign(this, { width, height, taken: new Set(), placed: [] }); }

  // Cells of a rectangle.
  cells(x, y, wide, high) {
    const found = [];
    for (let q = Math.floor(y / CELL); q * CELL < y + high; q++) for (let p = Math.floor(x / CELL); p * CELL < x + wide; p++) found.push(p + 16384 * q);
    return found;
  }

  keep(x, y, wide, high) { for (const c of this.cells(x, y, wide, high)) this.taken.add(c); }

  // Keep texts off a point, and off an arrow from a point.
  point(u, v) { this.keep(u - POINT, v - POINT, 2 * POINT, 2 * POINT); }

  arrow(u, v, du, dv) {
    const size = Math.hypot(du, dv);
    for (let s = BESIDE; s <= size; s += CELL) this.keep(u + (s * du) / size - 1, v + (s * dv) / size - 1, 2, 2);
  }

  take(x, y, wide) {
    this.keep(x, y, wide, HIGH);
    this.placed.push([x, y, wide, HIGH]);
    return [x, y];
  }

  // Left upper corner of a text beside a point, which is taken then; null where there is no room.
  // What must be told stands in the first corner then, within the drawing.
  place(u, v, wide, { side = "above", must = false } = {}) {
    const at = ([right, rows]) => [right > 0 ? u + 6 : u - 6 - wide, rows > 0 ? v + 4 + (rows - 1) * HIGH : v - 4 + rows * HIGH];
    for (const corner of SIDES[side]) {
      const [x, y] = at(corner);
      if (x < 0 || y < 0 || x + wide > this.width || y + HIGH > this.height) continue;
      if (this.cells(x, y, wide, HIGH).some((c) => this.taken.has(c))) continue;
      return this.take(x, y, wide);
    }
    if (!must) return null;
    const [x, y] = at(SIDES[side][0]);
    return this.take(Math.max(0, Math.min(x, this.width - wide)), Math.max(0, Math.min(y, this.height - HIGH)), wide);
  }
}
