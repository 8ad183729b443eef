// The frame of the page: login, networks, views, language, colours, and what is told everywhere.
import { read, request } from "./api.js";
import { button, fill, h, say } from "./dom.js";
import { clock, language, loadLanguages, nodesOf, recall, remember, stamp, t, useKinds, useLanguage } from "./language.js";
import { connection, context, forget, here, on, peek, useNetwork, watch } from "./live.js";
import { alarmPlace, freshness, link, pill, reason } from "./parts.js";
import { alarmSentence, alarmsOf, countsOf, light } from "./state.js";
import { icon, symbol } from "./symbols.js";
import { downloads } from "./downloads.js";
import { epochs } from "./epochs.js";
import { instruments } from "./instruments.js";
import { overview } from "./overview.js";
import { planView } from "./plan_view.js";
import { points } from "./points.js";
import { verdicts } from "./verdicts.js";

const VIEWS = { overview, plan: planView, verdicts, points, epochs, instruments, downloads, more };
const NARROW = ["overview", "plan", "verdicts", "points", "more"];
const WIDE = ["overview", "plan", "verdicts", "points", "epochs", "instruments", "downloads"];
const app = document.getElementById("app");
let frame = null, viewing = null, shownView = null;

// -- login ------------------------------------------------------------------------------------

function login(told = "") {
  viewing?.abort();
  forget();
  frame = null;
  document.title = t("login");
  const problem = h("p", { class: "problem", role: "alert" }, told);
  const token = h("input", { type: "password", name: "token", autocomplete: "current-password", required: true });
  const user = h("input", { type: "text", autocomplete: "username", hidden: true }); // as managers of passwords ask for
  const form = h("form", { on: { submit: async (event) => {
    event.preventDefault();
    problem.textContent = "";
    try {
      await request("POST", "session", { token: token.value.trim() });
      token.value = "";
      await begin();
    } catch (error) {
      fill(problem, error.status === 401 || error.status === 403 ? t("login_wrong") : nodesOf("failed", { reason: reason(error) }));
      token.focus();
    }
  } } }, user, h("label", { class: "field" }, t("token"), token), problem, h("div", { class: "row" }, h("button", { type: "submit", class: "main" }, t("login"))));
  fill(app, h("main", { class: "login" }, h("h1", {}, t("login_title")), h("p", {}, t("login_what")), form, settings(() => login())));
  token.focus();
}

// -- language and colours ---------------------------------------------------------------------

function settings(again) {
  const languages = h("select", { "aria-label": t("language"), on: { change: () => { useLanguage(languages.value); remember("language", languages.value); again(); document.querySelector("[data-setting=language]")?.focus(); } }, "data-setting": "language" },
    ["en", "de"].map((code) => h("option", { value: code, lang: code }, { en: "English", de: "Deutsch" }[code])));
  languages.value = language();
  const themes = h("select", { "aria-label": t("colours"), "data-setting": "theme", on: { change: () => { remember("theme", themes.value || null); window.applyTheme(); } } },
    [["", "theme_system"], ["light", "theme_light"], ["dark", "theme_dark"]].map(([value, text]) => h("option", { value }, t(text))));
  themes.value = recall("theme") ?? "";
  return h("div", { class: "row" }, h("label", {}, t("language"), languages), h("label", {}, t("colours"), themes));
}

function more(root) {
  root.append(h("ul", { class: "cards" }, ["epochs", "instruments", "downloads"].map((v) => h("li", { class: "card" }, h("a", { href: link(v) }, t(`view_${v}`)), h("p", { class: "note" }, t(`about_${v}`))))),
    h("h2", {}, t("settings")), settings(rebuild), h("p", { class: "note" }, t("times_are", { zone: Intl.DateTimeFormat().resolvedOptions().timeZone ?? "–" })), account());
}

function account() {
  const { site } = context;
  return h("div", {}, h("p", { class: "note" }, t("you_are", { role: t(`role_${context.role}`) }), " · factorgraph-adj ", site.version ?? ""),
    site.tokens === false ? h("p", { class: "note" }, t("no_tokens")) : h("div", { class: "row" }, button(t("logout"), async () => {
      try { await request("DELETE", "session"); } catch { /* the session may be gone already */ }
      login();
    })));
}

// -- frame ------------------------------------------------------------------------------------

function build() {
  const { site } = context;
  const networks = site.networks ?? [];
  const choice = networks.length > 1 && h("select", { "aria-label": t("network"), on: { change: () => (location.hash = `#/${encodeURIComponent(choice.value)}/overview`) } }, networks.map((n) => h("option", { value: n.name }, n.title ?? n.name)));
  const lamp = h("a", { class: "pill unknown", id: "lamp" }, symbol("unknown"), t("light_name_unknown"));
  const banner = h("div", { class: "banner", role: "status", hidden: true }), alarmbar = h("div", { class: "banner alarmbar", hidden: true });
  const list = (names, kind) => names.map((v) => h("li", { class: kind }, h("a", { href: "#", "data-view": v }, icon(v), v === "more" ? [h("span", { class: "narrow" }, t("view_more")), h("span", { class: "wide" }, t("settings"))] : h("span", {}, t(`view_${v}`)))));
  const both = WIDE.filter((v) => NARROW.includes(v));
  const nav = h("nav", { class: "views", "aria-label": t("views") }, h("ul", {}, list(both, null), list(WIDE.filter((v) => !both.includes(v)), "wide"), list(["more"], null)));
  const main = h("main", { id: "main", tabindex: -1 });
  fill(app, h("div", { class: "frame" },
    h("a", { class: "skip", href: "#main", on: { click: (e) => { e.preventDefault(); main.focus(); } } }, t("skip")),
    h("header", { class: "top" }, h("div", { class: "name" }, site.name ?? "factorgraph-adj"), choice, lamp),
    h("div", { class: "bars" }, banner, alarmbar), nav, main),
  h("div", { id: "say", class: "said", role: "status" }), h("div", { id: "say-alarm", class: "unseen", role: "alert", "aria-live": "assertive" }));
  frame = { choice, lamp, banner, alarmbar, nav, main };
}

const frameLife = { controller: null };
function watchFrame() {
  frameLife.controller?.abort();
  const { signal } = (frameLife.controller = new AbortController());
  const known = new Set();
  let first = true;
  const shine = () => {
    const found = light();
    const made = pill(found.state, t(`light_name_${found.state}`));
    frame.lamp.className = made.className;
    fill(frame.lamp, ...made.childNodes);
    frame.lamp.href = link("overview");
    frame.lamp.title = found.reasons.join("\n");
    frame.lamp.setAttribute("aria-label", `${t("light")}: ${t(`light_name_${found.state}`)}`);
    const counts = countsOf(peek(here("")));
    const badge = (view, n, text) => {
      const place = frame.nav.querySelector(`[data-view=${view}]`);
      place.querySelector(".badge")?.remove();
      if (n) place.append(h("span", { class: "badge" }, n > 99 ? "99+" : n, h("span", { class: "unseen" }, ` ${text}`)));
    };
    badge("verdicts", counts.suspects, t("suspects"));
    document.title = `${found.state === "alarm" ? "⚠ " : ""}${t(`light_name_${found.state}`)} · ${context.network} · ${context.site.name ?? ""}`;
  };
  const banners = () => {
    const lost = connection.state === "lost";
    const { documentElement: page } = document;
    page.toggleAttribute("data-stale", lost);
    page.style.setProperty("--as-of", `"${t("as_of", { at: stamp(connection.heard) })}"`);
    frame.banner.hidden = !lost;
    const text = lost ? t("connection_lost", { since: clock(connection.since, true), at: stamp(connection.heard, true) }) : "";
    if (frame.banner.textContent !== text) frame.banner.textContent = text;
    shine();
  };
  on("connection", ({ before }) => {
    banners();
    viewing?.fresh?.();
    if (before === "lost" && connection.state === "live") say(t("connection_back"));
  }, signal);
  on("heard", () => viewing?.fresh?.(), signal);
  on("login", () => login(t("login_again")), signal);
  watch(here(""), shine, { events: ["arrival", "epoch"], least: 1000, signal });
  watch("instruments", shine, { events: ["instrument"], every: 15000, signal });
  watch("alarms?state=standing", (r) => {
    const open = alarmsOf(r.data).filter((a) => a.state === "open");
    for (const a of open) {
      if (!known.has(a.id) && !first) say(`${t("alarm")}: ${alarmSentence(a)}`, { urgent: true });
      known.add(a.id);
    }
    if (r.data) {
      if (first && open.length) say(`${t("alarm")}: ${open.map(alarmSentence).join(" ")}`, { urgent: true });
      first = false;
    }
    frame.alarmbar.hidden = !open.length;
    fill(frame.alarmbar, open.length ? [t("alarm"), ": ", h("a", { href: alarmPlace(open[0]) }, alarmSentence(open[0])), open.length > 1 ? ` ${t("and_more", { n: open.length - 1 })}` : ""] : null);
    shine();
  }, { events: ["alarm"], every: 30000, signal });
  banners();
}

// -- views ------------------------------------------------------------------------------------

const placeOf = () => {
  const [network, view = "overview", ...rest] = location.hash.replace(/^#\/?/, "").split("/").map((p) => { try { return decodeURIComponent(p); } catch { return p; } });
  return { network, view, rest: rest.filter((p) => p !== "") };
};

let routing = Promise.resolve();
const route = () => (routing = routing.then(routeNow).catch((error) => console.error(error)));
async function routeNow() {
  if (!frame) return;
  const names = (context.site.networks ?? []).map((n) => n.name), { network, view: asked, rest } = placeOf();
  if (!names.length) { fill(frame.main, h("h1", {}, context.site.name ?? ""), h("p", {}, t("no_networks"))); return; }
  const wanted = names.includes(network) ? network : names.includes(recall("network")) ? recall("network") : names[0];
  if (network && !names.includes(network)) say(t("network_unknown", { name: network, shown: context.site.networks.find((n) => n.name === wanted).title ?? wanted }));
  if (!VIEWS[asked] || wanted !== network) { history.replaceState(null, "", `#/${encodeURIComponent(wanted)}/overview`); return routeNow(); }
  if (wanted !== context.network) {
    viewing?.abort();
    frameLife.controller?.abort();
    fill(frame.main, h("p", { class: "note" }, t("reading")));
    await useNetwork(wanted);
    remember("network", wanted);
    if (!frame) return;
    watchFrame();
  }
  if (frame.choice) frame.choice.value = wanted;
  viewing?.abort();
  const own = (viewing = new AbortController());
  const again = shownView === asked;
  shownView = asked;
  for (const a of frame.nav.querySelectorAll("a")) {
    a.href = link(a.dataset.view);
    const current = a.dataset.view === asked;
    if (current) a.setAttribute("aria-current", "page"); else a.removeAttribute("aria-current");
  }
  const fresh = freshness(), title = h("h1", { tabindex: -1 }, ["points", "epochs"].includes(asked) && rest[0] ? (asked === "points" ? rest[0] : t("epoch_n", { number: rest[0] })) : t(`view_${asked}`));
  own.fresh = fresh.update;
  const root = h("div", { id: "view", "data-view": asked });
  fill(frame.main, title, fresh.node, root);
  VIEWS[asked](root, rest, own.signal);
  // The focus follows a person to the new view, but not at the start.
  const kept = sessionStorage.getItem("focus");
  sessionStorage.removeItem("focus");
  if (kept && document.getElementById(kept)) document.getElementById(kept).focus();
  else if (route.moved && !(again && asked === "verdicts")) title.focus({ preventScroll: true });
  if (route.moved && !again) scrollTo(0, 0);
  route.moved = true;
  document.documentElement.dataset.ready = asked;
}

function rebuild() {
  const focus = document.activeElement?.dataset?.setting;
  build();
  watchFrame();
  route().then(() => focus && document.querySelector(`[data-setting=${focus}]`)?.focus());
}

async function begin() {
  let site;
  try { site = await read("site"); } catch (error) {
    if (error.status === 401 || error.status === 403) { login(); return; }
    fill(app, h("main", { class: "login" }, h("h1", {}, t("no_service")), h("p", { class: "problem", role: "alert" }, reason(error)), button(t("try_again"), begin, { class: "main" })));
    setTimeout(() => { if (!frame && app.querySelector("h1")?.textContent === t("no_service")) begin(); }, 5000);
    return;
  }
  context.site = site;
  context.role = site.role;
  useKinds(site.kinds);
  build();
  await route();
}

addEventListener("hashchange", route);
await loadLanguages();
await begin();
