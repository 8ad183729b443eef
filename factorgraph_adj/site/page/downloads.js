// Files of the network as it is now; and for administrators the tokens of the site.
import { address, request } from "./api.js";
import { ask, button, fill, h } from "./dom.js";
import { moment, stamp, t } from "./language.js";
import { context, here, watch } from "./live.js";
import { act, may, part } from "./parts.js";
import { Table } from "./table.js";

const FILES = [["report.html", "file_report"], ["results.json", "file_results"], ["network.gpkg", "file_gpkg"], ["project.zip", "file_project"]];

// Links to the files of an ended epoch, whose names tell it.
export const filesOfEpoch = (number) => FILES.map(([file], i) => [i ? " · " : "",
  h("a", { href: address(here(`${file}?epoch=${encodeURIComponent(number)}`)), download: `${context.network}-epoch-${number}-${file}` }, file)]);

export function downloads(root, _, signal) {
  root.append(h("ul", { class: "cards" }, FILES.map(([file, text]) => h("li", { class: "card" },
    h("a", { href: address(here(file)), download: `${context.network}-${file}` }, file), h("p", { class: "note" }, t(text))))),
  h("p", { class: "note" }, t("api_told"), " ", h("a", { href: address("openapi.json") }, "openapi.json")));
  if (may("admin")) tokens(root, signal);
}

function tokens(root, signal) {
  const box = part(t("tokens"), { id: "tokens" }), made = h("div", { role: "status" }), tools = h("div", { class: "row" });
  root.append(box.node);
  let table = null;
  const resource = watch("tokens", (r) => box.show(r, (found) => {
    table ??= new Table({
      caption: t("tokens"), filters: false, name: (k) => String(k.id),
      columns: [
        { title: t("name"), value: (k) => k.name }, { title: t("role"), value: (k) => t(`role_${k.role}`) },
        { title: t("created"), value: (k) => k.created, text: (k) => stamp(k.created), node: (k) => moment(k.created), later: true },
        { title: t("last_used"), value: (k) => k.last_used, text: (k) => stamp(k.last_used), node: (k) => moment(k.last_used), later: true },
        { title: t("remove"), plain: true, value: () => "", node: (k) => { const cell = h("div"); cell.append(button(t("remove"), () => remove(k, cell), { "aria-label": `${t("remove")}: ${k.name}` })); return cell; } },
      ],
    });
    if (!table.node.isConnected) fill(box.body, tools, made, table.node);
    table.set(found);
  }), { signal });
  async function remove(k, cell) {
    const sure = await ask({ title: t("token_remove_title", { name: k.name }), content: h("p", {}, t("token_remove_what")), agree: t("remove"), cancel: t("cancel"), danger: true });
    if (sure) { await act(cell, () => request("DELETE", `tokens/${encodeURIComponent(k.id)}`), () => t("token_removed", { name: k.name })); resource.wish(); }
  }
  tools.append(button(t("token_new"), async () => {
    const roles = ["instrument", "viewer", "surveyor", "admin"];
    const given = await ask({
      title: t("token_new"), agree: t("token_make"), cancel: t("cancel"),
      content: [h("label", { class: "field" }, t("name"), h("input", { name: "name", required: true, autocomplete: "off" })), h("label", { class: "field" }, t("role"), h("select", { name: "role" }, roles.map((r) => h("option", { value: r }, t(`role_${r}`)))))],
      check: (form) => (form.elements.name.value.trim() ? null : t("token_name_wrong")),
    });
    if (!given) return;
    const answer = await act(tools, () => request("POST", "tokens", { name: given.get("name").trim(), role: given.get("role") }), () => t("token_made"));
    if (answer) fill(made, h("p", {}, t("token_shown")), h("p", { class: "secret" }, answer.token));
    resource.wish();
  }));
}
