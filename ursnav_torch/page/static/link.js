// The connection to the program: JSON texts, and pictures as a line of JSON and a JPEG. It comes back by itself.
// The program hears of every message when it is shown, and sends the next of that kind only then: no queue can grow.
import { atFrame } from "./pace.js";
import { words } from "./words.js";

// `handlers`, by kind, show a message: in the frame that is drawn next, and none of a connection that another has followed.
export function connect(handlers) {
  let socket = null;
  const open = () => {
    const own = socket = new WebSocket(`ws://${location.host}/live`);
    own.binaryType = "arraybuffer";
    own.onopen = () => handlers.notice?.({ text: "" });
    own.onmessage = async ({ data }) => {
      const [m, picture] = read(data);
      try {
        if (picture) m.bitmap = await createImageBitmap(picture);
        await atFrame(() => { if (own === socket) handlers[m.kind]?.(m); });
      } finally { if (own.readyState === 1) own.send(JSON.stringify({ shown: m.kind })); }
    };
    own.onclose = () => { handlers.notice?.({ text: words.lost }); setTimeout(open, 1000); };
  };
  open();
  return (name, value) => { if (socket.readyState === 1) socket.send(JSON.stringify({ do: name, value })); };
}

function read(data) {
  if (typeof data === "string") return [JSON.parse(data), null];
  const bytes = new Uint8Array(data), end = bytes.indexOf(10);
  return [JSON.parse(new TextDecoder().decode(bytes.subarray(0, end))), new Blob([bytes.subarray(end + 1)], { type: "image/jpeg" })];
}

export const $ = (id) => document.getElementById(id);
export const put = (element, text) => { if (element.textContent !== text) element.textContent = text; };

// Put a text whole: in small letters where it would be cut off, and anew when the window has another size.
export const putWhole = (element, text) => {
  if (element.textContent === text) return;
  element.textContent = element.title = text; fitLetters(element);
  if (!element.dataset.whole) { element.dataset.whole = "true"; addEventListener("resize", () => fitLetters(element)); }
};
const fitLetters = (element) => {
  element.classList.remove("small");
  element.classList.toggle("small", element.scrollHeight > element.clientHeight || element.scrollWidth > element.clientWidth);
};

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
