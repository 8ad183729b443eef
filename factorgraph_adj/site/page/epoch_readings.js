// What an epoch has left out and why, its doubts, and who has decided what about it.
import { fill, h } from "./dom.js";
import { moment, t } from "./language.js";
import { may } from "./live.js";
import { observationItem } from "./observation.js";
import { observationList } from "./observation_list.js";

const PATHS = ["rejected", "suspects", "waiting"];

// A part that is read when it is opened: the service reads the journal of an epoch for it.
function opening(key, draw) {
  const summary = h("summary", {}), body = h("div");
  const node = h("details", { hidden: true, "data-part": key }, summary, body);
  node.addEventListener("toggle", () => { if (node.open && !body.childElementCount) body.append(...[draw()].flat()); });
  return { node, body, summary };
}

export function epochReadings(number, signal) {
  const doubts = h("div"), note = h("p", { class: "note" }), decided = h("ol", { class: "verdicts", "aria-label": t("decisions") });
  const lists = Object.fromEntries(PATHS.map((path) => [path, opening(path, () => observationList(path, signal, { epoch: number }))]));
  const decisions = opening("decisions", () => decided);
  const show = (e) => {
    const dropped = e.state === "dropped", counts = e.counts ?? {};
    for (const path of PATHS) {
      const { node, summary } = lists[path], n = counts[path];
      // An epoch that has no result yet has no counts: what it has is seen when it is opened.
      node.hidden = dropped || (n === 0 && !node.open) || (n === undefined && path === "waiting");
      summary.textContent = n === undefined ? t(`tab_${path}`) : t("with_number", { name: t(`tab_${path}`), number: n });
    }
    const any = PATHS.some((path) => !lists[path].node.hidden);
    note.textContent = dropped ? t("epoch_dropped", { n: counts.rejected ?? "–" })
      : e.state === "reopened" ? t("epoch_computed")
        : !any ? t("nothing_left_out") : e.state !== "open" && may("surveyor") ? t("decide_ended") : "";
    fill(doubts, (e.doubts ?? []).length ? [h("h3", { class: "livehead" }, t("doubts")), h("ol", { class: "verdicts" }, e.doubts.map((text) => h("li", { class: "suspect", lang: "en" }, text)))] : null);
    const given = (e.decisions ?? []).toReversed();
    decisions.node.hidden = !given.length;
    decisions.summary.textContent = t("with_number", { name: t("decisions"), number: given.length });
    fill(decided, given.map((d) => decision(d, e)));
  };
  return { node: h("section", { "aria-label": t("left_out") }, h("h2", { class: "livehead" }, t("left_out")), note, PATHS.map((p) => lists[p].node), doubts, decisions.node), show };
}

// What was decided, by whom and when, with what of it can be taken back.
function decision(d, e) {
  const who = d.by === "site" ? t("by_site") : d.by;
  const mine = e.state === "dropped" ? [] : d.revocable ?? [];
  const verdict = d.do === "accept" ? "accepted" : "rejected";
  const names = d.ids.map((id) => d.labels?.[id] ?? id);
  return h("li", { class: "plain", "data-decision": d.do },
    h("div", { class: "head" }, h("strong", {}, t(`decided_${d.do}`)), h("span", {}, who), h("span", { class: "note" }, moment(d.at, { withSeconds: true }))),
    mine.length ? null : h("div", { class: "why" }, names.length > 5 ? t("n_observations", { n: names.length }) : names.join(", ")),
    mine.length ? h("ol", { class: "verdicts" }, mine.map((id) => observationItem({ id, verdict, label: d.labels?.[id] ?? id, epoch: e.number, decision: d, revocable: true }, { only: ["revoke"] }).node)) : null);
}
