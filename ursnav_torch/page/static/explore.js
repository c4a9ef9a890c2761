// The page to fly through a kidney by hand.
import { $, connect, hold, keys, put, putWhole } from "./link.js";
import { gamepad } from "./gamepad.js";
import { kidneyView, turningKeys } from "./kidney.js";
import { scopeView } from "./scope.js";
import { fill, words } from "./words.js";

fill();
put($("status"), words.labels.starting);

const scope = scopeView($("picture"), $("edges"));
let view = null, state = null, names = [];

const send = connect({
  about(m) { if (!$("moves").children.length) build(m); },
  state(m) { state = m; show(m); },
  scope: scope.show,
  said(m) { put($("said"), m.text); put($("notice"), ""); },
  notice(m) { put($("notice"), m.text); },
});
kidneyView($("kidney"), (name) => go(name)).then((found) => { if (!found) { $("picking").disabled = true; return; } view = found; window.kidney = found; if (state) show(state); });

function go(name) { $("chosen").value = name; send("go_to", name); }

function build(m) {
  for (const move of m.moves) {
    const button = document.createElement("button"), hint = document.createElement("kbd");
    button.type = "button"; button.append(`${move} `, hint); hint.textContent = words.flight[move].toUpperCase();
    hold(button, () => send("fly", move)); $("moves").append(button);
  }
  $("save").disabled = !m.saves;
  const { names: labels, share, sentences } = m.alike, table = $("alike");
  const row = (head, cells) => { const r = table.insertRow(), h = document.createElement("th"); h.textContent = head; r.append(h); cells.forEach((c) => { r.insertCell().textContent = c; }); };
  if (labels.length) row("", labels);
  share.forEach((line, i) => row(labels[i], line.map((v) => (v ? String(v) : ""))));
  sentences.forEach((text) => { const p = document.createElement("p"); p.textContent = text; $("sentences").append(p); });
}

function show(m) {
  putWhole($("status"), m.status);
  if (m.calyces.join("\n") !== names.join("\n")) {
    const at = Math.max($("chosen").selectedIndex, 0);
    names = m.calyces;
    $("chosen").replaceChildren(...names.map((name) => new Option(name, name)));
    $("chosen").selectedIndex = at;
    $("strip").replaceChildren(...names.map((name, i) => {
      const item = document.createElement("li"), button = document.createElement("button"), image = new Image(), title = document.createElement("b");
      button.type = "button"; image.src = `/calyx/${i}.jpg`; image.alt = ""; title.textContent = name;
      button.append(image, title); button.onclick = () => go(name); item.append(button);
      return item;
    }));
  }
  if (view) { view.names(m.calyces); view.pose(m.pose); view.dots([[m.views, 0xb9a0ff, 0.3], [m.landmarks, 0xffb52e, 0.6]]); }
}

$("go").onclick = () => go($("chosen").value);
$("rename").onclick = () => { put($("notice"), ""); send("rename", [$("chosen").value, $("name").value.trim()]); };
$("plan").onclick = () => send("plan", Math.round(Number($("count").value)));
$("picking").onchange = () => view?.onPick($("picking").checked ? (ray) => send("pick", ray) : null);
for (const name of ["take", "unpick", "save", "end"]) $(name).onclick = () => send(name);
const table = { t: () => send("take"), ...turningKeys(() => view) };
for (const [move, key] of Object.entries(words.flight)) table[key] = () => send("fly", move);
keys(table);
gamepad({ stop: () => {}, turn: (right, down) => view?.turn(right, down) });
