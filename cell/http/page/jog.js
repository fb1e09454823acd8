// Moves the arm by hand, in mode Manual: small steps and the way home while a button is held; the hand.

import { attend } from "./commands.js";
import { bodyOf, byId, el, isOff, setButton, tell, tellRefusal, untell } from "./dom.js";
import { ask, now, on } from "./link.js";
import { texts } from "./texts.js";

const AGAIN_MS = 150;
const MODE_FROM = ["Stopped", "Idle", "Complete", "Aborted"];
const moving = [];
let held = null;
let mode = null;
let hint = null;

/** Sends a motion as long as its button is held; one that is refused because the last one lasts is no trouble. */
async function whileHeld(verb, request) {
  const hold = (held = {}); // not the button: it may be held anew before the answer
  untell();
  while (held === hold) {
    try {
      await ask(`/api/commands/${verb}`, request);
    } catch (refusal) {
      if (refusal.code === "LEASE_HELD" && held === hold) return attend(verb, request);
      if (refusal.code !== "MOVING") return tellRefusal(refusal);
    }
    await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
  }
  return null;
}

function letGo() {
  held = null;
}

function holding(words, verb, request = {}) {
  const press = () => !isOff(button) && whileHeld(verb, request);
  const grab = (event) => {
    button.setPointerCapture(event.pointerId); // the page may move below the pointer
    press();
  };
  const button = el("button", {
    class: "do", onpointerdown: grab, onpointerup: letGo, onlostpointercapture: letGo, onpointercancel: letGo, onblur: letGo,
    onkeydown: (event) => [" ", "Enter"].includes(event.key) && !event.repeat && press(), onkeyup: letGo,
    oncontextmenu: (event) => event.preventDefault(),
  }, words);
  moving.push([button, verb]);
  return button;
}

function once(words, verb) {
  const press = () => !isOff(button) && attend(verb, {});
  const button = el("button", { class: "do", onclick: press }, words);
  moving.push([button, verb]);
  return button;
}

function changeMode() {
  if (isOff(mode)) return tell(mode.title, true);
  return attend("mode", { mode: now.state.mode === "Manual" ? "Production" : "Manual" });
}

function draw() {
  const isManual = now.state?.mode === "Manual";
  const can = now.isLinked && now.role !== "viewer" && MODE_FROM.includes(now.state?.state);
  byId("jog").hidden = now.role === "viewer";
  bodyOf("jog").querySelector(".by-hand").hidden = !isManual;
  mode.textContent = isManual ? texts.toProduction : texts.toManual;
  setButton(mode, can ? "" : texts.notNow, texts.manualMeans);
  const why = now.state?.state === "Aborted" ? texts.clearToMove : texts.notNow;
  hint.hidden = now.state?.state !== "Aborted";
  for (const [button, verb] of moving) {
    setButton(button, can && now.state.available.includes(verb) ? "" : why, texts.holdButton);
  }
  if (!isManual) letGo();
}

export function showJog() {
  byId("jog-title").textContent = texts.jog;
  mode = el("button", { id: "mode", onclick: changeMode });
  const steps = Object.entries(texts.steps).map(([axis, words]) => el("div", { class: "row" },
    ...[1, -1].map((direction) => holding(words[direction], "jog", { axis, direction }))));
  hint = el("p", { class: "strong", id: "why-jog", hidden: true }, texts.clearToMove);
  bodyOf("jog").append(mode, el("div", { class: "by-hand", hidden: true }, hint, el("p", { class: "soft" }, texts.manualMeans), ...steps,
    el("div", { class: "row" }, holding(texts.home, "jog_home"), once(texts.handOpen, "hand_open"), once(texts.handClose, "hand_close"))));
  on("state link about", draw);
  window.addEventListener("blur", letGo);
  document.addEventListener("visibilitychange", letGo);
  draw();
}
