// The page of a live session or a record: shows what the program sends, passes on what is pressed.
import { $, connect, hold, keys, put, putWhole } from "./link.js";
import { gamepad } from "./gamepad.js";
import { kidneyView, turningKeys } from "./kidney.js";
import { scopeView } from "./scope.js";
import { timelineView } from "./timeline.js";
import { fill, words } from "./words.js";

const scope = scopeView($("picture"), $("edges"));
fill();
put($("status"), words.labels.starting); put($("words"), words.labels.unknown); put($("play"), words.labels.pause); list([]);
const timeline = timelineView($("timeline"), (t) => send("seek", t));
let view = null, about = null, cells = [], state = null, seeking = false;
const pending = {};
const later = (name, action) => { if (view) action(); else pending[name] = action; };
const slug = (verdict) => verdict.replaceAll(" ", "-");

const send = connect({
  about(m) { state = null; if (!about) { about = m; build(m); } },
  state: take,
  scope(m) { scope.show(m); take(m.state); },
  virtual(m) { const c = $("virtual"); if (c.width !== m.bitmap.width) { c.width = m.bitmap.width; c.height = m.bitmap.height; } c.getContext("2d").drawImage(m.bitmap, 0, 0); m.bitmap.close(); },
  ways(m) { later("ways", () => view.ways(m.path, m.route)); },
  seen(m) { later("seen", () => view.seen(m.patches)); },
  stones(m) { list(m.stones); later("stones", () => view.stones(m.stones)); },
  cloud(m) { later("cloud", () => view.cloud(m.points)); },
  timeline(m) { timeline.show(m.moments, m.duration_s); },
  replay(m) { put($("play"), m.playing ? words.labels.pause : words.labels.play); put($("time"), `${m.at_s.toFixed(1)} s`); if (!seeking) $("at").value = m.at_s; },
  notice(m) { put($("notice"), m.text); },
});
kidneyView($("kidney"), (name) => send("choose", name)).then((found) => {
  if (!found) { const cloud = document.querySelector("[data-shows=cloud]"); cloud.disabled = true; cloud.setAttribute("aria-pressed", "false"); return; }
  view = found; window.kidney = found; Object.values(pending).forEach((action) => action()); if (state) show(state);
});

// A line a stone; the list has a size of its own and scrolls, so that it moves nothing.
function list(stones) {
  const said = (s) => [`${s.number}`, s.calyx, `${s.size.toFixed(1)} ± ${s.sd.toFixed(1)} mm`, words.stoneStates[s.state], s.known].filter(Boolean).join(" · ");
  const line = (text, state) => { const e = document.createElement("li"); e.className = state; e.textContent = e.title = text; return e; };
  $("stones").replaceChildren(...(stones.length ? stones.map((s) => line(said(s), s.state)) : [line(words.labels.noStone, "none")]));
}

function build(m) {
  cells = m.calyces.map((name, i) => {
    const item = document.createElement("li"), button = document.createElement("button"), image = new Image(), title = document.createElement("b");
    const [share, sign, verdict] = ["share", "sign", "verdict"].map((part) => { const e = document.createElement("span"); e.className = part; return e; });
    button.type = "button"; image.src = `/calyx/${i}.jpg`; image.alt = ""; title.textContent = name; sign.setAttribute("aria-hidden", "true");
    button.append(image, title, share, sign, verdict); button.setAttribute("aria-pressed", "false");
    button.onclick = () => send("choose", name); item.append(button); $("strip").append(item);
    return { name, button, title, share, sign, verdict };
  });
  for (const [move, [label, key]] of Object.entries(words.moves)) {
    const button = document.createElement("button"), hint = document.createElement("kbd");
    button.type = "button"; button.append(`${label} `, hint); hint.textContent = key.toUpperCase();
    hold(button, () => send("drive", move)); $("moves").append(button);
  }
  $("stop").hidden = $("robot-part").hidden = !m.robot;
  $("drive-part").hidden = !m.drive; $("pilot").hidden = !m.pilot; $("hold").hidden = !m.by_itself;
  for (const [key, what] of words.keys) { const term = document.createElement("dt"), said = document.createElement("dd"); term.textContent = key; said.textContent = what; $("keys").append(term, said); }
  $("replay").hidden = m.duration_s === null; $("at").max = m.duration_s ?? 0;
  document.body.classList.add("built");
}

// Words may have come while their picture was decoded; older ones do not replace them.
function take(m) { if (!state || m.version >= state.version) { state = m; show(m); } }

function show(m) {
  putWhole($("status"), m.status);
  put($("tag"), m.calyx ? `${m.may_be} · ${m.words}` : m.place || m.words);
  put($("words"), m.pose ? `${m.words} (${Math.round(100 * m.confidence)} %)` : m.words);
  $("bar").style.transform = `scaleX(${m.confidence})`;
  $("bar").parentElement.className = `bar ${m.confidence >= 0.9 ? "inspected" : m.confidence >= 0.6 ? "glimpsed" : "unseen"}`;
  put($("robot"), `${words.robot}: ${m.robot || words.unheard}${m.autonomy ? ` · ${m.autonomy}` : ""}`); put($("notice-robot"), m.notice);
  $("pilot").setAttribute("aria-pressed", String(!m.by_hand));
  put($("latency"), m.latency); $("latency").title = m.latency; $("latency").dataset.state = m.version;
  const rows = new Map(m.coverage.map((row) => [row[0], row]));
  for (const cell of cells) {
    const [, , verdict = "unseen", share = 0] = rows.get(cell.name) ?? [];
    put(cell.share, `${Math.round(100 * share)} %`); put(cell.verdict, words.verdicts[verdict]);
    put(cell.sign, words.signs[verdict]);
    for (const part of ["title", "share", "sign", "verdict"]) cell[part].className = `${part} ${slug(verdict)}`;
    cell.button.setAttribute("aria-pressed", String(cell.name === (m.chosen || m.next)));
    cell.button.className = cell.name === m.calyx ? "here" : "";
  }
  if (view) { view.pose(m.pose); view.verdicts(m.coverage); }
}

const press = { stop: "stop", acknowledge: "acknowledge", arm: "arm", propose: "propose", end: "end", play: "play", step: "step" };
for (const [id, name] of Object.entries(press)) $(id).onclick = () => send(name);
$("brighter").onclick = () => send("brighten", 1);
$("darker").onclick = () => send("brighten", -1);
hold($("hold"), () => send("drive", "hold"));
$("pilot").onclick = () => send("pilot", !!state?.by_hand);
// What lies over the picture and in the kidney can be switched.
const hide = { cloud: () => view?.toggleCloud(), drawn: () => { const c = $("virtual"); c.hidden = !c.hidden; return !c.hidden; } };
const toggle = (what) => { const button = document.querySelector(`[data-shows=${what}]`), on = hide[what] ? hide[what]() : scope.toggle(what); button.setAttribute("aria-pressed", String(!!on)); };
for (const button of document.querySelectorAll("[data-shows]")) button.onclick = () => toggle(button.dataset.shows);
const doubt = (by) => { const t = timeline.doubt(by, Number($("at").value)); if (t !== null) send("seek", t); };
$("before").onclick = () => doubt(-1); $("next").onclick = () => doubt(1);
$("at").oninput = () => { seeking = true; };
$("at").onchange = () => { seeking = false; send("seek", Number($("at").value)); };

const table = { " ": () => { if (about?.robot) send("stop"); else send("play"); }, a: () => send("acknowledge"), r: () => send("arm"), f: () => send("pilot", !!state?.by_hand), h: () => about?.by_itself && send("drive", "hold"), e: () => toggle("edges"), s: () => toggle("stones"), n: () => toggle("names"), c: () => toggle("cloud"), v: () => toggle("drawn"), "[": () => doubt(-1), "]": () => doubt(1), 0: () => send("propose"), p: () => send("play"), ".": () => send("step"), ...turningKeys(() => view) };
for (let i = 1; i <= 9; i++) table[i] = () => cells[i - 1] && send("choose", cells[i - 1].name);
for (const [move, [, key]] of Object.entries(words.moves)) table[key] = () => about?.drive && send("drive", move);
keys(table);
gamepad({ stop: () => { if (about?.robot) send("stop"); else send("play"); }, turn: (right, down) => view?.turn(right, down) });
