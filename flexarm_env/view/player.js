// Charts, legend, controls; behind arm.js in the same script.

// ------------------------------------------------------------------- charts
/** One chart a title, with the curves of all clips: { title, canvas, curves: [{ clip, name, values, color, dash, told }] }. */
const CHARTS = [];

function makeCharts() {
  const titles = [...new Set(CLIPS.flatMap((clip) => clip.charts.map((chart) => chart.title)))];
  for (const title of titles) {
    const box = make("article", "chart"), canvas = make("canvas"), list = make("ul");
    box.append(Object.assign(make("h2"), { textContent: title }), canvas, list);
    canvas.setAttribute("role", "img");
    list.setAttribute("aria-label", `Curves of ${title}; each can be hidden`);
    const chart = { title, canvas, curves: [] };
    const many = CLIPS.length > 1, names = new Set();
    CLIPS.forEach((clip, run) => {
      const own = clip.charts.find((c) => c.title === title);
      for (const [name, values] of Object.entries(own ? own.series : {})) {
        names.add(name);
        const k = [...names].indexOf(name);
        chart.curves.push({ clip, run, name, values, color: many ? run : k, dash: DASHES[many ? k % 6 : Math.floor(k / 6) % 6], hidden: k >= 6 });
      }
    });
    for (const name of names) {
      const own = chart.curves.filter((curve) => curve.name === name), color = () => (many ? COLORS.ink : runColor(own[0].color));
      const told = entry(list, name, () => `<line x1="0" y1="8" x2="26" y2="8" stroke="${color()}" stroke-width="3" stroke-dasharray="${own[0].dash}"/>`,
        !own[0].hidden, (on) => { own.forEach((curve) => { curve.hidden = !on; }); chart.base = null; });
      for (const curve of own) {
        curve.told = make("span", many ? `run${curve.run % 6}` : "");
        told.output.append(curve.told);
      }
    }
    scrub(chart);
    CHARTS.push(chart);
    $("charts").append(box);
  }
}

/** Room on the left of a chart for numbers, and the places of a time and a value. */
function axes(chart, width, height) {
  const left = 3.6 * em(), right = 0.5 * em(), top = 0.5 * em(), bottom = 1.3 * em();
  const [t0, t1] = [TIMES[0], Math.max(TIMES[TIMES.length - 1], TIMES[0] + 1e-9)];
  const [low, high] = chart.range;
  return { left, right: width - right, top, bottom: height - bottom, t0, t1,
    x: (t) => left + ((t - t0) / (t1 - t0)) * (width - left - right),
    y: (v) => height - bottom - ((v - low) / (high - low)) * (height - top - bottom) };
}

function drawChart(chart) {
  const [pen, width, height] = fit(chart.canvas);
  const shown = chart.curves.filter((curve) => !curve.hidden && !state.hidden.has(`run ${curve.run}`));
  if (!chart.base || chart.base.width !== chart.canvas.width || chart.base.height !== chart.canvas.height) {
    let low = Infinity, high = -Infinity;
    for (const curve of shown) for (const v of curve.values) if (v === v) { low = Math.min(low, v); high = Math.max(high, v); }
    if (low > high) [low, high] = [0, 1];
    const least = Math.max(1e-12, 1e-6 * Math.max(Math.abs(low), Math.abs(high)));
    if (high - low < least) [low, high] = [low - least, high + least];
    chart.range = [low - 0.06 * (high - low), high + 0.06 * (high - low)];
    chart.base = document.createElement("canvas");
    [chart.base.width, chart.base.height] = [chart.canvas.width, chart.canvas.height];
    const own = chart.base.getContext("2d");
    own.setTransform(pen.getTransform());
    drawCurves(own, chart, shown, width, height);
  }
  pen.save();
  pen.setTransform(1, 0, 0, 1, 0, 0);
  pen.drawImage(chart.base, 0, 0);
  pen.restore();
  const frame = axes(chart, width, height), x = frame.x(state.time);
  pen.fillStyle = COLORS.ink;
  pen.fillRect(Math.round(x) - 0.5, frame.top, 1.5, frame.bottom - frame.top);
  const told = [];
  for (const curve of chart.curves) {
    const value = curve.values[last(curve.clip.t, state.time)];
    curve.told.textContent = short(value);
    if (!shown.includes(curve)) continue;
    told.push(`${CLIPS.length > 1 ? `${curve.clip.label}, ` : ""}${curve.name} ${short(value)}`);
    if (Number.isFinite(value)) disc(pen, [x, frame.y(value)], 3.5, runColor(curve.color), COLORS.panel, 1);
  }
  if (!state.playing) chart.canvas.setAttribute("aria-label", `${chart.title} over time; at ${clock()}: ${told.join(", ")}`);
}

function drawCurves(pen, chart, curves, width, height) {
  const frame = axes(chart, width, height), [low, high] = chart.range;
  pen.font = `${0.72 * em()}px system-ui, sans-serif`;
  pen.textBaseline = "middle";
  const rise = roundStep((high - low) / 2.5);
  for (let k = Math.ceil(low / rise); k * rise <= high; k++) {
    const y = Math.round(frame.y(k * rise));
    pen.fillStyle = k === 0 ? COLORS.ghost : COLORS.grid;
    pen.fillRect(frame.left, y, frame.right - frame.left, 1);
    pen.fillStyle = COLORS.soft;
    pen.textAlign = "right";
    pen.fillText(short(k * rise), frame.left - 5, y, frame.left - 6);
  }
  const run = roundStep((frame.t1 - frame.t0) / 3.5);
  pen.textAlign = "center";
  for (let k = Math.ceil(frame.t0 / run); k * run <= frame.t1 + 1e-9; k++) {
    const x = frame.x(k * run);
    pen.fillStyle = COLORS.grid;
    pen.fillRect(Math.round(x), frame.top, 1, frame.bottom - frame.top);
    pen.fillStyle = COLORS.soft;
    const text = short(k * run) + ((k + 1) * run > frame.t1 + 1e-9 ? " s" : "");
    pen.fillText(text, Math.min(x, frame.right - pen.measureText(text).width / 2), height - 0.5 * em());
  }
  pen.lineJoin = "round";
  for (const curve of curves) {
    pen.beginPath();
    let up = true;
    curve.values.forEach((v, i) => {
      if (v !== v) up = true;
      else if (up) { pen.moveTo(frame.x(curve.clip.t[i]), frame.y(v)); up = false; }
      else pen.lineTo(frame.x(curve.clip.t[i]), frame.y(v));
    });
    pen.setLineDash(curve.dash);
    pen.strokeStyle = runColor(curve.color);
    pen.lineWidth = (CLIPS.length > 1 ? 1.4 : 1.8) + 3 * over(curve.run);
    pen.stroke();
  }
  pen.setLineDash([]);
}

/** A press or a drag on a chart moves the cursor. */
function scrub(chart) {
  const go = (event) => {
    const box = chart.canvas.getBoundingClientRect(), frame = axes(chart, box.width, box.height);
    const share = (event.clientX - box.left - frame.left) / (frame.right - frame.left);
    pause();
    seek(nearest(frame.t0 + share * (frame.t1 - frame.t0)));
  };
  chart.canvas.addEventListener("pointerdown", (event) => { chart.canvas.setPointerCapture(event.pointerId); go(event); });
  chart.canvas.addEventListener("pointermove", (event) => { if (event.buttons) go(event); });
}

// ------------------------------------------------------------------- legend
function make(tag, name = "") {
  const element = document.createElement(tag);
  if (name) element.className = name;
  return element;
}

/** An entry of a legend: a sign, a name, a value; a press hides what it stands for. sign: gives the inside of an svg. */
function entry(list, label, sign, on, change) {
  const button = Object.assign(make("button"), { type: "button" }), mark = make("span"), output = make("output");
  const draw = () => { mark.innerHTML = `<svg viewBox="0 0 26 16" aria-hidden="true">${sign()}</svg>`; };
  button.append(mark, label, output);
  button.setAttribute("aria-pressed", String(on));
  button.addEventListener("click", () => {
    const now = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", String(now));
    change(now);
    later();
  });
  const item = make("li");
  item.append(button);
  list.append(item);
  SIGNS.push(draw);
  draw();
  return { label, output };
}
const SIGNS = []; // redrawn when colours change
const PULLS = []; // { name, output }

function makeLegend() {
  const list = $("legend"), toggle = (what) => (on) => {
    if (on) state.hidden.delete(what);
    else state.hidden.add(what);
    CHARTS.forEach((chart) => { chart.base = null; });
  };
  const stroke = (color, more = "") => `<line x1="0" y1="8" x2="26" y2="8" stroke="${color}" stroke-width="3" ${more}/>`;
  const add = (what, label, sign) => entry(list, label, sign, true, toggle(what));
  CLIPS.forEach((clip, k) => {
    const color = () => (CLIPS.length > 1 ? runColor(k) : COLORS.ink);
    add(`run ${k}`, (CLIPS.length > 1 ? clip.label : clip.links > 1 ? "flexible links" : "flexible link"),
      () => `${stroke(color(), 'stroke-linecap="round"').replace('"3"', '"9"')}${stroke(COLORS["bend-none"], 'stroke-linecap="round"').replace('"3"', '"5"')}`);
  });
  if (CLIPS.some((clip) => clip.rigid)) add("ghost", "rigid arm, same joint angles", () => stroke(COLORS.ghost, 'stroke-dasharray="5 4"'));
  if (CLIPS.some((clip) => clip.walls)) add("walls", "obstacle", () => `<rect x="4" y="1" width="18" height="14" fill="${COLORS.wall}" fill-opacity="0.25" stroke="${COLORS.wall}"/>`);
  add("trace", "path of the tip, last second bold", () => stroke(CLIPS.length > 1 ? COLORS.soft : runColor(0)));
  if (CLIPS.some((clip) => clip.target))
    add("target", "target", () => `<circle cx="13" cy="8" r="6" fill="none" stroke="${COLORS.target}" stroke-width="2.5"/><circle cx="13" cy="8" r="1.8" fill="${COLORS.target}"/>`);
  const arrows = new Map(CLIPS.flatMap((clip) => clip.pulls.map((pull) => [pull.name, pull])));
  for (const [name, pull] of arrows) {
    const force = pull.shape.length > 1, d = force ? "M2 8h14" : "M8 13A6 6 0 1 1 18 11", tip = force ? "M15 3l9 5-9 5z" : "M22 9l-4 6-4-5z";
    const sign = () => { const c = COLORS[force ? "force" : "torque"]; return `<path d="${d}" fill="none" stroke="${c}" stroke-width="2.5"/><path d="${tip}" fill="${c}"/>`; };
    PULLS.push({ name, unit: force ? "N" : "N m", ...add(name, name, sign) });
  }
}

/** Numbers beside the names of forces and torques. */
function tellPulls() {
  for (const { name, unit, output } of PULLS) {
    const told = CLIPS.flatMap((clip, k) => clip.pulls.filter((pull) => pull.name === name).map((pull) => {
      const i = last(clip.t, state.time), value = make("span", CLIPS.length > 1 ? `run${k % 6}` : "");
      value.textContent = short(pull.shape.length > 1 ? Math.hypot(...pull.values.subarray(pull.shape[1] * i, pull.shape[1] * (i + 1))) : pull.values[i]);
      return value;
    }));
    output.replaceChildren(...told, unit);
  }
}

function tellScale() {
  const most = extent.curvature, strains = new Set(CLIPS.map((clip) => clip.surface));
  $("scale").hidden = !(most > 0);
  $("scale-name").textContent = "Curvature";
  $("low").textContent = short(-Number(most.toPrecision(3)));
  $("high").textContent = `+${short(Number(most.toPrecision(3)))} 1/m`;
  const surface = CLIPS[0].surface;
  if (strains.size === 1 && surface !== null) $("strain").textContent = `strain at the surface up to ${short(Number((100 * most * surface).toPrecision(2)))} %`;
}

// ----------------------------------------------------------------- controls
const nearest = (t) => {
  const i = last(TIMES, t);
  return i + 1 < TIMES.length && TIMES[i + 1] - t < t - TIMES[i] ? i + 1 : i;
};
const clock = () => `${state.time.toFixed(TIMES[TIMES.length - 1] < 0.1 ? 4 : 2)} s`;

/** Go to instant i of all. */
function seek(i) {
  state.time = TIMES[Math.max(0, Math.min(TIMES.length - 1, i))];
  later();
}
const step = (k) => { pause(); seek(last(TIMES, state.time) + k); };

let clocked = 0;
function play() {
  if (last(TIMES, state.time) >= TIMES.length - 1) seek(0);
  state.playing = true;
  clocked = performance.now();
  requestAnimationFrame(tick);
  later();
}
function pause() {
  if (!state.playing) return;
  state.playing = false;
  seek(last(TIMES, state.time));
}
function tick(now) {
  if (!state.playing) return;
  state.time += (Math.max(0, now - clocked) / 1000) * state.speed;
  clocked = now;
  const end = TIMES[TIMES.length - 1];
  if (state.time >= end) { state.time = end; state.playing = false; }
  draw();
  requestAnimationFrame(tick);
}

function setMagnify(m) {
  state.magnify = Math.max(1, Math.min(20, m));
  $("magnify").value = state.magnify;
  survey();
  later();
}
function setSpeed(step) {
  const select = $("speed");
  select.selectedIndex = Math.max(0, Math.min(select.options.length - 1, select.selectedIndex + step));
  state.speed = Number(select.value);
}
function setBeside(beside) {
  state.beside = beside && CLIPS.length > 1;
  $("layout").value = state.beside ? "beside" : "over";
  later();
}
function setTheme(theme) {
  if (theme === "auto") delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = theme;
  $("theme").textContent = `Theme: ${theme}`;
  $("theme").dataset.now = theme;
  recolor();
}
function recolor() {
  readColors();
  CHARTS.forEach((chart) => { chart.base = null; });
  SIGNS.forEach((sign) => sign());
  later();
}
const nextTheme = () => setTheme({ auto: "light", light: "dark", dark: "auto" }[$("theme").dataset.now]);
const toggle = () => (state.playing ? pause() : play());

const KEYS = {
  " ": toggle, k: toggle, ArrowLeft: (e) => step(e.shiftKey ? -10 : -1), ArrowRight: (e) => step(e.shiftKey ? 10 : 1),
  Home: () => step(-TIMES.length), End: () => step(TIMES.length), "+": () => setSpeed(1), "=": () => setSpeed(1), "-": () => setSpeed(-1),
  ArrowUp: () => setMagnify(state.magnify + 1), ArrowDown: () => setMagnify(state.magnify - 1),
  s: () => setBeside(!state.beside), t: nextTheme, ...STAGE_KEYS,
  f: () => (document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen()),
};
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const own = event.target, key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  const taken = own.matches("select, summary, #magnify") ? key !== "s" && key !== "t" && key !== "f"
    : own.matches("#time") ? key === "ArrowUp" || key === "ArrowDown" : own.matches("button") && key === " ";
  if (taken || !(key in KEYS)) return; // the element's own keys
  event.preventDefault();
  KEYS[key](event);
});

// --------------------------------------------------------------------- draw
const PLAY = "M7 4.5v15L20 12z", PAUSE = "M6 5h4v14H6zM14 5h4v14h-4z";
let waiting = false;
/** Draw with the next picture of the screen. */
function later() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(draw);
}
function draw() {
  waiting = false;
  drawStage();
  CHARTS.forEach(drawChart);
  tellPulls();
  const i = last(TIMES, state.time), slider = $("time"), end = TIMES[TIMES.length - 1];
  slider.value = i;
  slider.setAttribute("aria-valuetext", `${clock()} of ${short(end)} s`);
  $("clock").textContent = `${clock()} of ${short(end)} s`;
  $("times").textContent = `× ${state.magnify}`;
  $("magnify").setAttribute("aria-valuetext", `${state.magnify} times`);
  $("sign").setAttribute("d", state.playing ? PAUSE : PLAY);
  $("play").setAttribute("aria-label", state.playing ? "Pause" : "Play");
  if (!state.playing) {
    const tips = CLIPS.map((clip) => `${CLIPS.length > 1 ? `${clip.label}: ` : ""}${tipText(clip)}`);
    stage.setAttribute("aria-label", `The arm at ${clock()}; ${tips.join("; ")}`);
  }
}

readColors();
$("title").textContent = DATA.title;
const same = CLIPS.every((clip) => clip.note === CLIPS[0].note);
$("note").textContent = same ? CLIPS[0].note : CLIPS.map((clip) => `${clip.label}: ${clip.note}`).join("\n");
$("time").max = TIMES.length - 1;
$("layout-label").hidden = CLIPS.length < 2;
setTheme("auto");
survey();
tellScale();
makeLegend();
makeCharts();
$("time").addEventListener("input", (event) => { pause(); seek(Number(event.target.value)); });
$("back").addEventListener("click", () => step(-1));
$("forward").addEventListener("click", () => step(1));
$("play").addEventListener("click", toggle);
stage.addEventListener("click", (event) => { if (!dragged(event)) toggle(); });
$("theme").addEventListener("click", nextTheme);
$("speed").addEventListener("change", () => setSpeed(0));
$("magnify").addEventListener("input", (event) => setMagnify(Number(event.target.value)));
$("layout").addEventListener("change", (event) => setBeside(event.target.value === "beside"));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", recolor);
new ResizeObserver(later).observe(document.body);
later();

/** For tests: what is drawn now, as numbers. */
window.flexarm = {
  instants: TIMES.length,
  now: () => ({ time: state.time, magnify: state.magnify, playing: state.playing, speed: state.speed, beside: state.beside }),
  pose: (k = 0) => Array.from(poseAt(CLIPS[k], state.time, state.magnify)),
  ghost: (k = 0) => ghost(CLIPS[k], last(CLIPS[k].t, state.time)),
  ...HOOKS,
};
