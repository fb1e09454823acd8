// How the day went: the figures of `cell cycles --summary`, and two small charts.

import { bodyOf, el } from "./dom.js";
import { ask, cell } from "./link.js";
import { percent, texts } from "./texts.js";

const DAYS = 7;

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

/** Stops, aborts and holds an hour of cycles. */
function interventionsAnHour(day) {
  const count = Object.values(day.interventions).reduce((sum, one) => sum + one, 0);
  return day.busy_s > 0 ? Math.round((36000 * count) / day.busy_s) / 10 : null;
}

function figures(day) {
  const shown = {
    picks_per_hour: day.picks_per_hour ?? "–", success: percent(day.success), picks: day.picks,
    interventions: interventionsAnHour(day) ?? "–", between_stops: day.picks_between_stops ?? "–", missed: percent(day.missed), infeasible: percent(day.infeasible),
    multi_pick: percent(day.multi_pick), dropped: percent(day.dropped),
  };
  return el("dl", { class: "figures", id: "figures" },
    ...Object.entries(shown).map(([name, value]) => el("div", { "data-figure": name }, el("dt", { title: day.definitions[name] }, texts.figures[name]), el("dd", {}, value))));
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
    day.cycles ? figures(day) : el("p", { class: "empty" }, texts.noFigures),
    el("h3", {}, texts.lost), lost.length ? bars(lost, texts.lost, "bad") : el("p", { class: "soft" }, texts.nothingLost),
    ...(days.length ? [el("h3", {}, texts.perDay), bars(days, texts.perDay, "")] : []),
  );
}

export function showToday() {
  cell.addEventListener("recorded", refresh); // the first list is one, too
}
