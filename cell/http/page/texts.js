// Every word of the page that a person reads. To translate it, translate this file.

export const LANGUAGE = "en";

// What the cell says in its own terms, and what a person at the page reads instead.
const PLAIN = [
  [/^(.+ )?Something may be in the hand: .+ To take .+/, (_, why) => why ?? "Something may be in the hand."],
  [/^(?:TARGET_NOT_FOUND: )?There is no object within [\d.]+ (?:px|mm) of \(/, "Nothing lies where you clicked."],
  [/^(?:TARGET_NOT_FOUND: )?No object lies mostly in the box/, "Nothing lies mostly in the box you drew."],
  [/^The lease of '(http-page)?([^']*)' was lost.*?motion\.(.*)/, (_, page, client, more) =>
    `The ${page ? "page that started this pick was closed or reloaded" : `program that started this pick (${client}) was ended`}, or lost its link.${more}`],
  [/^Stopped during '(\w+)'/, (_, part) => `It was stopped ${DURING[part] ?? "on its way"}.`],
  [/^Stopped before '(?!v)/, "It was stopped before it grasped."],
  [/^The cell moves for '([^']*)'/, (_, client) => `The cell is moved ${texts.by(client)}.`],
  [/^http-page\S+ rejected it(.*)/, (_, why) => `Somebody at a page rejected it${why}`],
  [/^command '\w+' from (.+)/, (_, client) => `Asked for ${texts.by(client)}.`],
];
/** Whether the cell says in its reason that something may be in the hand. */
export const isInHand = (state) => /Something may be in the hand/.test(state?.reason);
const DURING = {
  detect: "while it looked", open: "while the hand opened", reach: "on its way to the thing", grasp: "while the hand closed", carry: "while it carried the thing",
  hold: "while it checked what it held", place: "on its way to lay the thing down", release: "while the hand opened", home: "on its way back",
};

/** A reason of the cell in plain words, where there are some. */
export function plainly(reason) {
  for (const [own, words] of PLAIN) {
    const found = own.exec(reason);
    if (found) return typeof words === "string" ? words : words(...found);
  }
  return reason;
}

/** What the cell advises, for a person at the page: its buttons in place of commands, no files of the documentation. */
export function adviceHere(advice) {
  return (advice ?? "").replace(/`cell\s(?!start)(\w+)`/g, (own, verb) => texts.verbs[verb] ?? own).replace(/[:;,]? *(?:see )?docs\/[\w/-]+\.md/g, "");
}

/** What the cell refuses with, for a person at the page: a job's fields are none of their words. */
export function refusalHere({ code, reason, advice }) {
  if (code !== "BAD_JOB") return `${plainly(reason ?? "")} ${adviceHere(advice)}`.trim();
  const what = reason.replace(/^[\w.]+: /, "");
  return `${what.slice(0, 1).toUpperCase()}${what.slice(1)}${reason.startsWith("target.") ? ` ${texts.chooseAgain}` : ""}`;
}

const metres = (point) => `${point.map((one) => one.toFixed(2)).join(", ")} m`;

export const texts = {
  sees: "What it sees",
  commands: "Run it",
  picks: "Last picks",
  today: "Today",
  health: "Health",

  stop: "Stop",
  stopKey: "Esc",
  stopTitle: "Stop the arm now, in a controlled way (key Escape). Not an emergency stop: that is the red button on the cell.",

  connecting: "Connecting",
  noLink: ["No link to the cell", "The network is gone, or the cell itself. A cell that runs holds what this page had in motion.",
    "It connects again by itself. Go to the cell if it must stop at once."],
  ended: ["The cell has ended", "Its program, or its interface, runs no more. What this page had in motion does not go on.",
    "See whether something is in the hand. When the cell is started again, this page connects by itself."],
  noCell: "The cell does not answer.",

  // What each state means, and what to do.
  meaning: {
    Stopped: "Nothing moves.",
    Resetting: "The arm goes to its looking place.",
    Idle: "Ready.",
    Starting: "It begins.",
    Execute: "It picks by itself: keep away from the arm.",
    Holding: "The arm brakes where it is.",
    Held: "The arm waits where it is.",
    Unholding: "It goes on.",
    Suspending: "The arm brakes where it is.",
    Suspended: "The arm waits for something outside of the cell.",
    Unsuspending: "It goes on.",
    Completing: "It finishes.",
    Complete: "Done.",
    empty: "Done: nothing is left.",
    Stopping: "The arm brakes.",
    Aborting: "Something failed: the arm brakes.",
    Aborted: "Something failed.",
    Clearing: "It recovers.",
    approve: "Nothing moves until you answer.",
    manual: "It moves only while a button is held.",
  },
  todo: {
    approve: "Look at the planned motion, then Approve it, or ask for another grasp.",
    manual: "When it is where you want it, go back to picking.",
    Stopped: "See that nobody is near the arm, then press Reset.",
    Idle: "Press Start, or choose what it shall pick in the picture.",
    Held: "See that nobody is near the arm. Then Unhold to go on, or Stop to end.",
    Suspended: "Unsuspend to go on, or Stop to end.",
    Complete: "Choose in the picture what it shall pick next. For several picks: Reset, then Start.",
    empty: "Put in what it shall pick next. Then Reset, and Start.",
    Aborted: "Look at the cell. Then Clear, then Reset.",
  },
  stages: {
    capture: "looks", detect: "finds out what it sees", plan: "plans", execute: "grasps", verify: "checks what it holds",
    deliver: "lays it down", approve: "asks before it moves",
  },
  lastFailed: (reason) => `Done: the last pick FAILED${reason ? ` - ${reason}` : "."}`,
  byHand: "moved by hand",
  by: (client) => (client.startsWith("http-page") ? "by another page" : `by ${client}`),
  byThis: "by this page",
  askedFor: (meaning, by) => `${meaning.replace(/\.$/, "")} (asked for ${by}).`,

  facts: { cell: "cell", mode: "mode", since: "for", cycle: "cycle", role: "you" },
  modes: { Production: "Production", Manual: "Manual: moved by hand" },
  simulated: "simulated",
  viewer: "viewer: look and stop only",
  jobNow: "Now",
  jobWhat: (target, thing) => {
    if (thing !== undefined) return `what you pointed at${thing && ` (Thing ${thing})`}`;
    if (target?.text) return `“${target.text}”`;
    if (target?.pixel) return "what was pointed at";
    if (target?.box) return "what is in the box";
    return target?.point_m ? `the object at ${metres(target.point_m)}` : "the best to grasp";
  },
  jobWhere: (place) => (place ? texts.layAt(place.name ?? metres(place.position_m)) : texts.layTray),
  jobTimes: (job) => (job.until_empty ? ", until nothing is left" : job.cycles > 1 ? `, ${job.cycles} times` : ""),
  jobIs: (what, where, times) => `Picks ${what}, lays it ${where}${times}`,
  jobNamed: (job) => ` (${job})`,
  cancel: "Cancel",
  cancelJob: (job) => `Cancel the job ${job}`,

  verbs: {
    start: "Start", empty: "Until empty", reset: "Reset", clear: "Clear", hold: "Hold", unhold: "Unhold",
    suspend: "Suspend", unsuspend: "Unsuspend", abort: "Abort", stop: "Stop",
  },
  means: {
    start: "Picks as many times as the box says.",
    empty: "Picks until nothing is left.",
    reset: "Makes it ready; the arm moves to its looking place.",
    letFall: "Lets fall what is in the hand; then the arm moves.",
    clear: "Acknowledges the failure; nothing moves.",
    hold: "Pauses where it is.",
    unhold: "Goes on from the pause.",
    unsuspend: "Goes on.",
    abort: "Ends everything as a failure.",
  },
  howMany: "How many picks",
  why: {
    manual: "First back to picking: below, Move by hand.",
    viewer: "Only an operator may.",
    neverEmpty: "This simulated cell brings a new object with every pick: it is never empty.",
    noLink: "There is no link to the cell.",
    start: { Stopped: "Reset first.", Aborted: "Clear, then Reset first.", Held: "Unhold, or Stop first.",
      Complete: "Reset first.", Suspended: "Unsuspend, or Stop first.", other: "It is busy." },
    reset: { Idle: "It is ready already.", Aborted: "Clear first.", Held: "Stop first.", Suspended: "Stop first.",
      other: "It is busy: Stop first." },
    clear: { other: "Nothing has failed." },
    hold: { Held: "It is held already.", other: "No pick is running." },
    unhold: { other: "Nothing is held." },
    unsuspend: { other: "Nothing is suspended." },
    abort: { other: "It is aborted already." },
    cancel: "Its grasp has begun: wait for its end, or Stop it.",
    pick: { Stopped: "To pick, Reset first.", Aborted: "To pick: Clear, then Reset.", Held: "To pick: Unhold, or Stop first.",
      other: "Wait until it is ready to pick." },
  },

  approve: "It asks before it moves",
  asks: (number, object, seconds) => {
    const looks = object.replace(/ at \([^)]*\)$/, "");
    return `It would take ${number ? `Thing ${number}${looks && ` (${looks})`}` : object || "this"}, in ${seconds} s of motion.`;
  },
  answerWithin: (left) => `An answer is needed within ${left}.`,
  answers: { approve: "Approve", next_grasp: "Another grasp", reject: "Reject" },
  answersMean: { approve: "The arm moves as shown.", next_grasp: "The next best grasp, perhaps of another thing.", reject: "This pick ends as a failure." },
  answerReason: "Why (for another grasp, or a rejection)",
  plan: { play: "Play", pause: "Pause", time: "Time of the motion", view: "The planned motion in 3-D" },

  jog: "Move by hand",
  toManual: "Move it by hand",
  toProduction: "Back to picking",
  manualMeans: "Only while a button is held, slowly. See that nobody, and nothing, is in the way: it knows only the fixed boxes.",
  holdButton: "Moves while it is held.",
  notNow: "Not in this state.",
  inHand: "Reset lets fall what is in the hand. To take it out first: “Move it by hand”, then open the hand over a place, or while you hold it.",
  clearToMove: "First Clear, then it can be moved.",
  steps: { x: { 1: "away from its base", "-1": "towards its base" }, y: { 1: "left", "-1": "right" }, z: { 1: "up", "-1": "down" } },
  home: "home",
  handOpen: "Open the hand",
  handClose: "Close the hand",

  takeOver: "Take over?",
  takeOverText: "Somebody else runs the cell:",
  takeOverYes: "Stop it, and take over",
  takeOverNo: "Leave it",
  takenOver: "The cell is yours, and ready.",

  noPicture: "No picture yet: the camera has shown nothing.",
  pictureAlt: "The picture of the camera, with what the cell found in it",
  live: "Live",
  pictureNow: "The picture is of now.",
  pictureAge: (age) => `Taken ${age} ago.`,
  legend: { grasp: "chosen grasp", object: "chosen object", rod: "imagined rod", other_grasp: "other grasps", unseen: "not seen" },
  thing: (number) => `Thing ${number}`,
  things: "Pick a thing by its number",
  pictureHeld: "The arm waits on its way: look whether all is well. Nothing can be chosen in this picture.",
  pictureElsewhere: "The arm is not where it looks from: Reset takes it there. Then choose an object.",
  pictureHelp: "Click an object to pick it, or drag a box around it. By keyboard: in the picture the arrow keys move a cross, with Shift by small steps.",
  pointHere: "The picture: the arrow keys move a cross in it",
  numberless: "Things get their numbers when the cell looks for them: with the next pick.",
  words: "or in words:",
  chooseWords: "Choose",
  chooseAgain: "Say it in other words, or click it in the picture.",
  wordsHint: "the largest red one",
  target: (target, thing) => (target.text ? `“${target.text}”` : target.box ? "What is in the box" : `The object at the cross${thing ? `: thing ${thing}` : ""}`),
  layWhere: "Where to lay it",
  layTray: "into the tray",
  layAt: (name) => `at ${name}`,
  pickIt: "Pick it",
  forget: "Not this",
  queued: (position) => `It waits its turn: number ${position}.`,

  noPicks: "No pick is recorded yet.",
  noFailures: "No failed pick is recorded.",
  failedOnly: "Failed only",
  cardKeys: "The last picks; the arrow keys move among their buttons",
  skips: { approve: "To its question", sees: "To the picture", commands: "To the buttons", picks: "To the last picks" },
  results: { SUCCESS: "picked", FAILED: "failed", ABORTED: "aborted", EMPTY: "nothing left", TORN: "not finished",
    DAMAGED: "damaged", UNFINISHED: "not finished" },
  report: "Report",
  noReport: "no report page",
  good: "Good",
  bad: "Bad",
  note: "Note",
  saidBy: (label, who, when) => `${label} by ${who}, ${when}`,
  verdictOf: (cycle) => `Verdict on ${cycle}`,
  yourName: "Your name",
  yourNote: "Note",
  save: "Save",
  close: "Close",
  dismiss: "Dismiss this message",
  kept: "Kept.",

  figures: {
    picks_per_hour: "picks an hour of the robot's time", success: "success", picks: "picks", interventions: "interventions an hour of the robot's time",
    between_stops: "picks between stops", missed: "missed", infeasible: "infeasible", multi_pick: "two at once", dropped: "dropped",
  },
  counts: { success: "picked", interventions: "interventions" }, // where there are too few picks for rates
  of: (count, whole) => `${count} of ${whole}`,
  explained: "Infeasible: no grasp fits, or none can be reached. Two at once: more than one thing was in the hand.",
  explains: {
    picks_per_hour: "Picks that succeeded. The robot's time is that of its cycles: what lies between them is left out.",
    interventions: "Stops, aborts and holds by a person or a program, while a pick ran.",
    between_stops: "Picks for each that was stopped or aborted.",
    infeasible: "Picks for which no grasp fits, or none can be reached.",
    multi_pick: "Closings of the hand that held more than one thing.",
  },
  lost: "Time lost, by reason",
  nothingLost: "No time lost.",
  perDay: "Picks of each day",
  noFigures: "No pick was made today.",
  seconds: (value) => `${value} s`,

  nodeGone: (name) => `${name} is gone.`,
  nodeWell: "well",
  restarts: (count) => `restarted ${count}×`,
  doors: { http: "HTTP", opcua: "OPC UA" },
  doorOpen: "open",
  doorOpens: "opens",
  nodeAdvice: "Look at its cable and its power; `cell doctor` says more.",
  defectAdvice: "A defect of the cell's program: report it, then end the cell and start it again.",
  disk: (free, kept) => `Disk: ${free} GB free, recordings ${kept} GB`,
  diskAdvice: "Make room, or let old recordings go: recording.keep_gb.",
  keepsAll: "Nothing is deleted by itself.",
  willGo: (count, size) => `Within a day ${count} recordings (${size} GB) will be deleted. Pin what must stay.`,
  willTrim: (count) => `${count} old recordings will lose their pictures.`,
  short: (rule) => `No more recordings may go, and ${rule} is not met.`,
  nothingGoes: "Nothing will be deleted within a day.",
  spent: (usd) => `Models: ${usd} US$ today`,
  clock: (time) => `The cell's clock: ${time}`,
  clockOff: (time) => `This device's clock is ${time} off; set it.`,
  events: "What it said last",

  login: "This cell asks for a token",
  token: "Token",
  enter: "Enter",
  badToken: "Nobody has this token.",
};

/** A duration for a person: 7 s, 3 min, 26 h. */
export function duration(seconds) {
  const s = Math.max(0, seconds);
  if (s < 120) return `${Math.round(s)} s`;
  return s < 7200 ? `${Math.round(s / 60)} min` : `${Math.round(s / 3600)} h`;
}

/** A share from 0 to 1 in percent; a dash for none. */
export function percent(share) {
  return Number.isFinite(share) ? `${(100 * share).toFixed(1)} %` : "–";
}
