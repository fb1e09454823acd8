// Pointing into the picture: a click an object, a drag a box; by keyboard a cross that the arrow keys move.

const DRAG_PX = 8;
const STEP = 0.04; // of the picture's width
const FINE = 0.005; // with Shift
const WAYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1], Enter: [0, 0], " ": [0, 0] };

/**
 * The listeners for the frame around the picture, which takes the keyboard's focus, and for what is drawn over it.
 *
 * `picture`: gives {image, stamp, isOff, pixel}: the image, its stamp, whether nothing can be pointed at in it, and the
 * pixel that is pointed at, if any. `choose`: is given {pixel} or {box}, and picture_ns.
 */
export function pointing(picture, choose) {
  let from = null;

  function pixelAt(event) {
    const frame = event.currentTarget.getBoundingClientRect();
    const { naturalWidth, naturalHeight } = picture().image;
    return [inside((event.clientX - frame.left) / frame.width, naturalWidth), inside((event.clientY - frame.top) / frame.height, naturalHeight)];
  }

  function press(event) {
    const { stamp, isOff } = picture();
    if (event.button !== 0 || isOff) return;
    from = { pixel: pixelAt(event), x: event.clientX, y: event.clientY, picture_ns: stamp };
    event.currentTarget.setPointerCapture(event.pointerId);
  }

  const isDrag = (event) => Math.hypot(event.clientX - from.x, event.clientY - from.y) >= DRAG_PX;

  function drag(event) {
    if (from === null || !isDrag(event)) return;
    const [[a, b], [c, d]] = [from.pixel, pixelAt(event)];
    choose({ box: [Math.min(a, c), Math.min(b, d), Math.max(a, c), Math.max(b, d)], picture_ns: from.picture_ns });
  }

  function release(event) {
    if (from !== null && !isDrag(event)) choose({ pixel: from.pixel, picture_ns: from.picture_ns });
    from = null;
  }

  function key(event) {
    const way = WAYS[event.key];
    if (way === undefined || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault(); // else the page scrolls
    const { image, stamp, isOff, pixel } = picture();
    if (isOff) return;
    const { naturalWidth: width, naturalHeight: height } = image;
    const step = (event.shiftKey ? FINE : STEP) * width;
    const [u, v] = pixel ?? [width / 2, height / 2];
    choose({ pixel: [inside((u + way[0] * step) / width, width), inside((v + way[1] * step) / height, height)], picture_ns: stamp });
  }

  return {
    frame: { onkeydown: key },
    overlay: { onpointerdown: press, onpointermove: drag, onpointerup: release, onpointercancel: () => { from = null; } },
  };
}

/** A share of a side as one of its pixels. */
function inside(share, most) {
  return Math.min(Math.max(0, Math.round(share * most)), most - 1);
}
