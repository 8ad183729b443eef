// The table of all points, and the page of one.
import { axis, chart, local, plain, timeAxis } from "./charts.js";
import { colour, figures, fill, h } from "./dom.js";
import { fixed, isNumber, kindName, labelText, metres, mmOf, moment, seriesOfMetres, stamp, t } from "./language.js";
import { arrivalOf, context, here, on, peek, watch } from "./live.js";
import { alarmItem } from "./overview.js";
import { link, part, pill } from "./parts.js";
import { fixedText } from "./plan_view.js";
import { axesNote, axisName, coordinate, lengthUnit, metresOfUnit } from "./plane.js";
import { observationItem } from "./observation.js";
import { Table } from "./table.js";

const AXES = ["x", "y", "z"];
const STATES = ["suspect", "waiting", "rejected", "accepted"], MOST_OBSERVATIONS = 100;

// Axes in which a network has places: where heights alone are adjusted, x and y of all points are 0.
const axesWithPlaces = (rows) => { const found = AXES.filter((a) => rows.some((p) => p[a])); return found.length ? found : AXES; };
const worstSigma = (p) => (p.determined === false ? -1 : Math.max(...AXES.map((a) => metres(p, `sigma_${a}`)).filter(isNumber), -1));
const stateOf = (p) => (p.fixed ? "fixed" : p.determined === false || !isNumber(p.x) && !isNumber(p.z) ? "undetermined" : p.object === false ? "reference" : "object");

export function points(root, [name], signal) {
  if (name) { point(root, name, signal); return; }
  const box = part(null), alarmed = new Map();
  let table = null, shown = "";
  root.append(box.node);
  const tableOf = (axes) => new Table({
    caption: t("points"), open: (p) => (location.hash = link("points", p.name)),
    columns: [
      { title: t("name"), value: (p) => p.name, node: (p) => h("a", { href: link("points", p.name), tabindex: -1 }, p.name) },
      ...axes.map((a) => ({ title: `${a} [${lengthUnit()}]`, number: true, value: (p) => (isNumber(p[a]) ? p[a] : NaN), text: (p) => coordinate(p[a]), later: a !== "z" })),
      ...axes.map((a) => ({ title: `σ ${a} [mm]`, number: true, later: true, value: (p) => 1000 * metres(p, `sigma_${a}`), text: (p) => fixed(1000 * metres(p, `sigma_${a}`), 2) })),
      { title: `${t("sigma_worst")} [mm]`, number: true, value: (p) => 1000 * worstSigma(p), text: (p) => (worstSigma(p) < 0 ? "–" : fixed(1000 * worstSigma(p), 2)) },
      { title: t("state"), value: (p) => fixedText(p), text: (p) => [fixedText(p), alarmed.has(p.name) ? t("alarm") : ""].filter(Boolean).join(", "), node: (p) => [fixedText(p), alarmed.has(p.name) ? [" ", pill("open", t("alarm"))] : null] },
    ],
  });
  watch(here("points"), (r) => box.show(r, (found) => {
    const axes = axesWithPlaces(found);
    if (shown !== axes.join()) { shown = axes.join(); table = tableOf(axes); }
    if (!table.node.isConnected) fill(box.body, h("p", { class: "note" }, axesNote()), table.node);
    table.set(found);
  }), { events: ["arrival", "epoch"], least: 2000, signal });
  watch("alarms?state=standing", (r) => {
    alarmed.clear();
    for (const a of r.data ?? []) if (!a.network || a.network === context.network) for (const p of a.points ?? []) alarmed.set(p, a);
    table?.draw();
  }, { events: ["alarm"], signal });
  let soon = null;
  on("points", () => { soon ??= setTimeout(() => { soon = null; if (!signal.aborted) table?.draw(); }, 300); }, signal);
}

// A level without a bound is null: nothing controls the errors of its weakest observations.
const levelOf = (bound, what) => (bound[`${what}_mm`] === null ? "∞" : mmOf(bound, what));

// -- one point --------------------------------------------------------------------------------

function point(root, name, signal) {
  const now = part(null), series = part(t("series")), alarms = part(t("alarms")), next = part(t("next_sights")), seen = part(t("observations_of", { name }));
  const about = h("div", { class: "two" }, h("div", {}, next.node, alarms.node), seen.node);
  root.append(h("p", { class: "row" }, h("a", { href: link("points") }, `‹ ${t("view_points")}`), h("a", { href: link("plan", "2d", name) }, t("show_in_plan"))), now.node,
    series.node, about);
  const find = () => (peek(here("points")) ?? []).find((p) => p.name === name);

  let bound = null;
  const drawNow = () => {
    const p = find();
    for (const node of [series.node, about]) node.hidden = !p;
    if (!p) { fill(now.body, h("p", { class: "problem" }, t("point_unknown", { name }))); return; }
    const e = p.ellipse ?? {};
    fill(now.body, h("p", {}, pill(stateOf(p) === "undetermined" ? "waiting" : "plain", fixedText(p))), figures([
      ...axesWithPlaces(peek(here("points")) ?? []).filter((a) => isNumber(p[a])).map((a) => [`${axisName(a)} [${lengthUnit()}]`, [coordinate(p[a]), isNumber(metres(p, `sigma_${a}`)) ? h("span", { class: "note" }, ` σ\u00a0${mmOf(p, `sigma_${a}`, 2)}`) : null], { "data-figure": a }]),
      isNumber(metres(e, "a")) ? [t("ellipse_level", { level: e.level ? `${+(100 * e.level).toPrecision(4)} %` : "" }), p.patched ? "–" : `${mmOf(e, "a", 2)} / ${mmOf(e, "b", 2)} / ${fixed(e.azimuth_deg, 0)}°`, { "data-figure": "ellipse" }] : null,
      bound ? [t("protection", { risk: bound.risk }), t("protection_told", { horizontal: levelOf(bound, "horizontal"), vertical: levelOf(bound, "vertical") }), { "data-figure": "protection" }] : null,
    ], { class: "figures small" }), bound?.weakest?.length ? h("p", { class: "note" }, t("protection_weakest", { names: bound.weakest.map(labelText).join(", ") })) : null);
  };
  watch(here("points"), (r) => now.show(r, drawNow), { events: ["arrival", "epoch"], least: 1500, signal });
  on("points", (rows) => { if (rows.some((p) => p.name === name)) drawNow(); }, signal);
  watch(here(`protection-levels?points=${encodeURIComponent(name)}`), ({ data }) => {
    const row = (data?.rows ?? []).find((b) => b.name === name);
    bound = row ? { ...row, risk: data.risk } : null;
    if (find()) drawNow();
  }, { events: ["arrival", "epoch"], least: 10000, signal });

  let draw = null, data = null;
  const plot = h("div", { class: "plot", role: "img", "aria-label": t("series_label", { name }) }), motion = h("div"), values = h("details", {}, h("summary", {}, t("series_values")));
  watch(here(`series?points=${encodeURIComponent(name)}`), (r) => series.show(r, (found) => {
    const list = found.points ?? found;
    data = (Array.isArray(list) ? list : Object.values(list)).find((s) => s.name === name);
    if (!data?.times?.length) { fill(series.body, h("p", { class: "note" }, t("series_none"))); return; }
    if (!plot.isConnected) fill(series.body, motion, plot, h("p", { class: "note" }, t("series_help"), " ", axesNote()), values);
    drawMotion(motion, data);
    drawValues(values, data);
    const shown = axesOf(data);
    plot.style.height = `${5 + 9.5 * shown.length}rem`;
    if (draw) draw(); else if (!plot.begun) { plot.begun = true; chart(plot, () => seriesFigure(data), signal).then((d) => (draw = d)); }
  }), { events: ["epoch", "alarm"], least: 1000, signal });

  watch(`alarms?point=${encodeURIComponent(name)}&network=${encodeURIComponent(context.network)}`, (r) => alarms.show(r, (found) => {
    const own = found.filter((a) => (a.points ?? []).includes(name));
    fill(alarms.body, own.length ? h("ul", { class: "verdicts" }, own.map(alarmItem)) : h("p", { class: "note" }, t("no_alarms_of", { name })));
  }), { events: ["alarm"], signal });

  watch(here(`next-sights?target=${encodeURIComponent(name)}&most=5`), (r) => next.show(r, (found) => drawNext(next.body, found)), { events: ["arrival"], least: 3000, signal });

  const lists = new Map();
  for (const state of STATES) watch(here(`observations?state=${state}&point=${encodeURIComponent(name)}&limit=${MOST_OBSERVATIONS}`), (r) => seen.show(r, (found) => {
    lists.set(state, found);
    if (seen.body.contains(document.activeElement)) return;
    const parts = STATES.map((s) => lists.get(s)).filter(Boolean), rows = parts.flatMap((p) => p.rows), n = parts.reduce((sum, p) => sum + (p.total ?? p.rows.length), 0);
    fill(seen.body, n > rows.length ? h("p", { class: "note" }, t("listed", { shown: rows.length, n })) : null,
      rows.length ? h("ol", { class: "verdicts" }, rows.map((o) => observationItem({ ...o, verdict: o.state }, arrivalOf(o.epoch, o.id)).node)) : h("p", { class: "note" }, t("no_observations")));
  }), { events: ["arrival"], least: 1000, signal });
}

function drawNext(box, found) {
  const sights = found.sights ?? [];
  const first = found.figures?.[0], determining = found.determining ?? [];
  fill(box, isNumber(metres(first, "now")) ? h("p", {}, t("next_now", { error: mmOf(first, "now", 2) })) : null,
    sights.length
      ? h("ol", { class: "cards" }, sights.map((s, i) => h("li", { class: "card" },
        h("div", {}, i === 0 ? h("strong", {}, `${t("next_best")}: `) : `${i + 1}. `, h("strong", { lang: "en", title: s.sentence }, s.station && s.target ? `${s.station} → ${s.target}` : s.name)),
        h("div", { class: "note" }, (s.kinds ?? []).map(kindName).join(", ")),
        h("div", { class: "note figure" }, t("next_gain", { error: mmOf(s.figures?.[0], "after", 2), gain: fixed(100 * s.gain, 1) })))))
      : determining.length ? null : h("p", { class: "note" }, t("next_none")),
    determining.length ? [h("p", {}, t("next_determining")), h("ul", {}, determining.map((what) => h("li", { lang: "en" }, what)))] : null);
}

function drawMotion(box, s) {
  const m = s.motion;
  if (!m?.times?.length) { box.replaceChildren(); return; }
  const last = m.times.length - 1, test = m.T_of_model?.[last], limit = m.critical_of_model?.[last], fits = !(test > limit);
  const rows = AXES.filter((a) => (m[`velocity_${a}_mm_per_day`] ?? []).some(isNumber)).map((a) => {
    const v = m[`velocity_${a}_mm_per_day`][last], sigma = m[`sigma_velocity_${a}_mm_per_day`]?.[last];
    return [t("velocity", { axis: axisName(a) }), [`${fixed(v, 3)} ± ${fixed(sigma, 3)}\u00a0mm/d`, fits ? h("span", { class: "note" }, ` ${t(Math.abs(v) > 3 * sigma ? "velocity_significant" : "velocity_none")}`) : null]];
  });
  fill(box, fits ? null : h("p", { class: "problem" }, t("motion_not_of_model", { test: fixed(test, 1), limit: fixed(limit, 1) })), rows.length ? figures(rows, { class: "figures small" }) : null);
}
function drawValues(box, s) {
  const rows = s.times.map((time, i) => ({ time, epoch: s.epochs?.[i], i }));
  const columns = [
    { title: t("epoch"), value: (r) => r.epoch, number: true },
    { title: t("time"), value: (r) => r.time, text: (r) => stamp(r.time), node: (r) => moment(r.time) },
    ...AXES.filter((a) => (s[a] ?? []).some(isNumber)).flatMap((a) => {
      const sigma = seriesOfMetres(s, `sigma_${a}`);
      return [
        { title: `${a} [${lengthUnit()}]`, number: true, value: (r) => s[a][r.i] ?? NaN, text: (r) => coordinate(s[a][r.i]) },
        { title: `σ ${a} [mm]`, number: true, value: (r) => (sigma[r.i] ?? NaN) * 1000, text: (r) => fixed((sigma[r.i] ?? NaN) * 1000, 2) },
        { title: `Δ${a} [mm]`, number: true, value: (r) => s[`d${a}_mm`]?.[r.i] ?? NaN, text: (r) => fixed(s[`d${a}_mm`]?.[r.i], 2) },
      ];
    }),
  ];
  const table = new Table({ caption: t("series_values"), columns, rows: rows.toReversed(), name: (r) => String(r.epoch ?? r.time), filters: false });
  box.replaceChildren(box.firstChild, table.node);
}

// Displacements from the reference epoch in mm: σ band, what can be detected, the motion and alarms.
// The reference is the epoch before the first displacement; epochs that are not compared, and those
// of a site that compares nothing, show their coordinates less those of the reference.
function displacementsOf(s, a) {
  const moved = s[`d${a}_mm`] ?? [], first = moved.findIndex(isNumber);
  const known = s[a].map((v, i) => (isNumber(v) ? i : -1)).filter((i) => i >= 0);
  const base = s[a][known.filter((i) => i < first).at(-1) ?? known[0]];
  const sigma = seriesOfMetres(s, `sigma_${a}`), ofMoved = seriesOfMetres(s, `sigma_d${a}`);
  return {
    off: s[a].map((v, i) => (isNumber(moved[i]) ? moved[i] : isNumber(v) ? 1000 * metresOfUnit() * (v - base) : null)),
    sigma: s[a].map((_, i) => 1000 * (isNumber(moved[i]) ? ofMoved[i] : sigma[i] ?? NaN)),
  };
}

// Axes in which epochs are compared; where none are, those that have coordinates.
function axesOf(s) {
  const compared = AXES.filter((a) => (s[`d${a}_mm`] ?? []).some(isNumber));
  return compared.length ? compared : AXES.filter((a) => (s[a] ?? []).some(isNumber));
}

function seriesFigure(s) {
  const shown = axesOf(s), times = s.times.map(local), data = [], layout = { shapes: [], annotations: [], margin: { l: 55, r: 12, t: 8, b: 40 } };
  const gap = 0.05, high = (1 - gap * (shown.length - 1)) / shown.length;
  const ofAlarm = seriesOfMetres(s, "alarm_detectable"), detectable = ofAlarm.some(isNumber) ? ofAlarm : seriesOfMetres(s, "detectable");
  shown.forEach((a, row) => {
    const y = row ? `y${row + 1}` : "y", { off, sigma } = displacementsOf(s, a), legend = row === 0;
    const edge = (sign) => off.map((v, i) => (v === null || !isNumber(sigma[i]) ? null : v + sign * sigma[i]));
    const common = { type: "scatter", xaxis: "x", yaxis: y, x: times };
    data.push({ ...common, y: edge(-1), mode: "lines", line: { width: 0 }, hoverinfo: "skip", showlegend: false },
      { ...common, y: edge(1), mode: "lines", line: { width: 0 }, fill: "tonexty", fillcolor: "rgba(0,114,178,0.28)", hoverinfo: "skip", name: t("band_sigma"), legendgroup: "s", showlegend: legend });
    if (detectable.some(isNumber)) for (const sign of [-1, 1])
      data.push({ ...common, y: detectable.map((d) => (isNumber(d) ? sign * 1000 * d : null)), mode: "lines", line: { color: colour("doubt"), width: 1.4, dash: "dash" }, hoverinfo: "skip", name: t("band_detectable"), legendgroup: "d", showlegend: legend && sign > 0 });
    const motion = s.motion?.[`displacement_${a}_mm`] ?? [];
    if (motion.some(isNumber))
      data.push({ ...common, x: s.motion.times.map(local), y: motion, mode: "lines", line: { color: colour("sight2"), width: 2, dash: "dot" }, hoverinfo: "skip", name: t("motion_model"), legendgroup: "m", showlegend: legend });
    data.push({ ...common, y: off, mode: "lines+markers", line: { color: colour("held"), width: 1.5 }, marker: { size: 5 }, name: t("displacement"), legendgroup: "v", showlegend: legend, text: s.times.map((time, i) => `${t("epoch")} ${s.epochs?.[i] ?? ""}: ${fixed(off[i], 2)} mm`), hoverinfo: "text+x" });
    const top = 1 - row * (high + gap);
    layout[`yaxis${row ? row + 1 : ""}`] = axis({ domain: [Math.max(top - high, 0), top], title: { text: `Δ${axisName(a)} [mm]` } });
  });
  // The first of consecutive epochs that exceed a limit has the name of the rule.
  const before = new Map();
  for (const alarm of s.alarms ?? []) {
    layout.shapes.push({ type: "line", x0: local(alarm.time), x1: local(alarm.time), yref: "paper", y0: 0, y1: 1, line: { color: colour("doubt"), width: 1.5, dash: "dot" } });
    const at = s.epochs.indexOf(alarm.epoch);
    if (before.get(alarm.rule) !== at - 1 || at < 0) layout.annotations.push({ x: local(alarm.time), yref: "paper", y: 1, yanchor: "bottom", xanchor: "right", showarrow: false, text: `⚠ ${plain(alarm.rule)}`, font: { color: colour("doubt") } });
    before.set(alarm.rule, at);
    layout.margin.t = 24;
  }
  layout.xaxis = timeAxis({ anchor: shown.length > 1 ? `y${shown.length}` : "y" });
  return { data, layout };
}
