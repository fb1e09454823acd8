// How the day went: the figures of `cell cycles --summary`, and two small charts.

import { bodyOf, el } from "./dom.js";
import { ask, cell } from "./link.js";
import { percent, texts } from "./texts.js";

const DAYS = 7;
const FEW = 20; // below so many picks a rate would say more than is known

/** Horizontal bars; rows are [name, value, what is written]. */
function bars(rows, label, kind) {
  const most = Math.max(...rows.map(([, value]) => value), 1e-9);
  return el("div", { class: "chart", role: "img", "aria-label": `${label}: ${rows.map(([name, , said]) => `${name} ${said}`).join(", ")}` },
    ...rows.flatMap(([name, value, said]) => {
      const bar = el("span", { class: `bar ${kind}` });
      bar.style.width = `${(100 * value) / most}%`;
      return [el("span", {}, name), el("span", { class: "track" }, bar), el("span", {}, said)];
    }));
}

/** Stops, aborts and holds, and the same an hour of cycles. */
function interventions(day) {
  const count = Object.values(day.interventions).reduce((sum, one) => sum + one, 0);
  return { count, anHour: day.busy_s > 0 ? Math.round((36000 * count) / day.busy_s) / 10 : null };
}

/** What is written below a figure. */
function nameOf(name, day, value) {
  return day.picks < FEW && name in texts.counts ? texts.counts[name](value, texts.inPicks(day.picks)) : texts.figures[name];
}

function figures(day) {
  const { count, anHour } = interventions(day);
  const isFew = day.picks < FEW;
  const shown = {
    picks_per_hour: isFew ? Math.round((day.success ?? 0) * day.picks) : day.picks_per_hour ?? "–", success: percent(day.success), picks: day.picks,
    interventions: isFew ? count : anHour ?? "–", between_stops: day.picks_between_stops ?? "–", missed: percent(day.missed), infeasible: percent(day.infeasible),
    multi_pick: percent(day.multi_pick), dropped: percent(day.dropped),
  };
  return el("dl", { class: "figures", id: "figures" },
    ...Object.entries(shown).map(([name, value]) => el("div", { "data-figure": name }, el("dt", { title: texts.explains[name] ?? day.definitions[name] }, nameOf(name, day, value)), el("dd", {}, value))));
}

async function refresh() {
  let day;
  let all;
  try {
    day = await ask("/api/summary?day=today");
    all = await ask("/api/summary");
  } catch {
    return;
  }
  const lost = Object.entries(day.lost_s).map(([code, value]) => [code || "–", value, texts.seconds(value)]);
  const days = Object.entries(all.days).slice(0, DAYS).map(([date, one]) => [date, one.picks, `${one.picks}`]);
  bodyOf("today").replaceChildren(
    ...(day.cycles ? [figures(day), el("p", { class: "soft" }, texts.explained)] : [el("p", { class: "empty" }, texts.noFigures)]),
    el("h3", {}, texts.lost), lost.length ? bars(lost, texts.lost, "bad") : el("p", { class: "soft" }, texts.nothingLost),
    ...(days.length ? [el("h3", {}, texts.perDay), bars(days, texts.perDay, "")] : []),
  );
}

export function showToday() {
  cell.addEventListener("recorded", refresh); // the first list is one, too
}
