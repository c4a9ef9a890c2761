// Drawing at a pace that leaves time for the rest: without a graphics card words and the scope's pictures come first.

// A drawing is followed by so many times as long a rest: drawing takes a fifth of the time.
const REST = 4;

// `draw` begins a drawing, `drawn` is kept when it is done, `clock` has `now`, `later` and `frame` (the window's own where
// none is given). What is asked for is drawn after the rest; what a hand turns, as soon as the last drawing is done.
export function paced(draw, drawn, clock = { now: () => performance.now(), later: setTimeout.bind(window), frame: requestAnimationFrame.bind(window) }) {
  let asked = false, hurried = false, busy = false, waits = 0, rested = 0;
  const run = async (turn) => {
    if (turn !== waits || busy) return;
    busy = true; asked = hurried = false;
    const begun = clock.now();
    draw();
    await drawn();
    rested = clock.now() + REST * (clock.now() - begun); busy = false;
    if (asked) plan();
  };
  const plan = () => {
    const turn = ++waits, go = () => clock.frame(() => run(turn));
    if (hurried) go(); else clock.later(go, Math.max(0, rested - clock.now()));
  };
  return {
    ask() { if (!asked) { asked = true; if (!busy) plan(); } },
    askNow() { if (!hurried) { asked = hurried = true; if (!busy) plan(); } },
  };
}
