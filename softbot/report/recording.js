// The run as the page carries it: decoded once, then looked up by time.
const run = JSON.parse(document.getElementById("run").textContent);

function decoded(text, type) {
  const binary = atob(text), bytes = new Uint8Array(binary.length);
  for (let i = 0; i < binary.length; i++) bytes[i] = binary.charCodeAt(i);
  return new type(bytes.buffer);
}

const columns = {};
for (const [name, text] of Object.entries(run.columns)) columns[name] = decoded(text, Float32Array);
const times = columns.t_s;
const startS = times[0], endS = Math.max(times[times.length - 1], startS + 1e-3);
const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

// Index of the last of `sorted` that is not over `value` (0 when all are).
function before(sorted, value) {
  let low = 0, high = sorted.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (sorted[middle] <= value) low = middle; else high = middle - 1;
  }
  return low;
}

// A column at a time, between its samples; `held` repeats the last sample instead.
function valueAt(name, t, held = false) {
  const values = columns[name];
  if (!values) return NaN;
  const i = before(times, t), j = Math.min(i + 1, values.length - 1);
  if (held || i === j) return values[i];
  const u = clamp((t - times[i]) / (times[j] - times[i]), 0, 1);
  return values[i] + u * (values[j] - values[i]);
}

function spanAt(band, t) {
  if (!band) return "";
  for (const [, end, name] of band.spans) if (t < end) return name;
  return band.spans[band.spans.length - 1][2];
}
const bandNamed = title => run.bands.find(band => band.title === title);

// The tube: nodes and unit directors at a time, laid between two recorded frames.
const shapes = {
  t: decoded(run.shapes.t_s, Float32Array), centre: decoded(run.shapes.centre_m, Float32Array),
  offset: decoded(run.shapes.offset, Int16Array), director: decoded(run.shapes.director, Int16Array),
  nodes: run.shapes.nodes, radius: run.shapes.radius_m,
};
const pose = {
  nodes: shapes.nodes, position: new Float64Array(3 * shapes.nodes), tangent: new Float64Array(3 * shapes.nodes),
  e1: new Float64Array(3 * shapes.nodes), e2: new Float64Array(3 * shapes.nodes),
};

function poseAt(t) {
  const n = shapes.nodes, i = before(shapes.t, t), j = Math.min(i + 1, shapes.t.length - 1);
  const u = i === j ? 0 : clamp((t - shapes.t[i]) / (shapes.t[j] - shapes.t[i]), 0, 1), w = 1 - u;
  const { position, tangent, e1, e2 } = pose, step = run.shapes.step_m, a = 3 * n * i, b = 3 * n * j;
  for (let k = 0; k < 3 * n; k++) {
    const axis = k % 3;
    position[k] = w * (shapes.centre[3 * i + axis] + step * shapes.offset[a + k])
      + u * (shapes.centre[3 * j + axis] + step * shapes.offset[b + k]);
    e1[k] = w * shapes.director[a + k] + u * shapes.director[b + k];
  }
  for (let m = 0; m < n; m++) {
    const back = 3 * Math.max(m - 1, 0), ahead = 3 * Math.min(m + 1, n - 1), k = 3 * m;
    let x = position[ahead] - position[back], y = position[ahead + 1] - position[back + 1], z = position[ahead + 2] - position[back + 2];
    const long = Math.hypot(x, y, z) || 1;
    x /= long; y /= long; z /= long;
    const along = e1[k] * x + e1[k + 1] * y + e1[k + 2] * z;
    let p = e1[k] - along * x, q = e1[k + 1] - along * y, r = e1[k + 2] - along * z;
    const size = Math.hypot(p, q, r) || 1;
    p /= size; q /= size; r /= size;
    tangent[k] = x; tangent[k + 1] = y; tangent[k + 2] = z;
    e1[k] = p; e1[k + 1] = q; e1[k + 2] = r;
    e2[k] = y * r - z * q; e2[k + 1] = z * p - x * r; e2[k + 2] = x * q - y * p;
  }
  return pose;
}

// Colours of the style sheet, read again when the theme changes.
const STATE_COLOURS = {
  "disarmed": "#8b97a1", "priming": "#5b86b8", "rolling": "#1f9d68", "stalled": "#d64545", "stall": "#d64545",
  "reversing": "#e0a106", "degraded": "#12a0a8", "degraded rolling": "#12a0a8", "safe": "#8a63d2", "side +": "#7aa6d8", "side −": "#d79a63",
  "straight": "#9aa5ad", "stopped": "#8b97a1",
};
const stateColour = name => STATE_COLOURS[name] || "#9aa5ad";
let palette = {};
function readPalette() {
  const style = getComputedStyle(document.documentElement);
  palette = {};
  for (const name of ["page", "card", "ink", "soft", "line", "faint", "accent", "second", "chamber-0", "chamber-1",
    "chamber-2", "chamber-3", "body", "dead", "sky", "floor", "grid", "shadow", "fault", "detection", "recovery", "stall"])
    palette[name] = style.getPropertyValue("--" + name).trim();
}
const rgb = hex => [1, 3, 5].map(i => parseInt(hex.slice(i, i + 2), 16));
const mixed = (a, b, u) => [0, 1, 2].map(i => a[i] + u * (b[i] - a[i]));
const faded = (hex, alpha) => `rgba(${rgb(hex).join(",")},${alpha})`;

// A canvas at the screen's own resolution, drawn in CSS pixels.
function fitted(canvas) {
  const box = canvas.getBoundingClientRect(), ratio = Math.min(window.devicePixelRatio || 1, 2);
  const width = Math.max(1, Math.round(box.width * ratio)), height = Math.max(1, Math.round(box.height * ratio));
  if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, box.width, box.height);
  return [context, box.width, box.height];
}

// A mark of an event, the same everywhere: fault ▼, detection ◆, recovery ●, stall ■.
function drawMark(context, type, x, y, size) {
  context.fillStyle = palette[type] || palette.soft;
  context.beginPath();
  if (type === "fault") { context.moveTo(x - size, y - size); context.lineTo(x + size, y - size); context.lineTo(x, y + size); }
  else if (type === "detection") { context.moveTo(x, y - size); context.lineTo(x + size, y); context.lineTo(x, y + size); context.lineTo(x - size, y); }
  else if (type === "stall") context.rect(x - 0.75 * size, y - 0.75 * size, 1.5 * size, 1.5 * size);
  else context.arc(x, y, 0.85 * size, 0, 2 * Math.PI);
  context.closePath();
  context.fill();
}

// Round steps of an axis: about `count` of them between low and high.
function ticks(low, high, count) {
  const raw = (high - low) / Math.max(count, 1) || 1, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map(k => k * power).find(s => s >= raw) || raw;
  const result = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) result.push(k * step);
  return [result, Math.max(0, -Math.floor(Math.log10(step) + 1e-9))];
}
const minus = text => text.replace("-", "−");
