// The first view: the light with its reason, the figures, alarms and instruments.
import { request } from "./api.js";
import { ask, button, figures, fill, h } from "./dom.js";
import { fixed, isNumber, language, moment, t, word } from "./language.js";
import { context, here, on, peek, watch } from "./live.js";
import { act, link, may, part, pill, pointLinks, problemOf } from "./parts.js";
import { alarmSentence, alarmUntil, alarmsOf, countsOf, instrumentsOf, light, ofNetwork, sigma0Of } from "./state.js";
import { symbol } from "./symbols.js";

const MOST_PROBLEMS = 5;
const MOST_ENDED = 20;
// The alarm that was acknowledged last after it had ended, until it has left the list.
let acknowledged = null;
const MOST_LETTERS = 500; // of a remark that the service takes
const MOST_HOURS = 744; // of silence that the service takes

export function overview(root, _, signal) {
  const lamp = h("section", { class: "light unknown", "aria-label": t("light") });
  const numbers = part(t("figures")), alarms = part(t("alarms"), { id: "alarms" }), health = part(t("instruments"));
  const problems = h("section", { id: "problems" }), ended = h("details", { id: "ended-alarms", hidden: true });
  root.append(lamp, h("div", { class: "two" }, h("div", {}, numbers.node), h("div", {}, alarms.node, ended, problems, health.node)));

  const shine = () => {
    const { state, reasons } = light();
    lamp.className = `light ${state}`;
    lamp.dataset.state = state;
    fill(lamp, symbol(state), h("h2", {}, t(`light_name_${state}`)), reasons.length > 1 ? h("ul", {}, reasons.map((r) => h("li", {}, r))) : h("p", {}, reasons[0]));
  };
  on("connection", shine, signal);

  const drawNumbers = () => {
    const s = peek(here(""));
    if (!s) return;
    const c = countsOf(s), [low, high] = s.sigma0_limits ?? [];
    fill(numbers.body, figures([
      [t("sigma0"), [fixed(sigma0Of(s), 3), low !== undefined && h("span", { class: "note" }, ` ${fixed(low, 2)}\u00a0…\u00a0${fixed(high, 2)}`)], { "data-figure": "sigma0" }],
      [t("observations"), c.observations ?? "–", { "data-figure": "observations" }],
      [t("redundancy"), c.redundancy ?? s.redundancy ?? "–", { "data-figure": "redundancy" }],
      [t("suspects"), h("a", { href: link("verdicts", "suspects") }, c.suspects ?? "–"), { "data-figure": "suspects" }],
      [t("waiting"), h("a", { href: link("verdicts", "waiting") }, c.waiting ?? "–"), { "data-figure": "waiting" }],
      [t("rejected"), h("a", { href: link("verdicts", "rejected") }, c.rejected ?? "–")],
      [t("doubts"), h("a", { href: link("verdicts", "doubts") }, c.doubts ?? "–")],
      [t("points"), s.points ?? "–"],
      s.photos ? [t("photos"), s.photos] : null,
      // Epoch 0 is that of the project: without readings of its own nothing has begun.
      [t("epoch"), s.epoch && (s.epoch.number || c.observations) ? [h("a", { href: link("epochs") }, s.epoch.number), ` ${word("state", s.epoch.state)}`, s.epoch.begin ? [`, ${t("since")} `, moment(s.epoch.begin)] : ""] : "–"],
      s.last_arrival ? [t("last_arrival"), moment(s.last_arrival, { withSeconds: true })] : null,
    ]), h("p", { class: "note" }, t("settings_of", { policy: word("policy", s.policy), alpha: s.alpha ?? "–", datum: word("datum", s.datum), crs: s.crs ?? t("local") })));
  };

  // What goes wrong beside the network, such as messages that could not be sent.
  const drawProblems = () => {
    const found = context.log.filter((e) => e.event === "problem").slice(-MOST_PROBLEMS).toReversed();
    fill(problems, found.length ? [h("h2", {}, t("problems")), h("ul", {}, found.map((e) => h("li", { class: "problem" }, moment(e.data.at), " ", h("span", { lang: "en" }, e.data.what))))] : null);
  };
  on("log", drawProblems, signal);
  on("event", (entry) => { if (entry.event === "problem") drawProblems(); }, signal);
  drawProblems();

  const draw = (where, what) => (resource) => { where.show(resource, what); shine(); };
  watch(here(""), draw(numbers, drawNumbers), { events: ["arrival", "epoch"], least: 1000, signal });
  watch("alarms?state=standing", draw(alarms, (found) => drawAlarms(alarms.body, found)), { events: ["alarm"], every: 30000, signal });
  // What has ended by itself may still be news to somebody.
  watch("alarms?state=ended", ({ data }) => {
    const unseen = (data ?? []).filter(ofNetwork);
    ended.hidden = !unseen.length;
    fill(ended, unseen.length ? [h("summary", {}, t("alarms_ended", { n: unseen.length })), h("ul", { class: "verdicts" }, unseen.slice(0, MOST_ENDED).map(alarmItem))] : null);
    // Who acknowledges several by keys goes on with the next one.
    const gone = acknowledged !== null && !unseen.some((a) => a.id === acknowledged);
    if (gone) {
      acknowledged = null;
      if (document.activeElement === document.body) ended.querySelector("[data-key]")?.focus();
    }
  }, { events: ["alarm"], least: 2000, signal });
  watch("instruments", draw(health, (found) => {
    const own = instrumentsOf(found);
    fill(health.body, own.length
      ? h("ul", { class: "cards" }, own.map((i) => h("li", { class: "card" }, h("a", { href: link("instruments") }, i.name), " ", pill(i.state, i.state === "faulty" && i.connection ? word("state", i.connection) : undefined), h("div", { class: "note" }, t("last_message"), " ", moment(i.last_message, { withSeconds: true })), i.problem ? h("div", { class: i.state === "ok" ? "note" : "problem" }, problemOf(i)) : null)))
      : h("p", { class: "note" }, t("no_instruments")));
  }), { events: ["instrument"], every: 15000, signal });
  shine();
}

function drawAlarms(box, found) {
  const standing = alarmsOf(found);
  const focus = box.contains(document.activeElement) ? document.activeElement.dataset.key : null;
  fill(box, standing.length ? h("ul", { class: "verdicts" }, standing.map(alarmItem)) : h("p", { class: "note" }, t("no_alarms")));
  if (focus) box.querySelector(`[data-key="${CSS.escape(focus)}"]`)?.focus();
}

export function alarmItem(a) {
  const row = h("div", { class: "row" });
  const post = (what, body, said) => act(row, () => request("POST", `alarms/${encodeURIComponent(a.id)}/${what}`, body), said);
  if (may("surveyor") && !isNumber(a.acknowledged))
    row.append(button(t("acknowledge"), async () => {
      const said = () => t("acknowledged_done", { rule: a.rule });
      const given = await ask({
        title: t(a.state === "closed" ? "acknowledge_ended" : "acknowledge_open", { rule: a.rule }), agree: t("acknowledge"), cancel: t("cancel"),
        content: [h("p", {}, alarmSentence(a)), h("label", { class: "field" }, t("remark"), h("input", { name: "remark", type: "text", maxlength: MOST_LETTERS }))],
      });
      if (!given) return null;
      if (a.state === "closed") acknowledged = a.id; // the event may come before the answer
      return post("acknowledge", { remark: given.get("remark") }, said);
    }, { "data-key": `ack-${a.id}` }));
  if (may("surveyor") && a.state !== "silenced" && a.state !== "closed")
    row.append(button(t("silence"), async () => {
      const given = await ask({
        title: t("silence_title", { rule: a.rule }), agree: t("silence"), cancel: t("cancel"),
        content: h("label", { class: "field" }, t("silence_hours", { most: MOST_HOURS }), h("input", { name: "hours", type: "number", min: 0.1, max: MOST_HOURS, step: "any", value: "8", required: true, inputmode: "decimal" })),
        check: (form) => (Number(form.hours.value) > 0 && Number(form.hours.value) <= MOST_HOURS ? null : t("silence_wrong", { most: MOST_HOURS })),
      });
      if (given) post("silence", { hours: Number(given.get("hours")) }, () => t("silenced_done", { rule: a.rule, hours: given.get("hours") }));
    }, { "data-key": `silence-${a.id}` }));
  return h("li", { class: a.state === "open" ? "rejected" : a.state === "closed" ? "accepted" : "suspect", "data-alarm": a.id },
    h("div", { class: "head" }, pill(a.state), h("strong", {}, a.rule), a.network && a.network !== context.network ? h("span", { class: "note" }, a.network) : null),
    h("div", {}, alarmSentence(a)),
    a.latest && (isNumber(a.latest.size_mm) || isNumber(a.latest.value)) ? h("div", { class: "note" }, t("alarm_latest", {
      size: isNumber(a.latest.size_mm) ? `${fixed(a.latest.size_mm, 1)} mm, ` : "", value: fixed(a.latest.value, 2), limit: fixed(a.latest.limit, 2),
    })) : null,
    // The service says the same in English.
    a.text && language() === "en" ? h("div", { class: "why" }, a.text) : null,
    a.revised ? h("div", { class: "note", lang: "en" }, a.revised) : null,
    h("div", { class: "why" }, [
      a.points?.length && [t("points"), ": ", pointLinks(a.points)],
      isNumber(a.epoch) && [t("epoch"), " ", h("a", { href: link("epochs", a.epoch) }, a.epoch)],
      a.until && alarmUntil(a),
      isNumber(a.acknowledged) && [word("state", "acknowledged"), " ", moment(a.acknowledged), a.by && ` ${t("by")} ${a.by}`],
      a.state === "silenced" && a.silenced_until && [t("silenced_until"), " ", moment(a.silenced_until), a.silenced_by && ` ${t("by")} ${a.silenced_by}`],
      a.remark && `${t("remark")}: ${a.remark}`,
      isNumber(a.false_alarms_per_month) && t("false_alarms", { rate: a.false_alarms_per_month }),
    ].filter(Boolean).map((part, i) => [i ? " · " : "", part])),
    row.childElementCount ? row : null);
}
