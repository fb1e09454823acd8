// How the day went: the figures of `cell cycles --summary`, and two small charts.

import { bodyOf, el } from "./dom.js";
import { asker, on } from "./link.js";
import { percent, texts } from "./texts.js";

const DAYS = 7;
const FEW = 20; // below so many picks a rate would say more than is known
const askDay = asker();
const askAll = asker();

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

/** Some of so many, as a count; a dash of none. */
function among(share, whole) {
  return whole ? texts.of(Math.round((share ?? 0) * whole), whole) : "–";
}

/** Of few picks: counts alone. */
function counted(day) {
  const { picks, executed } = day;
  return {
    success: among(day.success, picks), picks, interventions: interventions(day).count, missed: among(day.missed, executed),
    infeasible: among(day.infeasible, picks), multi_pick: among(day.multi_pick, executed), dropped: among(day.dropped, executed),
  };
}

function rated(day) {
  return {
    picks_per_hour: day.picks_per_hour ?? "–", success: percent(day.success), picks: day.picks, interventions: interventions(day).anHour ?? "–",
    between_stops: day.picks_between_stops ?? "–", missed: percent(day.missed), infeasible: percent(day.infeasible),
    multi_pick: percent(day.multi_pick), dropped: percent(day.dropped),
  };
}

function figures(day) {
  const isFew = day.picks < FEW;
  const names = isFew ? { ...texts.figures, ...texts.counts } : texts.figures;
  return el("dl", { class: "figures", id: "figures" },
    ...Object.entries(isFew ? counted(day) : rated(day)).map(([name, value]) => el("div", { "data-figure": name }, el("dt", { title: texts.explains[name] ?? day.definitions[name] }, names[name]), el("dd", {}, value))));
}

async function refresh() {
  let day;
  let all;
  try {
    day = await askDay("/api/summary?day=today");
    all = await askAll("/api/summary");
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
  on("recorded", refresh); // the first list is one, too
}
