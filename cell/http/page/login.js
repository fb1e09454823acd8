// Asks for a token where the cell wants one; the browser keeps it in a cookie that no script reads.

import { closeDialog, el, openDialog } from "./dom.js";
import { ask } from "./link.js";
import { texts } from "./texts.js";

/** Resolves when somebody has entered a token that counts. */
export function askToken() {
  return new Promise((resolve) => {
    const token = el("input", { type: "password", id: "token", autocomplete: "current-password", required: true });
    const wrong = el("p", { class: "bad", role: "alert" });
    const enter = async (event) => {
      event.preventDefault();
      try {
        await ask("/api/login", { token: token.value });
        closeDialog();
        resolve();
      } catch {
        wrong.textContent = texts.badToken;
      }
    };
    openDialog(
      el("form", { onsubmit: enter }, el("h2", { id: "asking-title" }, texts.login),
        el("label", { for: "token" }, texts.token), token, wrong, el("button", { type: "submit" }, texts.enter)),
    );
  });
}
