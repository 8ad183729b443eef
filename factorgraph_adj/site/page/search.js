// A search field that lists the points whose names fit.
import { fill, freshId, h } from "./dom.js";
import { t } from "./language.js";

const MOST = 12;

export function pointSearch(names, take) {
  const id = freshId("found");
  let shown = [], at = -1;
  const list = h("ul", { id, role: "listbox", "aria-label": t("search_found"), hidden: true });
  const told = h("span", { class: "unseen", role: "status" });
  const input = h("input", {
    type: "search", role: "combobox", "aria-expanded": "false", "aria-controls": id, "aria-autocomplete": "list", autocomplete: "off", spellcheck: "false",
    placeholder: t("search_point"), "aria-label": t("search_point"),
  });
  const close = () => { list.hidden = true; at = -1; input.setAttribute("aria-expanded", "false"); input.removeAttribute("aria-activedescendant"); };
  const choose = (name) => { input.value = name; close(); take(name); };
  const draw = () => {
    fill(list, shown.map((name, i) => h("li", { id: `${id}-${i}`, role: "option", "aria-selected": String(i === at), on: { pointerdown: (e) => { e.preventDefault(); choose(name); } } }, name)));
    if (at >= 0) input.setAttribute("aria-activedescendant", `${id}-${at}`); else input.removeAttribute("aria-activedescendant");
  };
  input.addEventListener("input", () => {
    const part = input.value.trim().toLowerCase();
    if (!part) { close(); return; }
    const begins = [], has = [];
    for (const name of names()) {
      const low = name.toLowerCase();
      if (low.startsWith(part)) begins.push(name); else if (low.includes(part)) has.push(name);
      if (begins.length >= MOST) break;
    }
    shown = [...begins, ...has].slice(0, MOST);
    at = -1;
    list.hidden = !shown.length;
    input.setAttribute("aria-expanded", String(shown.length > 0));
    told.textContent = t("search_count", { n: shown.length });
    draw();
  });
  input.addEventListener("keydown", (e) => {
    if (e.key === "Escape") { close(); return; }
    if (e.key === "Enter") {
      e.preventDefault();
      const typed = input.value.trim(), all = names();
      const name = at >= 0 ? shown[at] : all.find((n) => n === typed) ?? all.find((n) => n.toLowerCase() === typed.toLowerCase()) ?? shown[0];
      if (name) choose(name); else if (typed) { told.textContent = t("search_none", { name: typed }); input.setAttribute("aria-invalid", "true"); }
      return;
    }
    const step = { ArrowDown: 1, ArrowUp: -1 }[e.key];
    if (!step || list.hidden) return;
    e.preventDefault();
    at = (at + step + shown.length) % shown.length;
    draw();
  });
  input.addEventListener("blur", close);
  input.addEventListener("focus", () => input.removeAttribute("aria-invalid"));
  return h("div", { class: "search" }, input, list, told);
}
