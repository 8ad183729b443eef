// Shapes beside words: a state is never told by colour alone.
const SVG = "http://www.w3.org/2000/svg";

export function svg(tag, attributes = {}, ...children) {
  const made = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

const SHAPES = {
  tick: [["circle", { cx: 12, cy: 12, r: 10 }], ["path", { d: "m7 12.5 3.4 3.5L17 8.5", "data-cut": 1 }]],
  triangle: [["path", { d: "M12 2 23 21H1Z" }], ["path", { d: "M12 9v6M12 17.6v.6", "data-cut": 1 }]],
  octagon: [["path", { d: "M7.5 1.5h9l6 6v9l-6 6h-9l-6-6v-9Z" }], ["path", { d: "m8 8 8 8m0-8-8 8", "data-cut": 1 }]],
  question: [["path", { d: "M2 2h20v20H2Z" }], ["path", { d: "M8.5 9a3.5 3.5 0 1 1 5 3.2c-1 .5-1.5 1-1.5 2.3M12 18v.4", "data-cut": 1 }]],
  dots: [["circle", { cx: 12, cy: 12, r: 10 }], ["path", { d: "M7 12h.2m4.7 0h.2m4.7 0h.2", "data-cut": 1 }]],
  dash: [["circle", { cx: 12, cy: 12, r: 10 }], ["path", { d: "M7 12h10", "data-cut": 1 }]],
};
export const SHAPE_OF = {
  ok: "tick", faulty: "octagon", accepted: "tick", stable: "tick", closed: "tick",
  doubts: "triangle", suspect: "question", silent: "triangle", acknowledged: "triangle", silenced: "triangle", again: "triangle",
  alarm: "octagon", rejected: "octagon", open: "octagon", moved: "octagon", refused: "octagon",
  unknown: "question", waiting: "dots", stopped: "dash", gone: "dash", plain: "dash",
};

export function symbol(state) {
  const parts = SHAPES[SHAPE_OF[state] ?? "dash"].map(([tag, { "data-cut": cut, ...place }]) =>
    svg(tag, cut
      ? { ...place, fill: "none", stroke: "var(--page)", "stroke-width": 2.6, "stroke-linecap": "round" }
      : { ...place, fill: "currentColor" }));
  return svg("svg", { viewBox: "0 0 24 24", "aria-hidden": "true" }, ...parts);
}

const ICONS = {
  overview: "M4 13a8 8 0 0 1 16 0M12 13l4-4M3 18h18",
  plan: "M4 20 12 4l8 16ZM12 4v16M8 12h8",
  verdicts: "M4 6h10M4 12h8M4 18h6m4-3 3 3 5-7",
  points: "M4 5h16M4 10h16M4 15h16M4 20h16M9 5v15",
  epochs: "M3 17l5-5 4 3 8-9M3 21h18",
  instruments: "M9 3h6v6H9ZM12 9v4M12 13l-6 8M12 13l6 8M12 13v8",
  downloads: "M12 4v11m-5-5 5 5 5-5M4 20h16",
  more: "M5 12h.1M12 12h.1M19 12h.1",
};
export const icon = (name) =>
  svg("svg", { viewBox: "0 0 24 24", "aria-hidden": "true" }, svg("path", { d: ICONS[name] }));
