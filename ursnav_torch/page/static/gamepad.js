// A gamepad for the page: the cross's left and right go from button to button, Y presses, B stops, the right stick turns
// the kidney. The program itself may read the same gamepad to move a robot: there B stops, too, and the others do nothing.
const B = 1, Y = 3, LEFT = 14, RIGHT = 15;
const DEAD = 0.2, TURN = 0.06, LOOK_MS = 50;
const FOCUSABLE = "button:not([disabled]), input, select, summary, a[href]";

export function gamepad({ stop, turn }) {
  let held = new Set();
  const look = () => {
    const pads = [...navigator.getGamepads()].filter(Boolean), down = new Set();
    for (const pad of pads) {
      pad.buttons.forEach((button, i) => { if (button.pressed) down.add(i); });
      const [x, y] = [pad.axes[2] ?? 0, pad.axes[3] ?? 0].map((v) => (Math.abs(v) > DEAD ? v : 0));
      if (x || y) turn(TURN * x, TURN * y);
    }
    const fresh = [...down].filter((i) => !held.has(i));
    held = down;
    if (fresh.includes(B)) stop();
    if (fresh.includes(Y)) document.activeElement?.click();
    if (fresh.includes(RIGHT)) step(1);
    if (fresh.includes(LEFT)) step(-1);
  };
  let timer = 0;
  const begin = () => { timer ||= setInterval(look, LOOK_MS); };
  addEventListener("gamepadconnected", begin);
  addEventListener("gamepaddisconnected", () => { if (![...navigator.getGamepads()].some(Boolean)) { clearInterval(timer); timer = 0; } });
  if ([...navigator.getGamepads()].some(Boolean)) begin();
}

// Give the focus to the next of what can be pressed and is seen, or the one before.
function step(by) {
  const all = [...document.querySelectorAll(FOCUSABLE)].filter((e) => e.checkVisibility());
  const at = all.indexOf(document.activeElement);
  all.at(at < 0 ? (by > 0 ? 0 : -1) : (at + by) % all.length)?.focus();
}
