// The time line of a record: a band whose colors say what was known when, over the slider; a click jumps there.
import { words } from "./words.js";

const COLORS = { sure: "#63d07a", unsure: "#f2b53c", searching: "#8b97a1", lost: "#ff6f64" };

export function timelineView(band, onJump) {
  let moments = [], lasts = 0;
  const draw = () => {
    const pen = band.getContext("2d");
    pen.clearRect(0, 0, band.width, 1);
    for (const [from, to, kind] of moments) {
      pen.fillStyle = COLORS[kind];
      pen.fillRect(band.width * from / lasts, 0, Math.max(band.width * (to - from) / lasts, 1), 1);
    }
  };
  const at = (event) => { const box = band.getBoundingClientRect(); return lasts * Math.min(Math.max((event.clientX - box.x) / box.width, 0), 1); };
  band.addEventListener("click", (event) => onJump(at(event)));
  band.addEventListener("mousemove", (event) => {
    const t = at(event), found = moments.find(([from, to]) => from <= t && t <= to);
    band.title = found ? `${t.toFixed(1)} s: ${words.moments[found[2]]}${found[3] ? `, ${found[3]}` : ""}` : "";
  });
  return {
    show(list, duration) { moments = list; lasts = Math.max(duration, 0.1); band.dataset.moments = list.length; draw(); },
    // When the next doubt begins, or the one before; null where there is none.
    doubt(by, now) {
      const starts = moments.filter(([, , kind]) => kind !== "sure").map(([from]) => from);
      return (by > 0 ? starts.find((t) => t > now + 0.3) : starts.findLast((t) => t < now - 0.8)) ?? null;
    },
  };
}
