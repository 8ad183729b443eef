// The plan. Of a large network, the points in the window are thinned out: zooming in shows all.
const MOST_POINTS = 1500, MOST_LINES = 3000, MOST_PHOTOS = 400, AROUND = 32;
let plan, chosen = null;

// Markers of the states of points: those of the data, or those of a network.
const styles = () => plan.data.marks?.map((mark, state) => ({ state, ...mark, color: colour(mark.color) })) ?? [
  { state: 0, symbol: "triangle-up", size: 11, color: colour("point") },
  { state: 1, symbol: "triangle-down", size: 10, color: colour("sight2") },
  { state: 2, symbol: "triangle-up", size: 10, color: colour("held") },
  { state: 3, symbol: "diamond-open", size: 10, color: colour("ellipse") },
  { state: 4, symbol: "square-open", size: 10, color: colour("held") },
  { state: 5, symbol: "circle-open", size: 10, color: colour("point") },
  { state: 6, symbol: "circle", size: 5, color: colour("point") },
  { state: 7, symbol: "cross-thin-open", size: 7, color: colour("point") },
];

// Corners of the window, from the axes where they are drawn.
function windowOf(div) {
  const { xaxis, yaxis } = div._fullLayout ?? {};
  if (!xaxis) return plan.data.limits;
  const [x, y] = [xaxis.range, yaxis.range].map((r) => [...r].sort((a, b) => a - b));
  return [[x[0], y[0]], [x[1], y[1]]];
}

// Numbers of the points that are drawn: those that are not ordinary first, then an even choice.
function visible([low, high]) {
  const { xy: [x, y], state, test } = plan.data.points;
  const inside = [];
  for (let i = 0; i < x.length; i++)
    if (x[i] >= low[0] && x[i] <= high[0] && y[i] >= low[1] && y[i] <= high[1]) inside.push(i);
  if (inside.length <= MOST_POINTS) return { shown: inside, inside: inside.length };
  const first = inside.filter((i) => state[i] < 5 || i === chosen).slice(0, MOST_POINTS / 2);
  const taken = new Set(first);
  const step = inside.length / (MOST_POINTS - first.length);
  for (let k = 0; k < inside.length; k += step) taken.add(inside[Math.floor(k)]);
  return { shown: [...taken].sort((a, b) => a - b), inside: inside.length };
}

// Where the region of a point stands: at the point, or at the end of its displacement.
const endOf = (i) => {
  const { xy: [x, y], vectors } = plan.data.points, f = plan.data.factor;
  return vectors ? [x[i] + f * vectors[0][i], y[i] + f * vectors[1][i]] : [x[i], y[i]];
};

function ellipsesAt(place, regions, numbers) {
  const [a, b, turn] = regions, f = plan.data.factor;
  const out = { x: [], y: [], customdata: [] };
  for (const i of numbers) {
    if (!(a[i] > 0)) continue;
    const c = Math.cos(turn[i]), s = Math.sin(turn[i]), [x, y] = place(i);
    for (let k = 0; k <= AROUND; k++) {
      const t = (2 * Math.PI * k) / AROUND, u = f * a[i] * Math.cos(t), v = f * b[i] * Math.sin(t);
      out.x.push(x + u * c - v * s);
      out.y.push(y + u * s + v * c);
      out.customdata.push(i);
    }
    out.x.push(null); out.y.push(null); out.customdata.push(null);
  }
  return out;
}

function joined(lines) {
  const out = { x: [], y: [] };
  for (const [x, y] of lines) {
    out.x.push(...x, null);
    out.y.push(...y, null);
  }
  return out;
}

const lineTrace = (name, xy, more) => ({
  type: "scatter", mode: "lines", name, ...xy, hoverinfo: "skip", showlegend: true, ...more,
});

function sights([low, high]) {
  const { lines, points, instruments } = plan.data;
  const x = [...points.xy[0], ...instruments.xy[0]], y = [...points.xy[1], ...instruments.xy[1]];
  const looks = ["sight", "sight2", "sight3"], dashes = ["solid", "dash", "dot"];
  return lines.map(({ kinds, ends: [a, b] }, g) => {
    const inside = [];
    for (let k = 0; k < a.length; k++) {
      const [i, j] = [a[k], b[k]];
      if (Math.max(x[i], x[j]) < low[0] || Math.min(x[i], x[j]) > high[0]) continue;
      if (Math.max(y[i], y[j]) < low[1] || Math.min(y[i], y[j]) > high[1]) continue;
      inside.push([[x[i], x[j]], [y[i], y[j]]]);
    }
    const step = Math.max(Math.ceil((inside.length * lines.length) / MOST_LINES), 1);
    const shown = inside.filter((_, k) => k % step === 0);
    const line = { width: shown.length > 300 ? 0.6 : 1.1, color: colour(points.vectors ? "line" : looks[g % 3]), dash: dashes[g % 3] };
    return lineTrace(`${kinds} (${a.length})`, joined(shown), { line });
  });
}

function pointTraces(shown, by) {
  const { names, xy: [x, y], state, test, r } = plan.data.points;
  const trace = (numbers, more) => ({
    type: "scatter", mode: "markers", x: numbers.map((i) => x[i]), y: numbers.map((i) => y[i]),
    customdata: numbers, text: numbers.map((i) => hover(i)), hoverinfo: "text", meta: "points", ...more,
  });
  if (by === "state") {
    const counts = state.reduce((all, s) => all.set(s, (all.get(s) ?? 0) + 1), new Map());
    return styles().filter((s) => counts.has(s.state)).map(({ state: key, ...marker }) => {
      if (shown.length > 500 && key === 6) marker.size = 3.5;
      const own = shown.filter((i) => state[i] === key);
      return trace(own, { name: `${plan.data.states[key]} (${counts.get(key)})`, marker });
    });
  }
  const values = by === "r" ? r : test;
  const title = by === "r" ? tell("js_colour_r") : tell("js_colour_test", { test: plan.data.test });
  const scale = by === "r" ? [0, 1] : [0, Math.max(4, ...shown.map((i) => Math.min(values[i] ?? 0, 8)))];
  const marker = {
    size: shown.length > 500 ? 5 : 9, color: shown.map((i) => values[i]), cmin: scale[0], cmax: scale[1],
    colorscale: "Viridis", reversescale: by === "r", showscale: true, line: { width: 0.5, color: colour("soft") },
    colorbar: { title: { text: title, side: "right" }, thickness: 12, len: 0.6, y: 0.3, outlinewidth: 0 },
  };
  return [trace(shown, { name: tell("js_points"), marker })];
}

const plain = (text) => String(text).replace(/[&<>]/g, (c) => `&#${c.charCodeAt(0)};`);

function hover(i) {
  const { names, state, test, r, ellipses: [a, b], height, told } = plan.data.points;
  const lines = [`<b>${plain(names[i])}</b>`, plan.data.states[state[i]]];
  const mm = (v) => `${(1000 * v).toPrecision(3)} mm`;
  if (a[i] > 0) lines.push(`a ${mm(a[i])}, b ${mm(b[i])} (${plan.data.level})`);
  if (height[i] > 0) lines.push(`± ${mm(height[i])} (${plan.data.level})`);
  if (told) lines.push(...told[i].map(plain));
  if (test && test[i] !== null) lines.push(`max |${plan.data.test}| ${test[i]}`);
  if (r && r[i] !== null) lines.push(`r ${r[i]}`);
  return lines.join("<br>");
}

// Displacements of two epochs with heads and ellipses, those that are significant last.
function displacementTraces(shown, dash) {
  const { xy: [x, y], vectors, moved, ellipses } = plan.data.points;
  if (!vectors) return [];
  return [[false, "js_kept", "soft", 1.4], [true, "js_moved", "doubt", 2.4]].flatMap(([own, key, look, width]) => {
    const some = shown.filter((i) => moved[i] === own && Math.hypot(vectors[0][i], vectors[1][i]) > 0);
    if (!some.length) return [];
    const out = { x: [], y: [], customdata: [], text: [] };
    for (const i of some) {
      const [ex, ey] = endOf(i), dx = ex - x[i], dy = ey - y[i];
      const head = (side) => [ex - 0.2 * (dx - side * dy), ey - 0.2 * (dy + side * dx)];
      for (const [px, py] of [[x[i], y[i]], [(x[i] + ex) / 2, (y[i] + ey) / 2], [ex, ey], head(0.5), [ex, ey], head(-0.5)]) {
        out.x.push(px); out.y.push(py); out.customdata.push(i); out.text.push(hover(i));
      }
      out.x.push(null); out.y.push(null); out.customdata.push(null); out.text.push(null);
    }
    const line = { color: colour(look), width };
    const group = { legendgroup: key, meta: "points" };
    return [
      lineTrace(tell("js_region", { level: plan.data.level }), ellipsesAt(endOf, ellipses, some), {
        ...group, hoverinfo: "none", showlegend: false, line: { ...line, width: 1.3, dash },
      }),
      lineTrace(`${tell(key)} (${some.length})`, out, { ...group, hoverinfo: "text", line }),
    ];
  });
}

function doubtTraces() {
  const { doubts, aside } = plan.data;
  return [[doubts, "js_doubts", "doubt", "solid", "row"], [aside, "js_aside", "ink", "dot", "id"]]
    .filter(([found]) => found.length)
    .map(([found, key, look, dash, ident]) => {
      const out = { x: [], y: [], text: [], customdata: [] };
      for (const one of found) {
        const add = (x, y) => {
          out.x.push(x); out.y.push(y); out.text.push(plain(one.text)); out.customdata.push(one[ident]);
        };
        for (const [x, y] of one.lines) {
          // Places along the line can be clicked on too.
          for (let k = 0; k <= 8; k++) add(x[0] + (k / 8) * (x[1] - x[0]), y[0] + (k / 8) * (y[1] - y[0]));
          out.x.push(null); out.y.push(null); out.text.push(null); out.customdata.push(null);
        }
        one.points[0].forEach((x, k) => {
          add(x, one.points[1][k]);
          out.x.push(null); out.y.push(null); out.text.push(null); out.customdata.push(null);
        });
      }
      return {
        type: "scatter", mode: "lines+markers", name: `${tell(key)} (${found.length})`, ...out,
        hoverinfo: "text", meta: key, opacity: 0.8,
        line: { color: colour(look), width: found.length > 20 ? 1 : 2.2, dash },
        marker: { color: colour(look), symbol: key === "js_doubts" ? "diamond" : "x-thin-open", size: found.length > 20 ? 3 : 5 },
      };
    });
}

function traces(div) {
  const d = plan.data, box = windowOf(div);
  const { shown, inside } = visible(box);
  const by = byId("plan-colour")?.value ?? "state";
  const out = sights(box);
  const kinds = [...new Set(d.shapes.map((s) => s.name))];
  for (const kind of kinds) {
    const own = d.shapes.filter((s) => s.name === kind);
    const xy = joined(own.flatMap((s) => s.lines)), dashed = own[0].dash ?? "solid";
    out.push(lineTrace(`${kind} (${own.length})`, xy, { line: { color: colour("shape"), width: 1.5, dash: dashed } }));
  }
  if (d.photos.names.length) {
    const step = Math.ceil(d.photos.names.length / MOST_PHOTOS);
    const some = d.photos.shapes.filter((_, i) => i % step === 0);
    const name = `${tell("js_photos")} (${d.photos.names.length})`;
    out.push(lineTrace(name, joined(some), { legendgroup: "photos", line: { color: colour("photo"), width: 0.8 } }));
    out.push({
      type: "scatter", mode: "markers", x: d.photos.xy[0], y: d.photos.xy[1], text: d.photos.names.map(plain),
      customdata: d.photos.names, hoverinfo: "text", meta: "photos", legendgroup: "photos", showlegend: false,
      marker: { color: colour("photo"), symbol: "square", size: d.photos.names.length > 200 ? 3 : 6 },
    });
  }
  out.push(...doubtTraces());
  // Regions of a doubtful result are dashed, as in the figures of the library.
  const dash = d.doubtful ? "4px,2px" : "solid", doubtful = d.doubtful ? `, ${tell("js_doubtful")}` : "";
  out.push(...displacementTraces(shown, dash));
  const every = ellipsesAt(endOf, d.points.ellipses, shown);
  if (!d.points.vectors && d.points.ellipses[0].some((a) => a > 0))
    out.push(lineTrace(`${tell("js_ellipses")} ${d.level}${doubtful}`, every, {
      meta: "points", hoverinfo: "none", line: { color: colour("ellipse"), width: 1.3, dash },
    }));
  if (d.points.height.some((h) => h > 0)) {
    const tall = shown.filter((i) => d.points.height[i] > 0);
    const xy = joined(tall.map((i) => {
      const [x, y] = endOf(i), h = d.factor * d.points.height[i];
      return [[x, x], [y - h, y + h]];
    }));
    out.push(lineTrace(`${tell("js_heights")} ${d.level}${doubtful}`, xy, { line: { color: colour("ellipse"), width: 3 } }));
  }
  if (d.relative.names.length) {
    const all = d.relative.names.map((_, i) => i);
    out.push(lineTrace(tell("js_relative"), ellipsesAt((i) => [d.relative.xy[0][i], d.relative.xy[1][i]], d.relative.ellipses, all), {
      line: { color: colour("sight2"), width: 1.2, dash },
    }));
  }
  if (d.instruments.names.length)
    out.push({
      type: "scatter", mode: "markers", name: `${tell("js_instruments")} (${d.instruments.names.length})`,
      x: d.instruments.xy[0], y: d.instruments.xy[1], text: d.instruments.names.map(plain), hoverinfo: "text",
      marker: { symbol: "hexagon", size: 12, color: colour("sight2") },
    });
  out.push(...pointTraces(shown, by));
  const { names, xy } = d.points;
  const named = shown.length <= 100 ? shown : shown.filter((i) => d.points.state[i] < 4).slice(0, 60);
  out.push({
    type: "scatter", mode: "text", x: named.map((i) => xy[0][i]), y: named.map((i) => xy[1][i]),
    text: named.map((i) => plain(names[i])), textposition: "top right", hoverinfo: "skip",
    textfont: { color: colour("ink"), size: 11 }, showlegend: false,
  });
  if (chosen !== null)
    out.push({
      type: "scatter", mode: "markers", x: [xy[0][chosen]], y: [xy[1][chosen]], hoverinfo: "skip",
      showlegend: false, marker: { symbol: "circle-open", size: 20, color: colour("selected"), line: { width: 3 } },
    });
  const few = shown.length < inside ? tell("js_shown", { shown: shown.length, n: inside }) : "";
  const marked = chosen !== null ? tell("js_selected", { name: names[chosen] }) : "";
  byId("plan-told").textContent = [marked, few].filter(Boolean).join(" ");
  return out;
}

// A bar of known length in the scale of the ellipses, at the lower left corner of the window.
function scaleKey(box) {
  const d = plan.data, p = d.points;
  if (![...p.ellipses[0], ...p.height, ...d.relative.ellipses[0]].some((v) => v > 0)) return {};
  const [low, high] = box, w = high[0] - low[0], h = high[1] - low[1];
  const upright = d.schematic, span = (upright ? h : w) * 0.12;
  const power = 10 ** Math.floor(Math.log10(span / d.factor));
  const size = [5, 2, 1].map((m) => m * power).find((v) => v * d.factor <= span * 1.0001);
  const x = low[0] + 0.03 * w, y = low[1] + 0.03 * h, long = size * d.factor;
  const unit = size >= 1 ? [1, "m"] : size >= 1e-3 ? [1e-3, "mm"] : [1e-6, "µm"];
  const line = { color: colour("ink"), width: 3 };
  const text = tell(p.vectors ? "js_scale_displacements" : d.schematic || !d.points.ellipses[0].some((v) => v > 0) ? "js_scale_heights" : "js_scale", { size: `${+(size / unit[0]).toPrecision(3)} ${unit[1]}`, factor: d.multiple });
  return {
    shapes: [{ type: "line", x0: x, y0: y, x1: upright ? x : x + long, y1: upright ? y + long : y, line }],
    annotations: [{
      x, y, text, showarrow: false, xanchor: "left", yanchor: "bottom", xshift: upright ? 8 : 0, yshift: 4,
      bgcolor: colour("page"), font: { color: colour("ink"), size: 12 },
    }],
  };
}

function planLayout(div, box) {
  const d = plan.data, [low, high] = box, [x, y] = d.axes;
  return layoutOf({
    ...scaleKey(box), hovermode: "closest", dragmode: "pan", uirevision: "plan",
    legend: { itemsizing: "constant", font: { size: 11 }, ...(onPaper() ? { orientation: "h", y: -0.12 } : { orientation: "v" }) },
    xaxis: axisOf({ range: [low[0], high[0]], tickformat: ".10~f", title: { text: x && `${x} [m]` }, showticklabels: !d.schematic,
      showgrid: !d.schematic }),
    yaxis: axisOf({ range: [low[1], high[1]], title: { text: `${y} [m]` }, tickformat: ".10~f",
      ...(d.schematic ? {} : { scaleanchor: "x" }) }),
  });
}

function wider([low, high], share) {
  const size = [0, 1].map((k) => high[k] - low[k] || 1);
  return [low.map((v, k) => v - share * size[k]), high.map((v, k) => v + share * size[k])];
}

async function drawPlan(Plotly) {
  const div = byId("plan");
  plan = { data: await dataOf("plan"), busy: false };
  const draw = async (box) => {
    plan.busy = true;
    const at = box ?? windowOf(div);
    await Plotly.react(div, traces(div), planLayout(div, at), config);
    plan.busy = false;
  };
  plan.go = async (box) => {
    await Plotly.relayout(div, { "xaxis.range": [box[0][0], box[1][0]], "yaxis.range": [box[0][1], box[1][1]] });
  };
  const whole = wider(plan.data.limits, 0.08);
  await Plotly.newPlot(div, traces(div), planLayout(div, whole), config);
  await draw();
  let seen;
  figures.push(async () => {
    if (onPaper()) seen = windowOf(div);
    await draw();
    if (onPaper() || !seen) return;
    const box = seen;
    seen = undefined;
    await plan.go(box);
  });
  let waiting;
  div.on("plotly_relayout", () => {
    if (plan.busy) return;
    clearTimeout(waiting);
    waiting = setTimeout(() => draw(), 60);
  });
  div.on("plotly_click", ({ points: [hit] }) => clicked(hit));
  byId("plan-colour")?.addEventListener("change", () => draw());
  byId("plan-in").addEventListener("click", () => plan.go(wider(windowOf(div), -0.25)));
  byId("plan-out").addEventListener("click", () => plan.go(wider(windowOf(div), 0.5)));
  byId("plan-all").addEventListener("click", () => plan.go(whole));
  byId("plan-find").addEventListener("change", (event) => find(event.target.value.trim()));
  byId(`table-${plan.data.sheet ?? "points"}`)?.addEventListener("click", (event) => {
    const cell = event.target.closest("tbody tr")?.cells[0];
    if (cell) select(plan.data.points.names.indexOf(cell.textContent));
  });
  plan.draw = draw;
}

function clicked(hit) {
  const kind = hit.data.meta, what = hit.customdata;
  if (what === undefined || what === null) return;
  if (kind === "points") {
    select(what);
    showRow(plan.data.sheet ?? "points", (_, i) => i === what);
  } else if (kind === "photos") showRow("photos", (cells) => cells[0] === what);
  else if (kind === "js_doubts") showRow("observations", (_, i) => i === what);
  else if (kind === "js_aside") {
    const text = plan.data.aside.find((a) => a.id === what).text;
    showRow("rejected", (cells) => text === `${cells[0]} ${cells[1]}` || cells.includes(what));
  }
}

function select(number) {
  if (number < 0) return;
  chosen = number;
  plan.draw();
}

// Brings a point that was typed into the middle of the plan, and shows its row.
async function find(name) {
  if (!name) return;
  const { names, xy } = plan.data.points;
  let number = names.indexOf(name);
  if (number < 0) number = names.findIndex((n) => n.toLowerCase() === name.toLowerCase());
  if (number < 0) {
    byId("plan-told").textContent = tell("js_not_found", { name });
    return;
  }
  chosen = number;
  const [low, high] = plan.data.limits;
  const half = [0, 1].map((k) => 0.12 * (high[k] - low[k] || 1)), at = [xy[0][number], xy[1][number]];
  await plan.go([at.map((v, k) => v - half[k]), at.map((v, k) => v + half[k])]);
}
