// Figures of plotly in the colours of the page.
import { plotly } from "./api.js";
import { colour } from "./dom.js";
import { t } from "./language.js";

export const axis = (more = {}) => ({
  color: colour("ink"), gridcolor: colour("line"), zerolinecolor: colour("edge"), linecolor: colour("edge"),
  exponentformat: "none", separatethousands: false, automargin: true, ...more,
});

// Times as everywhere on the page, in figures: names of months would be English.
export const timeAxis = (more = {}) => axis({
  type: "date", tickformatstops: [
    { dtickrange: [null, 60e3], value: "%H:%M:%S\n%m-%d" }, { dtickrange: [60e3, 864e5], value: "%H:%M\n%m-%d" },
    { dtickrange: [864e5, "M1"], value: "%m-%d\n%Y" }, { dtickrange: ["M1", null], value: "%Y-%m" },
  ], ...more,
});

const layoutOf = (more) => ({
  autosize: true, paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
  font: { color: colour("ink"), size: 12, family: "system-ui, DejaVu Sans, sans-serif" },
  margin: { l: 60, r: 15, t: 25, b: 40 }, hovermode: "closest", uirevision: "kept",
  hoverlabel: { bgcolor: colour("page"), font: { color: colour("ink") } },
  legend: { orientation: "h", y: -0.18, itemsizing: "constant" }, ...more,
});

// `make()` gives {data, layout}; it is called again for each change and when the colours change.
export async function chart(div, make, signal, config = {}) {
  let Plotly;
  try { Plotly = await plotly(); } catch { div.textContent = t("no_plotly"); div.classList.add("empty"); return; }
  if (signal.aborted) return;
  const draw = () => {
    if (signal.aborted || !div.isConnected) return;
    const { data, layout } = make();
    return Plotly.react(div, data, layoutOf(layout), { responsive: true, displaylogo: false, displayModeBar: false, ...config });
  };
  await draw();
  div.dataset.made = "yes";
  addEventListener("theme", draw, { signal });
  signal.addEventListener("abort", () => Plotly.purge(div));
  return draw;
}

// Plotly takes local times as text without a zone.
export const local = (seconds) => {
  const d = new Date(seconds * 1000);
  return new Date(d.getTime() - d.getTimezoneOffset() * 60000).toISOString().slice(0, 23);
};
// The text of plotly reads a few tags: none of a name.
export const plain = (text) => String(text).replaceAll("&", "&amp;").replaceAll("<", "&lt;");
