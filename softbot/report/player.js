// One clock for everything on the page: animation, cursors, captions; and the controls that set it.
const byId = id => document.getElementById(id);
let nowS = startS, playing = !matchMedia("(prefers-reduced-motion: reduce)").matches, speed = 1, lastFrame = null, stale = true;
const slider = byId("time"), stateBand = bandNamed("state");
slider.min = startS; slider.max = endS;

function setTheme(name) {
  if (name === "dark") document.documentElement.dataset.theme = "dark"; else delete document.documentElement.dataset.theme;
  readPalette();
  redraw();
}
function redraw() { plots.draw(); floorPath.draw(); drawBand(); stale = true; }
function seek(t) { nowS = clamp(t, startS, endS); stale = true; }
function setPlaying(on) { playing = on; byId("play").classList.toggle("on", on); if (on && nowS >= endS) nowS = startS; }

// The scrub bar's background: the states over time, with a mark for each event.
function drawBand() {
  const [context, width] = fitted(byId("band")), top = 21, high = 8, toX = t => (t - startS) / (endS - startS) * width;
  for (const [start, end, name] of stateBand ? stateBand.spans : [[startS, endS, ""]]) {
    context.fillStyle = name ? stateColour(name) : palette.line;
    context.fillRect(toX(start), top, Math.max(1, toX(end) - toX(start)), high);
  }
  for (const type of ["stall", "recovery", "detection", "fault"])
    for (const event of run.events) if (event.type === type) drawMark(context, type, toX(event.t_s), type === "fault" ? 8 : 10, type === "fault" ? 6 : 4.5);
}

function writeLegend() {
  const legend = byId("marks"), add = (className, style, text) => {
    const entry = document.createElement("span"), key = document.createElement("i");
    key.className = className; if (className) key.style.cssText = "height:9px;width:9px;margin:0";
    if (style) key.style.background = style;
    entry.append(key, text); legend.append(entry);
  };
  for (const name of new Set((stateBand ? stateBand.spans : []).map(span => span[2]))) add("", stateColour(name), name);
  for (const type of ["fault", "detection", "recovery", "stall"]) if (run.events.some(event => event.type === type)) add(`mark ${type}`, null, type);
}

function put(id, text) { const element = byId(id); if (element.textContent !== text) element.textContent = text; }
function tell(t) {
  put("clock", t.toFixed(2));
  const name = spanAt(stateBand, t);
  put("state-name", name);
  byId("state-dot").style.background = name ? stateColour(name) : "transparent";
  put("told-roll", `${minus((valueAt("roll_rev", t)).toFixed(2))} revolutions`);
  const x = valueAt("moved_x_cm", t), y = valueAt("moved_y_cm", t);
  put("told-way", `${Math.hypot(x, y).toFixed(1)} cm from the start`);
  // Faults and what was made of them stay readable for a moment; a fault is not talked over by a stall.
  const rank = { fault: 3, detection: 2, recovery: 1, stall: 0 }, shownS = 1.4 * Math.max(1, speed);
  const recent = run.events.filter(event => event.t_s <= t && t < event.t_s + shownS).sort((a, b) => b.t_s - a.t_s || rank[b.type] - rank[a.type]);
  const caption = byId("caption");
  caption.classList.toggle("on", recent.length > 0);
  if (recent.length) {
    const shown = recent.slice(0, 2).reverse().map(event => `${event.type}: ${event.text}`);
    put("caption", shown.join("  ·  "));
  }
}

function frame(stamp) {
  if (playing && lastFrame !== null) {
    nowS += speed * Math.min(0.1, (stamp - lastFrame) / 1000);
    // A short rest on the last frame, then from the start again.
    if (nowS > endS + 1.2 * speed) nowS = startS;
    stale = true;
  }
  lastFrame = stamp;
  if (stale || !robotView.settled()) {
    const t = clamp(nowS, startS, endS);
    robotView.draw(t); plots.mark(t); floorPath.mark(t); tell(t);
    if (document.activeElement !== slider || playing || +slider.value !== t) slider.value = t;
    stale = false;
  }
  requestAnimationFrame(frame);
}

byId("play").addEventListener("click", () => setPlaying(!playing));
slider.addEventListener("input", () => seek(+slider.value));
byId("theme").addEventListener("click", () => setTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark"));
function choose(id, chosen) {
  byId(id).addEventListener("click", event => {
    const button = event.target.closest("button");
    if (!button) return;
    for (const other of byId(id).children) other.classList.toggle("on", other === button);
    chosen(button.dataset);
  });
}
choose("speed", data => { speed = +data.speed; });
choose("camera", data => robotView.look(data.camera));
document.addEventListener("click", event => {
  const button = event.target.closest(".seek");
  if (!button) return;
  seek(+button.dataset.t); setPlaying(false);
  byId("robot").scrollIntoView({ block: "center", behavior: "smooth" });
});
document.addEventListener("keydown", event => {
  if (event.target.closest("button, summary, a") && event.key === " ") return;
  if (event.key === " ") { setPlaying(!playing); event.preventDefault(); }
  else if (event.key === "ArrowLeft" || event.key === "ArrowRight") {
    setPlaying(false); seek(nowS + (event.key === "ArrowRight" ? 1 : -1) * (event.shiftKey ? 1 : 0.04)); event.preventDefault();
  }
});
window.addEventListener("resize", redraw);

// report.html#t=8.5&camera=top&theme=dark opens there, at rest: a link to a moment.
const asked = new URLSearchParams(location.hash.slice(1));
if (asked.has("t")) { seek(+asked.get("t") || startS); playing = false; }
if (["follow", "side", "top"].includes(asked.get("camera"))) byId("camera").querySelector(`[data-camera=${asked.get("camera")}]`).click(), robotView.look(asked.get("camera"), true);
plots.connect(() => clamp(nowS, startS, endS), t => { seek(t); setPlaying(false); });
writeLegend();
setPlaying(playing);
setTheme(asked.get("theme") || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light"));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", event => setTheme(event.matches ? "dark" : "light"));
requestAnimationFrame(frame);
