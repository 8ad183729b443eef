// Elements of the page. Text always enters as text: names from the field are never read as HTML.

export function h(tag, props = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(props)) {
    if (value === undefined || value === null || value === false) continue;
    if (name === "on") for (const [event, act] of Object.entries(value)) made.addEventListener(event, act);
    else if (name === "value" || name === "checked" || name === "disabled" || name === "open" || name === "indeterminate") made[name] = value;
    else made.setAttribute(name, value === true ? "" : value);
  }
  made.append(...flat(children));
  return made;
}

const flat = (children) =>
  children.flat(Infinity).filter((c) => c !== null && c !== undefined && c !== false);

export function fill(box, ...children) {
  box.replaceChildren(...flat(children));
  return box;
}

// What the service says: its sentences are English on pages of all languages.
export const english = (text) => h("span", { lang: "en" }, text);

let last = 0;
export const freshId = (word) => `${word}-${++last}`;

export const button = (text, act, props = {}) =>
  h("button", { type: "button", on: { click: act }, ...props }, text);

// A list of terms and figures; the figures are marked as such where they are not current.
export const figures = (pairs, props = {}) =>
  h("dl", { class: "figures", ...props }, pairs.filter(Boolean).map(([term, value, more]) =>
    h("div", more ?? {}, h("dt", {}, term), h("dd", { class: "figure" }, value))));

export const colour = (name) =>
  getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

// Asks in a dialog of the browser, which keeps the focus in it and closes with Escape.
export function ask({ title, content = [], agree, cancel, danger = false, check = () => null }) {
  return new Promise((resolve) => {
    const told = h("p", { class: "problem", role: "alert" });
    const id = freshId("dialog");
    const left = () => done(null); // another page is shown: what is asked does not stand there
    const done = (value) => { removeEventListener("hashchange", left); box.close(); box.remove(); resolve(value); };
    addEventListener("hashchange", left);
    const form = h("form", { novalidate: true, on: { submit: (event) => {
      event.preventDefault();
      const wrong = check(form);
      if (wrong) { told.textContent = wrong; return; }
      done(new FormData(form));
    } } },
    h("h2", { id }, title), content, told,
    h("div", { class: "row" },
      h("button", { type: "submit", class: danger ? "danger" : "main" }, agree),
      button(cancel, () => done(null))));
    const box = h("dialog", { "aria-labelledby": id, on: { cancel: (event) => { event.preventDefault(); done(null); } } }, form);
    // What is typed replaces the value that is offered.
    for (const field of form.querySelectorAll("input")) field.addEventListener("focus", () => field.select());
    document.body.append(box);
    box.showModal();
  });
}

// Says something to all: politely for results of one's own acts, at once for alarms.
export function say(text, { urgent = false } = {}) {
  const box = document.getElementById(urgent ? "say-alarm" : "say");
  if (!box) return;
  box.textContent = "";
  setTimeout(() => (box.textContent = text), 30);
  if (!urgent) {
    clearTimeout(say.timer);
    say.timer = setTimeout(() => (box.textContent = ""), 12000);
  }
}
