// Texts, data and libraries of the page. What is packed (gzip, base64) is unpacked when asked for.
const byId = (id) => document.getElementById(id);
const texts = JSON.parse(byId("texts").textContent);
const tell = (key, figures = {}) =>
  texts[key].replace(/\{(\w+)\}/g, (_, name) => figures[name] ?? "");

function failed(error) {
  const box = byId("failed");
  box.textContent = `${tell("js_failed")} ${error}`;
  box.hidden = false;
}

async function unpacked(id) {
  const coded = byId(id).textContent;
  const bytes = Uint8Array.from(atob(coded), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).text();
}

const once = (make) => {
  let made;
  return () => (made ??= make());
};
const dataOf = async (key) => JSON.parse(await unpacked(`data-${key}`));

const plotly = once(async () => {
  const script = document.createElement("script");
  script.textContent = await unpacked("library-plotly");
  document.head.append(script);
  return window.Plotly;
});

const dataTables = once(async () => {
  const style = document.createElement("style");
  style.textContent = await unpacked("library-style");
  // Before the style of the page, which has the last word.
  document.head.prepend(style);
  const source = new Blob([await unpacked("library-tables")], { type: "text/javascript" });
  const url = URL.createObjectURL(source);
  const module = await import(url);
  URL.revokeObjectURL(url);
  return module.default ?? module.DataTable;
});

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

// Figures draw themselves again when the colours of the page change, and for paper.
const figures = [];
const redraw = () => figures.forEach((draw) => draw());
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
const paper = (on) => () => {
  document.documentElement.toggleAttribute("data-paper", on);
  redraw();
};
addEventListener("beforeprint", paper(true));
addEventListener("afterprint", paper(false));

// Width of a figure on A4, pixels: 186 mm between the margins.
const PAPER_WIDTH = 695;
const onPaper = () => document.documentElement.hasAttribute("data-paper");

const layoutOf = (more) => ({
  ...(onPaper() ? { width: PAPER_WIDTH, autosize: false } : { autosize: true }),
  paper_bgcolor: "rgba(0,0,0,0)",
  plot_bgcolor: "rgba(0,0,0,0)",
  font: { color: colour("ink"), size: 12, family: "system-ui, DejaVu Sans, sans-serif" },
  margin: { l: 60, r: 20, t: 20, b: 50 },
  hoverlabel: { bgcolor: colour("page"), font: { color: colour("ink") } },
  legend: { itemsizing: "constant" },
  ...more,
});
const axisOf = (more) => ({
  color: colour("ink"), gridcolor: colour("line"), zeroline: false, linecolor: colour("soft"),
  exponentformat: "none", separatethousands: false, automargin: true, ...more,
});
const config = {
  responsive: true, displaylogo: false, scrollZoom: true,
  modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"],
};
