// Parts that several views have.
import { command } from "./api.js";
import { button, english, fill, h, say } from "./dom.js";
import { clock, duration, isNumber, moment, nodesOf, stamp, t, utc, word } from "./language.js";
import { connection, context, may, now } from "./live.js";
import { symbol } from "./symbols.js";

export const pill = (state, text) => h("span", { class: `pill ${state}` }, symbol(state), text ?? word("state", state));

export const link = (view, ...rest) =>
  `#/${encodeURIComponent(context.network ?? "")}/${[view, ...rest].map((p) => encodeURIComponent(p)).join("/")}`;
export const pointLink = (name) => h("a", { href: link("points", name) }, name);
export const pointLinks = (names, most = 12) => [
  names.slice(0, most).map((n, i) => [i ? ", " : "", pointLink(n)]),
  names.length > most && ` ${t("and_more", { n: names.length - most })}`,
];

// Where an alarm is looked at: its first point, otherwise its epoch.
export const alarmPlace = (a) => (a.points?.length ? link("points", a.points[0]) : isNumber(a.epoch) ? link("epochs", a.epoch) : link("overview"));

// Why something failed, as nodes: in the language of the page what the status says, and the words
// of the service. Without an answer there are only those of the browser, which say no more.
const SAID = [0, 403, 413, 429, 503];
export function reason(error) {
  const own = SAID.includes(error.status) ? t(`said_${error.status}`) : null;
  const told = error.status === 0 ? "" : error.message || String(error);
  return [own, own && told && " ", told && english(own ? `(${told})` : told)];
}

// The last problem of an instrument: what is over says so, with when it was.
export function problemOf(i) {
  if (!i.problem) return null;
  const age = now() - i.problem_time;
  const when = isNumber(i.problem_time) ? [moment(i.problem_time, { withSeconds: true }), age < 0 ? null : `, ${t("ago", { time: duration(age) })}`] : null;
  return [i.state === "ok" ? t("last_problem") : t("problem"), " ", when ? ["(", when, ")"] : null, ": ", english(i.problem)];
}

// A box whose content is drawn from a resource, and which says so where this is not current.
export function part(title, { level = "h2", id } = {}) {
  const notice = h("p", { class: "problem", role: "status" });
  const body = h("div", {}, h("p", { class: "note" }, t("reading")));
  const node = h("section", { id: id ?? null }, title && h(level, { class: "livehead" }, title), notice, body);
  return {
    node, body,
    show(resource, draw) {
      const { error, at, data } = resource;
      const lacking = error?.status === 404 && !error.named;
      notice.className = lacking && data === undefined ? "note" : "problem";
      node.classList.toggle("old", Boolean(error) && data !== undefined);
      if (error) {
        node.style.setProperty("--as-of", `"${t("as_of", { at: stamp(at) })}"`);
        fill(notice, data === undefined
          ? lacking ? t("not_offered") : nodesOf("unread", { reason: reason(error) })
          : nodesOf("unread_since", { since: clock(resource.failedSince), reason: reason(error), at: stamp(at, true) }));
        if (data === undefined) { body.replaceChildren(); return; }
      } else notice.textContent = "";
      draw(data);
    },
  };
}

// Sends a command; its buttons are off while it runs. What went wrong stands beside them.
export async function act(box, fields, done) {
  const buttons = [...box.querySelectorAll("button")].filter((b) => !b.disabled);
  let told = box.parentElement.querySelector(":scope > .problem");
  if (!told) box.after((told = h("p", { class: "problem", role: "alert" })));
  told.textContent = "";
  for (const b of buttons) b.disabled = true;
  try {
    const answer = await (typeof fields === "function" ? fields() : command(context.network, fields));
    say(done(answer));
    return answer;
  } catch (error) {
    fill(told, nodesOf("failed", { reason: reason(error) }));
    return null;
  } finally {
    for (const b of buttons) b.disabled = false;
  }
}

// "Figures of 14:03:12" below a title of a view; a warning where the connection is lost.
export function freshness() {
  const node = h("p", { class: "note fresh" });
  const update = () => {
    const at = connection.heard;
    if (connection.state === "live") fill(node, t("current", { at: clock(at, true) }));
    else fill(node, h("strong", {}, t(connection.state === "lost" ? "not_current" : "connecting", { at: stamp(at, true) })));
    node.title = at ? utc(at) : "";
  };
  update();
  return { node, update };
}

export { button, may, now };
