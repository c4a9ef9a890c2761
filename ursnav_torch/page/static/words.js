// Every text of the pages that is not said by the program itself: translate here.
// In HTML, data-word names an entry of `labels`; data-hint one that says what a part is to who does not see it.
export const words = {
  labels: {
    starting: "Starting.", stop: "STOP", confidence: "Confidence", unknown: "no place known", show: "Show", edges: "Edges", stones: "Stones",
    stoneList: "Stones found", noStone: "none yet", names: "Names", drawn: "Drawn", cloud: "Cloud", propose: "Propose next", end: "End session", robot: "Robot",
    acknowledge: "Acknowledge", arm: "Arm", pilot: "Pilot flies", hold: "Hold: goes by itself", brighter: "Brighter", darker: "Darker",
    disclaimer: "Research software, not a medical device.", play: "Play", pause: "Pause", before: "Doubt before", next: "Next doubt",
    fly: "Fly", calyx: "calyx", go: "Go there", newName: "new name", rename: "Rename", collect: "Collect", take: "Take this view",
    count: "views a calyx", plan: "Plan views again", picking: "Pick landmarks: click the kidney", unpick: "Take back the last landmark",
    leave: "End", save: "Save", alike: "What looks alike", alikeHint: "Rows what is shown, columns what it was taken for, % of the row.",
    help: "Keys",
    undrawn: "The kidney is not drawn: this browser has no WebGL. The rest of the page goes on. To see the kidney, turn on graphics acceleration in the browser's settings and load the page again.", report: "Report", rows: "Rows (CSV)",
  },
  hints: {
    scope: "What the scope sees", kidney: "The kidney with the scope in it", virtual: "What the scope should see here", controls: "Controls",
    calyces: "Calyces", step: "One picture on", time: "Time", timeline: "What is known of every moment", moves: "Moves",
    from: "What a scope sees from here", stoneList: "Stones found: number, calyx, size, there or gone",
  },
  verdicts: { inspected: "inspected", glimpsed: "glimpsed", unseen: "not seen", "out of reach": "out of reach" },
  signs: { inspected: "✓", glimpsed: "◐", unseen: "○", "out of reach": "–" },
  stoneStates: { there: "there", gone: "gone" },
  bodies: { stone: "stone", instrument: "instrument" },
  lost: "The connection is lost. The robot is not stopped by that; is the program still running?",
  robot: "robot", unheard: "not heard of yet",
  moments: { sure: "sure", unsure: "unsure", searching: "searching", lost: "lost" },
  keys: [["Tab, Enter", "go to a button, press it"], ["1 … 9", "lead to a calyx"], ["0", "propose the next one"], ["Arrows, + -", "turn the kidney, nearer, farther"], ["E S N C V", "show edges, stones, names, cloud, drawing"], ["Space", "STOP (a record: play)"], ["P . [ ]", "a record: play, one picture on, doubts"], ["Gamepad", "cross left, right: go to a button; Y: press it; B: STOP; right stick: turn the kidney"]],
  moves: { forward: ["Forward", "i"], back: ["Back", "k"], left: ["Left", "j"], right: ["Right", "l"], up: ["Up", "u"], down: ["Down", "m"] },
  flight: { forward: "i", back: "k", "look left": "j", "look right": "l", "look up": "u", "look down": "m", "roll left": "y", "roll right": "o" },
};

// Put the texts in their places; nothing is shown before.
export function fill() {
  for (const e of document.querySelectorAll("[data-word]")) e.prepend(words.labels[e.dataset.word] + (e.querySelector("kbd, select, input") ? " " : ""));
  for (const e of document.querySelectorAll("[data-hint]")) e.setAttribute("aria-label", words.hints[e.dataset.hint]);
  document.body.classList.add("ready");
}
