// What the cell sees: the last picture with what was found in it, or, while it rests, one of now. An object is chosen in
// it; a press then sends the job, with the picture in which it was pointed at. All of it by keyboard, too.

import { attend, whyNot } from "./commands.js";
import { bodyOf, el, isOff, replaceIn, say, setButton, svg, tell } from "./dom.js";
import { announce, asker, cellNow, now, on } from "./link.js";
import { isInside, overlayOf } from "./overlay.js";
import { pointing } from "./pointing.js";
import { duration, texts } from "./texts.js";

const LIVE_S = 3; // a picture is of now for so long, while nothing moves
const STILL = ["Stopped", "Idle", "Complete", "Aborted", "Held", "Suspended"];
const HELD = ["Held", "Suspended"];
const GOING_ON = ["Unholding", "Unsuspending"];
const WORKING = ["Starting", "Execute", "Completing"];
const NOTHING = { stamp: "", outlines: [], numbers: [] };
const parts = {};
const askScene = asker();
let shown = { stamp: "" };
let wanted = null;
let isLoading = false;
let scene = NOTHING;
let seen = null; // the last picture of a pick
let target = null;
let sending = null; // the target that is not answered yet
let thing; // the number of the thing that is pointed at; "" for none, undefined where nothing is pointed at

/** Loads one picture after the other, the newest only, and shows it when it is there: what is clicked is what is shown. */
async function load(detail) {
  wanted = detail;
  if (isLoading || (document.hidden && detail.is_live)) return;
  isLoading = true;
  while (wanted !== null) {
    const next = wanted;
    wanted = null;
    const image = el("img", { alt: texts.pictureAlt, id: "picture", draggable: "false", src: `/api/picture?at=${next.stamp}` });
    try {
      await image.decode();
    } catch {
      continue; // a newer one is there
    }
    parts.image.replaceWith(image);
    parts.image = image;
    shown = next;
    draw();
    if (lacksThings()) refreshScene();
  }
  isLoading = false;
}

/** A new picture; one of now counts while nothing moves. */
function take(detail) {
  if (!detail.is_live) seen = detail;
  else if (shown.stamp && !STILL.includes(now.state?.state)) return;
  load(detail);
}

/** When a held pick goes on, what it has found is shown again. */
function follow() {
  if (GOING_ON.includes(now.state?.state) && (shown.is_live || isLoading) && seen !== null) load(seen);
  draw();
}

/** Asks what was found; where that fails, again with the next picture of now. */
async function refreshScene() {
  const found = await askScene("/api/scene").catch(() => NOTHING);
  if (scene.stamp !== found.stamp) forgetNumbers();
  scene = found;
  draw();
}

/** With every look things are numbered anew. */
function forgetNumbers() {
  for (const job of Object.keys(now.pointed)) now.pointed[job] = "";
  announce("jobs");
}

/** Whether the picture that is shown has things of which nothing is known here. */
function lacksThings() {
  return Boolean(shown.is_live) && shown.things !== "0" && shown.things !== scene.stamp;
}

/** What is drawn into the picture that is shown: all that was found in it, or, in one of now, the things still there. */
function drawn() {
  if (!shown.is_live) return scene.stamp === shown.stamp ? scene : NOTHING;
  if (scene.stamp === "" || scene.stamp !== shown.things) return NOTHING;
  const isThere = (number) => !shown.gone.includes(Number(number));
  return {
    outlines: scene.outlines.filter((one) => one.kind === "unseen" || (one.kind === "thing" && isThere(one.number))),
    numbers: scene.numbers.filter((one) => isThere(one.text)),
  };
}

function draw() {
  const { image, overlay, things, none, figure, numberless } = parts;
  drawAge();
  const hasPicture = image.naturalWidth > 0;
  none.hidden = hasPicture;
  figure.hidden = parts.help.hidden = !hasPicture;
  if (!hasPicture) {
    numberless.hidden = true;
    return;
  }
  const { outlines, numbers } = drawn();
  overlay.setAttribute("viewBox", `0 0 ${image.naturalWidth} ${image.naturalHeight}`);
  overlay.classList.toggle("earlier", Boolean(shown.is_live));
  overlay.classList.toggle("elsewhere", isElsewhere());
  say(parts.help, !isElsewhere() ? texts.pictureHelp : HELD.includes(now.state?.state) ? texts.pictureHeld : texts.pictureElsewhere);
  overlay.replaceChildren(...overlayOf(outlines, numbers, isElsewhere() ? null : target, unitOf(image)));
  const label = numbers.map((one) => one.text).join();
  if (things.dataset.label !== label) {
    things.dataset.label = label;
    const pick = (one) => (event) => choose({ pixel: one.at_px, picture_ns: shown.stamp }, event.detail === 0);
    replaceIn(things, numbers.map((one) => el("button", { class: "small", onclick: pick(one) }, texts.thing(one.text))), figure);
  }
  things.hidden = numbers.length === 0;
  numberless.hidden = numbers.length > 0 || isElsewhere();
  const kinds = new Set(outlines.map((one) => one.kind));
  parts.legend.replaceChildren(
    ...Object.entries(texts.legend).filter(([kind]) => kinds.has(kind)).map(([kind, words]) => el("li", { class: kind }, words)),
  );
}

/** Pixels of the picture for one of the screen, where it is small; numbers stay readable on a phone. */
function unitOf(image) {
  return image.naturalWidth / Math.min(640, Math.max(300, image.clientWidth));
}

/**
 * Chooses what is to be picked; null forgets it. One way at a time: what is pointed at clears the words.
 * `goesOn`: the keyboard goes on to where it is sent.
 */
function choose(what, goesOn = false) {
  target = what;
  thing = what?.pixel ? thingAt(what.pixel) : undefined;
  if (what !== null && !what.text) parts.words.value = "";
  const hadFocus = parts.asked.contains(document.activeElement);
  parts.asked.hidden = what === null;
  if (what !== null) say(parts.what, texts.target(what, thing));
  if (goesOn) parts.place.focus(); // not on the button: a key that is held repeats itself
  else if (what === null && hadFocus) (parts.figure.hidden ? parts.words : parts.figure).focus();
  drawAllowed();
  draw();
}

function drawAllowed() {
  const isWorking = now.isLinked && now.role !== "viewer" && WORKING.includes(now.state?.state);
  const why = isWorking ? "" : whyNot("pick");
  setButton(parts.pick, why, "");
  say(parts.why, target === null ? "" : why);
}

async function send() {
  if (isOff(parts.pick)) return tell(parts.pick.title, true);
  if (sending === target) return null; // it was pressed twice
  const place = parts.place.value ? { name: parts.place.value } : null;
  const [chosen, number, { stamp }] = [target, thing, scene];
  sending = target;
  const reply = await attend("pick", { job: { target, place, queue: true } });
  sending = null;
  if (reply === null) return null;
  if (reply.position) tell(texts.queued(reply.position)); // else the banner says that it is under way
  if (target === chosen) choose(null); // else another thing was chosen meanwhile
  if (number === undefined) return null;
  now.pointed[reply.job_id] = stamp === scene.stamp ? number : "";
  return announce("jobs");
}

/** The number of the thing at a pixel (u, v) of the picture that is shown; "" for none. */
function thingAt(pixel) {
  const things = drawn().outlines.filter((one) => ["thing", "object"].includes(one.kind));
  return String(things.find((one) => isInside(pixel, one.points_px))?.number ?? "");
}

/** A picture of now from elsewhere than where the cell looks for things: nothing can be pointed at in it. */
function isElsewhere() {
  return Boolean(shown.is_live) && !shown.from_capture_pose;
}

function listPlaces() {
  const chosen = parts.place.value;
  const places = now.about?.places ?? [];
  parts.place.replaceChildren(
    el("option", { value: "" }, texts.layTray),
    ...places.map((one) => el("option", { value: one.name }, texts.layAt(one.name))),
  );
  parts.place.value = chosen;
}

function drawAge() {
  if (!shown.stamp) return;
  const age_s = (cellNow() - Number(shown.stamp)) / 1e9;
  const isStill = STILL.includes(now.state?.state) && Number(shown.stamp) >= now.state.since_ns;
  const isNow = Boolean(shown.is_live) && now.isLinked && isStill && age_s < LIVE_S;
  parts.live.hidden = !isNow;
  say(parts.age, isNow ? texts.pictureNow : texts.pictureAge(duration(age_s)));
}

export function showPicture() {
  parts.image = el("img", { alt: texts.pictureAlt, id: "picture" });
  const listens = pointing(() => ({ image: parts.image, stamp: shown.stamp, isOff: isElsewhere(), pixel: target?.pixel }), choose);
  parts.overlay = svg("svg", { id: "overlay", "aria-hidden": "true", ...listens.overlay });
  parts.live = el("span", { class: "live", hidden: true }, texts.live);
  parts.figure = el("div", { class: "picture", id: "figure", hidden: true, tabindex: 0, role: "application", "aria-label": texts.pointHere, "aria-describedby": "help", ...listens.frame }, parts.image, parts.overlay, parts.live);
  parts.none = el("p", { class: "empty" }, texts.noPicture);
  parts.age = el("p", { class: "soft", id: "age" });
  parts.help = el("p", { id: "help", hidden: true }, texts.pictureHelp);
  parts.legend = el("ul", { class: "legend" });
  parts.things = el("div", { class: "row", role: "group", "aria-label": texts.things, hidden: true });
  parts.numberless = el("p", { class: "soft", hidden: true }, texts.numberless);
  parts.what = el("strong", { id: "what", "aria-live": "polite" });
  parts.why = el("span", { class: "why", id: "why-pick" });
  parts.place = el("select", { id: "place", "aria-label": texts.layWhere });
  parts.pick = el("button", { id: "pick", class: "main", "aria-describedby": "why-pick", onclick: send }, texts.pickIt);
  parts.asked = el("div", { class: "asked", id: "asked", hidden: true, role: "group", "aria-label": texts.pickIt },
    parts.what, el("div", { class: "row" }, parts.place, parts.pick, el("button", { onclick: () => choose(null) }, texts.forget)), parts.why);
  const words = el("input", { id: "words", maxlength: 200, placeholder: texts.wordsHint, autocomplete: "off", oninput: () => choose(null) });
  parts.words = words;
  const said = (event) => {
    event.preventDefault();
    if (words.value.trim()) choose({ text: words.value.trim() }, true);
  };
  bodyOf("sees").append(parts.none, parts.figure, parts.asked, parts.legend, parts.age, parts.help, parts.things, parts.numberless,
    el("form", { class: "row", onsubmit: said }, el("label", { for: "words" }, texts.words), words, el("button", { type: "submit" }, texts.chooseWords)));
  listPlaces();
  on("about", listPlaces);
  on("picture", take);
  on("state", follow);
  on("scene", refreshScene);
  on("sent", (detail) => detail === "reset" && !target?.text && choose(null));
  window.addEventListener("resize", draw);
  document.addEventListener("visibilitychange", () => wanted !== null && load(wanted));
  on("state link about", drawAllowed);
  setInterval(drawAge, 1000);
}
