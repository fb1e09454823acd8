// The buttons, exactly as the cell's table allows; one that is off says why.

import { bodyOf, byId, closeDialog, el, isOff, openDialog, say, setButton, tell, tellRefusal } from "./dom.js";
import { command, now, on, untilState } from "./link.js";
import { isInHand, plainly, texts } from "./texts.js";

const FREE_MS = 5000;
const AGAIN_MS = 250;
const buttons = {};

/** Why a command is not possible now; "" when it is. */
export function whyNot(verb) {
  if (!now.isLinked || now.state === null) return texts.why.noLink;
  if (now.role === "viewer") return texts.why.viewer;
  if (now.state.available.includes(verb)) return "";
  if (now.state.mode === "Manual" && ["start", "reset", "pick"].includes(verb)) return texts.why.manual;
  const why = texts.why[verb];
  return why[now.state.state] ?? why.other;
}

function whyOff(name, verb) {
  return name === "empty" && now.about?.is_never_empty ? texts.why.neverEmpty : whyNot(verb);
}

function draw() {
  for (const [name, { button, reason, verb }] of Object.entries(buttons)) {
    const why = whyOff(name, verb);
    const means = texts.means[name === "reset" && isInHand(now.state) ? "letFall" : name];
    setButton(button, why, means);
    say(reason, why || means);
  }
  buttons.unsuspend.row.hidden = now.state?.state !== "Suspended";
}

/** Sends a command that moves the arm; who holds the lease is named, and asked about. */
export async function attend(verb, request) {
  try {
    return await command(verb, request);
  } catch (refusal) {
    if (refusal.code === "LEASE_HELD" && !byId("asking").open) askToTakeOver(refusal);
    else tellRefusal(refusal);
    return null;
  }
}

function askToTakeOver(refusal) {
  openDialog(
    el("h2", { id: "asking-title" }, texts.takeOver),
    el("p", {}, texts.takeOverText),
    el("p", { class: "strong" }, plainly(refusal.reason)),
    el("div", { class: "row" },
      el("button", { onclick: closeDialog }, texts.takeOverNo),
      el("button", { class: "main", onclick: takeOver }, texts.takeOverYes)),
  );
}

async function takeOver() {
  closeDialog();
  try {
    if (now.state.available.includes("stop")) {
      await command("stop");
      await untilState("Stopped");
      if (isInHand(now.state)) return; // a reset would drop it
    }
    await resetWhenFree();
    tell(texts.takenOver);
  } catch (refusal) {
    tellRefusal(refusal);
  }
}

/** The other one's lease ends a moment after its motion. */
async function resetWhenFree() {
  const giveUp = Date.now() + FREE_MS;
  for (;;) {
    try {
      return await command("reset");
    } catch (refusal) {
      if (refusal.code !== "LEASE_HELD" || Date.now() > giveUp) throw refusal;
      await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
    }
  }
}

function add(name, verb = name, request = () => ({}), ...beside) {
  const press = () => {
    if (isOff(button)) tell(button.title, true);
    else if (["hold", "abort", "clear"].includes(verb)) command(verb).catch(tellRefusal);
    else attend(verb, request());
  };
  const reason = el("span", { class: "why", id: `why-${name}` });
  const button = el("button", { id: name, class: `do do-${name}`, "aria-describedby": `why-${name}`, onclick: press },
    texts.verbs[name]);
  const row = el("div", { class: "command" }, el("div", { class: "row" }, button, ...beside), reason);
  buttons[name] = { button, reason, row, verb };
  return row;
}

export function showCommands() {
  const count = el("input", { type: "number", id: "count", min: 1, max: 1000000, value: 1, inputmode: "numeric", "aria-label": texts.howMany });
  bodyOf("commands").append(el("div", { class: "commands" },
    add("start", "start", () => ({ cycles: Math.max(1, Math.round(count.valueAsNumber || 1)) }), count),
    add("empty", "start", () => ({ until_empty: true })),
    add("hold"),
    add("unhold"),
    add("unsuspend"),
    add("reset"),
    add("clear"),
    add("abort"),
  ));
  on("state link about", draw);
  draw();
}
