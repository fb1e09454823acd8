// Makes elements, and shows messages. Text goes in as text only: names and replies of others never become markup.

import { refusalHere, texts } from "./texts.js";

const GOOD_MS = 6000;
const SVG = "http://www.w3.org/2000/svg";

function dress(one, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) one.addEventListener(name.slice(2), value);
    else if (value !== null && value !== undefined && value !== false) one.setAttribute(name, value === true ? "" : value);
  }
  one.append(...children.filter((child) => child !== null && child !== undefined).map((child) => (child instanceof Node ? child : String(child))));
  return one;
}

/** An element; children are nodes or text. A button submits only where it is told to. */
export function el(tag, attributes = {}, ...children) {
  return dress(document.createElement(tag), tag === "button" ? { type: tag, ...attributes } : attributes, children);
}

/** An SVG element. */
export function svg(tag, attributes = {}, ...children) {
  return dress(document.createElementNS(SVG, tag), attributes, children);
}

export function byId(id) {
  return document.getElementById(id);
}

/** Where a section of the page puts what it shows. */
export function bodyOf(id) {
  return byId(id).querySelector(".body");
}

/** Sets a text only where it is another one: a live region repeats nothing. */
export function say(one, text) {
  if (one.textContent !== text) one.textContent = text;
}

const nameOf = (one) => one.id || one.getAttribute("aria-label") || one.textContent;

/** Replaces what is in a place. The keyboard stays on what has the same name; where that is gone, `next` has it. */
export function replaceIn(place, children, next = byId("state")) {
  const had = place.contains(document.activeElement) ? nameOf(document.activeElement) : null;
  place.replaceChildren(...children);
  if (had === null) return;
  const again = [...place.querySelectorAll("a, button, input")].find((one) => nameOf(one) === had);
  (again ?? next).focus();
}

/** Opens the dialog; it never covers Stop, and leaves the rest of the page alive: Stop always works. */
export function openDialog(...children) {
  const dialog = byId("asking");
  dialog.replaceChildren(...children);
  if (!dialog.open) dialog.show();
}

/** Closes the dialog; the keyboard goes back to where it was. */
export function closeDialog() {
  byId("asking").close();
}

let quiet = 0;

/** Shows a message: a bad one until something new happens, or it is dismissed; a good one for a while. */
export function tell(text, isBad = false) {
  const dismiss = el("button", { class: "dismiss", "aria-label": texts.dismiss, onclick: untell });
  byId("message").replaceChildren(el("p", { class: isBad ? "bad" : "good" }, text), dismiss);
  clearTimeout(quiet);
  quiet = isBad ? 0 : setTimeout(untell, GOOD_MS);
}

/** Removes the message: it was dismissed, or is of an earlier try. */
export function untell() {
  clearTimeout(quiet);
  replaceIn(byId("message"), []);
}

/** Shows a refusal of the cell: what happened, and what to do. */
export function tellRefusal(refusal) {
  tell(refusalHere(refusal.reason === undefined ? { reason: String(refusal) } : refusal), true);
}

/** A button stays in the tab order: what it cannot do now it says. */
export function setButton(button, why, title) {
  button.setAttribute("aria-disabled", why ? "true" : "false");
  button.title = why || title;
}

export function isOff(button) {
  return button.getAttribute("aria-disabled") === "true";
}
