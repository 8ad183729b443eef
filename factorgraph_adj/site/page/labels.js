// Places of texts on a drawing where nothing is covered: beside their point, in one of its corners.
const CELL = 4, HIGH = 14, CLEAR = 5; // pixels: of the raster, of a text, around a point
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
  point(u, v) { this.keep(u - CLEAR + 2, v - CLEAR + 2, 2 * CLEAR - 4, 2 * CLEAR - 4); }

  arrow(u, v, du, dv) {
    const size = Math.hypot(du, dv);
    for (let s = CLEAR + 3; s <= size; s += CELL) this.keep(u + (s * du) / size - 1, v + (s * dv) / size - 1, 2, 2);
  }

  // Left upper corner of a text beside a point, which is taken then; null where there is no room.
  // What must be told stands in the first corner then, within the drawing.
  place(u, v, wide, { side = "above", must = false } = {}) {
    const at = ([right, rows]) => [right > 0 ? u + 6 : u - 6 - wide, rows > 0 ? v + 4 + (rows - 1) * HIGH : v - 4 + rows * HIGH];
    for (const corner of SIDES[side]) {
      const [x, y] = at(corner);
      if (x < 0 || y < 0 || x + wide > this.width || y + HIGH > this.height) continue;
      const cells = this.cells(x, y, wide, HIGH);
      if (cells.some((c) => this.taken.has(c))) continue;
      for (const c of cells) this.taken.add(c);
      this.placed.push([x, y, wide, HIGH]);
      return [x, y];
    }
    if (!must) return null;
    const [x, y] = at(SIDES[side][0]);
    return [Math.max(0, Math.min(x, this.width - wide)), Math.max(0, Math.min(y, this.height - HIGH))];
  }
}
