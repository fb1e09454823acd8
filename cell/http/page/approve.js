// The planned pick that waits for a person: what it is, in words and in 3-D, and the three answers.

import { bodyOf, byId, el, replaceIn, say, tellRefusal } from "./dom.js";
import { ask, asker, cellNow, command, now, on } from "./link.js";
import { mount } from "./plan_view.js";
import { duration, texts } from "./texts.js";

const askProposal = asker();
let asked = null; // the proposal that is shown
let view = null;

async function draw() {
  const waits = now.isLinked && now.role !== "viewer" && now.state?.available.includes("approve");
  if (!waits) {
    view?.close();
    view = asked = null;
    replaceIn(bodyOf("approve"), []);
    byId("approve").hidden = true;
    return;
  }
  byId("approve").hidden = false;
  try {
    const proposal = await askProposal("/api/proposal");
    if (proposal.proposal_id !== asked?.proposal_id && !byId("approve").hidden) await show(proposal);
  } catch {
    // it was answered meanwhile
  }
}

async function show(proposal) {
  asked = proposal;
  const reason = el("input", { id: "answer-reason", maxlength: 300, "aria-label": texts.answerReason, placeholder: texts.answerReason });
  const answer = (verb) => () => {
    const request = { proposal: proposal.proposal_id, reason: verb === "approve" ? "" : reason.value };
    command(verb, request).catch(tellRefusal);
  };
  const button = (verb, kind = "") => el("button", { id: `answer-${verb}`, class: kind, title: texts.answersMean[verb], onclick: answer(verb) }, texts.answers[verb]);
  const plan = el("div", { class: "plan" });
  bodyOf("approve").contains(document.activeElement) && byId("approve-title").focus(); // not on the same answer: this is another pick
  bodyOf("approve").replaceChildren(
    el("p", { class: "strong" }, texts.asks(proposal.thing, proposal.object, proposal.motion_s.toFixed(1))), el("p", { id: "answer-time", class: "soft" }),
    plan, el("div", { class: "row" }, button("approve", "main"), button("next_grasp"), button("reject")), reason);
  drawTime();
  try {
    const seen = await ask("/api/plan");
    if (asked === proposal && seen.proposal.proposal_id === proposal.proposal_id) view = mount(plan, seen, texts.plan);
  } catch (refusal) {
    say(plan, refusal.reason ?? "");
  }
}

function drawTime() {
  const place = byId("answer-time");
  if (place && asked) say(place, texts.answerWithin(duration((asked.until_ns - cellNow()) / 1e9)));
}

export function showApprove() {
  byId("approve-title").textContent = texts.approve;
  on("state link about proposal", draw);
  setInterval(drawTime, 1000);
  draw();
}

