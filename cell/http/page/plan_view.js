// A plan of the cell in 3-D (GET /api/plan: bus.md, PlanView), on a canvas: the robot plays the motion among what was
// seen. Drag turns it, the wheel or a pinch zooms, the slider moves the arm. Positions are metres in `base`, z up.

import { lens, paint, read, when } from "./plan_scene.js";

const WORDS = { play: "Play", pause: "Pause", time: "Time of the motion", view: "The planned motion in 3-D" };

/** Show a plan in an element. Returns `{ seek(seconds), play(), pause(), close() }`. */
export function mount(element, plan, words = WORDS) {
  const scene = read(plan);
  const root = document.createElement("div");
  root.className = "plan-view";
  const [canvas, row, button, slider, label] = ["canvas", "div", "button", "input", "output"].map((tag) =>
    document.createElement(tag));
  row.append(button, slider, label);
  root.append(canvas, row);
  canvas.setAttribute("role", "img");
  Object.assign(button, { type: "button" });
  Object.assign(slider, { type: "range", min: 0, step: 0.01, value: 0 });
  root.style.cssText = "display:flex;flex-direction:column;gap:.4rem;width:100%;height:100%;min-height:16rem";
  canvas.style.cssText = "flex:1;min-height:0;width:100%;touch-action:none;cursor:grab";
  row.style.cssText = "display:flex;gap:.6rem;align-items:center";
  button.style.flex = label.style.flex = "none";
  slider.style.cssText = "flex:1;min-width:0";
  label.style.minWidth = "8em";
  canvas.setAttribute("aria-label", words.view);
  slider.setAttribute("aria-label", words.time);
  slider.max = scene.lasts_s;
  element.replaceChildren(root);

  const camera = { turn: -0.9, lift: 0.5, zoom: 1 };
  const touching = new Map();
  let at_s = 0, playing = 0, last_ms = 0, due = 0;

  function draw() {
    due = 0;
    if (!root.isConnected) return;
    const box = canvas.getBoundingClientRect(), sharp = window.devicePixelRatio || 1;
    const [width, height] = [Math.max(1, Math.round(box.width * sharp)), Math.max(1, Math.round(box.height * sharp))];
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const context = canvas.getContext("2d");
    context.clearRect(0, 0, width, height);
    const now = when(scene, at_s);
    paint(context, scene, now, lens(camera, scene.center_m, width, height), sharp);
    label.textContent = `${now.name} ${now.in_s.toFixed(1)} / ${now.of_s.toFixed(1)} s`;
  }
  const redraw = () => { due = due || requestAnimationFrame(draw); };
  const seek = (seconds) => {
    at_s = Math.min(Math.max(seconds, 0), scene.lasts_s);
    slider.value = at_s;
    redraw();
  };
  function step(now_ms) {
    seek(at_s + (now_ms - last_ms) / 1000);
    last_ms = now_ms;
    if (at_s >= scene.lasts_s || !root.isConnected) pause();
    else playing = requestAnimationFrame(step);
  }
  function play() {
    if (playing) return;
    if (at_s >= scene.lasts_s) at_s = 0;
    button.textContent = words.pause;
    last_ms = performance.now();
    playing = requestAnimationFrame(step);
  }
  function pause() {
    cancelAnimationFrame(playing);
    playing = 0;
    button.textContent = words.play;
  }
  button.onclick = () => (playing ? pause() : play());
  slider.oninput = () => { pause(); seek(Number(slider.value)); };
  canvas.onwheel = (event) => { event.preventDefault(); zoom(Math.exp(-event.deltaY / 600)); };
  const zoom = (by) => { camera.zoom = Math.min(Math.max(camera.zoom * by, 0.4), 8); redraw(); };
  canvas.onpointerdown = (event) => { canvas.setPointerCapture(event.pointerId); touching.set(event.pointerId, event); };
  canvas.onpointerup = canvas.onpointercancel = (event) => touching.delete(event.pointerId);
  canvas.onpointermove = (event) => {
    const before = touching.get(event.pointerId);
    if (!before) return;
    touching.set(event.pointerId, event);
    const other = [...touching.values()].find((one) => one.pointerId !== event.pointerId);
    if (other) {
      const apart = (one) => Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY);
      zoom(apart(event) / Math.max(1, apart(before)));
      return;
    }
    camera.turn -= (event.clientX - before.clientX) / 150;
    camera.lift = Math.min(Math.max(camera.lift + (event.clientY - before.clientY) / 150, 0.02), 1.55);
    redraw();
  };
  const sized = new ResizeObserver(redraw);
  sized.observe(canvas);
  pause();
  redraw();
  return { seek, play, pause, close() { pause(); sized.disconnect(); root.remove(); } };
}
