// Tables: DataTables sorts, pages and exports; a filter stands over each column.
const sheets = new Map();
const escapeCell = (text) =>
  text.replace(/[&<>"']/g, (c) => `&#${c.charCodeAt(0)};`);

// What a filter of a column asks for: a part of the text, or a comparison such as > 3 or |<| 0.1.
function asked(text, numeric) {
  const found = numeric && /^\s*(\|)?\s*(<=|>=|<|>|=)\s*\|?\s*(-?[\d.]+(?:e[-+]?\d+)?)\s*$/i.exec(text);
  if (!found) {
    const part = text.trim().toLowerCase();
    return (cell) => cell.toLowerCase().includes(part);
  }
  const [, size, sign, limit] = found;
  const compare = {
    "<": (v) => v < +limit, ">": (v) => v > +limit, "<=": (v) => v <= +limit,
    ">=": (v) => v >= +limit, "=": (v) => v === +limit,
  }[sign];
  return (cell) => {
    const value = parseFloat(cell);
    return !Number.isNaN(value) && compare(size ? Math.abs(value) : value);
  };
}

// Blanks as wide as the digits that a cell lacks, so that figures align at their decimal points.
function pad(cell, decimals) {
  const found = /^-?\d+(\.\d+)?$/.exec(cell);
  const own = found ? (found[1] ?? ".").length - 1 : -1;
  if (decimals <= 0 || own === decimals) return "";
  return (own <= 0 ? "\u2008" : "") + "\u2007".repeat(decimals - Math.max(own, 0));
}

async function made(table) {
  const name = table.dataset.sheet;
  const [DataTable, { looks, english, decimals, columns }] = await Promise.all([
    dataTables(), dataOf(`sheet-${name}`),
  ]);
  const numeric = looks.map((look) => look === "number");
  const heads = [...table.tHead.rows[0].cells].map((c) => c.textContent);
  const n = columns[0].length;
  const rows = Array.from({ length: n }, (_, i) => columns.map((c) => c[i]));
  const bar = document.createElement("div");
  bar.className = "sheetbar";
  const box = table.closest(".tablebox");
  box.before(bar);
  const caption = table.caption;
  const api = new DataTable(table, {
    data: rows, deferRender: true, autoWidth: false, order: [], pageLength: 25,
    lengthMenu: [10, 25, 100, 500], orderMulti: true,
    layout: { topStart: null, topEnd: null, bottomStart: null, bottomEnd: null },
    columns: heads.map((_, i) => ({
      type: numeric[i] ? "num" : "string",
      className: looks[i],
      createdCell: (cell, text) => {
        if (english[i]) cell.lang = "en";
        const blanks = pad(text, decimals[i]);
        if (blanks) cell.dataset.pad = blanks;
      },
      orderSequence: numeric[i] ? ["desc", "asc", ""] : ["asc", "desc", ""],
      render: (cell, type) => {
        if (type === "display") return escapeCell(cell);
        if (numeric[i] && type === "sort") return parseFloat(cell);
        return cell;
      },
    })),
    language: {
      emptyTable: tell("js_no_rows"), zeroRecords: tell("js_no_rows"),
    },
  });
  if (caption && !table.caption) table.prepend(caption);
  if (n > 1) addFilters(table, api, heads, numeric);
  if (n > 1) bar.append(...controls(api, name, heads, rows));
  const cut = box.nextElementSibling;
  if (cut?.classList.contains("cut")) cut.remove();
  sheets.set(name, api);
  table.dataset.made = "yes";
  return api;
}

// A line of filters, after the table is made, which takes the last row of the head for its titles.
function addFilters(table, api, heads, numeric) {
  const line = table.tHead.insertRow();
  line.className = "filters";
  heads.forEach((head, i) => {
    const cell = document.createElement("td");
    const input = document.createElement("input");
    input.type = "search";
    input.setAttribute("aria-label", `${tell("js_filter")}: ${head}`);
    input.title = tell("js_filter_help");
    cell.append(input);
    line.append(cell);
    input.addEventListener("input", () => {
      const fits = asked(input.value, numeric[i]);
      api.column(i).search.fixed("asked", input.value ? (cell) => fits(String(cell)) : null);
      api.draw();
    });
    input.addEventListener("keydown", (event) => event.stopPropagation());
  });
}

// Search, paging and CSV, made of the elements that every browser has.
function controls(api, name, heads, rows) {
  const search = document.createElement("label");
  const text = document.createElement("input");
  text.type = "search";
  search.append(`${tell("js_search")} `, text);
  text.addEventListener("input", () => api.search(text.value).draw());
  const csv = button(tell("js_csv"), () => download(api, name, heads, rows));
  const back = button(tell("js_previous"), () => api.page("previous").draw("page"));
  const forth = button(tell("js_next"), () => api.page("next").draw("page"));
  const length = document.createElement("select");
  length.setAttribute("aria-label", tell("js_page_length"));
  length.append(...[10, 25, 100, 500].map((v) => new Option(v, v, v === 25, v === 25)));
  length.addEventListener("change", () => api.page.len(+length.value).draw());
  const told = document.createElement("span");
  told.setAttribute("role", "status");
  const say = () => {
    const info = api.page.info();
    const from = info.recordsDisplay ? info.start + 1 : 0;
    const figures = { from, to: info.end, n: info.recordsDisplay, all: info.recordsTotal };
    const less = info.recordsDisplay < info.recordsTotal;
    told.textContent = tell(less ? "js_filtered" : "js_rows", figures);
    back.disabled = info.page === 0;
    forth.disabled = info.page >= info.pages - 1;
    for (const each of [back, forth, length]) each.hidden = info.recordsTotal <= 25;
  };
  api.on("draw", say);
  say();
  return [search, csv, back, forth, length, told];
}

function button(text, act) {
  const made = document.createElement("button");
  made.type = "button";
  made.textContent = text;
  made.addEventListener("click", act);
  return made;
}

// The rows that the filters leave, in the order of the screen, with a mark of UTF-8 for Excel.
function download(api, name, heads, rows) {
  const quoted = (cell) => (/[",\r\n]/.test(cell) ? `"${cell.replaceAll('"', '""')}"` : cell);
  const shown = api.rows({ search: "applied", order: "applied" }).indexes().toArray();
  const lines = [heads, ...shown.map((i) => rows[i])].map((r) => r.map(quoted).join(","));
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob(["\ufeff", lines.join("\r\n"), "\r\n"], { type: "text/csv" }));
  link.download = `${name}.csv`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

const making = new Map();
const enhanced = (table) => {
  const name = table.dataset.sheet;
  if (!making.has(name)) making.set(name, made(table).catch(failed));
  return making.get(name);
};

// Shows the row of a table for which ``fits`` holds: cells of the row, and its number.
async function showRow(name, fits) {
  const table = byId(`table-${name}`);
  if (!table) return;
  const api = await enhanced(table);
  const number = api.rows((i, cells) => fits(cells, i)).indexes().toArray()[0];
  if (number === undefined) return;
  if (!api.rows({ search: "applied" }).indexes().toArray().includes(number)) {
    api.search("");
    api.columns().every(function () { this.search.fixed("asked", null); });
    table.closest("section").querySelectorAll(".filters input, .sheetbar input").forEach((i) => (i.value = ""));
    api.draw();
  }
  const place = api.rows({ search: "applied", order: "applied" }).indexes().toArray().indexOf(number);
  api.page(Math.floor(place / api.page.len())).draw("page");
  document.querySelectorAll("tr.chosen").forEach((row) => row.classList.remove("chosen"));
  const row = api.row(number).node();
  row.classList.add("chosen");
  row.tabIndex = -1;
  row.scrollIntoView({ block: "center" });
  row.focus({ preventScroll: true });
}

const near = new IntersectionObserver(
  (entries) => entries.filter((e) => e.isIntersecting).forEach((e) => {
    near.unobserve(e.target);
    enhanced(e.target);
  }),
  { rootMargin: "200px" },
);
