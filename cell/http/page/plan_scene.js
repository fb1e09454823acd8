// What is drawn of a plan in 3-D, and how: parts, boxes and points sorted by their distance from the eye.

const TYPES = { "<f4": Float32Array, "<f8": Float64Array, "<u2": Uint16Array };
const COLORS = { robot: [214, 220, 228], hand: [242, 170, 60], box: [150, 160, 175], path: "#2f7de1", grasp: "#1fb455" };
const HAND = new Set(["hand", "left finger", "right finger"]);
const LIGHT = [0.36, -0.48, 0.8];
const EYE_M = 2.4;

/** The numbers of a message's array, flat: it travels as nested lists, or as base64 of its bytes. */
export function numbers(value) {
  if (Array.isArray(value)) return Float64Array.from(value.flat(Infinity));
  const bytes = Uint8Array.from(atob(value.base64), (letter) => letter.charCodeAt(0));
  return new TYPES[value.dtype](bytes.buffer);
}

/** What is drawn of a plan: typed arrays, and when each segment is played. */
export function read(plan) {
  const parts = plan.parts.map((part) => ({ ...part, points: numbers(part.vertices_m), faces: numbers(part.faces) }));
  let begin_s = 0;
  const segments = plan.segments.filter((one) => !one.only_to_look).map((one) => {
    const times = numbers(one.times_s), poses = numbers(one.base_from_frame), path = numbers(one.tcp_m);
    const segment = { name: one.name, begin_s, times, poses, path, of_s: times[times.length - 1] };
    begin_s += segment.of_s;
    return segment;
  });
  const boxes = plan.boxes.map((box) => ({ name: box.name, ...corners(numbers(box.center_m), numbers(box.size_m)) }));
  const grasp = numbers(plan.proposal.base_from_tcp);
  const center_m = [0.6 * grasp[3], 0.6 * grasp[7], 0.3];
  const cloud = { points: numbers(plan.cloud_m), colors: numbers(plan.cloud_rgb) };
  const frames = plan.frames.length, opening_m = plan.proposal.opening_m;
  return { parts, segments, boxes, grasp, center_m, cloud, frames, opening_m, lasts_s: begin_s };
}

function corners(center, size) {
  const points = [];
  for (let i = 0; i < 8; i++)
    for (let axis = 0; axis < 3; axis++) points.push(center[axis] + ((i >> axis) & 1 ? 0.5 : -0.5) * size[axis]);
  return { points, quads: [[4, 5, 7, 6], [0, 2, 3, 1], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]] };
}

/** The segment that is played at a time, and its sample. */
export function when(scene, at_s) {
  const segment = scene.segments.findLast((one) => one.begin_s <= at_s) || scene.segments[0];
  const in_s = Math.min(at_s - segment.begin_s, segment.of_s);
  const next = segment.times.findIndex((time_s) => time_s >= in_s);
  return { name: segment.name, of_s: segment.of_s, in_s, segment, sample: next < 0 ? segment.times.length - 1 : next };
}

/** Maps a point to its pixel and its distance from the eye. */
export function lens(camera, center, width, height) {
  const [ct, st, cl, sl] = [Math.cos(camera.turn), Math.sin(camera.turn), Math.cos(camera.lift), Math.sin(camera.lift)];
  const focal = 1.5 * Math.min(width, height * 1.2) * camera.zoom;
  return (x, y, z) => {
    const [dx, dy, dz] = [x - center[0], y - center[1], z - center[2]];
    const [right, ahead] = [-st * dx + ct * dy, -ct * dx - st * dy];
    const depth = Math.max(0.05, EYE_M + cl * ahead - sl * dz), up = cl * dz + sl * ahead;
    return [width / 2 + (focal * right) / depth, height / 2 - (focal * up) / depth, depth];
  };
}

export function paint(context, scene, now, see, sharp) {
  const [table, ...others] = scene.boxes;
  if (table) fill(context, table.quads[0].map((i) => see(...table.points.slice(3 * i, 3 * i + 3))), "rgba(140,150,165,.18)");
  const items = [];
  for (const box of others) {
    const seen = [...Array(8).keys()].map((i) => [...box.points.slice(3 * i, 3 * i + 3)]);
    for (const quad of box.quads) face(items, quad.map((i) => seen[i]), see, COLORS.box, 0.85);
  }
  for (const part of scene.parts) {
    const pose = now.segment.poses.subarray(12 * (now.sample * scene.frames + part.frame)), placed = [];
    for (let i = 0; i < part.points.length; i += 3) placed.push(moved(pose, part.points.subarray(i, i + 3)));
    const color = HAND.has(part.name) ? COLORS.hand : COLORS.robot;
    for (let i = 0; i < part.faces.length; i += 3)
      face(items, [0, 1, 2].map((corner) => placed[part.faces[i + corner]]), see, color, 1);
  }
  const { points, colors } = scene.cloud, size = 2.2 * sharp;
  for (let i = 0; i < points.length; i += 3) {
    const [x, y, depth] = see(points[i], points[i + 1], points[i + 2]);
    items.push({ depth, draw: () => {
      context.fillStyle = `rgb(${colors[i]},${colors[i + 1]},${colors[i + 2]})`;
      context.fillRect(x - size / 2, y - size / 2, size, size);
    } });
  }
  items.sort((one, other) => other.depth - one.depth);
  for (const item of items) item.draw ? item.draw() : fill(context, item.outline, item.style);
  for (const { path, name } of scene.segments) line(context, path, see, COLORS.path, (name === "reach" ? 2.5 : 1.2) * sharp);
  line(context, gripper(scene.grasp, scene.opening_m), see, COLORS.grasp, 3 * sharp);
}

function moved(pose, [x, y, z]) {
  return [0, 4, 8].map((row) => pose[row] * x + pose[row + 1] * y + pose[row + 2] * z + pose[row + 3]);
}

/** Add a face that looks to the eye, shaded by its direction; its corners are counter-clockwise from outside. */
function face(items, points, see, color, alpha) {
  const outline = points.map((point) => see(...point));
  const [a, b, c] = outline;
  if ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) >= 0) return;
  const [u, v] = [1, 2].map((i) => points[i].map((value, axis) => value - points[0][axis]));
  const normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
  const facing = normal.reduce((sum, value, axis) => sum + value * LIGHT[axis], 0) / (Math.hypot(...normal) || 1);
  const style = `rgba(${color.map((value) => Math.round(value * (0.68 + 0.32 * facing)))},${alpha})`;
  items.push({ outline, style, depth: outline.reduce((sum, point) => sum + point[2], 0) / outline.length });
}

function fill(context, outline, style) {
  context.beginPath();
  outline.forEach(([x, y]) => context.lineTo(x, y));
  context.closePath();
  Object.assign(context, { fillStyle: style, strokeStyle: style, lineWidth: 1 }); // the outline closes the seams
  context.fill();
  context.stroke();
}

function line(context, points, see, style, width) {
  context.beginPath();
  for (let i = 0; i < points.length; i += 3) context.lineTo(...see(points[i], points[i + 1], points[i + 2]));
  Object.assign(context, { strokeStyle: style, lineWidth: width });
  context.stroke();
}

/** The fingers at the grasp, as one line: they close along y, and come along z. */
function gripper(pose, opening_m) {
  const half = opening_m / 2;
  return [[0, -half, 0.005], [0, -half, -0.045], [0, 0, -0.045], [0, 0, -0.1], [0, 0, -0.045], [0, half, -0.045],
    [0, half, 0.005]].flatMap((point) => moved(pose, point));
}
