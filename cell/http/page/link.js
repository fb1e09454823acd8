// The link to the cell: what it says, as events, and what it is asked. The stream is the session of whoever attends
// the motion: when this page is gone, or answers no ping, the cell holds.

import { texts } from "./texts.js";

export const cell = new EventTarget();
// `result`: of the last cycle, none while one runs. `pointed`: by job, the number of the thing that was pointed at here.
export const now = { state: null, health: null, result: null, role: "operator", client_id: "", jobs: {}, pointed: {}, isLinked: false, isEnded: false, offset_ns: 0, about: null };

const RETRY_MS = 2000;
const NAMES = ["state", "health", "event", "result", "picture", "scene", "proposal", "jobs"];
let session = ""; // null: the link was lost
let stream = null;

/** Who this page says it is. */
function clientName() {
  const person = (localStorage.getItem("name") ?? "").normalize("NFKD").replace(/[^A-Za-z0-9._-]/g, "");
  return `page${person ? `-${person}` : ""}`.slice(0, 40);
}

export function announce(name, detail) {
  cell.dispatchEvent(new CustomEvent(name, { detail }));
}

/** Has every event of these names heard: what it is about is given. */
export function on(names, heard) {
  for (const name of names.split(" ")) cell.addEventListener(name, ({ detail }) => heard(detail));
}

function setLinked(isLinked) {
  if (now.isLinked === isLinked) return;
  now.isLinked = isLinked;
  announce("link", isLinked);
}

/** Opens the stream, and keeps it open. */
export function listen() {
  stream?.close();
  stream = new EventSource(`/api/events?client=${clientName()}`);
  stream.addEventListener("session", (said) => {
    if (session === null) learn().catch(() => {}); // it may have other places now
    ({ session, client_id: now.client_id } = JSON.parse(said.data));
    now.isEnded = false;
    setLinked(true);
  });
  stream.addEventListener("end", () => { now.isEnded = true; });
  stream.addEventListener("ping", () => ask("/api/heartbeat", {}).catch(() => {}));
  for (const name of NAMES) {
    stream.addEventListener(name, (said) => {
      const detail = JSON.parse(said.data);
      if (name in now) now[name] = detail; // state, health, jobs
      if (name === "state" || name === "health") now.isEnded = false;
      if (detail.code === "CELL_GONE") now.isEnded = true;
      announce(name, detail);
    });
  }
  stream.onerror = () => {
    session = null;
    setLinked(false);
    if (stream.readyState === EventSource.CLOSED) setTimeout(listen, RETRY_MS);
  };
}

/** Asks the interface: GET, or with a body POST. Throws what it refuses with: {code, reason, advice}. */
export async function ask(path, body) {
  const init = { cache: "no-store", keepalive: body !== undefined };
  if (body !== undefined) {
    init.method = "POST";
    init.headers = { "Content-Type": "application/json" };
    if (session) init.headers["X-Cell-Session"] = session;
    init.body = JSON.stringify(body);
  }
  let answer;
  try {
    answer = await fetch(path, init);
  } catch {
    throw { code: "NO_LINK", reason: `${texts.noLink[0]}.`, advice: "" };
  }
  const text = await answer.text();
  const said = text ? JSON.parse(text) : null;
  if (!answer.ok) throw said ?? { code: String(answer.status), reason: answer.statusText, advice: "" };
  return said;
}

/** Asks one thing again and again. An answer that one to a later question has overtaken is never given. */
export function asker() {
  let asked = 0;
  let given = 0;
  return (path) => new Promise((resolve, reject) => {
    const question = (asked += 1);
    const unlessOld = (give) => (said) => {
      if (question < given) return;
      given = question;
      give(said);
    };
    ask(path).then(unlessOld(resolve), unlessOld(reject));
  });
}

/** Sends one command, which is announced as "asked"; one that is accepted then as "sent". */
export async function command(verb, request = {}) {
  announce("asked", verb);
  const reply = await ask(`/api/commands/${verb}`, request);
  announce("sent", verb);
  return reply;
}

/** Resolves when the cell is in the state; rejects after so many seconds. */
export function untilState(wanted, withinS = 60) {
  return new Promise((resolve, reject) => {
    const look = () => {
      if (now.state?.state !== wanted) return;
      end();
      resolve();
    };
    const end = () => {
      cell.removeEventListener("state", look);
      clearTimeout(late);
    };
    const late = setTimeout(() => {
      end();
      reject({ code: "LATE", reason: texts.noCell, advice: "" });
    }, 1000 * withinS);
    cell.addEventListener("state", look);
    look();
  });
}

/** The cell's UTC now [ns, as a number], whatever this device's clock says. */
export function cellNow() {
  return Date.now() * 1e6 + now.offset_ns;
}

const askAbout = asker();

/** What the station is, and how far this device's clock is from the cell's. */
export async function learn() {
  const asked_ms = Date.now();
  now.about = await askAbout("/api/cell");
  now.offset_ns = now.about.now_ns - 5e5 * (asked_ms + Date.now()); // it was said halfway
  now.role = now.about.role;
  announce("about", now.about);
}
