// One observation with its verdict, its reasons and what may be done with it.
import { command } from "./api.js";
import { ask, button, fill, h } from "./dom.js";
import { fixed, isNumber, kindName, known, labelText, moment, significant, t, word } from "./language.js";
import { context, hasEnded, isRevocable } from "./live.js";
import { act, may, pill, pointLinks } from "./parts.js";

const SAME_SECONDS = 2;
const nameOf = (v) => (v.label ? labelText(v.label) : `${kindName(v.kind)} ${v.id}`);

const listed = (lacks) => (Array.isArray(lacks) ? lacks.join("; ") : lacks ?? "");

// Sizes of errors with σ, of each component that has one.
const sizes = (v, sign) => (v.innovation ?? []).flatMap((off, i) => {
  const name = v.innovation.length > 1 ? `${v.components?.[i] ?? i + 1} ` : "";
  return isNumber(off) ? [`${name}${fixed(sign * off, 2)}\u00a0±\u00a0${fixed(v.innovation_sigma?.[i], 2)}\u00a0${v.small_unit ?? ""}`] : [];
}).join(", ");
const largest = (values) => values.reduce((best, x, i) => (Math.abs(x ?? 0) > Math.abs(values[best] ?? 0) ? i : best), 0);

// The test of an observation that is out: how large its error would be, and what its test says.
function errorOf(v) {
  const i = largest(v.w), single = v.dof === 1;
  return [
    t("gross_error", { size: sizes(v, -1) }),
    t(single ? "tested_w" : "tested_t2", {
      w: fixed(Math.abs(v.w[i]), 1), critical: fixed(single ? Math.sqrt(v.critical) : v.critical, 2), t2: fixed(v.t2, 1), dof: v.dof, r: fixed(v.redundancy_number?.[i], 2),
    }),
  ];
}

// Why the verdict is as it is: sentences of the page, then those of the service.
export function reasonsOf(v) {
  const out = [], w = v.w ?? [], isOut = v.verdict === "rejected" || v.verdict === "suspect";
  if (v.verdict === "waiting" || v.lacks) out.push([t("lacks", { what: "" }), h("span", { lang: "en" }, listed(v.lacks))]);
  if (Array.isArray(w) && w.length) {
    const worst = largest(w);
    if (isOut && v.controlled !== false) out.push(...errorOf(v));
    else out.push(t("tested", {
      off: fixed(v.innovation?.[worst], 2), unit: v.small_unit ?? "", sigma: fixed(v.innovation_sigma?.[worst], 2),
      w: fixed(w[worst], 1), r: fixed(v.redundancy_number?.[worst], 2),
    }));
    if (isNumber(v.test) && v.controlled !== false) out.push(t(v.test > 1 ? "test_failed" : "test_passed", { test: fixed(v.test, 2) }));
  } else if (typeof w === "number" || typeof v.r === "number")
    out.push(t("in_graph", { v: significant(v.v), unit: v.small_unit ?? "", w: fixed(v.w, 1), r: fixed(v.r, 2), mdb: significant(v.mdb) }));
  if (v.controlled === false) out.push(t("uncontrolled"));
  if (v.cause) out.push([t("cause"), " ", known("why", v.cause) ? word("why", v.cause) : h("span", { lang: "en" }, v.cause)]);
  if (v.doubt) out.push(h("span", { lang: "en" }, v.doubt));
  return out;
}

// Who has decided that an observation is out, where it is listed as such.
function decided(v) {
  const d = v.decision, given = d && d.by !== "site" ? decisionOf(d) : null;
  if (given && d.do !== "revoke") return given;
  const test = v.verdict === "rejected" && !v.cause ? t("by_test") : v.verdict === "suspect" ? t("undecided") : null;
  return given ? [test, test && " · ", given] : test;
}
// What was decided, by whom and when.
const decisionOf = (d) => [t(`decided_${d.do}`), " ", t("by"), " ", d.by, ", ", moment(d.at, { withSeconds: true })];

// Commands for the state of an observation, in the order of use at the instrument.
const ACTS = { suspect: ["accept", "reject", "replace"], rejected: ["accept"], accepted: ["reject", "sigma", "replace", "remove"], waiting: ["remove"] };

const of = (v) => (isNumber(v.epoch) ? { epoch: v.epoch } : {});
async function run(row, what, v, done) {
  // Names of observations may be the same in several epochs: a command says which one is meant.
  const name = nameOf(v), about = { ids: [v.id], ...of(v) }, ended = hasEnded(v.epoch);
  if (what === "accept") {
    const sure = !ended || await ask({ title: t("accept_title", { name }), content: h("p", {}, t("accept_ended", { number: v.epoch })), agree: t("accept"), cancel: t("cancel") });
    return sure && act(row, { do: "accept", ...about }, () => (done("accepted"), t("accepted_done", { name })));
  }
  if (what === "reject") {
    const sure = !ended || await ask({ title: t("reject_title", { name }), content: h("p", {}, t("ended_what", { number: v.epoch })), agree: t("reject"), cancel: t("cancel") });
    return sure && act(row, { do: "discard", ...about }, () => (done("rejected"), t("rejected_done", { name })));
  }
  if (what === "revoke") {
    const d = v.decision, given = d && d.do !== "revoke" ? h("p", {}, decisionOf(d)) : null;
    const sure = await ask({ title: t("revoke_title", { name }), content: [given, h("p", {}, t("revoke_what")), ended ? h("p", {}, t("ended_what", { number: v.epoch })) : null], agree: t("revoke"), cancel: t("cancel") });
    return sure && act(row, { do: "revoke", ...about }, (answer) => (done(answer.verdicts?.find((x) => x.id === v.id)?.verdict ?? "accepted"), t("revoked_done", { name })));
  }
  if (what === "remove") {
    const sure = await ask({ title: t("remove_title", { name }), content: [h("p", {}, t("remove_what")), h("p", {}, t(v.verdict === "waiting" ? "remove_gone" : "remove_accepted")), ended ? h("p", {}, t("ended_what", { number: v.epoch })) : null], agree: t("remove"), cancel: t("cancel"), danger: true });
    return sure && act(row, { do: "remove", ...about }, () => (done("gone"), t("removed_done", { name })));
  }
  if (what === "sigma") {
    const given = await ask({
      title: t("sigma_title", { name }), agree: t("change"), cancel: t("cancel"),
      content: [h("p", {}, t("sigma_what")), h("label", { class: "field" }, t("sigma_times"), h("input", { name: "times", type: "number", min: 0.01, step: "any", value: "2", required: true, inputmode: "decimal" }))],
      check: (form) => (Number(form.times.value) > 0 ? null : t("sigma_wrong")),
    });
    // σ grows by the factor, the weight shrinks by its square.
    return given && act(row, { do: "reweight", ...about, factor: 1 / Number(given.get("times")) ** 2 }, () => t("sigma_done", { name, times: given.get("times") }));
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
  return act(row, () => command(context.network, { do: "replace", id: v.id, observation, ...of(v) }), () => (done("gone"), t("replaced_done", { name })));
}

// When it was measured; when it came, where that is another time; when it was decided; by whom.
const times = ({ time, at, decided: given, by }) => [
  isNumber(time) ? [t("measured"), " ", moment(time, { withSeconds: true })] : null,
  isNumber(at) && !(Math.abs(at - time) < SAME_SECONDS) ? [t("came"), " ", moment(at, { withSeconds: true })] : null,
  isNumber(given) ? [t("decided_at"), " ", moment(given, { withSeconds: true })] : null, by,
].filter(Boolean).map((part, i) => [i ? " · " : "", part]);

// `reasons`: also who has decided, and its points; `only`: the commands that are offered.
export function observationItem(v, { fresh = false, state, reasons = false, only, ...when } = {}) {
  const node = h("li", { class: `${v.verdict}${fresh ? " new" : ""}`, "data-id": v.id, "data-verdict": v.verdict });
  const present = h("span", {}), buttons = h("div", { class: "row" });
  fill(node,
    h("div", { class: "head" }, pill(v.verdict), h("strong", {}, nameOf(v)), present, h("span", { class: "note" }, times(when))),
    h("div", { class: "why" }, [...reasonsOf(v), reasons && decided(v)].filter(Boolean).map((r, i) => [i ? " · " : "", r])),
    v.now ? h("div", { class: "why" }, t("tested_now"), " ", [...errorOf(v.now), t(v.now.test > 1 ? "fits_not" : "fits_now")].join(" · ")) : null,
    reasons && v.points?.length ? h("div", { class: "why" }, t("points"), ": ", pointLinks(v.points, 6)) : null,
    buttons);
  const become = (now) => {
    node.dataset.now = now;
    fill(present, now !== v.verdict ? [h("span", { class: "unseen" }, `${t("by_now")} `), pill(now)] : null);
    // A command of which the page has heard is later than the list.
    const revocable = isRevocable(v.epoch, v.id) ?? v.revocable;
    const acts = may("surveyor") ? [...(revocable ? ["revoke"] : []), ...(ACTS[now] ?? [])].filter((a) => (a !== "replace" || v.record) && (!only || only.includes(a))) : [];
    fill(buttons, acts.map((a) => button(t(a), () => run(buttons, a, v, become), { "data-act": a, "aria-label": `${t(a)}: ${nameOf(v)}` })));
    buttons.hidden = !acts.length;
  };
  become(state ?? v.verdict);
  return { node, become, id: v.id, epoch: v.epoch };
}
