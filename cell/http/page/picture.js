// The last picture with what was found in it. A click chooses an object, a drag a box; a press then sends the job.

import { attend, whyNot } from "./commands.js";
import { bodyOf, el, isOff, say, setButton, svg, tell } from "./dom.js";
import { ask, cell, cellNow, now } from "./link.js";
import { duration, texts } from "./texts.js";

const DRAG_PX = 8;
const WORKING = ["Starting", "Execute", "Completing"];
const parts = {};
let shown = { picture_ns: 0, scene: null };
let target = null;
let from = null;

async function refreshPicture({ stamp_ns }) {
  parts.image.src = `/api/picture?at=${stamp_ns}`;
  shown.picture_ns = stamp_ns;
}

async function refreshScene() {
  try {
    shown.scene = await ask("/api/scene");
  } catch {
    shown.scene = null;
  }
  draw();
}

function draw() {
  const { image, overlay, things, none, figure } = parts;
  drawAge();
  const hasPicture = image.naturalWidth > 0;
  none.hidden = hasPicture;
  figure.hidden = !hasPicture;
  overlay.setAttribute("viewBox", `0 0 ${image.naturalWidth || 1} ${image.naturalHeight || 1}`);
  const scene = shown.scene !== null && shown.scene.stamp_ns === shown.picture_ns ? shown.scene : { outlines: [], numbers: [] };
  const order = ["thing", "other_grasp", "rod", "object", "grasp"];
  const outlines = scene.outlines.toSorted((a, b) => order.indexOf(a.kind) - order.indexOf(b.kind));
  const unit = (image.naturalWidth || 640) / 640;
  overlay.replaceChildren(
    ...outlines.map((one) => svg("polygon", { points: one.points_px.join(" "), class: `line ${one.kind}`, stroke: one.color, "stroke-width": (one.kind === "grasp" ? 3 : 1.6) * unit })),
    ...scene.numbers.map((one) => svg("text", { x: one.at_px[0], y: one.at_px[1], "font-size": 15 * unit, class: "number" }, one.text)),
    ...mark(unit),
  );
  things.replaceChildren(
    ...scene.numbers.map((one) => el("button", { type: "button", class: "small", onclick: () => choose({ pixel: one.at_px }) }, texts.thing(one.text))),
  );
  things.hidden = scene.numbers.length === 0;
  const kinds = new Set(outlines.map((one) => one.kind));
  parts.legend.replaceChildren(
    ...Object.entries(texts.legend).filter(([kind]) => kinds.has(kind)).map(([kind, words]) => el("li", { class: kind }, words)),
  );
}

function mark(unit) {
  if (target?.pixel) {
    const [u, v] = target.pixel;
    const r = 16 * unit;
    return [svg("path", { class: "mark", "stroke-width": 3 * unit, d: `M${u - r} ${v}H${u + r}M${u} ${v - r}V${v + r}` })];
  }
  if (target?.box) {
    const [a, b, c, d] = target.box;
    return [svg("rect", { class: "mark", "stroke-width": 3 * unit, x: a, y: b, width: c - a, height: d - b })];
  }
  return [];
}

/** Chooses what is to be picked; null forgets it. */
function choose(what) {
  target = what;
  parts.asked.hidden = what === null;
  if (what !== null) say(parts.what, what.text ? texts.chosen.text(what.text) : texts.chosen[what.pixel ? "pixel" : "box"]);
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
  const place = parts.place.value ? { name: parts.place.value } : null;
  const reply = await attend("pick", { job: { target, place, queue: true } });
  if (reply !== null) {
    tell(reply.position ? texts.queued(reply.position) : texts.begun);
    choose(null);
  }
}

// --- pointing -------------------------------------------------------------------------------------------------------

function pixelAt(event) {
  const frame = parts.overlay.getBoundingClientRect();
  const inside = (value, most) => Math.round(Math.min(Math.max(0, value), 1) * (most - 1));
  return [
    inside((event.clientX - frame.left) / frame.width, parts.image.naturalWidth),
    inside((event.clientY - frame.top) / frame.height, parts.image.naturalHeight),
  ];
}

function press(event) {
  if (event.button !== 0) return;
  from = { pixel: pixelAt(event), x: event.clientX, y: event.clientY };
  parts.overlay.setPointerCapture(event.pointerId);
}

function drag(event) {
  if (from === null || Math.hypot(event.clientX - from.x, event.clientY - from.y) < DRAG_PX) return;
  const [[a, b], [c, d]] = [from.pixel, pixelAt(event)];
  choose({ box: [Math.min(a, c), Math.min(b, d), Math.max(a, c), Math.max(b, d)] });
}

function release(event) {
  if (from === null) return;
  if (Math.hypot(event.clientX - from.x, event.clientY - from.y) < DRAG_PX) choose({ pixel: from.pixel });
  from = null;
}

function listPlaces() {
  const chosen = parts.place.value;
  const places = now.about?.places ?? [];
  parts.place.replaceChildren(
    el("option", { value: "" }, texts.tray),
    ...places.map((one) => el("option", { value: one.name }, texts.place(one.name))),
  );
  parts.place.value = chosen;
}

function drawAge() {
  if (shown.picture_ns) say(parts.age, texts.pictureAge(duration((cellNow() - shown.picture_ns) / 1e9)));
}

export function showPicture() {
  parts.image = el("img", { alt: texts.pictureAlt, id: "picture", draggable: "false", onload: draw });
  parts.overlay = svg("svg", { id: "overlay", "aria-hidden": "true", onpointerdown: press, onpointermove: drag, onpointerup: release, onpointercancel: () => { from = null; } });
  parts.figure = el("div", { class: "picture", hidden: true }, parts.image, parts.overlay);
  parts.none = el("p", { class: "empty" }, texts.noPicture);
  parts.age = el("p", { class: "soft", id: "age" });
  parts.legend = el("ul", { class: "legend" });
  parts.things = el("div", { class: "row", role: "group", "aria-label": texts.things, hidden: true });
  parts.what = el("strong", { id: "what" });
  parts.why = el("span", { class: "why", id: "why-pick" });
  parts.place = el("select", { id: "place", "aria-label": texts.layAt });
  parts.pick = el("button", { type: "button", id: "pick", class: "main", "aria-describedby": "why-pick", onclick: send }, texts.pickIt);
  parts.asked = el("div", { class: "asked", id: "asked", hidden: true, role: "group", "aria-label": texts.pickIt },
    parts.what, el("div", { class: "row" }, parts.place, parts.pick, el("button", { type: "button", onclick: () => choose(null) }, texts.forget)), parts.why);
  const words = el("input", { id: "words", maxlength: 200, placeholder: texts.wordsHint, autocomplete: "off", "aria-label": texts.words });
  const said = (event) => {
    event.preventDefault();
    if (words.value.trim()) choose({ text: words.value.trim() });
  };
  bodyOf("sees").append(parts.none, parts.figure, parts.asked, parts.legend, parts.age, el("p", {}, texts.pictureHelp), parts.things,
    el("form", { class: "row", onsubmit: said }, words, el("button", { type: "submit" }, texts.words)));
  listPlaces();
  cell.addEventListener("about", listPlaces);
  cell.addEventListener("picture", ({ detail }) => refreshPicture(detail));
  cell.addEventListener("scene", refreshScene);
  for (const name of ["state", "link", "about"]) cell.addEventListener(name, drawAllowed);
  setInterval(drawAge, 1000);
}
