// What is drawn over the picture: what was not seen, the things and their numbers, grasps, and what is chosen.

import { svg } from "./dom.js";

const ORDER = ["thing", "other_grasp", "rod", "object", "grasp"];

/** The SVG elements. `unit`: how many pixels of the picture a line of 1 is wide. */
export function overlayOf(outlines, numbers, target, unit) {
  const lines = outlines.filter((one) => ORDER.includes(one.kind)).toSorted((a, b) => ORDER.indexOf(a.kind) - ORDER.indexOf(b.kind));
  return [
    ...shaded(outlines.filter((one) => one.kind === "unseen"), unit),
    ...lines.map((one) => svg("polygon", { points: one.points_px.join(" "), class: `line ${one.kind}`, stroke: one.color, "stroke-width": (one.kind === "grasp" ? 3 : 1.6) * unit })),
    ...numbers.map((one) => svg("text", { x: one.at_px[0], y: one.at_px[1], "font-size": 15 * unit, class: "number" }, one.text)),
    ...mark(target, unit),
  ];
}

/** Whether a pixel (u, v) lies inside a polygon: a ray from it crosses the rim an odd number of times. */
export function isInside([u, v], points) {
  const crossed = points.filter(([a, b], index) => {
    const [c, d] = points.at(index - 1);
    return b > v !== d > v && u < a + ((v - b) * (c - a)) / (d - b);
  });
  return crossed.length % 2 === 1;
}

/** Outer rims and those of holes as one path: even-odd filling leaves the holes free. */
function shaded(rims, unit) {
  if (rims.length === 0) return [];
  const stripe = svg("pattern", { id: "stripes", width: 6 * unit, height: 6 * unit, patternUnits: "userSpaceOnUse", patternTransform: "rotate(45)" },
    svg("rect", { width: 6 * unit, height: 6 * unit, class: "stripe-dark" }), svg("rect", { width: 2 * unit, height: 6 * unit, class: "stripe-light" }));
  const path = rims.map((one) => `M${one.points_px.join("L")}Z`).join("");
  return [svg("defs", {}, stripe), svg("path", { d: path, class: "unseen-area", fill: "url(#stripes)", "fill-rule": "evenodd" })];
}

function mark(target, unit) {
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
