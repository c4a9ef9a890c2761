// The kidney in the page: translucent, painted where it was seen, with the scope in it. It draws only when something changes.
import * as THREE from "./vendor/three.module.min.js";
import { OrbitControls } from "./vendor/OrbitControls.js";
import { paced } from "./pace.js";
import { words } from "./words.js";

const TISSUE = [0.88, 0.58, 0.57], SEEN = [0.25, 0.72, 0.4];
const COLORS = { inspected: 0x63d07a, glimpsed: 0xf2b53c, unseen: 0xff6f64, "out of reach": 0x9aa5ae };
const STONE = { there: 0xffb52e, gone: 0x9aa5ae };
const CLOUD = 0xffe08a, FRUSTUM_MM = 3.5;
// No picture is drawn wider: the time goes with its pixels, and most without a graphics card.
const WIDEST_PX = 1200, WIDEST_SOFTWARE_PX = 640;
// Share of the pane that the kidney fills.
const FILLED = 0.9;

// Kept with null where the browser cannot draw in three dimensions; the pane says so then.
export async function kidneyView(pane, onCalyx) {
  const canvas = pane.querySelector("canvas"), drawnBy = graphics();
  if (drawnBy === null) { sayInstead(pane, canvas); return null; }
  const buffer = await (await fetch("/kidney.bin")).arrayBuffer();
  const end = new Uint8Array(buffer).indexOf(10);
  const about = JSON.parse(new TextDecoder().decode(buffer.slice(0, end)));
  const vertices = new Float32Array(buffer, end + 1, 3 * about.vertices);
  const faces = new Uint32Array(buffer, end + 1 + vertices.byteLength, 3 * about.faces);
  const patches = new Int32Array(buffer, end + 1 + vertices.byteLength + faces.byteLength, about.vertices);
  const vector = (v) => new THREE.Vector3(...v);
  const center = vector(about.center), unit = about.scale;

  const software = /swiftshader|llvmpipe|software|basic render/i.test(drawnBy);
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: !software, alpha: true });
  const scene = new THREE.Scene(), camera = new THREE.PerspectiveCamera(40, 1, 1, 40 * about.extent);
  camera.up.copy(vector(about.up));
  const controls = new OrbitControls(camera, canvas);
  controls.enableDamping = false;
  scene.add(new THREE.AmbientLight(0xffffff, 1.4));
  const lamp = new THREE.DirectionalLight(0xffffff, 2.6);
  lamp.position.set(0.4, 0.5, 1); lamp.target.position.set(0, 0, -1);
  camera.add(lamp, lamp.target); scene.add(camera);

  const surface = new THREE.BufferGeometry();
  const colors = new Float32Array(3 * about.vertices);
  for (let i = 0; i < about.vertices; i++) colors.set(TISSUE, 3 * i);
  surface.setAttribute("position", new THREE.BufferAttribute(vertices, 3));
  surface.setAttribute("color", new THREE.BufferAttribute(colors, 3));
  surface.setIndex(new THREE.BufferAttribute(faces, 1));
  surface.computeVertexNormals();
  const tissue = new THREE.Mesh(surface, new THREE.MeshLambertMaterial({ vertexColors: true, transparent: true, opacity: 0.62, depthWrite: false }));
  scene.add(tissue);

  const balls = about.calyces.map(({ name, tip }) => {
    const ball = new THREE.Mesh(new THREE.SphereGeometry(1.1 * unit, 20, 14), new THREE.MeshLambertMaterial({ color: COLORS.unseen }));
    ball.position.copy(vector(tip)); ball.userData.name = name; scene.add(ball);
    const label = document.createElement("div");
    label.className = "label"; label.textContent = name; pane.append(label); ball.userData.label = label;
    return ball;
  });

  const scope = new THREE.Group(); scope.matrixAutoUpdate = false; scope.visible = false; scene.add(scope);
  const f = FRUSTUM_MM * unit, w = 0.7 * f, corner = [[-w, -w, f], [w, -w, f], [w, w, f], [-w, w, f]];
  const cone = corner.flatMap((c, i) => [[0, 0, 0], c, c, corner[(i + 1) % 4]]).map(vector);
  scope.add(new THREE.LineSegments(new THREE.BufferGeometry().setFromPoints(cone), new THREE.LineBasicMaterial({ color: 0xffffff })));
  scope.add(new THREE.Mesh(new THREE.SphereGeometry(0.55 * unit, 16, 12), new THREE.MeshBasicMaterial({ color: 0xffffff })));
  [[1, 0, 0, 0xff5a4d], [0, 1, 0, 0x5fe07a], [0, 0, 1, 0x6aa8ff]].forEach(([x, y, z, color]) => scope.add(new THREE.ArrowHelper(new THREE.Vector3(x, y, z), new THREE.Vector3(), 1.6 * f, color, 0.4 * f, 0.25 * f)));

  // Where the scope may be: as dense as it is likely.
  const haze = new THREE.Points(new THREE.BufferGeometry(), new THREE.PointsMaterial({ color: CLOUD, size: 1.5 * unit, transparent: true, opacity: 0.35, depthWrite: false, depthTest: false }));
  haze.frustumCulled = false; scene.add(haze);

  const ways = new THREE.Group(), dots = new THREE.Group(), stones = new THREE.Group(); scene.add(ways, dots, stones);
  const line = (points, color, faded) => {
    const geometry = new THREE.BufferGeometry().setFromPoints(points.map(vector));
    if (faded) {
      const c = new THREE.Color(color), dark = new THREE.Color(0x2a3440), all = [];
      points.forEach((_, i) => all.push(...dark.clone().lerp(c, (i + 1) / points.length).toArray()));
      geometry.setAttribute("color", new THREE.Float32BufferAttribute(all, 3));
    }
    return new THREE.Line(geometry, new THREE.LineBasicMaterial(faded ? { vertexColors: true } : { color }));
  };
  const empty = (group) => { for (const child of [...group.children]) { child.geometry.dispose(); child.material.dispose(); group.remove(child); } };

  // A drawing is done when the graphics card says so: the page goes on meanwhile.
  const gl = renderer.getContext();
  let fence = null;
  const draw = () => {
    renderer.render(scene, camera); place();
    gl.deleteSync(fence); fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0); gl.flush();
  };
  const isDrawn = () => !fence || gl.isContextLost() || gl.getSyncParameter(fence, gl.SYNC_STATUS) === gl.SIGNALED;
  const { ask, askNow } = paced(draw, isDrawn);
  const fit = () => {
    const { clientWidth: width, clientHeight: height } = pane;
    renderer.setPixelRatio(Math.min(devicePixelRatio, 1.5, (software ? WIDEST_SOFTWARE_PX : WIDEST_PX) / Math.max(width, 1))); renderer.setSize(width, height, false);
    camera.aspect = width / Math.max(height, 1); camera.updateProjectionMatrix();
    if (!moved) frame();
    askNow();
  };
  // The whole kidney in the middle of the pane, as near as it fits; until somebody turns it or comes nearer.
  let moved = false;
  const frame = () => {
    const back = vector(about.away).negate().normalize(), right = new THREE.Vector3().crossVectors(camera.up, back).normalize(), up = new THREE.Vector3().crossVectors(back, right);
    const origin = vector(about.center), p = new THREE.Vector3(), all = [];
    for (let i = 0; i < about.vertices; i++) { p.fromArray(vertices, 3 * i).sub(origin); all.push([p.dot(right), p.dot(up), p.dot(back)]); }
    const middle = (axis) => (all.reduce((m, q) => Math.min(m, q[axis]), Infinity) + all.reduce((m, q) => Math.max(m, q[axis]), -Infinity)) / 2;
    const x = middle(0), y = middle(1), slope = FILLED * Math.tan(THREE.MathUtils.degToRad(camera.fov / 2));
    const away = all.reduce((m, q) => Math.max(m, q[2] + Math.max(Math.abs(q[0] - x) / camera.aspect, Math.abs(q[1] - y)) / slope), 0);
    center.copy(origin).addScaledVector(right, x).addScaledVector(up, y);
    camera.position.copy(center).addScaledVector(back, away);
    controls.target.copy(center); controls.update();
  };
  controls.addEventListener("start", () => { moved = true; });
  new ResizeObserver(fit).observe(pane); controls.addEventListener("change", askNow);

  // Labels beside their balls; one that would cover another goes below or above it.
  const sizes = new Map();
  function place() {
    const taken = [...pane.querySelectorAll(".virtual")].filter((e) => !e.hidden).map((e) => ({ x: e.offsetLeft, y: e.offsetTop, w: e.offsetWidth, h: e.offsetHeight }));
    const spots = balls.map((ball) => {
      const p = ball.position.clone().project(camera);
      return { ball, x: (p.x + 1) / 2 * pane.clientWidth, y: (1 - p.y) / 2 * pane.clientHeight };
    }).sort((a, b) => a.y - b.y);
    for (const { ball, x, y } of spots) {
      const label = ball.userData.label, text = label.textContent;
      if (!sizes.has(text + pane.clientHeight)) sizes.set(text + pane.clientHeight, [label.offsetWidth, label.offsetHeight]);
      const [w, h] = sizes.get(text + pane.clientHeight), hits = (b) => taken.some((t) => b.x < t.x + t.w && t.x < b.x + w && b.y < t.y + t.h && t.y < b.y + h);
      const within = (b) => ({ x: Math.max(0, Math.min(b.x, pane.clientWidth - w)), y: Math.max(0, Math.min(b.y, pane.clientHeight - h)) });
      const tries = [[8, -h / 2], [-8 - w, -h / 2], [-w / 2, 8], [-w / 2, -8 - h]];
      for (let k = 1; k < 9; k++) tries.push([8, -h / 2 + k * h], [8, -h / 2 - k * h], [-8 - w, -h / 2 + k * h], [-8 - w, -h / 2 - k * h]);
      const box = tries.map(([dx, dy]) => within({ x: x + dx, y: y + dy })).find((b) => !hits(b)) ?? within({ x, y });
      taken.push({ ...box, w, h });
      label.style.transform = `translate(${Math.round(box.x)}px, ${Math.round(box.y)}px)`;
    }
  }

  const rays = new THREE.Raycaster(), ray = (event) => {
    const box = canvas.getBoundingClientRect();
    rays.setFromCamera(new THREE.Vector2((event.clientX - box.x) / box.width * 2 - 1, 1 - (event.clientY - box.y) / box.height * 2), camera);
    return rays;
  };
  let pick = null, down = null;
  canvas.addEventListener("pointerdown", (event) => { down = [event.clientX, event.clientY]; });
  canvas.addEventListener("click", (event) => {
    if (down && Math.hypot(event.clientX - down[0], event.clientY - down[1]) > 4) return;
    const found = ray(event);
    if (pick) { pick([...found.ray.origin.toArray(), ...found.ray.direction.toArray()]); return; }
    const hit = found.intersectObjects(balls)[0];
    if (hit) onCalyx(hit.object.userData.name);
  });
  fit();
  return {
    about,
    pose(T) { scope.visible = !!T; if (T) { scope.matrix.set(...T); scope.matrixWorldNeedsUpdate = true; } ask(); },
    verdicts(rows) { for (const [name, , verdict] of rows) { const b = balls.find((ball) => ball.userData.name === name); b?.material.color.setHex(COLORS[verdict]); } ask(); },
    names(list) { balls.forEach((ball, i) => { ball.userData.name = list[i]; ball.userData.label.textContent = list[i]; }); ask(); },
    seen(list) {
      const found = new Set(list);
      for (let i = 0; i < about.vertices; i++) colors.set(found.has(patches[i]) ? SEEN : TISSUE, 3 * i);
      surface.attributes.color.needsUpdate = true; ask();
    },
    cloud(points) { haze.geometry.setAttribute("position", new THREE.Float32BufferAttribute(points.flat(), 3)); canvas.dataset.cloud = points.length; ask(); },
    toggleCloud() { haze.visible = !haze.visible; ask(); return haze.visible; },
    ways(path, route) {
      empty(ways);
      path.forEach((piece, i) => ways.add(line(piece, 0xd8e4ee, i === path.length - 1)));
      if (route.length > 1) ways.add(line(route, 0x7db7ff, false));
      ask();
    },
    stones(list) {
      empty(stones);
      for (const { at, size, state } of list) { const s = new THREE.Mesh(new THREE.SphereGeometry(size / 2, 20, 14), new THREE.MeshLambertMaterial({ color: STONE[state], wireframe: state === "gone" })); s.position.copy(vector(at)); stones.add(s); }
      canvas.dataset.stones = list.length; ask();
    },
    dots(sets) {
      empty(dots);
      for (const [points, color, size] of sets) for (const p of points) { const d = new THREE.Mesh(new THREE.SphereGeometry(size * unit, 10, 8), new THREE.MeshBasicMaterial({ color })); d.position.copy(vector(p)); dots.add(d); }
      ask();
    },
    turn(right, down_) { moved = true; const offset = camera.position.clone().sub(center), side = new THREE.Vector3().crossVectors(camera.up, offset).normalize(); offset.applyAxisAngle(camera.up, right).applyAxisAngle(side, down_); camera.position.copy(center).add(offset); controls.update(); askNow(); },
    zoom(factor) { moved = true; camera.position.sub(center).multiplyScalar(factor).add(center); controls.update(); askNow(); },
    onPick(action) { pick = action; },
    screen(points) { return points.map((p) => { const q = vector(p).project(camera), box = canvas.getBoundingClientRect(); return [box.x + (q.x + 1) / 2 * box.width, box.y + (1 - q.y) / 2 * box.height]; }); },
  };
}

// What the browser draws with, as far as it tells; null where it has no WebGL.
function graphics() {
  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl) return null;
  const info = gl.getExtension("WEBGL_debug_renderer_info"), name = info ? gl.getParameter(info.UNMASKED_RENDERER_WEBGL) : "";
  gl.getExtension("WEBGL_lose_context")?.loseContext();
  return name;
}

function sayInstead(pane, canvas) {
  const said = document.createElement("p");
  said.className = "instead"; said.textContent = words.labels.undrawn;
  canvas.hidden = true; pane.append(said);
}

// Arrow keys turn the kidney, plus and minus bring it nearer and farther.
export const turningKeys = (view) => ({
  arrowleft: () => view()?.turn(-0.15, 0), arrowright: () => view()?.turn(0.15, 0), arrowup: () => view()?.turn(0, -0.15), arrowdown: () => view()?.turn(0, 0.15),
  "+": () => view()?.zoom(0.9), "-": () => view()?.zoom(1.1),
});
