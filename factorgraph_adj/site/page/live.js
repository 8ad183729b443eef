// What the page knows of the service: resources that are read again as events come, the events,
// and whether the connection stands.
import { address, read } from "./api.js";

const EVENTS = ["arrival", "refused", "epoch", "alarm", "instrument", "problem", "hello", "beat"];
const MOST_LOGGED = 500;
// States of the observations that a command names; verdicts in its answer tell more.
const AFTER = { accept: "accepted", discard: "rejected", remove: "gone", replace: "gone" };
// Commands after which somebody can take his decision back; after others that name it he cannot.
const REVOCABLE = ["accept", "discard"], FINAL = ["revoke", "remove", "replace", "reweight"];
const FIRST_PAUSE = 1000, LONGEST_PAUSE = 15000;

const bus = new EventTarget();
const emit = (name, detail) => bus.dispatchEvent(new CustomEvent(name, { detail }));
export const on = (name, act, signal) => bus.addEventListener(name, (e) => act(e.detail), { signal });

export const now = () => Date.now() / 1000;
export const context = {
  site: null, network: null, role: null,
  summary: null, // of the network when it was chosen: its units and its plane
  epoch: null, // number of the latest epoch that the page has heard of
  log: [], // the latest events, oldest first
  states: new Map(), // latest verdict of observations that the page has heard of, by epoch and id
  revocable: new Map(), // whether the latest decision about them can be taken back, likewise
  arrivals: new Map(), // when these were measured and came, and who sent them, by epoch and id
};
const keyOf = (epoch, id) => `${epoch ?? ""} ${id}`;
export const stateOf = (epoch, id) => context.states.get(keyOf(epoch, id));
export const isRevocable = (epoch, id) => context.revocable.get(keyOf(epoch, id));
export const arrivalOf = (epoch, id) => context.arrivals.get(keyOf(epoch, id)) ?? {};
export const connection = { state: "connecting", since: now(), heard: null };

let source = null, lastId = null, pause = FIRST_PAUSE, timer = null, watchdog = null;

function change(state) {
  if (connection.state === state) return;
  const before = connection.state;
  connection.state = state;
  connection.since = now();
  emit("connection", { before });
  // The events that were missed come by themselves, in their order: the log is not read again.
  if (state === "live" && before === "lost") readResources();
}

function heard() {
  connection.heard = now();
  pause = FIRST_PAUSE;
  change("live");
  emit("heard");
}

export function connect() {
  disconnect();
  const query = new URLSearchParams({ network: context.network });
  if (lastId !== null) query.set("after", lastId);
  source = new EventSource(address(`events?${query}`));
  const own = source;
  source.onopen = heard;
  source.onerror = () => {
    if (own !== source) return;
    change("lost");
    // The browser reconnects by itself, unless the answer was an error: then the page does.
    if (own.readyState === EventSource.CLOSED) again();
  };
  for (const name of EVENTS) source.addEventListener(name, (e) => own === source && received(name, e));
  watchdog = setInterval(() => {
    const quiet = now() - (connection.heard ?? connection.since);
    if (quiet > 2.5 * (context.site?.beat_s ?? 10)) {
      change("lost");
      if (source && connection.state === "lost" && !timer) again();
    }
    emit("tick");
  }, 1000);
}

function again() {
  if (timer) return;
  source?.close();
  timer = setTimeout(async () => {
    timer = null;
    try { await read("site"); } catch (error) {
      if (error.status === 401) { emit("login"); return; }
      pause = Math.min(pause * 1.6, LONGEST_PAUSE);
      again();
      return;
    }
    connect();
  }, pause);
}

export function disconnect() {
  source?.close();
  source = null;
  clearTimeout(timer);
  timer = null;
  clearInterval(watchdog);
}

// A phone that wakes up, or comes back to the network, does not wait for the pause to end.
for (const [target, name] of [[window, "online"], [document, "visibilitychange"]])
  target.addEventListener(name, () => {
    if (connection.state === "lost" && source && !document.hidden) { pause = FIRST_PAUSE; connect(); }
  });
addEventListener("offline", () => change("lost"));

function received(name, event) {
  heard();
  if (event.lastEventId) lastId = event.lastEventId;
  let data = {};
  try { data = JSON.parse(event.data || "{}"); } catch { return; }
  if (name === "beat") return;
  if (name === "hello") { readAllAgain(); return; }
  take({ id: event.lastEventId || null, event: name, data }, true);
}

export const answerOf = (data) => data.answer ?? data;
export const verdictsOf = (answer) => [
  ...(answer.verdicts ?? (answer.verdict ? [answer] : [])), ...(answer.entered ?? []),
];

// Whether observations came; otherwise somebody has decided about some.
export const isReading = (answer) => (answer.do ?? "add") === "add";

function take(entry, fresh) {
  entry.id = entry.id === null ? null : String(entry.id);
  if (entry.id !== null && context.log.some((e) => e.id === entry.id)) {
    // The log was read after this event, the resources perhaps before it.
    if (fresh) wishAll(entry.event);
    return;
  }
  context.log.push(entry);
  if (context.log.length > MOST_LOGGED) context.log.splice(0, context.log.length - MOST_LOGGED);
  const answer = answerOf(entry.data);
  if (entry.event === "arrival") {
    const { epoch, time, at, by } = entry.data, become = (id, state) => context.states.set(keyOf(epoch, id), state);
    for (const id of entry.data.ids ?? []) if (AFTER[answer.do]) become(id, AFTER[answer.do]);
    const revocable = REVOCABLE.includes(answer.do) && by !== "site";
    if (revocable || FINAL.includes(answer.do)) for (const id of entry.data.ids ?? []) context.revocable.set(keyOf(epoch, id), revocable);
    for (const v of verdictsOf(answer)) become(v.id, v.verdict);
    for (const id of answer.waits_again ?? []) become(id, "waiting");
    if (isReading(answer)) for (const v of verdictsOf({ ...answer, entered: [] })) context.arrivals.set(keyOf(epoch, v.id), { time, at, by });
    if (fresh && isPresent(entry.data.epoch)) patchPoints(answer);
  }
  if (fresh) {
    emit("event", entry);
    wishAll(entry.event);
  }
}

function wishAll(kind) {
  for (const resource of resources.values()) if (resource.events.has(kind)) resource.wish();
}

// Late readings open an epoch again: their points are those of that epoch.
function isPresent(epoch) {
  if (typeof epoch !== "number") return true;
  const known = peek(here(""))?.epoch?.number ?? context.summary?.epoch?.number ?? -1;
  context.epoch = Math.max(context.epoch ?? -1, known, epoch);
  return epoch === context.epoch;
}

// Whether an epoch has ended, so that what is decided about it revises its result.
export function hasEnded(epoch) {
  const present = peek(here(""))?.epoch ?? context.summary?.epoch;
  return typeof epoch === "number" && (epoch < Math.max(context.epoch ?? -1, present?.number ?? -1) || (epoch === present?.number && present.state !== "open"));
}

// Coordinates and σ of points come with the answers; ellipses with the next reading: until then
// those of a point that was `patched` are of another moment than its σ.
function patchPoints(answer) {
  const resource = resources.get(here("points"));
  if (!resource?.data || !(answer.points?.length || answer.points_lost?.length)) return;
  resource.byName ??= new Map(resource.data.map((p) => [p.name, p]));
  for (const p of answer.points ?? []) {
    const row = resource.byName.get(p.name);
    if (row) Object.assign(row, p, { patched: true }); else { resource.data.push(p); resource.byName.set(p.name, p); }
  }
  emit("points", answer.points ?? []);
}

// -- resources --------------------------------------------------------------------------------

const resources = new Map();
export const here = (path) => `networks/${encodeURIComponent(context.network)}${path ? `/${path}` : ""}`;

class Resource {
  constructor(path) {
    Object.assign(this, { path, data: undefined, at: null, error: null, watchers: new Set(), events: new Set() });
    Object.assign(this, { reading: null, wished: false, took: 0, begun: 0, least: 400, timer: null });
  }

  // Reads soon: not again within `least`, nor so often that reading takes more than a fifth of the time.
  wish() {
    this.wished = true;
    if (this.reading || this.timer || !this.watchers.size) return;
    const wait = this.begun + Math.max(this.least, 5 * this.took) - Date.now();
    this.timer = setTimeout(() => { this.timer = null; this.read(); }, Math.max(wait, 0));
  }

  async read() {
    if (this.reading) return this.reading;
    this.wished = false;
    this.begun = Date.now();
    this.reading = (async () => {
      try {
        const data = await read(this.path);
        this.data = data;
        this.byName = undefined;
        this.at = now();
        this.error = null;
        this.failedSince = null;
      } catch (error) {
        this.error = error;
        this.failedSince ??= now();
        if (error.status === 401) emit("login");
        else if (error.status === 503 || error.status === 0) setTimeout(() => this.wish(), 1000 * (error.retryAfter ?? 3));
      }
      this.took = Date.now() - this.begun;
      this.reading = null;
      for (const watcher of [...this.watchers]) watcher(this);
      if (this.wished) this.wish();
    })();
    return this.reading;
  }
}

// Calls `show(resource)` now, if it has been read, and whenever it has been read again.
export function watch(path, show, { events = [], least = 400, every = 0, signal } = {}) {
  let resource = resources.get(path);
  if (!resource) resources.set(path, (resource = new Resource(path)));
  // What nobody watched has not been kept up to date: it is read first.
  const kept = resource.watchers.size > 0 && resource.data !== undefined;
  resource.watchers.add(show);
  for (const e of events) resource.events.add(e);
  resource.least = Math.max(resource.least, least);
  const clockwork = every ? setInterval(() => connection.state === "live" && resource.wish(), every) : null;
  signal?.addEventListener("abort", () => { resource.watchers.delete(show); clearInterval(clockwork); });
  if (kept) show(resource);
  resource.begun = 0;
  resource.wish();
  return resource;
}

export const peek = (path) => resources.get(path)?.data;
export const errorOf = (path) => resources.get(path)?.error ?? null;
function readResources() {
  for (const resource of resources.values()) { resource.begun = 0; resource.wish(); }
}
export function readAllAgain() {
  readResources();
  if (context.network) fillLog();
}

// The verdicts of before the page was opened.
async function fillLog() {
  const network = context.network;
  try {
    const found = await read(here("events?most=100"));
    if (network !== context.network) return;
    const mine = context.log;
    context.log = [];
    for (const known of [context.states, context.revocable]) known.clear();
    context.arrivals.clear();
    for (const e of [...found, ...mine]) take({ id: e.id, event: e.event, data: e.data }, false);
    context.log.sort((a, b) => Number(a.id) - Number(b.id));
    // What comes between this reading and the connection is not missed, also where the log was
    // empty. A connection that stands knows itself what it has sent.
    lastId ??= context.log.at(-1)?.id ?? "0";
    emit("log");
  } catch { /* an older service has no log: the list begins with what comes */ }
}

export async function useNetwork(name) {
  disconnect();
  resources.clear();
  Object.assign(context, { network: name, summary: null, epoch: null, log: [] });
  for (const known of [context.states, context.revocable]) known.clear();
  context.arrivals.clear();
  lastId = null;
  connection.state = "connecting";
  if (!name) return;
  try { context.summary = await read(here("")); } catch { /* it is read again */ }
  await fillLog();
  connect();
}

export function forget() {
  useNetwork(null);
  Object.assign(context, { site: null, role: null });
}

const RANKS = { instrument: 0, viewer: 1, surveyor: 2, admin: 3 };
export const may = (role) => (RANKS[context.role] ?? -1) >= RANKS[role];
