// The connection to the program: JSON texts, and pictures as a line of JSON and a JPEG. It comes back by itself.
import { words } from "./words.js";

export function connect(handlers) {
  let socket = null;
  const open = () => {
    socket = new WebSocket(`ws://${location.host}/live`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => handlers.notice?.({ text: "" });
    socket.onmessage = ({ data }) => {
      if (typeof data === "string") { const m = JSON.parse(data); handlers[m.kind]?.(m); return; }
      const bytes = new Uint8Array(data), end = bytes.indexOf(10);
      const m = JSON.parse(new TextDecoder().decode(bytes.subarray(0, end)));
      createImageBitmap(new Blob([bytes.subarray(end + 1)], { type: "image/jpeg" })).then((bitmap) => handlers[m.kind]?.({ ...m, bitmap }));
    };
    socket.onclose = () => { handlers.notice?.({ text: words.lost }); setTimeout(open, 1000); };
  };
  open();
  return (name, value) => { if (socket.readyState === 1) socket.send(JSON.stringify({ do: name, value })); };
}

export const $ = (id) => document.getElementById(id);
export const put = (element, text) => { if (element.textContent !== text) element.textContent = text; };

// While a button or a key is held, do something ten times a second.
export function hold(button, action) {
  let timer = 0;
  const end = () => { clearInterval(timer); timer = 0; };
  button.addEventListener("pointerdown", () => { end(); action(); timer = setInterval(action, 100); });
  for (const name of ["pointerup", "pointerleave", "pointercancel", "blur"]) button.addEventListener(name, end);
  button.addEventListener("click", (event) => { if (event.detail === 0) action(); });
}

export function keys(table) {
  addEventListener("keydown", (event) => {
    const key = event.key.toLowerCase();
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (key !== " " && /^(INPUT|SELECT)$/.test(event.target.tagName)) return;
    if (table[key]) { event.preventDefault(); table[key](event); }
  }, true);
}

// The scope's picture and, over it, what was found in it.
export function scopeView(picture, overlay) {
  let last = null, shown = true;
  const draw = () => {
    if (!last) return;
    for (const canvas of [picture, overlay]) if (canvas.width !== last.width || canvas.height !== last.height) { canvas.width = last.width; canvas.height = last.height; }
    picture.getContext("2d").drawImage(last.bitmap, 0, 0);
    picture.dataset.shown = 1 + Number(picture.dataset.shown ?? 0);
    const pen = overlay.getContext("2d");
    pen.clearRect(0, 0, last.width, last.height);
    if (!shown) return;
    pen.strokeStyle = "#3ce63c"; pen.lineWidth = 1; pen.beginPath();
    for (const [ax, ay, bx, by] of last.edges) { pen.moveTo(ax, ay); pen.lineTo(bx, by); }
    pen.stroke();
  };
  return { show(m) { last?.bitmap.close(); last = m; draw(); }, toggle() { shown = !shown; draw(); return shown; } };
}
