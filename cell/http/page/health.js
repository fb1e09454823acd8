// Health in lines: nodes, interfaces, disk and what goes, spending, clocks. A red line says what to do.

import { bodyOf, el } from "./dom.js";
import { ask, cellNow, learn, now, on } from "./link.js";
import { adviceHere, duration, plainly, texts } from "./texts.js";

const PERIOD_MS = 60000;
const CLOCK_S = 2;
const FULL = 0.05;
const EVENTS = 6;
let storage = null;
let spent = null;
const events = [];

function line(kind, text, advice) {
  return el("li", { class: kind }, text, advice ? el("span", { class: "advice" }, advice) : null);
}

function nodeLines() {
  return Object.entries(now.health?.nodes ?? {}).map(([name, node]) => {
    const restarts = node.restarts ? `, ${texts.restarts(node.restarts)}` : "";
    if (!node.is_alive) return line("bad", texts.nodeGone(name), texts.nodeAdvice);
    if (node.problems.length) return line("bad", `${name}: ${node.problems.join("; ")}${restarts}`, texts.nodeAdvice);
    return line("good", `${name}: ${texts.nodeWell}${restarts}`);
  });
}

/** The interfaces; of one that is closed why, and what to do. */
function doorLines() {
  return Object.entries(now.health?.doors ?? {}).map(([name, door]) => {
    const title = texts.doors[name] ?? name;
    return door.problem ? line("bad", `${title}: ${door.problem}`, door.advice) : line(door.endpoint ? "good" : "", `${title}: ${door.endpoint ? texts.doorOpen : texts.doorOpens}`);
  });
}

const gb = (bytes) => (bytes / 1e9).toFixed(bytes < 1e10 ? 2 : 0);

function storageLines() {
  if (storage === null) return [];
  const isFull = storage.free_bytes < FULL * storage.total_bytes;
  const { recordings, bytes, trimmed } = storage.soon;
  const next = [recordings ? texts.willGo(recordings, gb(bytes)) : texts.nothingGoes, trimmed ? texts.willTrim(trimmed) : ""];
  return [
    line(isFull ? "bad" : "good", texts.disk(gb(storage.free_bytes), gb(storage.recordings_bytes)), isFull ? texts.diskAdvice : ""),
    line("", Object.keys(storage.rules).length ? next.join(" ").trim() : texts.keepsAll),
    storage.short ? line("bad", texts.short(storage.short), texts.diskAdvice) : null,
  ];
}

function clockLine() {
  const off = Math.abs(now.offset_ns) / 1e9;
  const time = new Date(cellNow() / 1e6).toISOString().slice(0, 16).replace("T", " ");
  const isOff = off > CLOCK_S;
  return line(isOff ? "bad" : "good", texts.clock(`${time} UTC`), isOff ? texts.clockOff(duration(off)) : "");
}

function draw() {
  const defects = (now.health?.defects ?? []).map((one) => line("bad", one, texts.defectAdvice));
  const parts = now.isLinked && !now.isEnded ? [...nodeLines(), ...doorLines()] : [line("bad", texts.noCell)];
  const shown = events.map((one) => line(one.severity === "error" ? "bad" : "", `${one.code} ${plainly(one.text)}`, adviceHere(one.advice)));
  bodyOf("health").replaceChildren(
    el("ul", { class: "lines", id: "lines" }, ...defects, ...parts, ...storageLines(),
      spent === null ? null : line("", texts.spent(spent.toFixed(2))), clockLine()),
    ...(shown.length ? [el("h3", {}, texts.events), el("ul", { class: "lines" }, ...shown)] : []),
  );
}

async function refresh() {
  learn().catch(() => {});
  try {
    storage = await ask("/api/storage");
    spent = (await ask("/api/summary?day=today")).cost_usd;
    const health = now.health ?? (await ask("/api/health"));
    now.health ??= health; // what it said meanwhile is newer
  } catch {
    // the banner says that there is no link
  }
  draw();
}

export function showHealth() {
  on("health about link", draw);
  on("event", (detail) => {
    if (detail.code === "ABORTING") return; // ABORTED follows
    events.unshift(detail);
    events.length = Math.min(events.length, EVENTS);
    draw();
  });
  setInterval(refresh, PERIOD_MS);
  refresh();
}
