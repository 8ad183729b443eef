// Texts in English and German, numbers and times.
import { h } from "./dom.js";

const LANGUAGES = ["en", "de"];
const catalogues = {};
let current = "en", kinds = {};

export const language = () => current;
export const useKinds = (names) => { kinds = names ?? {}; };

const remembered = (key) => { try { return localStorage.getItem(key); } catch { return null; } };
export const remember = (key, value) => {
  try { value === null ? localStorage.removeItem(key) : localStorage.setItem(key, value); } catch { /* private window */ }
};
export const recall = remembered;

export async function loadLanguages() {
  await Promise.all(LANGUAGES.map(async (code) => {
    const found = await fetch(new URL(`./${code}.json`, import.meta.url));
    catalogues[code] = await found.json();
  }));
  const wanted = [remembered("language"), ...navigator.languages].map((l) => (l ?? "").slice(0, 2).toLowerCase());
  useLanguage(wanted.find((l) => LANGUAGES.includes(l)) ?? "en");
}

export function useLanguage(code) {
  current = code;
  document.documentElement.lang = code;
}

function textOf(key, values) {
  const texts = catalogues[current];
  const text = (values.n === 1 ? texts[`${key}_one`] : undefined) ?? texts[key];
  if (text === undefined) console.error(`no text ${key} in ${current}`);
  return text ?? `⟨${key}⟩`;
}
export const t = (key, values = {}) => textOf(key, values).replace(/\{(\w+)\}/g, (_, name) => values[name] ?? "–");

// The same as nodes, for values that are nodes, such as what the service says in English.
export const nodesOf = (key, values) => textOf(key, values).split(/\{(\w+)\}/).map((part, i) => (i % 2 ? values[part] ?? "–" : part));

// Whether the page has a word of the service in its language.
export const known = (group, value) => `${group}_${value}` in catalogues[current];
// A word of the service that the page knows, or the word itself.
export const word = (group, value) => {
  const key = `${group}_${value}`;
  return catalogues[current][key] ?? String(value ?? "–").replaceAll("_", " ");
};
// The name of a reading, which has its kind as files state it.
export const labelText = (label) => {
  let found = false;
  return label.replace(/[a-z0-9_]+/g, (w) => (found || !Object.hasOwn(kinds, w) ? w : ((found = true), kindName(w))));
};
export const kindName = (kind) => kinds[kind]?.[current] ?? String(kind ?? "–").replaceAll("_", " ");

// -- numbers ----------------------------------------------------------------------------------

export const isNumber = (v) => typeof v === "number" && Number.isFinite(v);
export const fixed = (v, decimals) => (isNumber(v) ? v.toFixed(decimals).replace(/^-(0\.?0*)$/, "$1") : "–");
export const significant = (v, digits = 3) => {
  if (!isNumber(v)) return "–";
  if (v === 0) return "0";
  const size = Math.floor(Math.log10(Math.abs(v)));
  return size > 6 || size < -5 ? v.toExponential(digits - 1) : v.toFixed(Math.max(digits - 1 - size, 0));
};

const METRES = { m: 1, dm: 0.1, cm: 0.01, mm: 1e-3, um: 1e-6, "µm": 1e-6, km: 1e3, ft: 0.3048, us_ft: 1200 / 3937 };

// The field `name_UNIT` of a record, in metres: NaN where there is none.
export function metres(record, name) {
  for (const [unit, size] of Object.entries(METRES)) {
    const found = record?.[`${name}_${unit}`];
    if (isNumber(found)) return found * size;
  }
  return NaN;
}
export const seriesOfMetres = (record, name) => {
  for (const [unit, size] of Object.entries(METRES)) {
    const found = record?.[`${name}_${unit}`];
    if (Array.isArray(found)) return found.map((v) => (isNumber(v) ? v * size : null));
  }
  return [];
};
export const mm = (value, decimals = 1) => (isNumber(value) ? `${fixed(value * 1000, decimals)}\u00a0mm` : "–");
export const signed = (value, decimals = 1) => (isNumber(value) && value > 0 ? "+" : "") + mm(value, decimals);
export const mmOf = (record, name, decimals = 1) => mm(metres(record, name), decimals);

// -- times ------------------------------------------------------------------------------------

const pad = (v) => String(v).padStart(2, "0");
export const clock = (seconds, withSeconds = false) => {
  if (!isNumber(seconds)) return "–";
  const d = new Date(seconds * 1000);
  return `${pad(d.getHours())}:${pad(d.getMinutes())}${withSeconds ? `:${pad(d.getSeconds())}` : ""}`;
};
const day = (seconds) => {
  const d = new Date(seconds * 1000);
  return `${d.getFullYear()}-${pad(d.getMonth() + 1)}-${pad(d.getDate())}`;
};
export const stamp = (seconds, withSeconds = false) => {
  if (!isNumber(seconds)) return "–";
  const own = day(seconds), today = day(Date.now() / 1000);
  const date = own === today ? "" : own.slice(0, 4) === today.slice(0, 4) ? `${own.slice(5)} ` : `${own} `;
  return date + clock(seconds, withSeconds);
};
export const utc = (seconds) => `${new Date(seconds * 1000).toISOString().slice(0, 19).replace("T", " ")} UTC`;

// Local time, with UTC in its title.
export function moment(seconds, { withSeconds = false } = {}) {
  if (!isNumber(seconds)) return "–";
  const iso = new Date(seconds * 1000).toISOString();
  return h("time", { datetime: iso, title: utc(seconds) }, stamp(seconds, withSeconds));
}
export function duration(seconds) {
  if (!isNumber(seconds)) return "–";
  const s = Math.max(Math.round(seconds), 0);
  if (s < 120) return `${s} s`;
  if (s < 7200) return `${Math.round(s / 60)} min`;
  if (s < 172800) return `${Math.round(s / 3600)} h`;
  return `${Math.round(s / 86400)} d`;
}
