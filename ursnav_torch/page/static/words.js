// Every text of the pages that is not said by the program itself: translate here.
export const words = {
  verdicts: { inspected: "inspected", glimpsed: "glimpsed", unseen: "not seen", "out of reach": "out of reach" },
  lost: "The connection is lost. The robot is not stopped by that; is the program still running?",
  robot: "robot", unheard: "not heard of yet",
  play: "Play", pause: "Pause",
  moves: { forward: ["Forward", "i"], back: ["Back", "k"], left: ["Left", "j"], right: ["Right", "l"], up: ["Up", "u"], down: ["Down", "m"] },
  flight: { forward: "i", back: "k", "look left": "j", "look right": "l", "look up": "u", "look down": "m", "roll left": "y", "roll right": "o" },
};
