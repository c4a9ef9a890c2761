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
