// The light of a network: ok, doubts, alarm or unknown, each with its reasons in sentences.
import { fixed, isNumber, stamp, t, word } from "./language.js";
import { connection, context, errorOf, here, peek } from "./live.js";

export const ALARMS = "alarms?state=standing", INSTRUMENTS = "instruments";

// Counts, σ̂0, its limits and the epoch belong together: all are of one answer, the summary, which is
// read again as observations arrive.
export const countsOf = (summary) => summary?.counts ?? {};
export const sigma0Of = (summary) => countsOf(summary).sigma0 ?? summary?.sigma0;

export const ofNetwork = (record) => !record.network || record.network === context.network;
export const alarmsOf = (alarms) => (alarms ?? []).filter((a) => ofNetwork(a) && a.state !== "closed");
export const instrumentsOf = (found) => (found ?? []).filter(ofNetwork);

// Alarms have the times of epochs, which are their middles: told is the epoch, from begin to end.
export function alarmSince(a) {
  if (!isNumber(a.epoch)) return t("since_time", { time: stamp(a.since) });
  if (isNumber(a.epoch_begin)) return t("since_epoch", { epoch: a.epoch, begin: stamp(a.epoch_begin), end: stamp(a.epoch_end) });
  return t(a.epoch_seconds === null ? "since_begun" : "since_of", { epoch: a.epoch, time: stamp(a.since) });
}
export function alarmUntil(a) {
  const half = 0.5 * (a.epoch_end - a.epoch_begin);
  return isNumber(half) ? t("until_epoch", { begin: stamp(a.until - half), end: stamp(a.until + half) }) : t("until_time", { time: stamp(a.until) });
}

export function alarmSentence(a) {
  // The size of a displacement in mm; values of tests have no unit, those of silence have seconds.
  const figure = (v) => `${fixed(v, a.unit ? 0 : 2)}${a.unit ? ` ${a.unit}` : ""}`;
  const told = [
    isNumber(a.size_mm) ? `${fixed(a.size_mm, 1)} mm` : null,
    isNumber(a.value) ? `${a.unit ? "" : `${t("test_value")} `}${figure(a.value)}` : null,
    isNumber(a.limit) ? `${t("limit")} ${figure(a.limit)}` : null,
  ].filter(Boolean);
  const size = told.length ? ` (${told.join(", ")})` : "";
  return t("alarm_sentence", {
    rule: a.rule, test: word("test", a.test), since: alarmSince(a),
    points: a.points?.length ? a.points.join(", ") : a.instrument ?? t("whole_network"),
  }) + size;
}

// What could not be read is no good news: alarms and instruments that are not known make no light
// green, unless the service has none.
export function light() {
  const summary = peek(here("")), alarms = peek(ALARMS), instruments = peek(INSTRUMENTS);
  if (connection.state !== "live" || !summary)
    return { state: "unknown", reasons: [connection.state === "lost" ? t("light_lost", { at: stamp(connection.heard, true) }) : t("light_reading")] };
  const unread = [[ALARMS, alarms, "alarms"], [INSTRUMENTS, instruments, "instruments"]].map(([path, data, name]) => ({ name, error: errorOf(path), lacks: data === undefined }));
  const standing = alarmsOf(alarms), open = standing.filter((a) => a.state === "open");
  if (open.length) return { state: "alarm", reasons: open.map(alarmSentence) };
  const counts = countsOf(summary), sigma0 = sigma0Of(summary), [low, high] = summary.sigma0_limits ?? [];
  const reasons = unread.filter((u) => u.error && u.error.status !== 404).map((u) => t("light_unread", { what: t(u.name) }));
  if (!reasons.length && unread.some((u) => u.lacks && !u.error)) return { state: "unknown", reasons: [t("light_reading")] };
  for (const a of standing) reasons.push(t(a.state === "silenced" ? "light_silenced" : "light_acknowledged", { alarm: alarmSentence(a) }));
  if (counts.suspects) reasons.push(t("light_suspects", { n: counts.suspects }));
  if (counts.doubts) reasons.push(t("light_doubts", { n: counts.doubts }));
  if (low !== undefined && sigma0 !== null && (sigma0 < low || sigma0 > high))
    reasons.push(t(sigma0 > high ? "light_sigma0_high" : "light_sigma0_low", { sigma0: fixed(sigma0, 2), low: fixed(low, 2), high: fixed(high, 2) }));
  for (const i of instrumentsOf(instruments))
    if (i.state !== "ok" && i.state !== "stopped") reasons.push(t("light_instrument", { name: i.name, state: word("state", i.state), last: stamp(i.last_message) }));
  if (reasons.length) return { state: "doubts", reasons };
  const own = instrumentsOf(instruments);
  // What nothing checks is not well.
  if (!counts.observations) return { state: "unknown", reasons: [t("light_empty")] };
  if (counts.redundancy <= 0) return { state: "unknown", reasons: [t("light_unchecked", { n: counts.observations })] };
  return { state: "ok", reasons: [[
    t(counts.observations === 0 ? "light_none" : low === undefined ? "light_ok" : "light_ok_tested", { n: counts.observations ?? "–", sigma0: fixed(sigma0, 2), low: fixed(low, 2), high: fixed(high, 2) }),
    alarms ? t("light_no_alarm") : t("light_alarms_none"), own.length ? t("light_instruments_well", { n: own.length }) : "",
  ].join(" ").trim()] };
}
