// The last picks, newest first: small pictures, results, reports, and what persons say of them.

import { bodyOf, closeDialog, el, openDialog, replaceIn, tell, tellRefusal } from "./dom.js";
import { announce, ask, asker, now, on } from "./link.js";
import { LANGUAGE, plainly, texts } from "./texts.js";

const SHOWN = 6;
const NOT_FOUND = "TARGET_NOT_FOUND"; // what lies there, or in simulation was put there, is another thing
const SOON_MS = 700; // the recording is finished after the result, its report later
const AGAIN_MS = 2000;
const TRIES = 8;
const REACHED = ".about a, .about button";
const STEPS = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 };
const askCycles = asker();
let list = null;
let only = null; // the box "failed only"
let later = 0;
let drawn = "";
let expected = ""; // the cycle of the last result
let tries = 0;

async function refresh() {
  let cycles;
  try {
    cycles = await askCycles(`/api/cycles?limit=${SHOWN}${only.checked ? "&failed=true" : ""}`);
  } catch {
    return again(AGAIN_MS);
  }
  cycles = cycles.filter((one) => one.result !== "TORN" || one.cycle_id !== now.state?.cycle_id); // the one that runs
  const isThere = !expected || only.checked || cycles.some((one) => one.cycle_id === expected);
  if (!isThere || cycles.some((one) => one.result === "TORN" || !one.report)) again(isThere ? AGAIN_MS : SOON_MS);
  const last = cycles.find((one) => one.result !== "TORN");
  if (now.isLinked && !only.checked && !now.state?.cycle_id) now.result ??= last ?? null; // this page was not there
  const content = JSON.stringify(cycles);
  if (content === drawn) return;
  drawn = content;
  const empty = cycles.length === 0 ? [el("li", { class: "about soft" }, only.checked ? texts.noFailures : texts.noPicks)] : [];
  replaceIn(list, [...empty, ...cycles.map(entry)]);
  rove([...list.querySelectorAll(REACHED)][0]);
  loadInTurn([...list.querySelectorAll("img")]);
  announce("recorded");
}

function again(ms) {
  clearTimeout(later);
  if (tries++ < TRIES) later = setTimeout(refresh, ms);
}

/** One picture after the other: a browser opens few connections, and Stop needs one. */
async function loadInTurn(images) {
  for (const image of images) {
    await new Promise((resolve) => {
      image.onload = image.onerror = resolve;
      image.src = image.dataset.src;
    });
  }
}

function entry(one) {
  const result = texts.results[one.result] ?? one.result;
  const image = one.result === "TORN" || !one.file
    ? el("span", { class: "thumbnail" })
    : el("img", { "data-src": `/api/thumbnails/${encodeURIComponent(one.cycle_id)}`, alt: "" });
  const what = one.code === NOT_FOUND ? askedFor(one.reason ?? "") : one.object;
  const name = `${result}${one.code ? ` ${one.code}` : ""}${what ? `, ${what}` : ""}`;
  const report = { href: one.report, target: "_blank", rel: "noopener" };
  const picture = one.report
    ? el("a", { ...report, class: "thumbnail", "aria-label": `${texts.report}: ${one.cycle_id}, ${name}` }, image)
    : el("span", { class: "thumbnail" }, image);
  const label = one.labels.at(-1);
  return el("li", { "data-cycle": one.cycle_id }, picture, el("div", { class: "about" },
    el("span", { class: "tag" }, el("span", { class: one.result }, result), one.code ? ` ${one.code}` : "", what ? ` · ${what}` : ""),
    el("span", { class: "clip", title: one.reason }, plainly(one.reason ?? "")),
    el("span", { class: "soft" }, `${timeOf(one)} · ${one.cycle_id}`, one.report ? "" : ` · ${texts.noReport}`),
    label ? el("span", { class: "said" }, said(label)) : null,
    el("div", { class: "row" },
      one.report ? el("a", { ...report, class: "report", "aria-label": `${texts.report}: ${one.cycle_id}` }, texts.report) : null,
      ...(now.role === "viewer" || !one.file ? [] : ["good", "bad", "note"].map((word) => el("button", { class: "small", "aria-label": `${texts[word]}: ${one.cycle_id}`, onclick: () => judge(one.cycle_id, word) }, texts[word]))))));
}

/** What was asked for in words and not found. */
function askedFor(reason) {
  const words = /'([^']+)'/.exec(reason)?.[1];
  return words ? `“${words}”` : "";
}

/** When a cycle began; its id is of when it was asked for. */
function timeOf({ began, cycle_id }) {
  return clock(Date.parse((began || cycle_id).replace(/^(\d{4})(\d\d)(\d\d)T(\d\d)(\d\d)(\d\d).*$/, "$1-$2-$3T$4:$5:$6Z")));
}

function clock(at_ms) {
  const time = new Date(at_ms).toLocaleTimeString(LANGUAGE, { hour: "2-digit", minute: "2-digit", hourCycle: "h23", timeZone: "UTC" });
  return `${time} UTC`; // as in the ids
}

function said(label) {
  const words = texts.saidBy(label.label ? texts[label.label] : texts.note, label.who, clock(label.at_ns / 1e6));
  return label.note ? `${words}: ${label.note}` : words;
}

/** A verdict with the person's name; the name is asked once. */
function judge(cycle, word) {
  const who = localStorage.getItem("name") ?? "";
  if (word !== "note" && who) {
    keep(cycle, { who, label: word, note: "" });
    return;
  }
  const name = el("input", { id: "who", maxlength: 100, required: true, value: who, autocomplete: "name" });
  const note = el("input", { id: "note", maxlength: 1000, required: word === "note" });
  const save = (event) => {
    event.preventDefault();
    localStorage.setItem("name", name.value.trim());
    closeDialog();
    keep(cycle, { who: name.value.trim(), label: word === "note" ? "" : word, note: note.value });
  };
  openDialog(el("form", { onsubmit: save },
    el("h2", { id: "asking-title" }, `${texts.verdictOf(cycle)}: ${texts[word]}`),
    el("label", { for: "who" }, texts.yourName), name, el("label", { for: "note" }, texts.yourNote), note,
    el("div", { class: "row" }, el("button", { onclick: closeDialog }, texts.close), el("button", { type: "submit", class: "main" }, texts.save))));
}

/** One stop of the Tab key for all cards: it leads to this one of their links and buttons. */
function rove(to) {
  const had = list.contains(document.activeElement) ? document.activeElement : null;
  for (const one of list.querySelectorAll("a, button")) one.tabIndex = one === (had ?? to) ? 0 : -1;
}

/** The arrow keys move among the links and buttons of the cards. */
function step(event) {
  if (!(event.key in STEPS) || event.ctrlKey || event.altKey || event.metaKey) return;
  const all = [...list.querySelectorAll(REACHED)];
  const next = all[all.indexOf(document.activeElement) + STEPS[event.key]];
  event.preventDefault(); // else the page scrolls
  if (next === undefined) return;
  next.focus();
  rove(next);
}

async function keep(cycle, verdict) {
  try {
    await ask(`/api/labels/${encodeURIComponent(cycle)}`, verdict);
    tell(texts.kept);
    await refresh();
  } catch (refusal) {
    tellRefusal(refusal);
  }
}

export function showPicks() {
  list = el("ol", { id: "pick-list", "aria-label": texts.cardKeys, onkeydown: step, onfocusin: () => rove(null) });
  only = el("input", { type: "checkbox", id: "failed-only", onchange: refresh });
  bodyOf("picks").append(el("label", { class: "only" }, only, texts.failedOnly), list);
  on("result", (detail) => {
    expected = detail.cycle_id;
    tries = 0;
    again(SOON_MS);
  });
  on("link", (detail) => {
    drawn = "";
    tries = 0;
    if (detail) refresh();
    else now.result = null; // another pick may end meanwhile
  });
  refresh();
}
