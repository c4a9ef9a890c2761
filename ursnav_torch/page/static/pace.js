// Drawing at a pace that leaves time for the rest: without a graphics card words and the scope's pictures come first.

// A drawing is followed by so many times as long a rest: drawing takes a fifth of the time.
const REST = 4;
// Time between looks whether a drawing is done, and the time after which nobody waits for it any more.
const LOOK_MS = 5, LONGEST_MS = 3000;
// What waits for a frame is done without one after so long: a browser draws none of a tab that nobody sees.
const SOON_MS = 250;

// Do something with the next frame that the browser draws, or soon where it draws none; kept when that is done.
export const atFrame = (action) => new Promise((done, failed) => {
  const go = () => { cancelAnimationFrame(frame); clearTimeout(timer); try { done(action()); } catch (error) { failed(error); } };
  const frame = requestAnimationFrame(go), timer = setTimeout(go, SOON_MS);
});

// `draw` begins a drawing, `isDrawn` says whether it is done, `clock` has `now`, `later` and `frame` (the window's own where
// none is given). What is asked for is drawn after the rest; what a hand turns, as soon as the last drawing is done. A
// drawing that fails or never says that it is done stops no other.
export function paced(draw, isDrawn, clock = { now: () => performance.now(), later: setTimeout.bind(window), frame: requestAnimationFrame.bind(window) }) {
  let asked = false, hurried = false, busy = false, waits = 0, rested = 0;
  const pause = (ms) => new Promise((done) => { clock.later(done, ms); });
  const run = async (turn) => {
    if (turn !== waits || busy) return;
    busy = true; asked = hurried = false;
    const begun = clock.now();
    try {
      draw();
      await pause(0);
      while (!isDrawn() && clock.now() - begun < LONGEST_MS) await pause(LOOK_MS);
    } finally {
      rested = clock.now() + REST * (clock.now() - begun); busy = false;
      if (asked) plan();
    }
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
