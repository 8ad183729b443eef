// The view in three dimensions, the statistical figures and the mean photos; then everything starts.
async function drawScene(Plotly) {
  const d = await dataOf("scene"), div = byId("scene");
  const [x, y, z] = d.points;
  const line = (name, [a, b, c], look, width) => ({
    type: "scatter3d", mode: "lines", name, x: a, y: b, z: c, hoverinfo: "skip",
    line: { color: colour(look), width },
  });
  const draw = () => Plotly.react(div, [
    ...d.lines.map((l, i) => line(l.kinds, l.xyz, ["sight", "sight2", "sight3"][i % 3], 1.5)),
    ...(d.rays.shown ? [{ ...line(tell("js_rays"), d.rays.xyz, "line", 1), visible: "legendonly" }] : []),
    ...(d.photos.names.length ? [
      { ...line(tell("js_photos"), d.photos.shapes, "photo", 2), legendgroup: "p" },
      {
        type: "scatter3d", mode: "markers", showlegend: false, legendgroup: "p", x: d.photos.xyz[0],
        y: d.photos.xyz[1], z: d.photos.xyz[2], text: d.photos.names.map(plain), hoverinfo: "text",
        customdata: d.photos.names, meta: "photos", marker: { size: d.photos.names.length > 200 ? 1.5 : 3, color: colour("photo"), symbol: "square" },
      },
    ] : []),
    {
      type: "scatter3d", mode: "markers", name: tell("js_points"), x, y, z, text: d.names.map(plain),
      customdata: d.names.map((_, i) => i), meta: "points", hoverinfo: "text",
      marker: { size: x.length > 2000 ? 1.5 : x.length > 100 ? 2.2 : 3.5, color: colour("point") },
    },
  ], layoutOf({
    margin: { l: 0, r: 0, t: 0, b: 0 }, uirevision: "scene",
    scene: {
      camera: { eye: { x: 1.2, y: -1.7, z: 1.1 } },
      aspectmode: d.flat ? "manual" : "data", ...(d.flat ? { aspectratio: flatRatio(d) } : {}),
      ...Object.fromEntries(["x", "y", "z"].map((a, i) => [`${a}axis`, axisOf({ title: { text: d.axes[i] }, tickformat: ".10~f" })])),
    },
  }), config);
  await draw();
  figures.push(draw);
  div.on("plotly_click", ({ points: [hit] }) => clicked(hit));
}

function flatRatio(d) {
  const size = d.points.map((v, i) => {
    const all = [...v, ...(d.photos.xyz[i] ?? [])];
    let low = Infinity, high = -Infinity;
    for (const u of all) { low = Math.min(low, u); high = Math.max(high, u); }
    return high - low;
  });
  const most = Math.max(size[0], size[1]) || 1;
  return { x: size[0] / most || 0.05, y: size[1] / most || 0.05, z: 0.3 };
}

const PALETTE = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c8c8c", "#b0a500"];

async function drawStatistics(Plotly) {
  const d = await dataOf("statistics");
  const bars = (counts, x) => Object.entries(counts).map(([name, y], i) => ({
    type: "bar", name: plain(name), x, y, marker: { color: PALETTE[i % PALETTE.length] },
  }));
  const limits = d.critical === null ? [] : [-d.critical, d.critical];
  const upright = (at) => ({
    type: "line", x0: at, x1: at, y0: 0, y1: 1, yref: "paper", line: { color: colour("doubt"), dash: "dash", width: 1.5 },
  });
  const level = (at) => ({ ...upright(at), x0: 0, x1: 1, xref: "paper", yref: "y", y0: at, y1: at });
  const plot = (id, data, more) => Plotly.react(byId(id), data, layoutOf(more), { ...config, scrollZoom: false });
  const draw = () => Promise.all([
    plot("histogram", [
      ...bars(d.histogram, d.centres),
      { type: "scatter", mode: "lines", name: tell("js_normal"), x: d.centres, y: d.normal, line: { color: colour("ink"), width: 1.5, shape: "spline" } },
    ], { barmode: "stack", bargap: 0.05, shapes: limits.map(upright), xaxis: axisOf({ title: { text: d.test } }), yaxis: axisOf({ title: { text: tell("js_count") } }) }),
    plot("quantiles", [
      { type: "scatter", mode: "lines", name: tell("js_normal"), x: [d.quantiles[0], d.quantiles.at(-1)], y: [d.quantiles[0], d.quantiles.at(-1)], line: { color: colour("ink"), width: 1.2 } },
      { type: "scatter", mode: "markers", name: d.test, x: d.quantiles, y: d.sorted, marker: { size: 5, color: d.sorted.map((v) => (d.critical !== null && Math.abs(v) > d.critical ? colour("doubt") : colour("held"))) } },
    ], { showlegend: false, shapes: limits.map(level), xaxis: axisOf({ title: { text: tell("js_quantile") } }), yaxis: axisOf({ title: { text: d.test } }) }),
    plot("redundancy", bars(d.redundancy, Array.from({ length: 20 }, (_, i) => (i + 0.5) / 20)), {
      barmode: "stack", bargap: 0.05, xaxis: axisOf({ title: { text: tell("js_redundancy") }, range: [0, 1] }), yaxis: axisOf({ title: { text: tell("js_count") } }),
    }),
  ]);
  await draw();
  figures.push(draw);
}

async function drawMeanPhotos(Plotly) {
  const every = await dataOf("mean-photos");
  const draw = () => Promise.all(every.map((m, k) => {
    const arrows = m.from[0].map((x, i) => ({
      x: m.to[0][i], y: m.to[1][i], ax: x, ay: m.from[1][i], axref: "x", ayref: "y", xref: "x", yref: "y",
      showarrow: true, arrowhead: 2, arrowsize: 0.8, arrowwidth: 1.4, text: "",
      arrowcolor: colour(m.significant[i] ? "doubt" : "held"),
    }));
    const data = [{
      type: "scatter", mode: "markers", x: m.from[0], y: m.from[1], text: m.count.map((n) => `${tell("js_count")}: ${n}`),
      hoverinfo: "text", marker: { size: 4, color: colour("soft") },
    }];
    return Plotly.react(byId(`mean-photo-${k}`), data, layoutOf({
      annotations: arrows, xaxis: axisOf({ title: { text: `x [${m.unit}]` } }),
      yaxis: axisOf({ title: { text: `y [${m.unit}]` }, scaleanchor: "x", ...(m.down ? { autorange: "reversed" } : {}) }),
    }), { ...config, scrollZoom: false });
  }));
  await draw();
  figures.push(draw);
}

async function start() {
  document.querySelectorAll("table.sheet").forEach((table) => near.observe(table));
  const button_ = byId("scene-show");
  button_?.addEventListener("click", async () => {
    button_.disabled = true;
    byId("scene").hidden = false;
    await drawScene(await plotly()).catch(failed);
    button_.parentElement.hidden = true;
    byId("scene").dataset.made = "yes";
  });
  if (byId("plan")) await drawPlan(await plotly());
  document.documentElement.dataset.ready = "yes";
  const Plotly = byId("histogram") || byId("mean-photo-0") ? await plotly() : null;
  if (byId("data-statistics")) await drawStatistics(Plotly);
  if (byId("data-mean-photos")) await drawMeanPhotos(Plotly);
  document.documentElement.dataset.all = "yes";
}
start().catch(failed);
