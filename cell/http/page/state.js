// The banner: the state in words, why it is so, what to do, the job and what waits.

import { byId, el, isOff, replaceIn, say, setButton, tell, tellRefusal } from "./dom.js";
import { cellNow, command, now, on } from "./link.js";
import { adviceHere, duration, isInHand, plainly, texts } from "./texts.js";

const BY = /^(?:command|mode) '?(\w+)'? from (.+)$/;
const ENDING = ["stop", "abort", "hold", "suspend"];
const WORKING = ["Execute", "Completing"];
const TONES = {
  Stopped: "rest", Idle: "good", Holding: "held", Held: "held", Suspending: "held", Suspended: "held", Complete: "good",
  Stopping: "rest", Aborting: "bad", Aborted: "bad", approve: "held", manual: "rest", failed: "held", empty: "good",
}; // any other: busy
const GRASPING = ["execute", "verify", "deliver"]; // the stages in which a pick is not undone any more
const PRESS_MS = 1000; // a click within this time is the end of a press
const OWN_NAME = /^\d{8}T\d{9}$/; // of a job that its client gave none
let stopping = ""; // why the cell stopped; said before it is
let drawnJobs = "";

/** The reason for a person; that of Stopping holds for the Stopped that follows. */
function reasonOf(state, meaning) {
  if (state.state !== "Stopped") stopping = state.reason;
  const cause = state.reason || stopping;
  const by = BY.exec(cause);
  if (!by) return adviceHere(plainly(cause));
  const who = now.client_id && by[2].startsWith(now.client_id) ? texts.byThis : texts.by(by[2]);
  return ENDING.includes(by[1]) || !meaning ? who : texts.askedFor(meaning, who);
}

/** What is said in place of the state, where that tells too little. */
function specialOf(state) {
  if (state.mode === "Manual" && state.state !== "Aborted") return "manual";
  if (state.state === "Execute" && state.stage === "approve") return "approve";
  return (state.state === "Complete" && { FAILED: "failed", EMPTY: "empty" }[now.result?.result]) || state.state;
}

function todoOf(state, special) {
  if (state.mode === "Manual" && state.state === "Aborted") return texts.clearToMove;
  const todo = texts.todo[special] ?? texts.todo[state.state] ?? "";
  return isInHand(state) ? `${texts.inHand} ${todo}` : todo;
}

function draw() {
  const state = now.state;
  if (state?.cycle_id && state.cycle_id !== now.result?.cycle_id) now.result = null; // another one runs
  if (!now.isLinked || now.isEnded || state === null) {
    byId("banner").className = "tone-none";
    return write(...(now.isEnded ? texts.ended : now.isLinked ? [texts.connecting, "", ""] : texts.noLink));
  }
  const special = specialOf(state);
  byId("banner").className = `tone-${TONES[special] ?? "busy"}`;
  const meaning = texts.meaning[special] ?? texts.meaning[state.state] ?? "";
  const reason = reasonOf(state, meaning) || (special === "failed" ? texts.lastFailed(plainly(now.result.reason)) : "");
  const stage = special === "manual" ? texts.byHand : WORKING.includes(state.state) ? texts.stages[state.stage] : "";
  const [why, ...advice] = (reason || meaning).split(state.state === "Aborted" ? /(?<=\.) (?=[A-Z])/ : "\n");
  return write(stage ? `${state.state}: ${stage}` : state.state, why, [...advice, todoOf(state, special)].join(" "));
}

function write(name, reason, todo) {
  say(byId("state"), name);
  say(byId("reason"), reason);
  say(byId("todo"), todo);
  drawJobs();
  drawFacts();
}

function drawFacts() {
  const state = now.state;
  if (state === null || !now.isLinked) return byId("facts").replaceChildren();
  const facts = [
    [texts.facts.cell, now.about?.cell_id ?? ""],
    [texts.facts.mode, [texts.modes[state.mode] ?? state.mode, now.about?.is_simulated ? texts.simulated : ""].filter(Boolean).join(", ")],
    [texts.facts.since, duration((cellNow() - state.since_ns) / 1e9)],
    [texts.facts.cycle, state.cycle_id],
    [texts.facts.role, now.role === "viewer" ? texts.viewer : ""],
  ];
  byId("facts").replaceChildren(
    ...facts.filter(([, what]) => what).map(([name, what]) => el("div", {}, el("dt", {}, name), el("dd", {}, what))),
  );
}

/** The job under way and those that wait, each with its turn, what it picks, and where that goes. */
function drawJobs() {
  const { state, jobs } = now;
  if (state === null) return;
  const turns = !now.isLinked ? [] : [[texts.jobNow, state.job_id], ...state.queue.map((job, index) => [index + 1, job])].filter(([, job]) => job);
  const content = JSON.stringify([turns, jobs, now.role, now.pointed, isTooLate(state.job_id)]);
  if (content === drawnJobs) return;
  drawnJobs = content;
  replaceIn(byId("jobs"), turns.map(([turn, job]) => el("li", {}, el("span", { class: "turn" }, turn), el("span", { class: "job" }, said(job)), cancelling(job))));
}

function said(job) {
  const about = now.jobs[job];
  if (about === undefined) return job;
  const name = OWN_NAME.test(job) ? "" : texts.jobNamed(job);
  return texts.jobIs(texts.jobWhat(about.target, now.pointed[job]), texts.jobWhere(about.place), texts.jobTimes(about)) + name;
}

function cancelling(job) {
  if (now.role === "viewer") return null;
  const cancel = () => (isOff(button) ? tell(button.title, true) : command("cancel", { job: { job_id: job } }).catch(tellRefusal));
  const button = el("button", { class: "small", "aria-label": texts.cancelJob(job), onclick: cancel }, texts.cancel);
  setButton(button, isTooLate(job) ? texts.why.cancel : "", "");
  return button;
}

/** Whether a job's only pick, or its last, is under way and cannot be cancelled any more. */
function isTooLate(job) {
  const { job_id: at, state, stage } = now.state;
  const isGrasping = state === "Completing" || GRASPING.includes(stage);
  return job === at && isGrasping && !now.jobs[job]?.until_empty && (now.jobs[job]?.cycles ?? 1) <= 1;
}

/** How much of the screen's upper end is always covered. */
function measure() {
  document.documentElement.style.setProperty("--banner", `${byId("banner").offsetHeight || byId("state").offsetHeight}px`);
}

function stop() {
  command("stop").catch(tellRefusal);
}

export function showState() {
  const button = byId("stop");
  button.append(texts.stop, " ", el("kbd", { "aria-hidden": "true" }, texts.stopKey));
  setButton(button, "", texts.stopTitle);
  let pressed_ms = -PRESS_MS;
  button.addEventListener("pointerdown", () => {
    pressed_ms = performance.now();
    stop(); // at the press, not at its end
  });
  button.addEventListener("click", () => performance.now() - pressed_ms > PRESS_MS && stop()); // keyboard, screen reader
  document.addEventListener("keydown", (event) => event.key === "Escape" && !event.repeat && stop(), { capture: true });
  say(byId("state"), texts.connecting);
  on("state link about result recorded event health", draw);
  on("jobs", drawJobs);
  const sized = new ResizeObserver(measure);
  for (const id of ["banner", "state"]) sized.observe(byId(id));
  setInterval(drawFacts, 1000);
}
