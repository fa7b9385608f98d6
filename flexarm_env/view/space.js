// Arms in space on the stage, drawn with three.js; behind clip.js and three.min.js in the same script. z is up.

for (const clip of CLIPS) clip.size = clip.cuts[clip.links]; // points of all links; each has its own root and tip

// ----------------------------------------------------------------- geometry
/** Points at instant i, m. */
function pose(clip, i) {
  const n = 3 * clip.size;
  return clip.points.slice(n * i, n * (i + 1)).map((v, j) => v + clip.root[3 * i + (j % 3)]);
}

/** Numbers of an instant's row of `values`, `size` each, straight between instants. */
function rowAt(clip, values, size, t) {
  const i = last(clip.t, t), here = values.slice(size * i, size * (i + 1));
  if (i + 1 >= clip.t.length || t - clip.t[i] < 1e-9) return here;
  const share = (t - clip.t[i]) / (clip.t[i + 1] - clip.t[i]);
  return here.map((v, j) => v + share * (values[size * (i + 1) + j] - v));
}
function poseAt(clip, t) {
  const root = rowAt(clip, clip.root, 3, t);
  return rowAt(clip, clip.points, 3 * clip.size, t).map((v, j) => v + root[j % 3]);
}
const ghost = (clip, i) => (clip.rigid ? Array.from(clip.rigid.slice(3 * (clip.links + 1) * i, 3 * (clip.links + 1) * (i + 1))) : []);

/** The ball that holds all that is ever shown; the tips' paths. */
function survey() {
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  const include = (points) => points.forEach((v, j) => { low[j % 3] = Math.min(low[j % 3], v); high[j % 3] = Math.max(high[j % 3], v); });
  for (const clip of CLIPS) {
    clip.tips = new Float32Array(3 * clip.t.length);
    for (let i = 0; i < clip.t.length; i++) {
      const points = pose(clip, i);
      clip.tips.set(points.subarray(-3), 3 * i);
      include(points);
    }
    if (clip.target) include(clip.target);
  }
  extent.length = Math.max(...CLIPS.map((clip) => clip.length));
  extent.ground = Math.min(...CLIPS.map((clip) => clip.ground));
  extent.center = low.map((v, d) => 0.5 * (v + high[d]));
  extent.radius = Math.max(0.55 * extent.length, 0.5 * Math.hypot(...low.map((v, d) => high[d] - v)));
}

// -------------------------------------------------------------------- scene
const T = THREE;
let world = null;

function makeWorld(renderer) {
  renderer.shadowMap.enabled = true;
  const scene = new T.Scene(), camera = new T.PerspectiveCamera(28, 1, 0.02 * extent.length, 60 * extent.radius);
  camera.up.set(0, 0, 1);
  const sun = new T.DirectionalLight(0xffffff, 3.0), span = 1.6 * extent.radius;
  sun.castShadow = true;
  sun.shadow.mapSize.set(2048, 2048);
  Object.assign(sun.shadow.camera, { left: -span, right: span, top: span, bottom: -span, near: 0.1 * span, far: 8 * span });
  sun.shadow.normalBias = 0.004 * extent.length;
  sun.shadow.bias = -0.0004;
  const sky = new T.HemisphereLight(0xffffff, 0xc9d2dc, 2.4);
  scene.add(sun, sun.target, sky);
  const controls = new T.OrbitControls(camera, stage);
  controls.enableDamping = false;
  controls.addEventListener("change", () => world.sized && later());
  world = { renderer, scene, camera, controls, sun, span, paints: [], runs: [], followed: null };
  addGround();
  CLIPS.forEach((clip, k) => world.runs.push(makeRun(clip, k)));
  look("corner");
}

/** A material whose colour is `color()` in each theme. */
function paint(color, more = {}) {
  const material = new T.MeshStandardMaterial({ roughness: 0.55, metalness: 0.05, ...more });
  world.paints.push(() => material.color.set(color()));
  return material;
}
function stroke(color, more = {}) {
  const material = new T.LineBasicMaterial(more);
  world.paints.push(() => material.color.set(color()));
  return material;
}

function addGround() {
  const { scene } = world, radius = 1.5 * extent.radius, cell = roundStep(extent.length / 4), lines = [];
  const [x, y] = CLIPS.some((clip) => clip.pinned) ? [0, 0] : extent.center;
  const disc = new T.Mesh(new T.CircleGeometry(radius, 96), paint(() => COLORS.paper, { transparent: true, opacity: 0.75, side: T.DoubleSide, roughness: 1 }));
  const shade = new T.Mesh(new T.CircleGeometry(radius, 96), new T.ShadowMaterial({ opacity: 0.24 }));
  shade.receiveShadow = true;
  for (let k = -Math.floor(radius / cell); k * cell <= radius; k++) {
    const half = Math.sqrt(Math.max(0, radius ** 2 - (k * cell) ** 2));
    lines.push(k * cell, -half, 0, k * cell, half, 0, -half, k * cell, 0, half, k * cell, 0);
  }
  const grid = new T.LineSegments(new T.BufferGeometry(), stroke(() => COLORS.line));
  grid.geometry.setAttribute("position", new T.BufferAttribute(new Float32Array(lines), 3));
  [disc, grid, shade].forEach((part, k) => {
    part.position.set(x, y, extent.ground + (k - 5) * 4e-4 * extent.length);
    part.renderOrder = k - 3;
    scene.add(part);
  });
}

const CORNERS = [[1, 1], [-1, 1], [-1, -1], [1, -1]], ROUND = 14;

/** A link: of a ribbon flat sides, the one of +y lighter; round where it is rigid. */
function makeLink(clip, k, color) {
  const m = clip.cuts[k + 1] - clip.cuts[k], rigid = clip.sides[k][0] === 0, c = rigid ? ROUND : 4, geometry = new T.BufferGeometry();
  const rows = rigid ? m : 2 * m, index = [], count = (rigid ? m * c : 2 * m * 4) + 8;
  for (let f = 0; f < c; f++)
    for (let j = 0; j + 1 < m; j++) {
      const [a, b] = rigid ? [j * c + f, j * c + ((f + 1) % c)] : [f * rows + 2 * j, f * rows + 2 * j + 1], next = rigid ? c : 2;
      index.push(a, b, a + next, b, b + next, a + next);
    }
  const cap = count - 8;
  if (!rigid) index.push(cap, cap + 1, cap + 2, cap, cap + 2, cap + 3, cap + 4, cap + 6, cap + 5, cap + 4, cap + 7, cap + 6);
  const light = new Float32Array(3 * count).fill(1);
  if (!rigid) light.fill(0.72, 3 * rows); // all sides but the first
  geometry.setAttribute("position", new T.BufferAttribute(new Float32Array(3 * count), 3));
  geometry.setAttribute("normal", new T.BufferAttribute(new Float32Array(3 * count), 3));
  geometry.setAttribute("color", new T.BufferAttribute(light, 3));
  geometry.setIndex(index);
  const mesh = new T.Mesh(geometry, paint(color, { vertexColors: true, side: T.DoubleSide }));
  mesh.castShadow = true;
  mesh.frustumCulled = false;
  const least = rigid ? [0.06, 0.06] : [0.03, 0.006];
  const half = clip.sides[k].map((side, d) => 0.5 * Math.max(side, least[d] * clip.length));
  return { mesh, m, c, rigid, half, first: clip.cuts[k], cap };
}

const V = () => new T.Vector3(), [p, q, along, across, up, normal] = [V(), V(), V(), V(), V(), V()];

function shapeLink(link, points, widths) {
  const position = link.mesh.geometry.attributes.position, facing = link.mesh.geometry.attributes.normal, ends = [];
  for (let j = 0; j < link.m; j++) {
    const o = 3 * (link.first + j), [a, b] = [Math.max(0, j - 1), Math.min(link.m - 1, j + 1)].map((i) => 3 * (link.first + i));
    p.fromArray(points, o);
    along.fromArray(points, b).sub(q.fromArray(points, a)).normalize();
    across.fromArray(widths, o).normalize();
    up.crossVectors(across, along).normalize();
    if (link.rigid) {
      for (let f = 0; f < link.c; f++) {
        const turn = (2 * Math.PI * f) / link.c;
        normal.copy(across).multiplyScalar(Math.cos(turn)).addScaledVector(up, Math.sin(turn)).toArray(facing.array, 3 * (j * link.c + f));
        q.copy(p).addScaledVector(normal, link.half[0]).toArray(position.array, 3 * (j * link.c + f));
      }
      continue;
    }
    const corners = CORNERS.map(([x, y]) => p.clone().addScaledVector(across, x * link.half[0]).addScaledVector(up, y * link.half[1]));
    for (let f = 0; f < 4; f++) {
      normal.copy(f % 2 ? across : up).multiplyScalar(f === 0 || f === 3 ? 1 : -1);
      [corners[f], corners[(f + 1) % 4]].forEach((corner, e) => {
        const at = 3 * (f * 2 * link.m + 2 * j + e);
        corner.toArray(position.array, at);
        normal.toArray(facing.array, at);
      });
    }
    if (j === 0 || j === link.m - 1) ends.push(corners.map((corner) => [corner, along.clone().multiplyScalar(j ? 1 : -1)]));
  }
  if (!link.rigid) ends.flat().forEach(([corner, way], k) => { corner.toArray(position.array, 3 * (link.cap + k)); way.toArray(facing.array, 3 * (link.cap + k)); });
  position.needsUpdate = facing.needsUpdate = true;
}

/** A line of so many points, none of them yet. */
function makeLine(count, material) {
  const made = new T.Line(new T.BufferGeometry(), material);
  made.geometry.setAttribute("position", new T.BufferAttribute(new Float32Array(3 * count), 3));
  made.frustumCulled = false;
  return made;
}

function makeRun(clip, k) {
  const group = new T.Group(), many = CLIPS.length > 1, own = () => runColor(many ? k : 0), L = clip.length;
  const tone = (i) => () => mix(i % 2 || many ? own() : COLORS.run2, i % 2 && many ? COLORS.ink : "#ffffff", i % 2 && many ? 0.2 : 0.15);
  const links = clip.sides.map((sides, i) => makeLink(clip, i, sides[0] === 0 ? () => COLORS.ghost : tone(i)));
  const ball = (radius, color) => {
    const made = new T.Mesh(new T.SphereGeometry(radius * L, 32, 16), paint(color));
    made.castShadow = true;
    return made;
  };
  const joints = clip.sides.map((_, i) => ball(i ? 0.024 : 0.034, () => COLORS.soft));
  joints[0].visible = clip.pinned;
  const payload = clip.payload ? ball(0.026, () => COLORS.payload) : null;
  const rigid = clip.rigid && makeLine(clip.links + 1, stroke(() => COLORS.ghost));
  const trace = makeLine(clip.t.length + 1, stroke(own, { transparent: true, opacity: 0.45 }));
  const recent = new T.Mesh(new T.BufferGeometry(), new T.MeshBasicMaterial({ transparent: true, opacity: 0.9 }));
  recent.frustumCulled = false;
  world.paints.push(() => recent.material.color.set(own()));
  let target = null;
  if (clip.target) {
    target = new T.Group();
    const color = paint(() => COLORS.target), ring = new T.Mesh(new T.TorusGeometry(0.035 * L, 0.006 * L, 12, 48), color);
    target.add(ring, new T.Mesh(new T.SphereGeometry(0.009 * L, 16, 12), color));
  }
  const plumbs = [clip.target && (() => COLORS.target), () => COLORS.payload].map((color) => color && makeLine(2, stroke(color, { transparent: true, opacity: 0.6 })));
  const pulls = clip.pulls.map((pull) => {
    const material = paint(() => COLORS[pull.shape.length > 1 ? "force" : "torque"]), part = new T.Group();
    part.add(new T.Mesh(new T.BufferGeometry(), material), new T.Mesh(new T.ConeGeometry(0.017 * L, 0.045 * L, 20), material));
    return part;
  });
  const walls = new T.Group();
  if (clip.walls) {
    const geometry = new T.BufferGeometry();
    geometry.setAttribute("position", new T.BufferAttribute(clip.walls, 3));
    geometry.computeVertexNormals();
    const body = new T.Mesh(geometry, paint(() => COLORS.wall, { transparent: true, opacity: 0.22, side: T.DoubleSide, depthWrite: false }));
    walls.add(body, new T.LineSegments(new T.EdgesGeometry(geometry, 30), stroke(() => COLORS.wall, { transparent: true, opacity: 0.6 })));
  }
  const parts = [...links.map((link) => link.mesh), ...joints, payload, rigid, trace, recent, target, ...plumbs, ...pulls, walls];
  group.add(...parts.filter(Boolean));
  world.scene.add(group);
  return { clip, k, group, links, joints, payload, rigid, trace, recent, target, plumbs, pulls, walls };
}

const turn = new T.Quaternion(), unit = V(), z = new T.Vector3(0, 0, 1), y = new T.Vector3(0, 1, 0);

function update(run) {
  const { clip } = run, i = last(clip.t, state.time), points = poseAt(clip, state.time), L = clip.length;
  const shown = (what) => !state.hidden.has(what), tip = points.subarray(-3);
  const widths = rowAt(clip, clip.across, 3 * clip.size, state.time);
  run.links.forEach((link) => shapeLink(link, points, widths));
  run.joints.forEach((joint, k) => joint.position.fromArray(points, 3 * clip.cuts[k]));
  if (run.payload) run.payload.position.fromArray(tip);
  if (run.rigid) {
    run.rigid.visible = shown("ghost");
    setLine(run.rigid, rowAt(clip, clip.rigid, 3 * (clip.links + 1), state.time));
  }
  const past = [...clip.tips.subarray(0, 3 * (i + 1)), ...tip], since = last(clip.t, state.time - 1);
  setLine(run.trace, past);
  setTube(run.recent, past.slice(3 * since), 0.0035 * L);
  run.trace.visible = run.recent.visible = shown("trace");
  const marked = clip.target && clip.target.subarray(3 * i, 3 * i + 3);
  if (run.target) {
    run.target.visible = run.plumbs[0].visible = shown("target");
    run.target.position.fromArray(marked);
    run.target.children[0].quaternion.copy(world.camera.quaternion);
  }
  [marked, tip].forEach((at, k) => run.plumbs[k] && setLine(run.plumbs[k], [...at, at[0], at[1], extent.ground]));
  clip.pulls.forEach((pull, k) => {
    run.pulls[k].visible = shown(pull.name) && drawPull(run.pulls[k], pull, i, points, L);
  });
  run.walls.visible = shown("walls");
}

function setLine(line, values) {
  const position = line.geometry.attributes.position;
  position.array.set(values.slice(0, position.array.length));
  position.needsUpdate = true;
  line.geometry.setDrawRange(0, Math.min(values.length, position.array.length) / 3);
}

/** A bar of six sides along a path: lines of a graphics card are one pixel wide. */
function setTube(mesh, path, radius) {
  const n = path.length / 3, position = new Float32Array(18 * n), index = [];
  for (let j = 0; j < n; j++) {
    along.fromArray(path, 3 * Math.min(n - 1, j + 1)).sub(q.fromArray(path, 3 * Math.max(0, j - 1))).normalize();
    across.crossVectors(Math.abs(along.z) < 0.9 ? z : y, along).normalize();
    up.crossVectors(along, across);
    for (let f = 0; f < 6; f++) {
      p.fromArray(path, 3 * j).addScaledVector(across, radius * Math.cos((f * Math.PI) / 3)).addScaledVector(up, radius * Math.sin((f * Math.PI) / 3));
      p.toArray(position, 18 * j + 3 * f);
      if (j + 1 < n) index.push(6 * j + f, 6 * j + ((f + 1) % 6), 6 * j + 6 + f, 6 * j + ((f + 1) % 6), 6 * j + 6 + ((f + 1) % 6), 6 * j + 6 + f);
    }
  }
  mesh.geometry.dispose();
  mesh.geometry = new T.BufferGeometry();
  mesh.geometry.setAttribute("position", new T.BufferAttribute(position, 3));
  mesh.geometry.setIndex(index);
}

/** A force as a straight arrow from its point; a torque as an arrow round its axis, three quarters of a turn at its largest. */
function drawPull(part, pull, i, points, L) {
  const [bar, tip] = part.children, most = pullsMost[pull.name] || 1;
  part.position.fromArray(points, 3 * pull.point);
  bar.geometry.dispose();
  if (pull.shape.length > 1) {
    unit.fromArray(pull.values, 3 * i);
    const long = (0.5 * L * unit.length()) / most;
    if (!(long > 0.01 * L)) return false;
    part.quaternion.setFromUnitVectors(y, unit.normalize());
    bar.geometry = new T.CylinderGeometry(0.006 * L, 0.006 * L, long, 12).translate(0, 0.5 * long, 0);
    tip.position.set(0, long, 0);
    tip.quaternion.identity();
    return true;
  }
  const share = Math.max(-1.1, Math.min(1.1, pull.values[i] / most)), radius = 0.085 * L;
  if (!(Math.abs(share) > 0.02)) return false;
  part.quaternion.setFromUnitVectors(z, unit.fromArray(pull.axis, 3 * i).multiplyScalar(share < 0 ? -1 : 1).normalize());
  const arc = 1.5 * Math.PI * Math.abs(share);
  bar.geometry = new T.TorusGeometry(radius, 0.006 * L, 10, 48, arc);
  tip.position.set(radius * Math.cos(arc), radius * Math.sin(arc), 0);
  tip.quaternion.setFromUnitVectors(y, unit.set(-Math.sin(arc), Math.cos(arc), 0));
  tip.scale.setScalar(Math.min(1, 8 * Math.abs(share)));
  return true;
}

// --------------------------------------------------------------------- view
const VIEWS = { corner: [-58, 20], front: [-90, 4], side: [0, 4], top: [-90, 89.9], tip: [-40, 25] }; // azimuth and height, degrees

/** From where it is looked at. */
function look(name) {
  const { camera, controls } = world, [azimuth, height] = VIEWS[name].map((v) => (v * Math.PI) / 180), near = name === "tip";
  const [w, h] = [stage.clientWidth || 1, stage.clientHeight || 1], half = Math.tan((camera.fov * Math.PI) / 360) * Math.min(1, w / h);
  const far = (near ? 0.35 * extent.length : 1.08 * extent.radius) / half;
  controls.target.fromArray(near ? Array.from(poseAt(CLIPS[0], state.time).subarray(-3)) : extent.center);
  camera.position.set(Math.cos(azimuth) * Math.cos(height), Math.sin(azimuth) * Math.cos(height), Math.sin(height)).multiplyScalar(far).add(controls.target);
  $("view").value = name;
  if (near) $("follow").checked = true;
  world.followed = null;
  controls.update();
  if (world.sized) later();
}

function follow() {
  const { camera, controls } = world, tip = V().fromArray(poseAt(CLIPS[0], state.time), 3 * CLIPS[0].size - 3);
  if ($("follow").checked && world.followed) {
    const way = tip.clone().sub(world.followed);
    camera.position.add(way);
    controls.target.add(way);
  }
  world.followed = tip;
}

function drawStage() {
  if (!world) return;
  const { renderer, scene, camera, sun, span } = world, [width, height] = [stage.clientWidth, stage.clientHeight];
  const ratio = Math.min(2, window.devicePixelRatio || 1);
  if (renderer.getPixelRatio() !== ratio) renderer.setPixelRatio(ratio);
  if (stage.width !== Math.floor(width * ratio) || stage.height !== Math.floor(height * ratio)) {
    renderer.setSize(width, height, false);
    if (!world.sized) look($("view").value);
    world.sized = true;
  }
  if (world.colors !== COLORS) {
    world.colors = COLORS;
    world.paints.forEach((own) => own());
    scene.background = new T.Color(COLORS.panel);
  }
  follow();
  const middle = $("follow").checked ? world.controls.target.toArray() : extent.center;
  sun.target.position.fromArray(middle);
  sun.position.fromArray(middle).add(V().set(-0.5, -1.0, 2.2).multiplyScalar(1.4 * span));
  world.runs.forEach(update);
  const groups = state.beside ? world.runs.map((run) => [run]) : [world.runs], columns = width >= height ? groups.length : 1;
  const [w, h] = [width / columns, (height * columns) / groups.length];
  camera.aspect = w / h;
  camera.updateProjectionMatrix();
  renderer.setScissorTest(groups.length > 1);
  groups.forEach((runs, k) => {
    world.runs.forEach((run) => { run.group.visible = runs.includes(run) && !state.hidden.has(`run ${run.k}`); });
    const place = [(k % columns) * w, height - h * (1 + Math.floor(k / columns)), w, h];
    renderer.setViewport(...place);
    renderer.setScissor(...place);
    renderer.render(scene, camera);
  });
}

function tipText(clip) {
  const at = pose(clip, last(clip.t, state.time)).subarray(-3);
  return `tip at x ${short(at[0])} m, y ${short(at[1])} m, z ${short(at[2])} m`;
}

let pressed = null;
stage.addEventListener("pointerdown", (event) => { pressed = [event.clientX, event.clientY]; });
const dragged = (event) => pressed && Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) > 4;
const STAGE_KEYS = Object.fromEntries(Object.keys(VIEWS).map((name, k) => [String(k + 1), () => world && look(name)]));
STAGE_KEYS.c = () => { $("follow").checked = !$("follow").checked; later(); };
const HOOKS = { camera: () => world && world.camera.position.toArray(), aim: () => world && world.controls.target.toArray(), look };

document.body.classList.add("in-space");
$("magnify-label").hidden = true;
$("view-label").hidden = $("follow-label").hidden = false;
readColors();
survey();
try {
  makeWorld(new T.WebGLRenderer({ canvas: stage, antialias: true }));
} catch (fault) {
  if (world) throw fault;
  const told = document.createElement("p");
  told.textContent = "The arm cannot be drawn here: this browser has no WebGL. Its charts can.";
  stage.replaceWith(told);
}
$("view").addEventListener("change", (event) => world && look(event.target.value));
$("follow").addEventListener("change", () => later());
