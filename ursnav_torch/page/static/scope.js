// The scope's picture and, over it, what was found in it: edges, stones, names of calyces, the way on.
import { words } from "./words.js";

const EDGE = "#3ce63c", BODY = { stone: "#ffb52e", instrument: "#d39cff" }, NAME = "#ffffff", WAY = "#7db7ff", SHADE = "#000c";
// The drawing over the picture is no higher: without a graphics card the time goes with its pixels.
const HIGHEST_PX = 800;
// Both are drawn by the processor: what changes with every picture costs a graphics card in software most.
const pen2d = (canvas) => canvas.getContext("2d", { willReadFrequently: true });

export function scopeView(picture, overlay) {
  const shown = { edges: true, stones: true, names: true };
  let last = null;
  const draw = () => {
    if (!last) return;
    const { width, height } = last, k = Math.max(1, Math.min(overlay.clientHeight, HIGHEST_PX) / height);
    resize(picture, width, height); resize(overlay, Math.round(k * width), Math.round(k * height));
    pen2d(picture).drawImage(last.bitmap, 0, 0);
    picture.dataset.shown = 1 + Number(picture.dataset.shown ?? 0); picture.dataset.state = last.state?.version ?? -1;
    const pen = pen2d(overlay);
    pen.setTransform(1, 0, 0, 1, 0, 0); pen.clearRect(0, 0, overlay.width, overlay.height);
    pen.setTransform(k, 0, 0, k, k / 2 - 0.5, k / 2 - 0.5);  // pixel centers lie at whole numbers
    const unit = height / 250;
    if (shown.edges) strokes(pen, last.edges, unit);
    if (shown.stones) outlines(pen, last.bodies ?? [], unit);
    if (shown.names) { arrow(pen, last.way, width, height, unit); labels(pen, last.names ?? [], width, height, unit); }
    overlay.dataset.drawn = JSON.stringify({ edges: shown.edges ? last.edges.length : null, stones: shown.stones ? (last.bodies ?? []).length : null, names: shown.names ? (last.names ?? []).length : null });
  };
  return {
    show(m) { last?.bitmap.close(); last = m; draw(); },
    toggle(what) { shown[what] = !shown[what]; draw(); return shown[what]; },
  };
}

function resize(canvas, width, height) { if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; } }

function strokes(pen, edges, unit) {
  pen.strokeStyle = EDGE; pen.lineWidth = unit; pen.beginPath();
  for (const [ax, ay, bx, by] of edges) { pen.moveTo(ax, ay); pen.lineTo(bx, by); }
  pen.stroke();
}

function outlines(pen, bodies, unit) {
  for (const [kind, points] of bodies) {
    pen.strokeStyle = BODY[kind] ?? NAME; pen.lineWidth = 2 * unit; pen.beginPath();
    points.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    pen.closePath(); pen.stroke();
    const top = points.reduce((a, b) => (b[1] < a[1] ? b : a));
    text(pen, words.bodies[kind] ?? kind, top[0], top[1] - 6 * unit, 10 * unit, pen.strokeStyle);
  }
}

// Names at the tips of their calyces; one that would cover another goes below it.
function labels(pen, names, width, height, unit) {
  const taken = [];
  for (const [name, x, y] of names) {
    const size = 15 * unit;
    let at = Math.max(size, Math.min(y, height - size));
    for (const t of taken) if (Math.abs(t.x - x) < 3 * size && Math.abs(t.y - at) < size) at = t.y + size;
    taken.push({ x, y: at });
    text(pen, name, Math.max(size, Math.min(x, width - size)), at, size, NAME);
  }
}

// Where to bend: an arrow on the way from the middle to the rim; a ring in the middle is "straight on".
function arrow(pen, way, width, height, unit) {
  if (!way) return;
  const length = Math.hypot(...way), cx = (width - 1) / 2, cy = (height - 1) / 2, reach = 0.36 * Math.min(width, height);
  for (const [color, wide] of [[SHADE, 7], [WAY, 3.5]]) {
    pen.strokeStyle = color; pen.lineWidth = wide * unit; pen.lineCap = pen.lineJoin = "round"; pen.beginPath();
    if (length < 0.22) pen.arc(cx, cy, 9 * unit, 0, 7);
    else {
      const [dx, dy] = way.map((v) => v / length), at = [cx + reach * dx, cy + reach * dy], h = 13 * unit;
      pen.moveTo(at[0] - h * (dx - dy), at[1] - h * (dy + dx)); pen.lineTo(...at); pen.lineTo(at[0] - h * (dx + dy), at[1] - h * (dy - dx));
      pen.moveTo(...at); pen.lineTo(at[0] - 2 * h * dx, at[1] - 2 * h * dy);
    }
    pen.stroke();
  }
}

function text(pen, words_, x, y, size, color) {
  pen.font = `600 ${size}px system-ui, sans-serif`; pen.textAlign = "center"; pen.textBaseline = "middle";
  pen.lineWidth = size / 4; pen.lineJoin = "round"; pen.strokeStyle = SHADE; pen.strokeText(words_, x, y);
  pen.fillStyle = color; pen.fillText(words_, x, y); pen.strokeStyle = color;
}
