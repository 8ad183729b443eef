// The plan on a canvas: fast for ten thousand points. While it moves, the last picture is moved;
// the whole is drawn again when it rests or when a frame is cheap.
import { colour } from "./dom.js";
import { Labels } from "./labels.js";
import { isNumber, mm, t } from "./language.js";

const COLOURS = ["page", "ink", "soft", "point", "held", "ellipse", "photo", "sight", "sight2", "doubt", "aside", "moved", "selected", "line", "amber"];
const CHEAP = 12; // ms that a frame may take to be drawn while the plan moves
const MOST_LABELS = 400, NEAR = 16;
const MOST_SIGHTS = 5000; // lines in the window; of more that fit or are untested, an even choice is drawn
const BATCH = 400; // shapes of one path: long paths are slow to fill and stroke
const LEAST_APART = 14; // pixels between points below which ordinary ones have no names
const LEAST_ELLIPSE = 2.5; // pixels; smaller ones say nothing
const AROUND = 28;
const FONT = "12px system-ui, DejaVu Sans, sans-serif";
const NORTH = 26; // pixels of the north arrow from the corner
const MARGIN = 55; // pixels around the points of the whole plan
const NICE = [1, 2, 5];

// Classes of sights by |w|; each has a width and a dash of its own besides its colour.
export const SIGHTS = [
  { key: "fits", colour: "sight", width: 1, dash: [] },
  { key: "doubtful", colour: "sight2", width: 1.8, dash: [10, 3] },
  { key: "bad", colour: "doubt", width: 3, dash: [] },
  { key: "untested", colour: "sight", width: 1, dash: [2, 3] },
  { key: "aside", colour: "aside", width: 1.2, dash: [7, 3, 1, 3] },
];
export const sightClass = (s, critical) =>
  s.state && s.state !== "accepted" ? (s.state === "waiting" ? 4 : 2)
    : s.w === null || s.w === undefined ? 3
      : Math.abs(s.w) > critical ? 2 : Math.abs(s.w) > 0.6 * critical ? 1 : 0;

// Whether a displacement has a part in height that the plan must tell: where heights alone are
// compared always, otherwise of a significant one whose part in height exceeds 3 σ or its arrow.
const showsHeight = (d) => isNumber(d.up) && (!isNumber(d.dx) || !isNumber(d.dy)
  || (d.moved && Math.abs(d.up) > Math.min(isNumber(d.sigmaUp) ? 3 * d.sigmaUp : Infinity, Math.hypot(d.dx, d.dy))));

export const niceBelow = (size) => {
  const power = 10 ** Math.floor(Math.log10(size));
  return NICE.filter((m) => m * power <= size * 1.0001).at(-1) * power;
};
const lengthText = (metres) =>
  metres >= 1000 ? `${+(metres / 1000).toPrecision(3)} km` : metres >= 1 ? `${+metres.toPrecision(3)} m`
    : metres >= 1e-3 ? `${+(metres * 1000).toPrecision(3)} mm` : `${+(metres * 1e6).toPrecision(3)} µm`;

export class Plan {
  constructor(canvas, { chosen = () => {}, hovered = () => {}, drawn = () => {} } = {}) {
    Object.assign(this, { canvas, onChosen: chosen, onHovered: hovered, onDrawn: drawn, k: 1, cx: 0, cy: 0, factor: 1 });
    this.g = canvas.getContext("2d");
    this.points = { names: [], x: new Float64Array(0), y: new Float64Array(0), a: [], b: [], turn: [], look: [], index: new Map() };
    this.sights = SIGHTS.map(() => new Int32Array(0));
    this.photos = [];
    this.vectors = [];
    this.chosen = -1;
    this.shown = { sights: true, ellipses: true, names: true, photos: true };
    this.stale = "";
    this.cost = 0;
    this.frames = [];
    this.picture = document.createElement("canvas");
    this.listen();
    this.size();
    new ResizeObserver(() => this.size()).observe(canvas);
  }

  // -- data -------------------------------------------------------------------------------------

  // rows: {name, x, y, a, b, turn (rad, clockwise from y), look: fixed|reference|object}; metres
  setPoints(rows) {
    const n = rows.length, p = { names: [], x: new Float64Array(n), y: new Float64Array(n), a: new Float64Array(n), b: new Float64Array(n), turn: new Float64Array(n), look: [], index: new Map() };
    rows.forEach((r, i) => {
      p.names.push(r.name); p.x[i] = r.x; p.y[i] = r.y; p.a[i] = r.a || 0; p.b[i] = r.b || 0; p.turn[i] = r.turn || 0; p.look.push(r.look);
      p.index.set(r.name, i);
    });
    const name = this.chosen >= 0 ? this.points.names[this.chosen] : null;
    const first = !this.points.names.length;
    this.points = p;
    this.bounds = null;
    this.chosen = name === null ? -1 : p.index.get(name) ?? -1;
    if (first && n) this.begin();
    this.redraw();
  }

  move(rows) {
    this.bounds = null;
    for (const { name, x, y } of rows) {
      const i = this.points.index.get(name);
      if (i !== undefined) { this.points.x[i] = x; this.points.y[i] = y; }
    }
    this.redraw();
  }

  // rows: {from, to, w, state}; those with an end that has no place are left out, and counted
  setSights(rows, critical) {
    const ends = SIGHTS.map(() => []), seen = new Map();
    let left = 0;
    for (const s of rows) {
      const i = this.place(s.from), j = this.place(s.to);
      if (i === undefined || j === undefined) { left++; continue; }
      // Of the readings between two places the worst is drawn.
      const key = i < j ? `${i} ${j}` : `${j} ${i}`, look = sightClass(s, critical), rank = [0, 2, 4, 1, 3][look];
      const old = seen.get(key);
      if (!old || rank > old.rank) seen.set(key, { i, j, look, rank });
    }
    for (const { i, j, look } of seen.values()) ends[look].push(i, j);
    this.sights = ends.map((e) => Int32Array.from(e));
    this.redraw();
    return left;
  }

  // Number of a point, or of a photo behind the points.
  place(name) {
    const i = this.points.index.get(name);
    if (i !== undefined) return i;
    const k = this.photoIndex?.get(name);
    return k === undefined ? undefined : -1 - k;
  }
  at(i) { return i >= 0 ? [this.points.x[i], this.points.y[i]] : [this.photos[-1 - i].x, this.photos[-1 - i].y]; }

  setPhotos(photos) {
    this.bounds = null;
    this.photos = photos;
    this.photoIndex = new Map(photos.map((p, i) => [p.name, i]));
    this.redraw();
  }

  setVectors(vectors) {
    this.vectors = vectors;
    if (this.automatic) this.rescale();
    this.redraw();
  }

  // Mean distance between neighbours on the screen.
  apart() {
    const [low, high] = this.limits(), area = (high[0] - low[0]) * (high[1] - low[1]);
    return area > 0 ? this.k * Math.sqrt(area / this.points.names.length) : Infinity;
  }

  begin() { this.fit(); this.rescale(); }

  // The window as it is, and a scale of ellipses and displacements that goes with it.
  rescale() { this.automatic = true; this.factor = this.autoFactor(); this.redraw(); }
  scale(up) { this.automatic = false; this.factor = niceBelow(this.factor * (up ? 2.5 : 0.5)); this.redraw(); }

  autoFactor() {
    const sizes = [...this.points.a].filter((a) => a > 0).sort((a, b) => a - b);
    const middle = sizes[Math.floor(sizes.length * 0.7)] ?? 0;
    // Of many points, ellipses stay smaller than the distance to the next; arrows stay in the window,
    // but not at the cost of ellipses that are points.
    const ellipse = Math.min(26, Math.max(0.5 * this.apart(), 2)) / middle, least = Math.min(7 / middle, ellipse);
    const longest = this.vectors.reduce((most, d) => Math.max(most, Math.hypot(d.dx ?? 0, d.dy ?? 0)), 0);
    const best = Math.max(Math.min(ellipse, MARGIN / longest), middle ? least : 0);
    return Number.isFinite(best) ? Math.max(Number((best / this.k).toPrecision(2)), 1) : 1000;
  }

  // -- window -----------------------------------------------------------------------------------

  size() {
    const ratio = Math.min(devicePixelRatio || 1, 2.5), box = this.canvas.getBoundingClientRect();
    if (!box.width || !box.height) return;
    this.w = box.width; this.h = box.height; this.ratio = ratio;
    this.canvas.width = Math.round(box.width * ratio);
    this.canvas.height = Math.round(box.height * ratio);
    if (!this.fitted && this.points.names.length) this.begin();
    this.draw();
  }

  limits() { return (this.bounds ??= this.extent()); }
  extent() {
    const low = [Infinity, Infinity], high = [-Infinity, -Infinity];
    const take = (x, y) => { low[0] = Math.min(low[0], x); low[1] = Math.min(low[1], y); high[0] = Math.max(high[0], x); high[1] = Math.max(high[1], y); };
    this.points.x.forEach((x, i) => take(x, this.points.y[i]));
    for (const p of this.photos) take(p.x, p.y);
    return [low, high];
  }

  fit() {
    const [low, high] = this.limits();
    if (!(low[0] <= high[0]) || !this.w) return;
    this.fitted = true;
    this.cx = (low[0] + high[0]) / 2; this.cy = (low[1] + high[1]) / 2;
    // Names and arrows stand beside points, bars of scale below.
    const side = Math.min(MARGIN, 0.15 * this.w), above = MARGIN, below = 75;
    this.k = Math.min((this.w - 2 * side) / Math.max(high[0] - low[0], 1e-3), (this.h - above - below) / Math.max(high[1] - low[1], 1e-3));
    this.k = Math.max(this.k, 1e-6);
    this.cy += (above - below) / (2 * this.k);
    this.redraw();
  }

  toScreen(x, y) { return [(x - this.cx) * this.k + this.w / 2, this.h / 2 - (y - this.cy) * this.k]; }
  toWorld(u, v) { return [(u - this.w / 2) / this.k + this.cx, (this.h / 2 - v) / this.k + this.cy]; }

  zoom(by, u = this.w / 2, v = this.h / 2) {
    const [x, y] = this.toWorld(u, v);
    this.k = Math.min(Math.max(this.k * by, 1e-6), 1e7);
    this.cx = x - (u - this.w / 2) / this.k; this.cy = y - (this.h / 2 - v) / this.k;
    this.moving();
  }
  pan(du, dv) { this.cx -= du / this.k; this.cy += dv / this.k; this.moving(); }

  show(name) {
    const i = this.points.index.get(name);
    if (i === undefined) return false;
    this.choose(i);
    this.cx = this.points.x[i]; this.cy = this.points.y[i];
    const [low, high] = this.limits(), span = Math.max(high[0] - low[0], high[1] - low[1], 1e-3);
    this.k = Math.max(this.k, Math.min(this.w, this.h) / (0.3 * span));
    this.redraw();
    return true;
  }

  choose(i) {
    this.chosen = i;
    this.onChosen(i < 0 ? null : this.points.names[i]);
    this.redraw();
  }

  nearest(u, v, within = NEAR) {
    let best = -1, least = within ** 2;
    const { x, y } = this.points;
    for (let i = 0; i < x.length; i++) {
      const du = (x[i] - this.cx) * this.k + this.w / 2 - u, dv = this.h / 2 - (y[i] - this.cy) * this.k - v, d = du * du + dv * dv;
      if (d < least) { least = d; best = i; }
    }
    return best;
  }

  // -- hands ------------------------------------------------------------------------------------

  listen() {
    const c = this.canvas, down = new Map();
    let travelled = 0, spread = 0;
    const where = (e) => { const b = c.getBoundingClientRect(); return [e.clientX - b.left, e.clientY - b.top]; };
    const pair = () => {
      const [[a, b], [p, q]] = [...down.values()];
      return { u: (a + p) / 2, v: (b + q) / 2, d: Math.hypot(a - p, b - q) };
    };
    c.addEventListener("pointerdown", (e) => {
      c.setPointerCapture(e.pointerId);
      down.set(e.pointerId, where(e));
      if (down.size === 1) travelled = 0;
      if (down.size === 2) spread = pair().d;
    });
    c.addEventListener("pointermove", (e) => {
      const [u, v] = where(e), old = down.get(e.pointerId);
      if (!old) { this.hover(u, v); return; }
      if (down.size === 1) { this.pan(u - old[0], v - old[1]); down.set(e.pointerId, [u, v]); }
      else if (down.size === 2) {
        const before = pair();
        down.set(e.pointerId, [u, v]);
        const after = pair();
        this.pan(after.u - before.u, after.v - before.v);
        if (spread > 0 && before.d > 0) this.zoom(after.d / before.d, after.u, after.v);
        travelled = 99;
      }
      travelled += Math.hypot(u - old[0], v - old[1]);
    });
    const up = (e) => {
      if (!down.has(e.pointerId)) return;
      const [u, v] = where(e);
      down.delete(e.pointerId);
      if (e.type === "pointerup" && !down.size && travelled < 6) this.choose(this.nearest(u, v, e.pointerType === "touch" ? 28 : NEAR));
    };
    c.addEventListener("pointerup", up);
    c.addEventListener("pointercancel", up);
    c.addEventListener("pointerleave", () => this.onHovered(null));
    c.addEventListener("wheel", (e) => { e.preventDefault(); this.zoom(Math.exp(-e.deltaY * (e.deltaMode ? 0.05 : 0.0015)), ...where(e)); }, { passive: false });
    c.addEventListener("dblclick", (e) => this.zoom(2, ...where(e)));
    c.addEventListener("keydown", (e) => {
      if (e.ctrlKey || e.metaKey || e.altKey) return;
      const step = 0.15 * Math.min(this.w, this.h);
      const acts = {
        ArrowLeft: () => this.pan(step, 0), ArrowRight: () => this.pan(-step, 0), ArrowUp: () => this.pan(0, step), ArrowDown: () => this.pan(0, -step),
        "+": () => this.zoom(1.5), "=": () => this.zoom(1.5), "-": () => this.zoom(1 / 1.5), 0: () => this.fit(), Home: () => this.fit(),
        n: () => this.step(1), p: () => this.step(-1), Escape: () => this.choose(-1),
      };
      const does = acts[e.key];
      if (does) { e.preventDefault(); does(); }
    });
  }

  // The next or previous point, brought into the window.
  step(by) {
    const n = this.points.names.length;
    if (!n) return;
    const i = this.chosen < 0 ? (by > 0 ? 0 : n - 1) : (this.chosen + by + n) % n;
    const [u, v] = this.toScreen(this.points.x[i], this.points.y[i]);
    if (u < 20 || v < 20 || u > this.w - 20 || v > this.h - 20) { this.cx = this.points.x[i]; this.cy = this.points.y[i]; }
    this.choose(i);
  }

  hover(u, v) {
    if (this.hovering) return;
    this.hovering = requestAnimationFrame(() => {
      this.hovering = null;
      const i = this.nearest(u, v);
      this.onHovered(i < 0 ? null : this.points.names[i]);
    });
  }

  // -- drawing ----------------------------------------------------------------------------------

  redraw() {
    if (this.asked) return;
    this.asked = requestAnimationFrame(() => { this.asked = null; this.draw(); });
  }

  moving() {
    if (this.cost <= CHEAP || !this.drawnAt) { this.redraw(); return; }
    clearTimeout(this.rest);
    this.rest = setTimeout(() => this.redraw(), 120);
    if (this.shifted || this.asked) return;
    this.shifted = requestAnimationFrame(() => { this.shifted = null; this.shift(); });
  }

  // The last picture at its new place and size.
  shift() {
    const begun = performance.now(), { k, cx, cy } = this.drawnAt, s = this.k / k;
    const u = (cx - this.cx) * this.k + this.w / 2 - (s * this.w) / 2, v = this.h / 2 - (cy - this.cy) * this.k - (s * this.h) / 2;
    const g = this.g;
    g.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    g.fillStyle = this.c.page;
    g.fillRect(0, 0, this.w, this.h);
    g.drawImage(this.picture, u, v, s * this.w, s * this.h);
    this.furniture();
    this.frames.push(performance.now() - begun);
  }

  draw() {
    if (!this.w) return;
    clearTimeout(this.rest);
    const begun = performance.now(), g = this.g;
    this.c = Object.fromEntries(COLOURS.map((n) => [n, colour(n)]));
    g.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    g.fillStyle = this.c.page;
    g.fillRect(0, 0, this.w, this.h);
    g.lineJoin = "round";
    if (this.shown.sights) this.drawSights();
    if (this.shown.photos) this.drawPhotos();
    if (this.shown.ellipses) this.drawEllipses();
    this.drawPoints();
    this.labels = new Labels(this.w, this.h);
    this.labels.keep(this.w - NORTH - 8, 0, 16, 50); // the north arrow, which is drawn last
    if (this.apart() >= LEAST_APART) for (let i = 0; i < this.points.x.length; i++) {
      const [u, v] = this.toScreen(this.points.x[i], this.points.y[i]);
      if (this.inside(u, v, 0)) this.labels.point(u, v);
    }
    this.drawVectors();
    this.named = new Set();
    this.drawHeights();
    if (this.shown.names) this.drawNames();
    if (this.cost > CHEAP) {
      this.picture.width = this.canvas.width; this.picture.height = this.canvas.height;
      this.picture.getContext("2d").drawImage(this.canvas, 0, 0);
      this.drawnAt = { k: this.k, cx: this.cx, cy: this.cy };
    } else this.drawnAt = null;
    this.furniture();
    const took = performance.now() - begun;
    // The first drawing of many points also compiles: a mean forgets it.
    this.cost = this.cost ? 0.5 * (this.cost + took) : took;
    this.frames.push(took);
    if (this.frames.length > 600) this.frames.splice(0, 300);
    this.canvas.dataset.drawn = String(this.points.names.length);
    this.onDrawn();
  }

  inside(u, v, margin) { return u > -margin && v > -margin && u < this.w + margin && v < this.h + margin; }

  drawSights() {
    const g = this.g, { w, h } = this, inside = this.sights.map((ends) => {
      const xy = new Float64Array(2 * ends.length);
      let n = 0;
      for (let s = 0; s < ends.length; s += 2) {
        const [u, v] = this.toScreen(...this.at(ends[s])), [p, q] = this.toScreen(...this.at(ends[s + 1]));
        if ((u < 0 && p < 0) || (v < 0 && q < 0) || (u > w && p > w) || (v > h && q > h)) continue;
        xy[n++] = u; xy[n++] = v; xy[n++] = p; xy[n++] = q;
      }
      return xy.subarray(0, n);
    });
    const ordinary = (inside[0].length + inside[3].length) / 4, step = Math.max(Math.ceil(ordinary / MOST_SIGHTS), 1);
    this.thinned = step > 1 ? { n: ordinary, shown: Math.round(ordinary / step) } : null;
    for (const look of [0, 3, 4, 1, 2]) {
      const xy = inside[look], style = SIGHTS[look], few = xy.length < 8000, by = look === 0 || look === 3 ? 4 * step : 4;
      if (!xy.length) continue;
      g.strokeStyle = this.c[style.colour];
      g.lineWidth = few ? style.width : Math.min(style.width, 0.8) + (look === 2 ? 1.5 : 0);
      g.setLineDash(few ? style.dash : []);
      for (let s = 0; s < xy.length;) {
        g.beginPath();
        for (const end = Math.min(s + BATCH * by, xy.length); s < end; s += by) { g.moveTo(xy[s], xy[s + 1]); g.lineTo(xy[s + 2], xy[s + 3]); }
        g.stroke();
      }
    }
    g.setLineDash([]);
  }

  drawEllipses() {
    const g = this.g, { x, y, a, b, turn } = this.points, f = this.factor * this.k;
    g.strokeStyle = this.c.ellipse;
    g.lineWidth = 1.4;
    let n = 0;
    g.beginPath();
    for (let i = 0; i < x.length; i++) {
      const long = a[i] * f;
      if (!(long > LEAST_ELLIPSE)) continue;
      const [u, v] = this.toScreen(x[i], y[i]);
      if (!this.inside(u, v, long)) continue;
      // Clockwise from y (up) on paper is the same turn on the screen, counted from its x axis.
      const angle = turn[i] - Math.PI / 2, c = Math.cos(angle), s = Math.sin(angle), short = Math.max(b[i] * f, 0.4);
      const around = long < 8 ? 12 : long < 60 ? AROUND : 3 * AROUND;
      for (let k = 0; k < around; k++) {
        const t_ = (2 * Math.PI * k) / around, p = long * Math.cos(t_), q = short * Math.sin(t_);
        if (k) g.lineTo(u + p * c - q * s, v + p * s + q * c); else g.moveTo(u + p * c - q * s, v + p * s + q * c);
      }
      g.closePath();
      if (++n % BATCH === 0) { g.stroke(); g.beginPath(); }
    }
    g.stroke();
  }

  drawPoints() {
    const g = this.g, { x, y, look } = this.points, many = x.length > 3000, apart = this.apart(), r = Math.min(Math.max(0.22 * apart, 0.8), 3.2);
    const small = [], paths = { object: new Path2D(), reference: new Path2D(), fixed: new Path2D() };
    for (let i = 0; i < x.length; i++) {
      const [u, v] = this.toScreen(x[i], y[i]);
      if (!this.inside(u, v, 8)) continue;
      const path = paths[look[i]] ?? paths.object;
      if (look[i] === "fixed") { path.moveTo(u, v - 7); path.lineTo(u + 6.5, v + 5); path.lineTo(u - 6.5, v + 5); path.closePath(); }
      else if (look[i] === "reference") path.rect(u - 4, v - 4, 8, 8);
      else if (many) small.push(u - r, v - r);
      else { path.moveTo(u + r, v); path.arc(u, v, r, 0, 2 * Math.PI); }
    }
    g.fillStyle = this.c.point; g.fill(paths.object);
    for (let k = 0; k < small.length; k += 2) g.fillRect(small[k], small[k + 1], 2 * r, 2 * r);
    g.lineWidth = 1.8; g.strokeStyle = this.c.held; g.fillStyle = this.c.page;
    g.fill(paths.reference); g.stroke(paths.reference);
    g.fillStyle = this.c.held; g.fill(paths.fixed);
    if (this.chosen >= 0) {
      const [u, v] = this.toScreen(x[this.chosen], y[this.chosen]);
      g.strokeStyle = this.c.selected; g.lineWidth = 3;
      g.beginPath(); g.arc(u, v, 12, 0, 2 * Math.PI); g.stroke();
    }
  }

  drawPhotos() {
    if (!this.photos.length) return;
    const g = this.g;
    g.strokeStyle = this.c.photo; g.fillStyle = this.c.photo;
    const chosen = this.chosen >= 0 ? this.points.names[this.chosen] : null;
    for (const p of this.photos) {
      const [u, v] = this.toScreen(p.x, p.y);
      const rays = p.fresh ? p.rays : chosen ? p.rays.filter((n) => n === chosen) : [];
      g.lineWidth = p.fresh ? 1.6 : 1;
      g.beginPath();
      for (const name of rays) {
        const i = this.points.index.get(name);
        if (i === undefined) continue;
        g.moveTo(u, v); g.lineTo(...this.toScreen(this.points.x[i], this.points.y[i]));
      }
      g.stroke();
      if (!this.inside(u, v, 12)) continue;
      g.beginPath(); g.rect(u - 6, v - 4, 12, 8); g.moveTo(u + 2.4, v); g.arc(u, v, 2.4, 0, 2 * Math.PI);
      g.lineWidth = 1.8; g.stroke();
    }
  }

  drawVectors() {
    const g = this.g, f = this.factor * this.k;
    for (const [moved, look, width] of [[false, "soft", 1.5], [true, "moved", 3]]) {
      g.strokeStyle = g.fillStyle = this.c[look];
      g.lineWidth = width;
      for (const d of this.vectors) {
        if (d.moved !== moved) continue;
        const i = this.points.index.get(d.name);
        if (i === undefined) continue;
        const [u, v] = this.toScreen(this.points.x[i], this.points.y[i]);
        if (!isNumber(d.dx) || !isNumber(d.dy)) continue;
        const du = d.dx * f, dv = -d.dy * f, size = Math.hypot(du, dv);
        if (!(size > 1) || !this.inside(u, v, size)) continue;
        const head = Math.min(9, size * 0.5), [ex, ey] = [du / size, dv / size];
        g.beginPath(); g.moveTo(u, v); g.lineTo(u + du, v + dv); g.stroke();
        g.beginPath();
        g.moveTo(u + du, v + dv);
        g.lineTo(u + du - head * (ex - 0.45 * ey), v + dv - head * (ey + 0.45 * ex));
        g.lineTo(u + du - head * (ex + 0.45 * ey), v + dv - head * (ey - 0.45 * ex));
        g.closePath();
        if (moved) { g.fill(); this.labels.arrow(u, v, du, dv); } else g.stroke();
      }
    }
  }

  text(text, x, y, colour) {
    const g = this.g;
    g.textBaseline = "top";
    g.lineWidth = 3; g.strokeStyle = this.c.page; g.strokeText(text, x, y);
    g.fillStyle = colour; g.fillText(text, x, y);
  }

  // A displacement in height is no arrow of the plan: a sign and its size, of significant ones always.
  drawHeights() {
    this.heights = new Map();
    for (const d of [...this.vectors].sort((a, b) => b.moved - a.moved)) {
      const i = this.points.index.get(d.name);
      if (i === undefined || !showsHeight(d) || (!d.moved && this.apart() < LEAST_APART)) continue;
      const [u, v] = this.toScreen(this.points.x[i], this.points.y[i]);
      if (!this.inside(u, v, 0)) continue;
      const text = d.up < 0 ? `↓ −${mm(-d.up)}` : `↑ +${mm(d.up)}`;
      this.g.font = `${d.moved ? "600 " : ""}${FONT}`;
      const at = this.labels.place(u, v, this.g.measureText(text).width, { side: "below", must: d.moved });
      if (!at) continue;
      this.heights.set(d.name, text);
      this.text(text, ...at, this.c[d.moved ? "moved" : "soft"]);
    }
  }

  // The name of a point, once, where there is room; of those that moved always.
  drawName(i, must = false) {
    if (this.named.has(i) || this.named.size >= MOST_LABELS) return;
    const [u, v] = this.toScreen(this.points.x[i], this.points.y[i]), name = this.points.names[i];
    if (!this.inside(u, v, 0)) return;
    this.g.font = FONT;
    const at = this.labels.place(u, v, this.g.measureText(name).width, { must });
    if (!at) return;
    this.named.add(i);
    this.text(name, ...at, this.c.ink);
  }

  // Names: chosen, moved, held, then the others.
  drawNames() {
    const { x, look } = this.points;
    if (this.chosen >= 0) this.drawName(this.chosen, true);
    for (const d of this.vectors) if (d.moved) { const i = this.points.index.get(d.name); if (i !== undefined) this.drawName(i, this.apart() >= LEAST_APART); }
    for (let i = 0; i < x.length; i++) if (look[i] !== "object") this.drawName(i);
    if (this.apart() < LEAST_APART) return;
    for (let i = 0; i < x.length && this.named.size < MOST_LABELS; i++) if (look[i] === "object") this.drawName(i);
  }

  // North arrow, scale bars and, where the figures are not current, their time.
  furniture() {
    const g = this.g;
    const text = (s, u, v, align = "left") => {
      g.textAlign = align; g.lineWidth = 4; g.strokeStyle = this.c.page; g.strokeText(s, u, v); g.fillText(s, u, v); g.textAlign = "left";
    };
    g.font = FONT;
    g.textBaseline = "alphabetic";
    g.fillStyle = this.c.ink;
    const nu = this.w - NORTH, nv = 22;
    g.beginPath(); g.moveTo(nu, nv); g.lineTo(nu + 7, nv + 26); g.lineTo(nu, nv + 20); g.lineTo(nu - 7, nv + 26); g.closePath();
    g.lineWidth = 3; g.strokeStyle = this.c.page; g.stroke(); g.fill();
    text("N", nu, nv - 4, "center");
    const bar = (size, label, v) => {
      const u = this.w - 70;
      g.strokeStyle = this.c.page; g.lineWidth = 6; g.beginPath(); g.moveTo(u - size, v); g.lineTo(u, v); g.stroke();
      g.strokeStyle = this.c.ink; g.lineWidth = 2; g.beginPath(); g.moveTo(u - size, v - 4); g.lineTo(u - size, v); g.lineTo(u, v); g.lineTo(u, v - 4); g.stroke();
      text(label, u, v - 7, "right");
    };
    const long = Math.min(130, this.w / 4);
    if (!this.points.names.length) return;
    const ground = niceBelow(long / this.k);
    this.bars = { ground: lengthText(ground) };
    bar(ground * this.k, lengthText(ground), this.h - 14);
    if (this.points.names.length && (this.shown.ellipses && this.points.a.some((a) => a > 0) || this.vectors.length)) {
      const small = niceBelow(long / (this.k * this.factor));
      this.bars.small = lengthText(small);
      g.fillStyle = this.c.ink;
      bar(small * this.k * this.factor, `${lengthText(small)} (${t(this.vectors.some((d) => isNumber(d.dx)) ? "bar_both" : "bar_ellipses")} × ${+this.factor.toPrecision(3)})`, this.h - 46);
    }
    if (this.stale) {
      g.font = "600 14px system-ui, DejaVu Sans, sans-serif";
      const half = g.measureText(this.stale).width / 2 + 6;
      g.fillStyle = this.c.page; g.fillRect(this.w / 2 - half, 6, 2 * half, 26);
      g.fillStyle = this.c.amber; text(this.stale, this.w / 2, 24, "center");
    }
  }
}
