// Epochs with their congruence tests, and σ̂0 and variance components over time.
import { request } from "./api.js";
import { axis, chart, local, plain, timeAxis } from "./charts.js";
import { ask, button, colour, figures, fill, h } from "./dom.js";
import { fixed, isNumber, kindName, metres, moment, stamp, t, word } from "./language.js";
import { here, watch } from "./live.js";
import { act, link, may, part, pill, pointLink, pointLinks } from "./parts.js";
import { filesOfEpoch } from "./downloads.js";
import { epochReadings } from "./epoch_readings.js";
import { axesNote } from "./plane.js";
import { Table } from "./table.js";

const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#b08400", "#56b4e9", "#8c8c8c"];
const SYMBOLS = ["circle", "square", "diamond", "triangle-up", "cross", "x", "star"];

// Epoch 0 is that of the project; where that has no readings, nothing was measured in it.
const hasBegun = (e) => e.number > 0 || !e.counts || e.counts.observations > 0;
const movedOf = (e) => e.congruence?.moved ?? [];
// The reference points may be untested, where there are none; their shape may have changed without
// a single point that is significant.
const verdictOf = (e) => {
  const moved = movedOf(e).length;
  if (moved) return ["moved", t("moved_n", { n: moved })];
  if (e.congruence?.outcome === "changed") return ["moved", t("changed")];
  return e.congruence ? ["stable", t("stable")] : null;
};
// Whether σ̂0 lies outside the limits of its global test; older results have none.
const isOutside = ({ sigma0, sigma0_limits: limits }) => isNumber(sigma0) && isNumber(limits?.[0]) && (sigma0 < limits[0] || sigma0 > limits[1]);
const limitsText = ({ sigma0_limits: limits }) => `${fixed(limits?.[0], 2)}\u00a0…\u00a0${fixed(limits?.[1], 2)}`;
const outsideMark = (e) => (isOutside(e) ? [" ", pill("doubts", t(e.sigma0 > e.sigma0_limits[1] ? "sigma0_high" : "sigma0_low"))] : null);
const leftOut = (e) => (e.counts ? e.counts.rejected + e.counts.suspects : NaN);
const outcome = (e) => {
  const found = verdictOf(e);
  return found ? pill(...found) : h("span", { class: "note" }, "–");
};

export function epochs(root, [number], signal) {
  if (number !== undefined) { epoch(root, number, signal); return; }
  const box = part(null), sigma = part(t("components"));
  const table = new Table({
    caption: t("view_epochs"), name: (e) => String(e.number), open: (e) => (location.hash = link("epochs", e.number)),
    columns: [
      { title: t("epoch"), number: true, value: (e) => e.number, node: (e) => h("a", { href: link("epochs", e.number), tabindex: -1 }, e.number) },
      { title: t("begin"), value: (e) => e.begin, text: (e) => stamp(e.begin), node: (e) => moment(e.begin) },
      { title: t("end"), value: (e) => e.end, text: (e) => stamp(e.end), node: (e) => moment(e.end), later: true },
      { title: t("state"), value: (e) => word("state", e.state), later: true, node: (e) => [word("state", e.state), e.revision > 1 ? ` (${t("revision", { number: e.revision })})` : ""] },
      { title: "σ̂0", number: true, value: (e) => e.sigma0 ?? NaN, text: (e) => fixed(e.sigma0, 3), node: (e) => [fixed(e.sigma0, 3), outsideMark(e)] },
      { title: t("redundancy"), number: true, later: true, value: (e) => e.redundancy ?? NaN, text: (e) => String(e.redundancy ?? "–") },
      { title: t("congruence"), value: (e) => movedOf(e).length, number: false, text: (e) => verdictOf(e)?.[1] ?? "–", node: outcome },
      { title: t("moved_points"), later: true, value: (e) => movedOf(e).join(", "), node: (e) => pointLinks(movedOf(e), 6) },
      { title: t("count_left_out"), number: true, later: true, value: (e) => leftOut(e), text: (e) => (isNumber(leftOut(e)) ? String(leftOut(e)) : "–") },
    ],
  });
  const tools = h("div", { class: "row" });
  if (may("surveyor")) tools.append(button(t("close_epoch"), async () => {
    const sure = await ask({ title: t("close_title"), content: h("p", {}, t("close_what")), agree: t("close_epoch"), cancel: t("cancel") });
    if (sure) act(tools, () => request("POST", here("epochs"), { close: true }), () => t("close_done"));
  }));
  root.append(tools, box.node, sigma.node);
  watch(here("epochs"), (r) => box.show(r, (found) => { if (!table.node.isConnected) fill(box.body, table.node); table.set(found.filter(hasBegun).toReversed()); }), { events: ["epoch"], signal });
  const plot = h("div", { class: "plot", role: "img", "aria-label": t("components_label") });
  let draw = null, data = [];
  watch(here("variance-components"), (r) => sigma.show(r, (found) => {
    data = found;
    if (!data.length) { fill(sigma.body, h("p", { class: "note" }, t("components_none"))); return; }
    if (!plot.isConnected) fill(sigma.body, plot, h("p", { class: "note" }, t("components_help")));
    if (draw) draw(); else if (!plot.begun) { plot.begun = true; chart(plot, () => componentsFigure(data), signal).then((d) => (draw = d)); }
  }), { events: ["epoch"], least: 2000, signal });
}

function componentsFigure(found) {
  const times = found.map((e) => local(e.time)), names = [...new Set(found.flatMap((e) => (e.groups ?? []).map((g) => g.name)))];
  const data = [
    { type: "scatter", mode: "lines+markers", name: "σ̂0", x: times, y: found.map((e) => e.sigma0), line: { color: colour("ink"), width: 2.5 }, marker: { size: 5 } },
    ...names.map((name, i) => ({
      type: "scatter", mode: "lines+markers", name: plain(kindName(name)), x: times, y: found.map((e) => e.groups?.find((g) => g.name === name)?.component ?? null),
      line: { color: COLOURS[i % COLOURS.length], width: 1.4, dash: ["solid", "dash", "dot"][i % 3] }, marker: { symbol: SYMBOLS[i % SYMBOLS.length], size: 6 },
    })),
  ];
  return { data, layout: { xaxis: timeAxis(), yaxis: axis({ title: { text: t("factor_sigma") }, rangemode: "tozero" }), shapes: [{ type: "line", xref: "paper", x0: 0, x1: 1, y0: 1, y1: 1, line: { color: colour("soft"), dash: "dot" } }] } };
}

// Components of a motion with σ, those that are determined.
const motionText = (name, block, what, unit, decimals) => {
  const values = block[`${what}_${unit}`] ?? [], sigmas = block[`sigma_${what}_${unit}`] ?? [];
  const told = ["x", "y", "z"].flatMap((a, i) => (isNumber(values[i]) ? [`${a}\u00a0${fixed(values[i], decimals)}\u00a0±\u00a0${fixed(sigmas[i], decimals)}\u00a0${unit}`] : []));
  return told.length ? `${name}: ${told.join(", ")}` : "";
};

// Which epoch the others are compared with, and why.
const referenceText = (r) => {
  const which = t(r.epochs > 1 ? "reference_mean" : "reference_is", { number: r.epoch, n: r.epochs });
  return `${which} ${t(`reference_${r.why}`)}${r.poorer ? ` ${t("reference_poorer")}` : ""}`;
};

// -- one epoch --------------------------------------------------------------------------------

function epoch(root, number, signal) {
  const box = part(null), compared = h("div"), readings = epochReadings(number, signal);
  root.append(h("p", { class: "row" }, h("a", { href: link("epochs") }, `‹ ${t("view_epochs")}`)), box.node);
  let table = null;
  watch(here(`epochs/${encodeURIComponent(number)}`), (r) => box.show(r, (row) => {
    const e = row, c = e.congruence, rows = e.displacements ?? [], blocks = e.blocks ?? [];
    const head = h("div", {},
      verdictOf(e) ? h("p", {}, outcome(e)) : null,
      figures([
        [t("begin"), moment(e.begin)], [t("end"), moment(e.end)], [t("state"), word("state", e.state)],
        ["σ̂0", [fixed(e.sigma0, 3), isNumber(e.sigma0_limits?.[0]) && h("span", { class: "note" }, ` ${limitsText(e)}`), outsideMark(e)], { "data-figure": "sigma0" }], [t("observations"), e.counts?.observations ?? "–"], [t("redundancy"), e.redundancy ?? "–"], [t("revision_head"), e.revision ?? "–"],
      ], { class: "figures small" }),
      e.problem ? h("p", { class: "problem", lang: "en" }, e.problem) : null,
      isNumber(e.revised) ? h("p", { class: "note" }, t("revised_by", { number: e.revised })) : null,
      e.reference ? h("p", { class: e.reference.poorer ? "problem" : "note" }, referenceText(e.reference)) : null,
      c && isNumber(c.test) ? h("p", {}, t(c.outcome === "changed" ? "congruence_failed" : "congruence_passed", { against: e.against ?? "–", test: fixed(c.test, 2), critical: fixed(c.critical, 2) })) : h("p", { class: "note" }, t("congruence_none")),
      movedOf(e).length ? h("p", {}, t("moved_points"), ": ", pointLinks(movedOf(e), 30)) : null,
      e.state === "closed" && !e.problem ? h("p", { class: "note" }, t("files_of_epoch"), ": ", filesOfEpoch(e.number)) : null);
    const blockList = blocks.length ? [h("h3", { class: "livehead" }, t("blocks")), h("ul", { class: "cards" }, blocks.map((b, i) => h("li", { class: "card" },
      h("strong", {}, t("block_n", { number: i + 1 })), " ", b.problem ? null : pill(b.moved ? "moved" : "stable", t(b.moved ? "moved" : "stable")),
      b.problem ? h("div", { class: "problem", lang: "en" }, b.problem) : [
        h("div", { class: "figure" }, motionText(t("shift"), b, "translation", "mm", 1)),
        h("div", { class: "figure" }, motionText(t("rotation"), b, "rotation", "mgon", 2)),
        h("div", {}, t("block_test", { test: fixed(b.test, 2), critical: fixed(b.critical, 2) })),
        isNumber(b.fit) ? h("div", {}, t(b.rigid ? "block_fits" : "block_misfits", { test: fixed(b.fit, 2), critical: fixed(b.fit_critical, 2) })) : null],
      h("div", { class: "note" }, pointLinks(b.points ?? [], 20)))))] : null;
    if (!table && rows.length) table = new Table({
      caption: t("displacements", { against: e.against ?? "–" }), open: (d) => (location.hash = link("points", d.name)),
      columns: [
        { title: t("name"), value: (d) => d.name, node: (d) => pointLink(d.name) },
        ...["x", "y", "z"].map((a) => ({ title: `Δ${a} [mm]`, number: true, value: (d) => 1000 * metres(d, `d${a}`), text: (d) => fixed(1000 * metres(d, `d${a}`), 2) })),
        ...["x", "y", "z"].map((a) => ({ title: `σ Δ${a} [mm]`, number: true, later: true, value: (d) => 1000 * metres(d, `sigma_d${a}`), text: (d) => fixed(1000 * metres(d, `sigma_d${a}`), 2) })),
        { title: t("verdict"), value: (d) => t(d.moved ? "moved" : "stable"), node: (d) => pill(d.moved ? "moved" : "stable", t(d.moved ? "moved" : "stable")) },
        { title: "T/h", number: true, value: (d) => d.T ?? NaN, text: (d) => fixed(d.T, 2) },
        { title: t("critical"), number: true, later: true, value: (d) => d.critical ?? NaN, text: (d) => fixed(d.critical, 2) },
        { title: `${t("detectable")} [mm]`, number: true, later: true, value: (d) => 1000 * metres(d, "detectable"), text: (d) => fixed(1000 * metres(d, "detectable"), 2) },
        { title: `${t("alarm_detectable")} [mm]`, number: true, later: true, value: (d) => 1000 * metres(d, "alarm_detectable"), text: (d) => fixed(1000 * metres(d, "alarm_detectable"), 2) },
      ],
    });
    table?.set(rows);
    // What is open in the list of readings stays open when the epoch is read again.
    if (!readings.node.isConnected) fill(box.body, h("div"), readings.node, compared);
    readings.show(e);
    box.body.firstChild.replaceWith(head);
    fill(compared, rows.length || blocks.length ? [h("h2", { class: "livehead" }, t("movements", { against: e.against ?? "–" })), h("p", { class: "note" }, axesNote())] : null, blockList, table ? [table.node, h("p", { class: "note" }, t("displacement_test_note"))] : null);
  }), { events: ["epoch"], signal });
}
