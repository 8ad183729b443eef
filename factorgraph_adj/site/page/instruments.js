// Health of the instruments.
import { figures, fill, h } from "./dom.js";
import { duration, fixed, isNumber, moment, t, word } from "./language.js";
import { context, now, on, watch } from "./live.js";
import { part, pill, problemOf } from "./parts.js";
import { instrumentsOf } from "./state.js";

const TROUBLES = ["refused", "without_reading", "doubled", "late", "gaps", "clock_jumps", "doubtful_faces", "left_out", "not_posted", "refused_postings", "not_kept"];
const AHEAD_SECONDS = 2;

// How long after its measurement the last posting was recorded; the clock may run ahead.
const lagText = (lag) => (!isNumber(lag) ? "–" : lag < -AHEAD_SECONDS ? t("lag_ahead", { time: duration(-lag) }) : duration(lag));

export function instruments(root, _, signal) {
  const box = part(null);
  root.append(box.node);
  const ages = [];
  on("tick", () => { for (const [node, at] of ages) node.textContent = t("ago", { time: duration(now() - at) }); }, signal);
  watch("instruments", (r) => box.show(r, (found) => {
    const own = instrumentsOf(found);
    ages.length = 0;
    fill(box.body, own.length ? h("ul", { class: "cards" }, own.map((i) => {
      const age = h("span", { class: "note" });
      if (isNumber(i.last_message)) { ages.push([age, i.last_message]); age.textContent = t("ago", { time: duration(now() - i.last_message) }); }
      return h("li", { class: "card", "data-instrument": i.name },
        h("h2", {}, i.name, " ", pill(i.state, i.state === "faulty" && i.connection ? word("state", i.connection) : undefined)),
        h("p", { class: "note" }, [i.grammar, i.source, i.network !== context.network ? i.network : null].filter(Boolean).join(" · ")),
        i.problem ? h("p", { class: i.state === "ok" ? "note" : "problem" }, problemOf(i)) : null,
        figures([
          [t("last_message"), [moment(i.last_message, { withSeconds: true }), " ", age]],
          [t("messages"), i.messages ?? "–"], [t("readings"), i.readings ?? "–"],
          [t("lag"), lagText(i.lag_s), { "data-figure": "lag" }],
          [t("clock_offset"), isNumber(i.clock_offset_s) ? `${fixed(i.clock_offset_s, 1)} s` : "–"],
          // What should not happen is listed where it has happened.
          ...TROUBLES.filter((c) => i[c]).map((c) => [t(`count_${c}`), i[c]]),
        ], { class: "figures small" }),
        (i.events ?? []).length ? h("details", {}, h("summary", {}, t("instrument_events")), h("ul", {}, i.events.toReversed().map((e) => h("li", {}, moment(e.time, { withSeconds: true }), " ", h("span", { lang: "en" }, e.what))))) : null);
    })) : h("p", { class: "note" }, t("no_instruments")));
  }), { events: ["instrument"], every: 10000, signal });
}
