// Tables that sort, filter and page, by mouse and by keyboard.
import { button, fill, h } from "./dom.js";
import { t } from "./language.js";

const LENGTH = 50;
const order = new Intl.Collator(undefined, { numeric: true });

// What a filter asks for: a part of the text, or a comparison such as > 3 or |<| 0.1.
export function asked(text) {
  const found = /^\s*(\|)?\s*(<=|>=|<|>|=)\s*\|?\s*(-?[\d.]+(?:e[-+]?\d+)?)\s*$/i.exec(text);
  if (!found) {
    const part = text.trim().toLowerCase();
    return (_, cell) => String(cell).toLowerCase().includes(part);
  }
  const [, size, sign, limit] = found;
  const compare = { "<": (v) => v < +limit, ">": (v) => v > +limit, "<=": (v) => v <= +limit, ">=": (v) => v >= +limit, "=": (v) => v === +limit }[sign];
  return (value) => typeof value === "number" && Number.isFinite(value) && compare(size ? Math.abs(value) : value);
}

// columns: {key, title, number, value(row), text(row) or node(row), later: not on a phone, head: a row header}
export class Table {
  constructor({ caption, columns, rows = [], open = null, name = (row) => row.name, sort = null, filters = true }) {
    Object.assign(this, { columns, rows, open, name, sort, filters, search: "", asked: new Map(), page: 0 });
    this.told = h("span", { class: "note", role: "status" });
    this.back = button("‹", () => this.turn(-1), { class: "icon", "aria-label": t("table_previous") });
    this.forth = button("›", () => this.turn(1), { class: "icon", "aria-label": t("table_next") });
    const search = h("input", { type: "search", placeholder: t("table_search"), "aria-label": `${t("table_search")}: ${caption}`, on: { input: () => { this.search = search.value; this.page = 0; this.draw(); } } });
    this.bar = h("div", { class: "row" }, filters && search, this.told, this.back, this.forth);
    this.body = h("tbody");
    this.heads = columns.map((c) => h("th", { scope: "col", class: [c.number && "number", c.later && "later"].filter(Boolean).join(" "), "aria-sort": c.plain ? null : "none" },
      c.plain ? h("span", {}, c.title) : button(c.title, () => this.sortBy(c), { title: t("table_sort") })));
    const line = filters && h("tr", { class: "filters" }, columns.map((c) => h("td", { class: c.later ? "later" : null }, h("input", {
      type: "search", "aria-label": `${t("table_filter")}: ${c.title}`, title: t("table_filter_help"),
      on: { input: (e) => { e.target.value ? this.asked.set(c, asked(e.target.value)) : this.asked.delete(c); this.page = 0; this.draw(); } },
    }))));
    this.table = h("table", {}, h("caption", {}, caption), h("thead", {}, h("tr", {}, this.heads), line), this.body);
    this.table.addEventListener("keydown", (e) => this.key(e));
    this.node = h("div", {}, this.bar, h("div", { class: "tablebox" }, this.table));
    this.draw();
  }

  set(rows) { this.rows = rows; this.draw(); }

  text(c, row) {
    if (c.text) return c.text(row);
    const v = c.value(row);
    return v === null || v === undefined ? "–" : String(v);
  }

  sortBy(c) {
    const same = this.sort?.column === c;
    const first = c.number ? -1 : 1;
    if (!same) this.sort = { column: c, sign: first };
    else if (this.sort.sign === first) this.sort.sign = -first;
    else this.sort = null;
    this.page = 0;
    this.draw();
  }

  found() {
    const part = this.search.trim().toLowerCase();
    let rows = this.rows;
    if (part) rows = rows.filter((r) => this.columns.some((c) => this.text(c, r).toLowerCase().includes(part)));
    for (const [c, fits] of this.asked) rows = rows.filter((r) => fits(c.value(r), this.text(c, r)));
    if (this.sort) {
      const { column: { value, number }, sign } = this.sort;
      const keyed = rows.map((r) => [value(r), r]);
      // Rows without a value stand last in both orders.
      const lacks = (v) => v === null || v === undefined || (number && Number.isNaN(v));
      keyed.sort(([a], [b]) => lacks(a) || lacks(b) ? lacks(a) - lacks(b) : sign * (number ? a - b : order.compare(a, b)));
      rows = keyed.map(([, r]) => r);
    }
    return rows;
  }

  turn(by) { this.page += by; this.draw(); this.body.rows[0]?.focus(); }

  draw() {
    const rows = this.found(), pages = Math.max(Math.ceil(rows.length / LENGTH), 1);
    this.page = Math.min(Math.max(this.page, 0), pages - 1);
    const from = this.page * LENGTH, shown = rows.slice(from, from + LENGTH);
    const focused = this.body.contains(document.activeElement) ? document.activeElement.closest("tr")?.dataset.name : null;
    fill(this.body, shown.map((row, i) => this.row(row, i)),
      !shown.length && h("tr", {}, h("td", { colspan: this.columns.length, class: "note" }, t("table_empty"))));
    if (focused !== null && focused !== undefined) {
      const again = [...this.body.rows].find((r) => r.dataset.name === focused);
      if (again) { for (const r of this.body.rows) r.tabIndex = -1; again.tabIndex = 0; again.focus({ preventScroll: true }); }
    }
    this.heads.forEach((head, i) => this.columns[i].plain || head.setAttribute("aria-sort", this.sort?.column === this.columns[i] ? (this.sort.sign > 0 ? "ascending" : "descending") : "none"));
    const told = rows.length ? t("table_rows", { from: from + 1, to: from + shown.length, n: rows.length }) : "";
    if (this.told.textContent !== told) this.told.textContent = told;
    this.back.hidden = this.forth.hidden = pages < 2;
    this.back.disabled = this.page === 0;
    this.forth.disabled = this.page === pages - 1;
  }

  row(row, i) {
    const name = this.name(row);
    const cells = this.columns.map((c, k) => h(k === 0 ? "th" : "td", { scope: k === 0 ? "row" : null, class: [c.number && "number", c.later && "later"].filter(Boolean).join(" ") || null },
      c.node ? c.node(row) : this.text(c, row)));
    const live = this.open && { class: "live", tabindex: i === 0 ? 0 : -1, on: { click: (e) => { if (!e.target.closest("a, button")) this.open(row); } } };
    return h("tr", { "data-name": name, ...(live || {}) }, cells);
  }

  // Arrows move in the rows, Enter opens one.
  key(event) {
    const row = event.target.closest("tbody tr");
    if (!row || !this.open || event.target !== row) return;
    const rows = [...this.body.rows], at = rows.indexOf(row);
    const to = { ArrowDown: at + 1, ArrowUp: at - 1, Home: 0, End: rows.length - 1 }[event.key];
    if (event.key === "Enter" || event.key === " ") { event.preventDefault(); row.querySelector("a")?.click(); return; }
    if (event.key === "PageDown" && !this.forth.disabled) { event.preventDefault(); this.turn(1); return; }
    if (event.key === "PageUp" && !this.back.disabled) { event.preventDefault(); this.turn(-1); return; }
    if (to === undefined || !rows[to]) return;
    event.preventDefault();
    for (const r of rows) r.tabIndex = -1;
    rows[to].tabIndex = 0;
    rows[to].focus();
  }
}
