"""What a person sees of the page of a site, as computations in the browser: each returns findings.

Contrast is that of WCAG 2.2, (L₁ + 0.05) / (L₂ + 0.05) with the relative luminances L₁ ≥ L₂ of the
colour of a text and of what lies behind it.
"""

from __future__ import annotations

from typing import Any

LEAST_CONTRAST = 4.5
"""Of a text to its background, WCAG 1.4.3."""
LEAST_TAP = 40
"""Height of what is touched, pixels."""

CONTRAST = """least => {
  const canvas = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  const rgba = (text) => {
    canvas.clearRect(0, 0, 1, 1);
    canvas.fillStyle = text; canvas.fillRect(0, 0, 1, 1);
    const [r, g, b, a] = canvas.getImageData(0, 0, 1, 1).data;
    return [r, g, b, a / 255];
  };
  const over = (top, below) => [0, 1, 2].map(i => top[3] * top[i] + (1 - top[3]) * below[i]);
  const luminance = (c) => {
    const [r, g, b] = c.map(v => v / 255).map(v => v <= 0.04045 ? v / 12.92
      : ((v + 0.055) / 1.055) ** 2.4);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const behind = (e) => {
    const layers = [];
    for (let at = e; at; at = at.parentElement) {
      const c = rgba(getComputedStyle(at).backgroundColor);
      if (c[3] > 0) layers.push(c);
      if (c[3] === 1) break;
    }
    return layers.reduceRight((below, top) => over(top, below), [255, 255, 255]);
  };
  const found = new Map();
  const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node = texts.nextNode(); node; node = texts.nextNode()) {
    const e = node.parentElement;
    if (!node.data.trim() || e.closest("script, style, .unseen, option, :disabled")) continue;
    if (!e.checkVisibility({ opacityProperty: true, visibilityProperty: true })) continue;
    const style = getComputedStyle(e), drawn = e.namespaceURI.endsWith("svg");
    const back = behind(e), ink = rgba(drawn ? style.fill : style.color);
    const [a, b] = [luminance(over(ink, back)), luminance(back)].sort((p, q) => q - p);
    const ratio = (a + 0.05) / (b + 0.05);
    if (ratio < least) found.set(`${ratio.toFixed(2)} ${e.tagName.toLowerCase()}.${
      e.getAttribute("class") ?? ""}: ${node.data.trim().slice(0, 40)}`, ratio);
  }
  return [...found.keys()];
}"""
"""Texts with less contrast."""
WIDTH = """() => {
  const over = document.documentElement.scrollWidth - innerWidth;
  if (over <= 0) return [];
  const wide = [...document.querySelectorAll("body *")].filter(e => !e.closest(".tablebox, .skip")
    && e.getBoundingClientRect().right > innerWidth + 1);
  return [`${over} px wider: ${wide.slice(0, 3).map(e => e.outerHTML.slice(0, 80)).join(" | ")}`];
}"""
"""Whether the page scrolls sideways, and by what."""
TAPS = """least => [...document.querySelectorAll(
    "button, select, summary, input, label:has(input), nav a, tr.live, .card > a, .fields a")]
  .filter(e => e.checkVisibility({ visibilityProperty: true }))
  .filter(e => !e.closest(".unseen, .js-plotly-plot")
    && !(e.tagName === "INPUT" && e.closest("label:not(.field)")))
  .filter(e => e.getBoundingClientRect().height < least - 0.5)
  .map(e => `${e.getBoundingClientRect().height.toFixed(0)} px: ${e.tagName.toLowerCase()} ${
    e.tagName === "TR" ? "of a table" : e.dataset.act ?? e.textContent.trim().slice(0, 40)}`)"""
"""Controls that are less high than a finger needs."""
CUT = """() => [...document.querySelectorAll("body *")]
  .filter(e => e.checkVisibility() && !e.closest(".unseen, .js-plotly-plot, canvas, .skip")
    && e.scrollWidth > e.clientWidth + 1 && e.clientWidth > 0
    && ["hidden", "clip"].includes(getComputedStyle(e).overflowX)
    && getComputedStyle(e).textOverflow !== "ellipsis")
  .map(e => `${e.tagName.toLowerCase()}.${e.className}: ${e.textContent.trim().slice(0, 50)}`)"""
"""Texts that their boxes cut."""
HIDDEN = """() => {
  const bar = document.querySelector("nav.views"), found = [];
  for (const e of document.querySelectorAll("main button, main h1, .banner:not([hidden])")) {
    const b = e.getBoundingClientRect(), u = b.left + b.width / 2, v = b.top + b.height / 2;
    if (!b.width || v < 0 || v > innerHeight || u < 0 || u > innerWidth) continue;
    if (e.closest(".tablebox, dialog")) continue;
    const top = document.elementFromPoint(u, v);
    if (top && !e.contains(top) && !top.contains(e) && !bar?.contains(top)
        && !top.closest("header.top, .banner, dialog")) found.push(e.outerHTML.slice(0, 90));
  }
  return found;
}"""
"""Controls and titles that something lies over, apart from bars and dialogs."""


def audit(page: Any, *, phone: bool) -> list[str]:
    """Return what is wrong with the page as it stands, one sentence each."""
    found = [f"contrast {x}" for x in page.evaluate(CONTRAST, LEAST_CONTRAST)]
    found += [f"scrolls sideways, {x}" for x in page.evaluate(WIDTH)]
    found += [f"cut: {x}" for x in page.evaluate(CUT)]
    found += [f"covered: {x}" for x in page.evaluate(HIDDEN)]
    if phone:
        found += [f"to touch, {x}" for x in page.evaluate(TAPS, LEAST_TAP)]
    return found
