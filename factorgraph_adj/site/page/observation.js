// One observation with its verdict, its reasons and what may be done with it.
import { command } from "./api.js";
import { ask, button, fill, h } from "./dom.js";
import { fixed, kindName, labelText, moment, significant, t } from "./language.js";
import { context } from "./live.js";
import { act, may, pill } from "./parts.js";

const nameOf = (v) => (v.label ? labelText(v.label) : `${kindName(v.kind)} ${v.id}`);

const listed = (lacks) => (Array.isArray(lacks) ? lacks.join("; ") : lacks ?? "");

// Why the verdict is as it is: sentences of the page, then those of the service.
export function reasonsOf(v) {
  const out = [];
  if (v.verdict === "waiting" || v.lacks) out.push([t("lacks", { what: "" }), h("span", { lang: "en" }, listed(v.lacks))]);
  const w = v.w ?? [];
  if (Array.isArray(w) && w.length) {
    const worst = w.reduce((best, x, i) => (Math.abs(x ?? 0) > Math.abs(w[best] ?? 0) ? i : best), 0);
    out.push(t("tested", {
      off: fixed(v.innovation?.[worst], 2), unit: v.small_unit ?? "", sigma: fixed(v.innovation_sigma?.[worst], 2),
      w: fixed(w[worst], 1), r: fixed(v.redundancy_number?.[worst], 2), test: fixed(v.test, 2),
    }));
    if (v.test !== undefined && v.test !== null && v.controlled !== false) out.push(t(v.test > 1 ? "test_failed" : "test_passed", { test: fixed(v.test, 2) }));
  } else if (typeof w === "number" || typeof v.r === "number")
    out.push(t("in_graph", { v: significant(v.v), unit: v.small_unit ?? "", w: fixed(v.w, 1), r: fixed(v.r, 2), mdb: significant(v.mdb) }));
  if (v.controlled === false) out.push(t("uncontrolled"));
  if (v.cause) out.push([t("cause"), " ", h("span", { lang: "en" }, v.cause)]);
  if (v.doubt) out.push(h("span", { lang: "en" }, v.doubt));
  return out;
}

// Commands for the state of an observation, in the order of use at the instrument.
const ACTS = { suspect: ["accept", "reject", "replace"], rejected: ["accept"], accepted: ["remove", "sigma", "replace"], waiting: ["remove"] };

async function run(row, what, v, done) {
  const id = v.id, name = nameOf(v);
  if (what === "accept") return act(row, { do: "accept", ids: [id] }, () => (done("accepted"), t("accepted_done", { name })));
  if (what === "reject") return act(row, { do: "discard", ids: [id] }, () => (done("rejected"), t("rejected_done", { name })));
  if (what === "remove") {
    const sure = await ask({ title: t("remove_title", { name }), content: h("p", {}, t("remove_what")), agree: t("remove"), cancel: t("cancel"), danger: true });
    return sure && act(row, { do: "remove", ids: [id] }, () => (done("gone"), t("removed_done", { name })));
  }
  if (what === "sigma") {
    const given = await ask({
      title: t("sigma_title", { name }), agree: t("change"), cancel: t("cancel"),
      content: [h("p", {}, t("sigma_what")), h("label", { class: "field" }, t("sigma_times"), h("input", { name: "times", type: "number", min: 0.01, step: "any", value: "2", required: true, inputmode: "decimal" }))],
      check: (form) => (Number(form.times.value) > 0 ? null : t("sigma_wrong")),
    });
    // σ grows by the factor, the weight shrinks by its square.
    return given && act(row, { do: "reweight", ids: [id], factor: 1 / Number(given.get("times")) ** 2 }, () => t("sigma_done", { name, times: given.get("times") }));
  }
  return replace(row, v, name, done);
}

const FIXED = new Set(["kind", "time", "request", "station", "target", "photo", "point", "do", "id", "set", "from", "to"]);
// A field of a reading, with its unit.
const fieldName = (key, v) => {
  const of = /^sigma_(.+)$/.exec(key), unit = /\s(\S+)$/.exec(v.value ?? "")?.[1];
  return of ? `σ [${of[1]}]` : key === "value" ? t("reading_value") + (unit ? ` [${unit}]` : "") : key.replaceAll("_", " ");
};
async function replace(row, v, name, done) {
  const editable = Object.entries(v.record).filter(([key, value]) => !FIXED.has(key) && typeof value !== "object");
  const given = await ask({
    title: t("replace_title", { name }), agree: t("replace"), cancel: t("cancel"),
    content: [h("p", {}, t("replace_what")), editable.map(([key, value]) => h("label", { class: "field" }, fieldName(key, v), h("input", { name: key, value, required: true, inputmode: typeof value === "number" ? "decimal" : "text" })))],
    check: (form) => {
      const wrong = editable.filter(([key, value]) => typeof value === "number" && !Number.isFinite(Number(form.elements[key].value.replace(",", ".")))).map(([key]) => key);
      return wrong.length ? t("replace_wrong", { fields: wrong.join(", ") }) : null;
    },
  });
  if (!given) return null;
  const observation = { ...v.record };
  delete observation.request;
  for (const [key, value] of editable) observation[key] = typeof value === "number" ? Number(given.get(key).replace(",", ".")) : given.get(key);
  return act(row, () => command(context.network, { do: "replace", id: v.id, observation }), () => (done("gone"), t("replaced_done", { name })));
}

export function observationItem(v, { at, by, fresh = false, state } = {}) {
  const node = h("li", { class: `${v.verdict}${fresh ? " new" : ""}`, "data-id": v.id, "data-verdict": v.verdict });
  const present = h("span", {}), buttons = h("div", { class: "row" });
  fill(node,
    h("div", { class: "head" }, pill(v.verdict), h("strong", {}, nameOf(v)), present,
      h("span", { class: "note" }, [at ? moment(at, { withSeconds: true }) : null, by].filter(Boolean).map((part, i) => [i ? " · " : "", part]))),
    h("div", { class: "why" }, reasonsOf(v).map((r, i) => [i ? " · " : "", r])),
    buttons);
  const become = (now) => {
    node.dataset.now = now;
    fill(present, now !== v.verdict ? [h("span", { class: "unseen" }, `${t("by_now")} `), pill(now)] : null);
    const acts = may("surveyor") ? (ACTS[now] ?? []).filter((a) => a !== "replace" || v.record) : [];
    fill(buttons, acts.map((a) => button(t(a), () => run(buttons, a, v, become), { "data-act": a, "aria-label": `${t(a)}: ${nameOf(v)}` })));
    buttons.hidden = !acts.length;
  };
  become(state ?? v.verdict);
  return { node, become, id: v.id };
}
