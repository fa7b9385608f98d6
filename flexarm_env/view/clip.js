"use strict";
// What is shown: the clips of the block "data", time, colours, and pens. Then comes the stage, arm.js of arms in the plane
// or space.js of arms in space, and player.js, the rest. Positions in m, angles in rad, times in s.

const $ = (id) => document.getElementById(id);

// ------------------------------------------------------------------ numbers
const KINDS = { f8: Float64Array, f4: Float32Array, i2: Int16Array };

/** An array as it was packed: values in one flat array, shape beside it. */
function unpack(packed) {
  const text = atob(packed.data), bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  const raw = new KINDS[packed.kind](bytes.buffer);
  if (packed.kind !== "i2") return { values: raw, shape: packed.shape };
  const values = Float64Array.from(raw, (k) => (k === -32768 ? NaN : packed.low + (k + 32767) * packed.step));
  return { values, shape: packed.shape };
}

function load(clip) {
  for (const [name, value] of Object.entries(clip)) if (value && value.kind) clip[name] = unpack(value).values;
  if (Array.isArray(clip.walls)) clip.walls = clip.walls.map((wall) => unpack(wall).values);
  for (const pull of clip.pulls) {
    if (pull.axis) pull.axis = unpack(pull.axis).values;
    ({ values: pull.values, shape: pull.shape } = unpack(pull.values));
  }
  for (const chart of clip.charts)
    for (const name of Object.keys(chart.series)) chart.series[name] = unpack(chart.series[name]).values;
  clip.links = clip.cuts.length - 1;
  return clip;
}

const DATA = JSON.parse($("data").textContent);
const CLIPS = DATA.clips.map(load);

/** The instants of all clips, each once. */
const TIMES = (() => {
  const all = CLIPS.flatMap((clip) => Array.from(clip.t)).sort((a, b) => a - b);
  return all.filter((t, i) => i === 0 || t - all[i - 1] > 1e-9);
})();

/** Index of the last instant that is not later than t. */
function last(times, t) {
  let low = 0, high = times.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (times[middle] <= t + 1e-9) low = middle;
    else high = middle - 1;
  }
  return low;
}

/** The largest of 1, 2, 5 times a power of ten that is not above x. */
function roundStep(x) {
  const power = 10 ** Math.floor(Math.log10(x) + 1e-9);
  return [5, 2, 1].map((k) => k * power).find((k) => k <= x * (1 + 1e-9));
}

/** A number in four digits. */
function short(x) {
  if (!Number.isFinite(x)) return "–";
  const size = Math.abs(x);
  const text = size !== 0 && (size < 1e-3 || size >= 1e5) ? x.toExponential(2) : String(Number(x.toPrecision(4)));
  return text.replaceAll("-", "−");
}

/** How many runs are drawn over run k (4 at most): what lies below is drawn wider, so that equal curves are both seen. */
const over = (k) => Math.min(4, CLIPS.length - 1 - k);

// -------------------------------------------------------------------- state
const state = { time: TIMES[0], magnify: 1, playing: false, speed: 1, beside: false, hidden: new Set() };
const extent = { curvature: Math.max(...CLIPS.map((c) => (c.curvature || []).reduce((m, v) => Math.max(m, Math.abs(v)), 0))) };
const pullsMost = {}; // by name: the size at which an arrow is longest, over all clips
for (const clip of CLIPS)
  for (const p of clip.pulls) pullsMost[p.name] = Math.max(pullsMost[p.name] || 0, p.most);

// ------------------------------------------------------------------- colour
let COLORS = {};
function readColors() {
  const style = getComputedStyle(document.documentElement);
  const names = ["paper", "panel", "ink", "soft", "line", "grid", "ghost", "accent", "target", "torque", "force", "payload", "wall",
    "bend-low", "bend-none", "bend-high", "run0", "run1", "run2", "run3", "run4", "run5"];
  COLORS = Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}
const runColor = (k) => COLORS[`run${k % 6}`];
const DASHES = [[], [6, 3], [2, 3], [9, 3, 2, 3], [4, 2], [1, 2]];

function mix(from, to, share) {
  const part = (color, k) => parseInt(color.slice(1 + 2 * k, 3 + 2 * k), 16);
  return `rgb(${[0, 1, 2].map((k) => Math.round(part(from, k) + share * (part(to, k) - part(from, k)))).join(",")})`;
}
// -------------------------------------------------------------------- stage
const stage = $("stage");

/** A canvas of the size it has on the page, in device pixels; its pen in CSS pixels. */
function fit(canvas) {
  const ratio = window.devicePixelRatio || 1, box = canvas.getBoundingClientRect();
  const [w, h] = [Math.max(1, Math.round(box.width * ratio)), Math.max(1, Math.round(box.height * ratio))];
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, box.width, box.height);
  return [pen, box.width, box.height];
}
const em = () => parseFloat(getComputedStyle(document.documentElement).fontSize);

function disc(pen, [x, y], radius, fill, edge, wide = 2) {
  pen.beginPath();
  pen.arc(x, y, radius, 0, 2 * Math.PI);
  if (fill) { pen.fillStyle = fill; pen.fill(); }
  if (edge) { pen.strokeStyle = edge; pen.lineWidth = wide; pen.stroke(); }
}
