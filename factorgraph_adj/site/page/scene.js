// The network in three dimensions: points, sights, photos and their rays as they arrive.
import { axis, chart, plain } from "./charts.js";
import { button, colour, h } from "./dom.js";
import { t } from "./language.js";
import { here, watch } from "./live.js";
import { link, part } from "./parts.js";
import { criticalOf } from "./plan_view.js";
import { placed } from "./plane.js";
import { SIGHTS, sightClass } from "./plan.js";

const MOST_SIGHTS = 20000, MOST_RAYS = 20000;

export async function scene(root, signal) {
  const box = part(null), div = h("div", { class: "plot tall", role: "img", "aria-label": t("scene_label") });
  const found = { points: [], sights: [], photos: [], critical: criticalOf(null) };
  const times = { factor: 1 };
  const draw3 = () => draw?.();
  const heights = h("div", { class: "row", role: "group", "aria-label": t("heights_scale") }, t("heights_scale"),
    [1, 2, 5, 10].map((f) => button(`× ${f}`, (e) => {
      times.factor = f;
      for (const b of e.target.parentElement.querySelectorAll("button")) b.setAttribute("aria-pressed", String(b === e.target));
      draw3();
    }, { "aria-pressed": String(f === 1) })));
  root.append(heights, box.node, div, h("p", { class: "note" }, t("scene_help")));
  box.body.replaceChildren();
  let draw = null;

  const make = () => {
    const at = new Map([...found.points, ...found.photos].filter(placed).map((p) => [p.name, placed(p)]));
    const lines = (pairs, name, look, width, dash) => {
      const xyz = [[], [], []];
      for (const [a, b] of pairs) {
        const p = at.get(a), q = at.get(b);
        if (p && q) for (let i = 0; i < 3; i++) xyz[i].push(p[i], q[i], null);
      }
      return { type: "scatter3d", mode: "lines", name, x: xyz[0], y: xyz[1], z: xyz[2], hoverinfo: "skip", line: { color: colour(look), width, dash }, connectgaps: false };
    };
    const classes = SIGHTS.map(() => []);
    for (const s of found.sights.slice(0, MOST_SIGHTS)) classes[sightClass(s, found.critical)].push([s.from, s.to]);
    const dashes = ["solid", "dash", "solid", "dot", "dashdot"];
    const rays = found.photos.flatMap((p) => (p.rays ?? []).map((r) => [p.name, r])).slice(0, MOST_RAYS);
    const marks = (rows, name, look, mark, size) => {
      const some = rows.filter((p) => at.has(p.name)), xyz = some.map((p) => at.get(p.name));
      return { type: "scatter3d", mode: "markers", name, x: xyz.map((p) => p[0]), y: xyz.map((p) => p[1]), z: xyz.map((p) => p[2]), text: some.map((p) => plain(p.name)), hoverinfo: "text", marker: { color: colour(look), symbol: mark, size } };
    };
    const many = found.points.length > 2000, all = [...at.values()];
    const span = [0, 1, 2].map((i) => {
      let low = Infinity, high = -Infinity;
      for (const p of all) { low = Math.min(low, p[i]); high = Math.max(high, p[i]); }
      return Math.max(high - low, 1e-3);
    });
    const most = Math.max(span[0], span[1], span[2]);
    const data = [
      ...classes.map((pairs, i) => pairs.length && lines(pairs, t(`sight_${SIGHTS[i].key}`), SIGHTS[i].colour, i === 2 ? 4 : 1.5, dashes[i])),
      rays.length && lines(rays, t("rays"), "photo", 1.2, "dot"),
      found.photos.length && marks(found.photos, t("photos"), "photo", "square", 4),
      marks(found.points.filter((p) => !p.fixed), t("points"), "point", "circle", many ? 1.6 : found.points.length > 100 ? 2.2 : 3.5),
      marks(found.points.filter((p) => p.fixed), t("legend_fixed"), "held", "diamond", 4),
    ].filter(Boolean);
    const title = (text) => axis({ title: { text }, backgroundcolor: "rgba(0,0,0,0)", tickformat: ".10~f" });
    // On a phone the eye is farther away, and the legend stands below.
    const narrow = div.clientWidth < div.clientHeight, away = Math.max((1.3 * div.clientHeight) / div.clientWidth, 1.15);
    return { data, layout: {
      margin: { l: 0, r: 0, t: 0, b: 0 }, uirevision: "scene", legend: { orientation: "h", y: 0, bgcolor: colour("page") },
      scene: {
        camera: { eye: { x: 1.1 * away, y: -1.5 * away, z: 0.9 * away } }, aspectmode: "manual", domain: { y: [narrow ? 0.24 : 0.06, 1] },
        aspectratio: { x: Math.max(1.6 * span[0] / most, 0.08), y: Math.max(1.6 * span[1] / most, 0.08), z: Math.max(1.6 * span[2] * times.factor / most, 0.08) },
        xaxis: title(`${t("east")} [m]`), yaxis: title(`${t("north")} [m]`), zaxis: title(`${t("up")} [m]`),
      },
    } };
  };

  const start = async () => {
    if (draw === null && !signal.begun) { signal.begun = true; draw = await chart(div, make, signal, { scrollZoom: true }); }
    draw?.();
  };
  const noPlan = h("p", { class: "note" }, t("plan_heights_only"), " ", h("a", { href: link("points") }, t("view_points")));
  watch(here(""), (r) => {
    if (r.data) found.critical = criticalOf(r.data);
    if (r.data?.heights_only) root.replaceChildren(root.firstChild, noPlan);
  }, { signal });
  watch(here("points"), (r) => box.show(r, (d) => { found.points = d; start(); }), { events: ["arrival", "epoch"], least: 3000, signal });
  watch(here("sights"), (r) => { found.sights = r.data ?? []; draw?.(); }, { events: ["arrival"], least: 3000, signal });
  watch(here("photos"), (r) => { found.photos = r.data ?? []; div.dataset.photos = found.photos.length; draw?.(); }, { events: ["arrival"], least: 2000, signal });
}
