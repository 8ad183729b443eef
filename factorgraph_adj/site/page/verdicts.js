// Arriving verdicts, and what is suspect, waits, is rejected or in doubt.
import { button, fill, h } from "./dom.js";
import { fixed, moment, significant, t } from "./language.js";
import { answerOf, arrivalOf, context, here, isReading, on, stateOf, verdictsOf, watch } from "./live.js";
import { observationItem } from "./observation.js";
import { observationList } from "./observation_list.js";
import { link, part, pill } from "./parts.js";

const MOST_LIVE = 150;
const TABS = ["live", "suspects", "waiting", "rejected", "causes", "doubts"];

export function verdicts(root, [chosen = "live"], signal) {
  if (!TABS.includes(chosen)) chosen = "live";
  const tabs = h("div", { class: "tabs", role: "tablist", "aria-label": t("view_verdicts") });
  const panel = h("div", { role: "tabpanel", id: "verdict-panel", "aria-labelledby": `tab-${chosen}` });
  root.append(tabs, panel);
  const marks = new Map();
  fill(tabs, TABS.map((name) => {
    const mark = h("span", { class: "badge", hidden: true });
    marks.set(name, mark);
    return h("button", {
      type: "button", role: "tab", id: `tab-${name}`, "aria-selected": String(name === chosen), "aria-controls": "verdict-panel", tabindex: name === chosen ? 0 : -1,
      on: { click: () => (location.hash = link("verdicts", name)) },
    }, t(`tab_${name}`), " ", mark);
  }));
  tabs.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    event.preventDefault();
    const to = TABS[(TABS.indexOf(chosen) + step + TABS.length) % TABS.length];
    sessionStorage.setItem("focus", `tab-${to}`);
    location.hash = link("verdicts", to);
  });
  tabs.querySelector("[aria-selected=true]").scrollIntoView({ block: "nearest", inline: "nearest" });
  const count = (counts) => {
    if (counts) for (const name of ["suspects", "waiting", "rejected", "doubts"]) {
      const mark = marks.get(name);
      mark.textContent = counts[name] ?? "";
      mark.hidden = !counts[name];
    }
  };
  watch(here(""), ({ data }) => count(data?.counts), { events: ["arrival", "epoch"], least: 1000, signal });
  ({ live, suspects: list("suspects"), waiting: list("waiting"), rejected: list("rejected"), causes, doubts })[chosen](panel, signal);
}

// -- what arrives -----------------------------------------------------------------------------

function live(panel, signal) {
  const box = h("ol", { class: "verdicts", "aria-label": t("tab_live") });
  const items = [], held = [];
  let hold = false, only = false;
  const waiting = h("span", { class: "note", role: "status" });
  const holder = button(t("hold"), () => {
    hold = !hold;
    holder.setAttribute("aria-pressed", String(hold));
    if (!hold) { for (const e of held.splice(0)) add(e, true); waiting.textContent = ""; }
  }, { "aria-pressed": "false", title: t("hold_help") });
  const doubtful = h("input", { type: "checkbox", on: { change: () => { only = doubtful.checked; sift(); } } });
  const empty = h("p", { class: "note" }, t("no_verdicts"));
  panel.append(h("div", { class: "row" }, holder, h("label", {}, doubtful, t("only_doubtful")), waiting), empty, box);
  const sift = () => { for (const { node } of items) node.hidden = only && node.dataset.verdict === "accepted" && node.dataset.now === "accepted"; };

  function add(entry, fresh) {
    const answer = answerOf(entry.data), { at, by, epoch, time } = entry.data;
    // Of what somebody has decided it is told when; of readings, when they were measured.
    // What had waited came earlier.
    const came = new Set((answer.entered ?? []).map((v) => v.id));
    const when = ({ id }) => (came.has(id) ? arrivalOf(epoch, id) : isReading(answer) ? { time, at, by } : { time: arrivalOf(epoch, id).time, decided: at, by });
    empty.hidden = true;
    if (entry.event === "refused") {
      const errors = answer.error ?? entry.data.error ?? [];
      const node = h("li", { class: `refused${fresh ? " new" : ""}`, "data-verdict": "refused" },
        h("div", { class: "head" }, pill("refused"), h("span", { class: "note" }, moment(at, { withSeconds: true }), by ? ` · ${by}` : "")),
        h("div", { class: "why", lang: "en" }, errors.map((e) => `${e.where ? `${e.where}: ` : ""}${e.what}`).join("; ")));
      box.prepend(node);
      items.unshift({ node, become() {}, id: null });
    } else {
      const told = verdictsOf(answer);
      for (const v of told) {
        const item = observationItem({ epoch, ...v }, { ...when(v), fresh, state: stateOf(epoch, v.id) });
        box.prepend(item.node);
        items.unshift(item);
      }
      if (!told.length && answer.do) {
        const ids = entry.data.ids ?? [];
        const node = h("li", { class: "plain", "data-verdict": "command" }, h("div", { class: "head" }, pill("plain", t("command")), h("strong", { lang: "en" }, answer.do), h("span", { class: "note" }, moment(at, { withSeconds: true }), by ? ` · ${by}` : "")), ids.length ? h("div", { class: "why" }, ids.join(", ")) : null);
        box.prepend(node);
        items.unshift({ node, become() {}, id: null });
      }
    }
    for (const { node } of items.splice(MOST_LIVE)) node.remove();
    sift();
  }

  const all = () => {
    box.replaceChildren();
    items.length = 0;
    empty.hidden = false;
    for (const e of context.log.slice(-MOST_LIVE)) if (e.event === "arrival" || e.event === "refused") add(e, false);
  };
  all();
  on("log", all, signal);
  on("event", (entry) => {
    if (entry.event !== "arrival" && entry.event !== "refused") return;
    for (const item of items) { const now = stateOf(item.epoch, item.id); if (now && now !== item.node.dataset.now) item.become(now); }
    if (hold) { held.push(entry); waiting.textContent = t("held", { n: held.length }); } else add(entry, true);
  }, signal);
}

const list = (path) => (panel, signal) => panel.append(...observationList(path, signal));

// -- causes and doubts ------------------------------------------------------------------------

// Units of the sizes of errors, which the service gives in SI.
const QUANTITIES = { length: [1e-3, "mm"], angle: [Math.PI / 200000, "mgon"], turn: [Math.PI / 200000, "mgon"], ppm: [1, "ppm"], ratio: [0.01, "%"], image: [1, ""], number: [1, ""], curvature: [1, ""] };
function sizeOf(cause, i) {
  const [one, unit] = QUANTITIES[cause.quantities?.[i]] ?? [1, "?"];
  return [cause.components?.[i], significant(cause.error[i] / one), "±", significant(cause.sigma[i] / one), unit].filter(Boolean).join("\u00a0");
}

function causes(panel, signal) {
  const box = part(null);
  panel.append(h("p", { class: "note" }, t("causes_what")), box.node);
  watch(here("causes"), (resource) => box.show(resource, (found) => {
    const each = found.causes ?? [];
    fill(box.body,
      found.most_probable ? h("p", {}, h("strong", {}, t("most_probable")), " ", h("span", { lang: "en" }, found.most_probable)) : null,
      (found.undecided ?? []).map((text) => h("p", { lang: "en" }, text)),
      each.length
        ? h("ol", { class: "verdicts" }, each.map((c) => h("li", { class: "suspect" },
          h("div", { class: "head" }, h("strong", { lang: "en" }, `${c.cause} ${c.where ?? ""}`)),
          h("div", { class: "why" }, [(c.error ?? []).length ? `${t("cause_size", { size: c.error.map((_, i) => sizeOf(c, i)).join(", ") })} ` : "", t("cause_tested", { t2: fixed(c.t2, 1), critical: fixed(c.critical, 1), n: c.ids?.length ?? 0 })]))))
        : h("p", { class: "note" }, t("no_causes")));
  }), { events: ["arrival"], least: 5000, signal });
}

function doubts(panel, signal) {
  const box = part(null);
  panel.append(box.node);
  watch(here("doubts"), (resource) => box.show(resource, (found) => {
    const each = found.doubts ?? found;
    fill(box.body, each.length ? h("ol", { class: "verdicts" }, each.map((text) => h("li", { class: "suspect", lang: "en" }, text))) : h("p", { class: "note" }, t("no_doubts")));
  }), { events: ["arrival"], least: 2000, signal });
}
