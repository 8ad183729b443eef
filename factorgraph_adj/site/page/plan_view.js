// The plan and the view in three dimensions, with their tools.
import { button, fill, h } from "./dom.js";
import { fixed, isNumber, metres, mm, recall, remember, signed, stamp, t } from "./language.js";
import { connection, here, on, peek, watch } from "./live.js";
import { link, part, pointLink } from "./parts.js";
import { Plan, SIGHTS } from "./plan.js";
import { axisName, coordinate, lengthUnit, placed, sigmaUp, turned } from "./plane.js";
import { pointSearch } from "./search.js";
import { svg } from "./symbols.js";

const CRITICAL = 3.29; // of |w| at α = 0.001, where the service states none
const FRESH = 60; // s for which the rays of a photo that has arrived are drawn

export const criticalOf = (summary) => summary?.critical_w ?? CRITICAL;

// Rows of the points for the plan, in metres.
export function planRows(points) {
  const out = [];
  for (const p of points) {
    const place = placed(p);
    if (!place || p.determined === false) continue;
    const [x, y] = place;
    const e = p.ellipse ?? {};
    out.push({
      name: p.name, x, y, a: metres(e, "a"), b: metres(e, "b"), turn: ((e.azimuth_deg ?? 0) * Math.PI) / 180,
      look: p.fixed ? "fixed" : p.object === false ? "reference" : "object",
    });
  }
  return out;
}

export const fixedText = (p) => (p.fixed ? t("point_fixed", { axes: p.fixed }) : p.determined === false || p.x === null ? t("point_undetermined") : p.object === false ? t("point_reference") : t("point_object"));

export function planView(root, [mode = "2d", chosen], signal) {
  const dimension = mode === "3d" ? "3d" : "2d";
  const modes = h("div", { class: "row" }, ["2d", "3d"].map((m) => button(t(`plan_${m}`), () => (location.hash = link("plan", m)), { "aria-pressed": String(m === dimension) })));
  root.append(modes);
  if (dimension === "3d") { import("./scene.js").then(({ scene }) => !signal.aborted && scene(root, signal)); return; }
  drawPlan(root, modes, chosen, signal);
}

function drawPlan(root, bar, first, signal) {
  const canvas = h("canvas", { tabindex: 0, role: "application", "aria-roledescription": t("plan_role"), "aria-label": t("plan_label"), "aria-describedby": "plan-keys" });
  const told = h("div", { class: "told" }), card = h("div", { class: "chosen", role: "status" });
  const notice = part(null), noPlan = h("p", { class: "note" }, t("plan_heights_only"), " ", h("a", { href: link("points") }, t("view_points")));
  let points = [], read = false;
  const plan = new Plan(canvas, { chosen: describe, hovered: (name) => { if (told.dataset.name !== (name ?? "")) { told.dataset.name = name ?? ""; tell(); } }, drawn: () => tell() });
  const box = h("div", { class: "planbox" }, canvas, told, card, h("div", { class: "zoom" },
    button("+", () => plan.zoom(1.5), { class: "icon", "aria-label": t("zoom_in"), title: t("zoom_in") }),
    button("−", () => plan.zoom(1 / 1.5), { class: "icon", "aria-label": t("zoom_out"), title: t("zoom_out") }),
    button("⤢", () => plan.fit(), { class: "icon", "aria-label": t("zoom_all"), title: t("zoom_all") })));
  const search = pointSearch(() => plan.points.names, (name) => plan.show(name));
  bar.append(search);
  const epochs = h("select", { "aria-label": t("vectors_of"), on: { change: () => vectorsOf(epochs.value) } }, h("option", { value: "" }, t("vectors_none")));
  const toggles = ["sights", "ellipses", "names", "photos"].map((what) => {
    plan.shown[what] = recall(`plan-${what}`) !== "off";
    const input = h("input", { type: "checkbox", checked: plan.shown[what], on: { change: () => { plan.shown[what] = input.checked; remember(`plan-${what}`, input.checked ? null : "off"); plan.redraw(); } } });
    return h("label", {}, input, t(`show_${what}`));
  });
  const settings = h("details", { open: matchMedia("(min-width: 60rem)").matches }, h("summary", {}, t("plan_settings")),
    h("div", { class: "row" }, toggles, h("span", { class: "row", role: "group", "aria-label": t("ellipse_scale") }, t("ellipse_scale"),
      button("−", () => plan.scale(false), { class: "icon", "aria-label": t("ellipse_smaller") }), button("+", () => plan.scale(true), { class: "icon", "aria-label": t("ellipse_larger") }),
      button(t("ellipse_auto"), () => plan.rescale())),
    h("label", {}, t("vectors_of"), epochs)));
  const keys = h("p", { class: "note", id: "plan-keys" }, t("plan_keys")), symbols = legend();
  const drawn = [search, box, keys, symbols, settings];
  root.append(notice.node, box, keys, symbols, settings);
  notice.body.replaceChildren();
  root.insertBefore(settings, box.nextSibling);
  if (innerWidth >= 960) root.insertBefore(settings, box);

  // The point under the pointer, otherwise what is left out of the drawing.
  function tell() {
    const { name } = told.dataset, { thinned } = plan;
    const text = name ? hover(name) : !read ? t("reading") : thinned && plan.shown.sights ? t("plan_thinned", thinned) : plan.points.names.length || !points.length ? "" : t("plan_none");
    if (told.textContent !== text) told.textContent = text;
  }
  function hover(name) {
    const p = points.find((r) => r.name === name);
    return p ? `${name}  ${fixedText(p)}${!p.patched && isNumber(metres(p.ellipse ?? {}, "a")) ? `  ${mm(metres(p.ellipse, "a"))} / ${mm(metres(p.ellipse, "b"))}` : ""}` : name;
  }
  function describe(name) {
    const p = name && points.find((r) => r.name === name);
    if (!p) { fill(card); return; }
    const e = p.ellipse ?? {}, d = plan.vectors.find((v) => v.name === name);
    fill(card, button("✕", () => { plan.choose(-1); canvas.focus(); }, { class: "icon", "aria-label": t("close") }), h("strong", {}, pointLink(name)), ` ${fixedText(p)}`,
      h("div", { class: "figure" }, ["x", "y", "z"].filter((a) => isNumber(p[a])).map((a) => `${axisName(a)} ${coordinate(p[a])}\u00a0${lengthUnit()}`.replaceAll(", ", " ")).join(", ")),
      !p.patched && isNumber(metres(e, "a")) && h("div", {}, t("ellipse_told", { a: mm(metres(e, "a")), b: mm(metres(e, "b")), azimuth: fixed(e.azimuth_deg, 0) })),
      d && h("div", {}, t(d.moved ? "vector_moved" : "vector_kept", { size: sizes(d) })),
      h("div", {}, h("a", { href: link("points", name) }, t("open_point"))));
  }

  // A displacement in the plane and in height; of what is not compared it says nothing.
  function sizes({ dx, dy, up }) {
    const plane = isNumber(dx) && isNumber(dy) ? [t("size_plane", { size: mm(Math.hypot(dx, dy)) })]
      : [[dx, "east"], [dy, "north"]].filter(([v]) => isNumber(v)).map(([v, to]) => `${signed(v)} ${t(to)}`);
    return [...plane, ...(isNumber(up) ? [t("size_up", { size: signed(up) })] : [])].join(", ");
  }

  const setPoints = (found) => {
    points = found;
    read = true;
    const rows = planRows(found);
    plan.setPoints(rows);
    tell();
    canvas.setAttribute("aria-label", t("plan_label_n", { n: rows.length }));
    drawSights();
    if (first && plan.show(first)) first = null;
  };
  const drawSights = () => { const s = peek(here("sights")); if (s) plan.setSights(s, criticalOf(peek(here("")))); };
  watch(here(""), (r) => {
    const flat = Boolean(r.data?.heights_only);
    for (const node of drawn) node.hidden = flat;
    if (flat) notice.node.prepend(noPlan); else noPlan.remove();
    if (points.length) setPoints(points);
  }, { events: ["epoch"], signal });
  watch(here("points"), (r) => notice.show(r, setPoints), { events: ["arrival", "epoch"], least: 2000, signal });
  watch(here("sights"), drawSights, { events: ["arrival"], least: 1000, signal });
  const seen = new Map();
  watch(here("photos"), (r) => {
    const known = seen.size > 0 || r.photosRead, at = Date.now() / 1000;
    r.photosRead = true;
    plan.setPhotos((r.data ?? []).filter(placed).map((p) => {
      if (!seen.has(p.name)) seen.set(p.name, known ? at : 0);
      const [x, y] = placed(p);
      return { ...p, x, y, rays: p.rays ?? [], fresh: at - seen.get(p.name) < FRESH };
    }));
    drawSights();
  }, { events: ["arrival"], least: 1500, signal });
  on("points", (rows) => plan.move(rows.filter(placed).map((p) => ({ name: p.name, x: placed(p)[0], y: placed(p)[1] }))), signal);
  const staleness = () => {
    plan.stale = connection.state === "live" ? "" : t("not_current", { at: stamp(connection.heard, true) });
    plan.redraw();
  };
  on("connection", staleness, signal);
  staleness();
  addEventListener("theme", () => plan.redraw(), { signal });

  // Displacements of an epoch, of the latest that has some at first.
  async function vectorsOf(number) {
    vectorWatch?.abort();
    if (number === "") { plan.setVectors([]); return; }
    vectorWatch = new AbortController();
    signal.addEventListener("abort", () => vectorWatch.abort());
    watch(here(`epochs/${number}`), (r) => { plan.setVectors((r.data?.displacements ?? []).map((d) => {
      const [dx, dy, up] = turned(["dx", "dy", "dz"].map((a) => metres(d, a)));
      return { name: d.name, dx, dy, up, sigmaUp: sigmaUp(["dx", "dy", "dz"].map((a) => metres(d, `sigma_${a}`))), moved: Boolean(d.moved) };
    })); describe(plan.points.names[plan.chosen]); }, { events: ["epoch"], signal: vectorWatch.signal });
  }
  let vectorWatch = null, begun = false;
  watch(here("epochs"), (r) => {
    const with_ = (r.data ?? []).filter((e) => e.congruence), kept = epochs.value;
    fill(epochs, h("option", { value: "" }, t("vectors_none")), with_.toReversed().map((e) => h("option", { value: e.number }, `${e.number} (${stamp(e.end ?? e.begin)})`)));
    epochs.value = kept;
    if (!begun && with_.length) { begun = true; const last = with_.at(-1); epochs.value = last.number; vectorsOf(last.number); }
  }, { events: ["epoch"], signal });
  window.planForTests = plan;
  return plan;
}

function legend() {
  const line = (s) => svg("svg", { viewBox: "0 0 36 16", "aria-hidden": "true" }, svg("path", { d: "M1 8h34", stroke: `var(--${s.colour})`, "stroke-width": s.width + 0.5, "stroke-dasharray": s.dash.join(" ") || "none" }));
  const shape = (...parts) => svg("svg", { viewBox: "0 0 36 16", "aria-hidden": "true" }, ...parts);
  return h("ul", { class: "legend", "aria-label": t("legend") },
    SIGHTS.map((s) => h("li", {}, line(s), t(`sight_${s.key}`))),
    h("li", {}, shape(svg("path", { d: "m18 1 8 13H10Z", fill: "var(--held)" })), t("legend_fixed")),
    h("li", {}, shape(svg("rect", { x: 13, y: 3, width: 10, height: 10, fill: "none", stroke: "var(--held)", "stroke-width": 2 })), t("legend_reference")),
    h("li", {}, shape(svg("circle", { cx: 18, cy: 8, r: 3.5, fill: "var(--point)" })), t("legend_object")),
    h("li", {}, shape(svg("ellipse", { cx: 18, cy: 8, rx: 14, ry: 6, fill: "none", stroke: "var(--ellipse)", "stroke-width": 1.6 })), t("legend_ellipse")),
    h("li", {}, shape(svg("path", { d: "M3 12 25 5", stroke: "var(--moved)", "stroke-width": 3 }), svg("path", { d: "m33 3-9-2 3 8Z", fill: "var(--moved)" })), t("legend_moved")),
    h("li", {}, shape(svg("path", { d: "M13 14V5m-4 3 4-5 4 5", fill: "none", stroke: "var(--moved)", "stroke-width": 2 }), svg("path", { d: "M22 2v9m-4-3 4 5 4-5", fill: "none", stroke: "var(--moved)", "stroke-width": 2 })), t("legend_heights")),
    h("li", {}, shape(svg("rect", { x: 12, y: 4, width: 12, height: 8, fill: "none", stroke: "var(--photo)", "stroke-width": 2 })), t("legend_photo")));
}
