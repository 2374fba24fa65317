// Plots over time, one canvas each, all with the same time axis, cursor and zoom.
const plots = (() => {
  const LEFT = 52, RIGHT = 12, holder = document.getElementById("plots");
  let from = startS, to = endS, hoverS = null, seek = () => {};
  const list = [];

  function addPlot(spec) {
    const box = document.createElement("div"), label = document.createElement("div"), canvas = document.createElement("canvas");
    box.className = "plot"; label.className = "label";
    const cursor = document.createElement("div"), hover = document.createElement("div"), zoom = document.createElement("div");
    cursor.className = "cursor"; hover.className = "hover"; zoom.className = "zoom";
    box.append(label, canvas, zoom, hover, cursor);
    holder.append(box);
    const plot = { spec, box, label, canvas, cursor, hover, zoom };
    canvas.style.height = (spec.spans ? 20 : spec.short ? 74 : 118) + (spec.last ? 20 : 0) + "px";
    const title = document.createElement("b");
    title.textContent = spec.title + (spec.unit ? ` [${spec.unit}]` : "");
    label.append(title);
    plot.values = (spec.series || [{ label: "" }]).map(series => {
      const entry = document.createElement("span"), key = document.createElement("i"), value = document.createElement("span");
      if (series.colour) { key.style.background = `var(--${series.colour})`; if (series.area) key.className = "area"; entry.append(key, series.label + " "); }
      entry.append(value); label.append(entry);
      return value;
    });
    listen(plot);
    list.push(plot);
  }
  for (const band of run.bands) addPlot({ title: band.title, spans: band.spans });
  const ranges = groupRanges();
  run.plots.forEach((spec, i) => addPlot({ ...spec, last: i === run.plots.length - 1 }));

  // Plots of one group share their range; the others take that of their own columns.
  function groupRanges() {
    const found = new Map();
    run.plots.forEach((spec, i) => {
      const key = spec.group || i;
      let [low, high] = found.get(key) || [Infinity, -Infinity];
      for (const { column } of spec.series) for (const v of columns[column]) if (Number.isFinite(v)) { low = Math.min(low, v); high = Math.max(high, v); }
      found.set(key, [low, high]);
    });
    return run.plots.map((spec, i) => {
      if (spec.range) return spec.range;
      let [low, high] = found.get(spec.group || i);
      if (!(high >= low)) [low, high] = [0, 1];
      if (spec.zero || spec.group) { low = Math.min(low, 0); high = Math.max(high, 0); }
      const room = 0.07 * (high - low) || Math.max(0.05 * Math.abs(high), 0.5);
      return [spec.zero && low === 0 ? 0 : low - room, high + room];
    });
  }

  const toX = (t, width) => LEFT + (t - from) / (to - from) * (width - LEFT - RIGHT);
  const toT = (x, width) => clamp(from + (x - LEFT) / (width - LEFT - RIGHT) * (to - from), from, to);

  function drawPlot(plot, index) {
    const { spec, canvas } = plot, [context, width, total] = fitted(canvas), height = total - (spec.last ? 20 : 0);
    plot.width = width;
    context.font = "11px system-ui, sans-serif";
    const inner = width - LEFT - RIGHT;
    if (spec.spans) {
      for (const [start, end, name] of spec.spans) {
        const a = clamp(toX(start, width), LEFT, LEFT + inner), b = clamp(toX(end, width), LEFT, LEFT + inner);
        if (b <= a) continue;
        context.fillStyle = stateColour(name);
        context.fillRect(a, 2, Math.max(b - a, 0.75), height - 4);
        if (b - a > context.measureText(name).width + 12) { context.fillStyle = "#fff"; context.textBaseline = "middle"; context.textAlign = "left"; context.fillText(name, a + 6, height / 2); }
      }
      return;
    }
    const [low, high] = ranges[index - run.bands.length], toY = v => height - 4 - (v - low) / (high - low) * (height - 8);
    context.fillStyle = palette.faint; context.fillRect(LEFT, 0, inner, height);
    const [marks, digits] = spec.range ? [[-180, -90, 0, 90, 180], 0] : ticks(low, high, spec.short ? 2 : 4);
    context.textAlign = "right"; context.textBaseline = "middle"; context.lineWidth = 1;
    for (const v of marks) {
      const y = Math.round(toY(v)) + 0.5;
      context.strokeStyle = Math.abs(v) < 1e-12 ? palette.grid : palette.line;
      context.beginPath(); context.moveTo(LEFT, y); context.lineTo(LEFT + inner, y); context.stroke();
      context.fillStyle = palette.soft; context.fillText(minus(v.toFixed(digits)), LEFT - 7, clamp(y, 6, height - 5));
    }
    const [stamps, timeDigits] = ticks(from, to, inner / 90);
    for (const t of stamps) {
      const x = Math.round(toX(t, width)) + 0.5;
      context.strokeStyle = palette.line; context.beginPath(); context.moveTo(x, 0); context.lineTo(x, height); context.stroke();
      if (spec.last) { context.fillStyle = palette.soft; context.textAlign = t === stamps[stamps.length - 1] && x > width - 40 ? "right" : "center"; context.fillText(`${t.toFixed(timeDigits)} s`, x, height + 11); }
    }
    context.save();
    context.beginPath(); context.rect(LEFT, 0, inner, height); context.clip();
    const first = Math.max(before(times, from) - 1, 0), last = Math.min(before(times, to) + 2, times.length);
    for (const series of spec.series) {
      const values = columns[series.column], colour = palette[series.colour];
      context.beginPath();
      let pen = false, previous = NaN, startX = 0, x = 0;
      const close = () => { if (series.area && pen) { context.lineTo(x, toY(0)); context.lineTo(startX, toY(0)); context.closePath(); } };
      for (let i = first; i < last; i++) {
        const v = values[i];
        if (!Number.isFinite(v) || (series.wrap && Math.abs(v - previous) > series.wrap / 2)) { close(); pen = false; }
        previous = v;
        if (!Number.isFinite(v)) continue;
        x = toX(times[i], width);
        if (pen) context.lineTo(x, toY(v)); else { startX = x; if (series.area) { context.moveTo(x, toY(0)); context.lineTo(x, toY(v)); } else context.moveTo(x, toY(v)); }
        pen = true;
      }
      close();
      if (series.area) { context.fillStyle = faded(colour, 0.26); context.fill(); }
      else { context.strokeStyle = colour; context.lineWidth = 1.6; context.lineJoin = "round"; context.stroke(); }
    }
    for (const event of run.events) {
      if (event.t_s < from || event.t_s > to || (event.type !== "fault" && event.type !== "detection")) continue;
      const x = toX(event.t_s, width);
      context.strokeStyle = palette[event.type]; context.lineWidth = 1.2; context.setLineDash(event.type === "fault" ? [] : [3, 3]);
      context.beginPath(); context.moveTo(x, 0); context.lineTo(x, height); context.stroke();
      context.setLineDash([]);
    }
    context.restore();
  }

  function draw() { list.forEach(drawPlot); }

  function mark(t) {
    for (const plot of list) {
      const width = plot.width || plot.box.clientWidth, inside = t >= from && t <= to;
      plot.cursor.style.display = inside ? "block" : "none";
      plot.cursor.style.transform = `translateX(${toX(t, width)}px)`;
      plot.hover.style.display = hoverS === null ? "none" : "block";
      if (hoverS !== null) plot.hover.style.transform = `translateX(${toX(hoverS, width)}px)`;
      const at = hoverS === null ? t : hoverS;
      if (plot.spec.spans) { put(plot.values[0], spanAt(plot.spec, at)); continue; }
      plot.spec.series.forEach((series, i) => {
        const v = valueAt(series.column, at, Boolean(series.wrap));
        put(plot.values[i], Number.isFinite(v) ? minus(v.toFixed(plot.spec.unit === "°" || plot.spec.unit === "kPa" ? 1 : 2)) : "—");
      });
    }
  }
  function put(element, text) { if (element.textContent !== text) element.textContent = text; }

  function listen(plot) {
    const { canvas, zoom } = plot;
    let pressed = null;
    const at = event => { const box = canvas.getBoundingClientRect(); return [event.clientX - box.left, box.width]; };
    canvas.addEventListener("pointerdown", event => { pressed = at(event)[0]; canvas.setPointerCapture(event.pointerId); });
    canvas.addEventListener("pointermove", event => {
      const [x, width] = at(event);
      hoverS = toT(x, width);
      if (pressed !== null && Math.abs(x - pressed) > 6) {
        zoom.style.display = "block"; zoom.style.left = Math.min(x, pressed) + "px"; zoom.style.width = Math.abs(x - pressed) + "px";
      }
      mark(currentS());
    });
    canvas.addEventListener("pointerup", event => {
      if (pressed === null) return;
      const [x, width] = at(event), a = toT(Math.min(x, pressed), width), b = toT(Math.max(x, pressed), width);
      zoom.style.display = "none";
      if (Math.abs(x - pressed) > 6 && b - a > 0.01) { from = a; to = b; draw(); mark(currentS()); } else seek(toT(x, width));
      pressed = null;
    });
    canvas.addEventListener("pointercancel", () => { pressed = null; zoom.style.display = "none"; });
    canvas.addEventListener("pointerleave", () => { hoverS = null; mark(currentS()); });
    canvas.addEventListener("dblclick", () => { from = startS; to = endS; draw(); mark(currentS()); });
  }
  let currentS = () => startS;
  return { draw, mark, connect: (now, goTo) => { currentS = now; seek = goTo; } };
})();
