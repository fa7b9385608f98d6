// The arm of the plane on the stage; behind clip.js in the same script. x to the right, y up.

for (const clip of CLIPS) {
  clip.size = clip.cuts[clip.links] + 1; // points of the chain
  clip.reach = clip.cuts.slice(1).reduce((sum, b) => sum + Math.hypot(clip.rest[2 * b], clip.rest[2 * b + 1]), 0);
}

// ----------------------------------------------------------------- geometry
/** Points of the rigid arm at the same joint angles. */
function ghost(clip, i) {
  let x = clip.root[2 * i], y = clip.root[2 * i + 1];
  const out = [x, y];
  for (let k = 0; k < clip.links; k++) {
    const angle = clip.rigid[i * clip.links + k], c = Math.cos(angle), s = Math.sin(angle);
    for (let j = clip.cuts[k] + 1; j <= clip.cuts[k + 1]; j++) {
      const [along, across] = [clip.rest[2 * j], clip.rest[2 * j + 1]];
      out.push(x + c * along - s * across, y + s * along + c * across);
    }
    [x, y] = out.slice(-2);
  }
  return out;
}

/** Points of the chain at instant i, deflection times m about the rigid arm (as `flexarm_env.view.magnified`). */
function pose(clip, i, m) {
  const n = clip.size, p = clip.points.subarray(2 * n * i, 2 * n * (i + 1)), out = new Float64Array(2 * n);
  let x = clip.root[2 * i], y = clip.root[2 * i + 1];
  for (let k = 0; k < clip.links; k++) {
    const a = clip.cuts[k], b = clip.cuts[k + 1], angle = clip.angles[2 * (i * clip.links + k)];
    const rigid = clip.rigid[i * clip.links + k];
    const turned = rigid + m * (angle - rigid);
    const c = Math.cos(angle), s = Math.sin(angle), C = Math.cos(turned), S = Math.sin(turned);
    for (let j = a; j <= b; j++) {
      const dx = p[2 * j] - p[2 * a], dy = p[2 * j + 1] - p[2 * a + 1];
      const bow = j > a ? clip.rest[2 * j + 1] : 0, along = c * dx + s * dy, across = bow + m * (c * dy - s * dx - bow);
      out[2 * j] = x + C * along - S * across;
      out[2 * j + 1] = y + S * along + C * across;
    }
    x = out[2 * b];
    y = out[2 * b + 1];
  }
  return out;
}

/** The pose at a time, straight between instants. */
function poseAt(clip, t, m) {
  const i = last(clip.t, t), here = pose(clip, i, m);
  if (i + 1 >= clip.t.length || t - clip.t[i] < 1e-9) return here;
  const share = (t - clip.t[i]) / (clip.t[i + 1] - clip.t[i]), next = pose(clip, i + 1, m);
  return here.map((value, j) => value + share * (next[j] - value));
}

/** What depends on the magnification: the tips' paths and the box that holds everything. */
function survey() {
  let [x0, x1, y0, y1] = [Infinity, -Infinity, Infinity, -Infinity];
  const include = (points) => {
    for (let j = 0; j < points.length; j += 2) {
      x0 = Math.min(x0, points[j]); x1 = Math.max(x1, points[j]);
      y0 = Math.min(y0, points[j + 1]); y1 = Math.max(y1, points[j + 1]);
    }
  };
  for (const clip of CLIPS) {
    const n = clip.t.length, tips = new Float64Array(2 * n);
    for (let i = 0; i < n; i++) {
      const points = pose(clip, i, state.magnify);
      tips.set(points.subarray(-2), 2 * i);
      include(points);
      include(ghost(clip, i));
    }
    clip.tips = tips;
    if (clip.target) include(clip.target);
  }
  const reach = Math.max(...CLIPS.map((c) => c.reach));
  extent.center = [(x0 + x1) / 2, (y0 + y1) / 2];
  extent.half = [Math.max((x1 - x0) / 2, 0.3 * reach), Math.max((y1 - y0) / 2, 0.3 * reach)];
  extent.follow = Math.max(x1 - x0, y1 - y0) > 4 * reach; // a body that flies off: the view goes with it
  if (extent.follow) extent.half = [0.9 * reach, 0.9 * reach];
}

function bendColor(curvature) {
  const share = Math.max(-1, Math.min(1, curvature / (extent.curvature || 1)));
  return mix(COLORS["bend-none"], COLORS[share < 0 ? "bend-low" : "bend-high"], Math.abs(share));
}

function drawStage() {
  const [pen, width, height] = fit(stage);
  const groups = state.beside ? CLIPS.map((clip) => [clip]) : [CLIPS];
  const columns = width >= 1.1 * height ? groups.length : Math.ceil(groups.length / Math.max(1, Math.round(height / width * groups.length)));
  const rows = Math.ceil(groups.length / columns), [w, h] = [width / columns, height / rows];
  groups.forEach((clips, k) => {
    pen.save();
    pen.beginPath();
    pen.rect((k % columns) * w, Math.floor(k / columns) * h, w, h);
    pen.clip();
    pen.translate((k % columns) * w, Math.floor(k / columns) * h);
    drawPanel(pen, w, h, clips);
    if (k) { pen.strokeStyle = COLORS.line; pen.lineWidth = 1; pen.strokeRect(0, 0, w, h); }
    pen.restore();
  });
}

function drawPanel(pen, width, height, clips) {
  const room = 2.2 * em();
  const scale = Math.min((width - 2 * room) / (2 * extent.half[0]), (height - 2 * room) / (2 * extent.half[1]));
  const poses = clips.map((clip) => poseAt(clip, state.time, state.magnify));
  let center = extent.center;
  if (extent.follow) {
    const sum = [0, 0], count = poses.reduce((n, p) => n + p.length / 2, 0);
    poses.forEach((p) => p.forEach((v, j) => { sum[j % 2] += v; }));
    center = sum.map((v) => v / count);
  }
  const at = (x, y) => [width / 2 + (x - center[0]) * scale, height / 2 - (y - center[1]) * scale];
  drawGrid(pen, width, height, scale, center, at);
  const shown = (what) => !state.hidden.has(what);
  for (const wall of clips[0].walls && shown("walls") ? clips[0].walls : []) {
    line(pen, [...wall, wall[0], wall[1]], at, COLORS.wall, 1.5, []);
    Object.assign(pen, { fillStyle: COLORS.wall, globalAlpha: 0.15 });
    pen.fill();
    pen.globalAlpha = 1;
  }
  clips.forEach((clip, k) => {
    const i = last(clip.t, state.time), own = runColor(CLIPS.indexOf(clip));
    if (!shown(`run ${CLIPS.indexOf(clip)}`)) return;
    if (shown("ghost")) line(pen, ghost(clip, i), at, COLORS.ghost, 2, [5, 4]);
    if (shown("trace")) {
      const since = last(clip.t, state.time - 1.0);
      line(pen, clip.tips.subarray(0, 2 * (i + 1)), at, own, 1, [], 0.45);
      line(pen, [...clip.tips.subarray(2 * since, 2 * (i + 1)), ...poses[k].subarray(-2)], at, own, 2.2, [], 0.9);
    }
  });
  clips.forEach((clip) => { if (clip.target && shown("target")) drawTarget(pen, clip, at); });
  clips.forEach((clip, k) => {
    if (!shown(`run ${CLIPS.indexOf(clip)}`)) return;
    if (clip.base) drawBase(pen, clip.base[last(clip.t, state.time)], at(...poses[k]));
    drawLinks(pen, clip, poses[k], at);
    for (const pull of clip.pulls) if (shown(pull.name)) drawPull(pen, clip, pull, poses[k], at, Math.min(width, height));
  });
  if (state.beside) {
    pen.fillStyle = COLORS.ink;
    pen.font = `600 ${em()}px system-ui, sans-serif`;
    pen.textBaseline = "top";
    pen.fillText(clips[0].label, 0.7 * em(), 0.6 * em(), width - em());
  }
}

function drawGrid(pen, width, height, scale, center, at) {
  const cell = roundStep(Math.max(6 * em(), Math.min(width, height) / 4) / scale);
  pen.font = `${0.75 * em()}px system-ui, sans-serif`;
  pen.textBaseline = "alphabetic";
  for (const axis of [0, 1]) {
    const half = (axis ? height : width) / 2 / scale;
    for (let k = Math.ceil((center[axis] - half) / cell); k * cell <= center[axis] + half; k++) {
      const [x, y] = at(k * cell, k * cell);
      pen.fillStyle = k === 0 ? COLORS.line : COLORS.grid;
      if (axis) pen.fillRect(0, Math.round(y), width, 1);
      else pen.fillRect(Math.round(x), 0, 1, height);
      pen.fillStyle = COLORS.soft;
      const text = short(k * cell), wide = pen.measureText(text).width;
      if (!axis && x > wide && x < width - 2.5 * wide - em()) pen.fillText(text, x + 3, height - 4);
      if (axis && y > (state.beside ? 3.2 : 1) * em() && y < height - 1.5 * em()) pen.fillText(text, 4, y - 3);
    }
  }
  const unit = "m", wide = pen.measureText(unit).width;
  pen.fillText(unit, width - wide - 6, height - 4);
}

function line(pen, points, at, color, width, dash, alpha = 1) {
  pen.beginPath();
  for (let j = 0; j + 1 < points.length; j += 2) {
    const [x, y] = at(points[j], points[j + 1]);
    if (j) pen.lineTo(x, y);
    else pen.moveTo(x, y);
  }
  Object.assign(pen, { strokeStyle: color, lineWidth: width, lineJoin: "round", lineCap: "round", globalAlpha: alpha });
  pen.setLineDash(dash);
  pen.stroke();
  pen.setLineDash([]);
  pen.globalAlpha = 1;
}

/** The links: a smooth line through the points, each piece in the colour of its curvature. */
function drawLinks(pen, clip, points, at) {
  const i = last(clip.t, state.time), unit = em() / 15;
  const color = CLIPS.length > 1 && !state.beside ? runColor(CLIPS.indexOf(clip)) : COLORS.ink;
  for (let k = 0; k < clip.links; k++) {
    const a = clip.cuts[k], b = clip.cuts[k + 1], knots = [];
    for (let j = a; j <= b; j++) knots.push(at(points[2 * j], points[2 * j + 1]));
    const curve = smooth(knots), wide = (8 - (2.5 * k) / clip.links) * unit;
    pen.lineCap = pen.lineJoin = "round";
    pen.lineWidth = wide + (3 + (state.beside ? 0 : 4.5 * over(CLIPS.indexOf(clip)))) * unit;
    pen.strokeStyle = color;
    pen.beginPath();
    curve.forEach(([x, y], j) => (j ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    pen.stroke();
    pen.lineWidth = wide;
    const fine = (curve.length - 1) / (knots.length - 1);
    for (let j = 0; j + 1 < curve.length; j++) {
      const from = Math.floor(j / fine), share = (j + 0.5) / fine - from, row = i * clip.size + a + from;
      pen.strokeStyle = bendColor((1 - share) * clip.curvature[row] + share * clip.curvature[row + 1]);
      pen.beginPath();
      pen.moveTo(...curve[j]);
      pen.lineTo(...curve[j + 1]);
      pen.stroke();
    }
  }
  for (let k = 0; k < clip.links; k++) {
    const where = at(points[2 * clip.cuts[k]], points[2 * clip.cuts[k] + 1]);
    if (k || clip.pinned || clip.base) disc(pen, where, (k ? 6 : 9) * unit, COLORS.panel, COLORS.ink, 3 * unit);
  }
  if (clip.payload) disc(pen, at(...points.subarray(-2)), 7 * unit, COLORS.payload, COLORS.panel, 1.5 * unit);
}

/** A body that floats, with panels to both sides, and a mark where it points to. */
function drawBase(pen, attitude, [x, y]) {
  const unit = em() / 15;
  pen.save();
  pen.translate(x, y);
  pen.rotate(-attitude);
  Object.assign(pen, { fillStyle: COLORS.grid, strokeStyle: COLORS.soft, lineWidth: 1.5 * unit });
  for (const box of [[-6, -58, 12, 36], [-6, 22, 12, 36], [-17, -17, 34, 34]]) {
    pen.fillRect(...box.map((v) => v * unit));
    pen.strokeRect(...box.map((v) => v * unit));
  }
  line(pen, [0, 0, 17 * unit, 0], (a, b) => [a, b], COLORS.soft, 2 * unit, []);
  pen.restore();
}

/** A finer line through knots: cubics with slopes from the neighbours. */
function smooth(knots, pieces = 4) {
  if (knots.length < 3) return knots;
  const slope = (j) => {
    const p = knots[Math.max(0, j - 1)], q = knots[Math.min(knots.length - 1, j + 1)], one = j > 0 && j + 1 < knots.length;
    return [0, 1].map((axis) => (q[axis] - p[axis]) * (one ? 0.5 : 1));
  };
  const out = [knots[0]];
  for (let j = 0; j + 1 < knots.length; j++) {
    const [p, q, u, v] = [knots[j], knots[j + 1], slope(j), slope(j + 1)];
    for (let k = 1; k <= pieces; k++) {
      const s = k / pieces, a = (2 * s - 3) * s * s + 1, b = ((s - 2) * s + 1) * s, c = (3 - 2 * s) * s * s, d = (s - 1) * s * s;
      out.push([0, 1].map((axis) => a * p[axis] + b * u[axis] + c * q[axis] + d * v[axis]));
    }
  }
  return out;
}

function drawTarget(pen, clip, at) {
  const i = last(clip.t, state.time), goal = [clip.target[2 * i], clip.target[2 * i + 1]], unit = em() / 15;
  const root = [clip.root[2 * i], clip.root[2 * i + 1]];
  if (clip.polar) line(pen, [...root, ...goal], at, COLORS.target, 1.5, [3, 5]);
  disc(pen, at(...goal), 11 * unit, null, COLORS.panel, 5 * unit);
  disc(pen, at(...goal), 11 * unit, null, COLORS.target, 2.5 * unit);
  disc(pen, at(...goal), 2.5 * unit, COLORS.target);
}

/** A force as a straight arrow from its point; a torque as an arrow round it, three quarters of a turn at its largest. */
function drawPull(pen, clip, pull, points, at, side) {
  const i = last(clip.t, state.time), [x, y] = at(points[2 * pull.point], points[2 * pull.point + 1]), unit = em() / 15;
  const most = pullsMost[pull.name] || 1, color = pull.shape.length > 1 ? COLORS.force : COLORS.torque;
  Object.assign(pen, { strokeStyle: color, fillStyle: color, lineWidth: 3.2 * unit, lineCap: "butt" });
  if (pull.shape.length > 1) {
    const [fx, fy] = [pull.values[2 * i], pull.values[2 * i + 1]], long = (0.3 * side * Math.hypot(fx, fy)) / most;
    if (long < 2) return;
    const turn = Math.atan2(-fy, fx), end = [x + long * Math.cos(turn), y + long * Math.sin(turn)];
    pen.beginPath();
    pen.moveTo(x, y);
    pen.lineTo(...end);
    pen.stroke();
    head(pen, end, turn, 8 * unit);
    return;
  }
  const share = Math.max(-1.1, Math.min(1.1, pull.values[i] / most)), radius = (pull.point ? 19 : 24) * unit;
  if (Math.abs(share) < 0.01) return;
  const sweep = -share * 1.5 * Math.PI, from = -Math.PI / 2; // counter-clockwise is positive, and up on a screen is -y
  pen.beginPath();
  pen.arc(x, y, radius, from, from + sweep, share > 0);
  pen.stroke();
  const to = from + sweep, way = to + (share > 0 ? -Math.PI / 2 : Math.PI / 2);
  head(pen, [x + radius * Math.cos(to), y + radius * Math.sin(to)], way, Math.min(7 * unit, 0.6 * radius * Math.abs(sweep)));
}

function head(pen, [x, y], turn, size) {
  pen.beginPath();
  for (const [along, across] of [[1.3, 0], [-0.5, 0.8], [-0.5, -0.8]])
    pen.lineTo(x + size * (along * Math.cos(turn) - across * Math.sin(turn)), y + size * (along * Math.sin(turn) + across * Math.cos(turn)));
  pen.fill();
}

/** Where the tip is, in words. */
function tipText(clip) {
  const p = pose(clip, last(clip.t, state.time), 1).subarray(-2);
  return `tip at x ${short(p[0])} m, y ${short(p[1])} m`;
}
const dragged = () => false; // what a press on the stage means
const STAGE_KEYS = {}, HOOKS = {};
