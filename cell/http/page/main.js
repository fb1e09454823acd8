// Puts the parts of the page together.

import { askToken } from "./login.js";
import { byId, el, tell, untell } from "./dom.js";
import { learn, listen, now, on } from "./link.js";
import { LANGUAGE, adviceHere, plainly, texts } from "./texts.js";
import { showState } from "./state.js";
import { showCommands } from "./commands.js";
import { showPicture } from "./picture.js";
import { showApprove } from "./approve.js";
import { showJog } from "./jog.js";
import { showPicks } from "./picks.js";
import { showToday } from "./today.js";
import { showHealth } from "./health.js";

const IN_BANNER = ["ABORTING", "ABORTED", "HAND_NOT_EMPTY", "PICK_CUT_OFF"];
const ANEW = ["Resetting", "Clearing"];
let told = "";

/** Messages of an earlier try go when another begins, or a person is asked. */
function forgetEarlier() {
  const { state, stage, cycle_id: cycle } = now.state;
  const begun = ANEW.includes(state) ? state : stage === "approve" ? `${cycle} approve` : cycle;
  if (begun && begun !== told) untell();
  told = begun;
}

async function begin() {
  document.documentElement.lang = LANGUAGE;
  for (const one of document.querySelectorAll("[data-text]")) one.textContent = texts[one.dataset.text];
  byId("skips").append(...Object.entries(texts.skips).map(([id, words]) => el("a", { href: `#${id}`, "data-to": id }, words)));
  showState();
  showCommands();
  on("event", (detail) => {
    if (detail.severity !== "info" && !IN_BANNER.includes(detail.code) && detail.text !== now.state?.reason) tell(`${plainly(detail.text)} ${adviceHere(detail.advice)}`.trim(), true);
  });
  on("state", forgetEarlier);
  on("asked", untell); // at once: what is said before the answer stays
  try {
    await learn();
  } catch (refusal) {
    if (refusal.code === "NO_TOKEN") {
      await askToken();
      location.reload();
      return;
    }
    setTimeout(() => learn().catch(() => {}), 3000);
  }
  listen();
  for (const show of [showPicture, showApprove, showJog, showPicks, showToday, showHealth]) show();
}

begin();
