// Lists of observations that are suspect, wait or are rejected, of the present epoch or of another.
import { fill, h } from "./dom.js";
import { isNumber, kindName, t } from "./language.js";
import { arrivalOf, hasEnded, here, watch } from "./live.js";
import { observationItem } from "./observation.js";
import { link, part } from "./parts.js";

const MOST_LISTED = 200;
export const VERDICTS = { suspects: "suspect", waiting: "waiting", rejected: "rejected" };

// `epoch`: that of the list; the present one where it is left out. An epoch that has ended changes
// with decisions and late readings alone, not with what arrives in the present one.
export function observationList(path, signal, { epoch } = {}) {
  const own = epoch === undefined ? path : `${path}?epoch=${encodeURIComponent(epoch)}`;
  const box = part(null), search = h("input", { type: "search", placeholder: t("table_search"), "aria-label": `${t("table_search")}: ${t(`tab_${path}`)}` });
  const bar = h("div", { class: "row" }, search);
  const heading = h("p", { class: "note" });
  let rows = [], number;
  const ul = h("ol", { class: "verdicts", "aria-label": t(`tab_${path}`) }), told = h("p", { class: "note", role: "status" });
  const known = new Map();
  const draw = () => {
    const sought = search.value.trim().toLowerCase();
    const some = rows.filter((v) => !sought || `${v.label} ${v.kind} ${kindName(v.kind)} ${v.id} ${v.lacks ?? ""}`.toLowerCase().includes(sought));
    const shown = some.slice(0, MOST_LISTED), ids = new Set(shown.map((v) => v.id));
    for (const [id, item] of known) if (!ids.has(id)) { item.node.remove(); known.delete(id); }
    // Items stay where they are while their observation is listed: a finger or the focus may be on them.
    shown.forEach((v, i) => {
      let item = known.get(v.id);
      const now = JSON.stringify(v);
      if (!item || (item.told !== now && !item.node.contains(document.activeElement))) {
        item?.node.remove();
        item = { ...observationItem({ verdict: VERDICTS[path], ...v }, { ...arrivalOf(v.epoch, v.id), reasons: true }), told: now };
        known.set(v.id, item);
      }
      if (ul.children[i] !== item.node) ul.insertBefore(item.node, ul.children[i] ?? null);
    });
    told.textContent = some.length > shown.length ? t("listed", { shown: shown.length, n: some.length }) : some.length ? "" : t(`no_${path}`, { number });
  };
  search.addEventListener("input", draw);
  watch(here(own), (resource) => box.show(resource, (found) => {
    rows = found.rows ?? found[path] ?? found;
    number = found.epoch;
    // Of the present epoch it is said that it is not the one before, which has a list of its own.
    if (epoch === undefined && isNumber(number)) fill(heading, t("epoch_n", { number }), " · ", h("a", { href: link("epochs", number) }, t("decisions_of_epoch")), number > 1 ? [" · ", h("a", { href: link("epochs", number - 1) }, t("left_out_before", { number: number - 1 }))] : null);
    // A few are seen at a glance.
    bar.hidden = epoch !== undefined && rows.length < 6;
    if (!ul.isConnected) fill(box.body, heading, told, ul);
    draw();
  }), { events: epoch === undefined ? ["arrival"] : hasEnded(Number(epoch)) ? ["epoch"] : ["arrival", "epoch"], signal });
  return [bar, box.node];
}
