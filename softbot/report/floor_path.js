// The path of the centre of mass from above, coloured by state, with the tube's outline now and along the way.
const floorPath = (() => {
  const canvas = document.getElementById("path"), layer = document.createElement("canvas");
  let toScreen = null, ratio = 1, pixels = 1;

  function bounds() {
    let box = [Infinity, -Infinity, Infinity, -Infinity];
    const add = (x, y) => { if (Number.isFinite(x + y)) box = [Math.min(box[0], x), Math.max(box[1], x), Math.min(box[2], y), Math.max(box[3], y)]; };
    for (let i = 0; i < times.length; i += 4) add(0.01 * columns.x_cm[i], 0.01 * columns.y_cm[i]);
    for (const t of stations()) {
      const p = poseAt(t).position;
      for (let k = 0; k < p.length; k += 3) add(p[k], p[k + 1]);
    }
    return box;
  }

  // Times at which the outline is left on the floor: evenly along the way that the centre of mass went.
  let kept = null;
  function stations() {
    if (kept) return kept;
    kept = [startS];
    let x0 = columns.x_cm[0], y0 = columns.y_cm[0];
    for (let i = 1; i < times.length; i++) {
      const x = columns.x_cm[i], y = columns.y_cm[i];
      if (Math.hypot(x - x0, y - y0) >= 600 * shapes.radius) { kept.push(times[i]); x0 = x; y0 = y; }
    }
    kept.push(endS);
    return kept;
  }

  function outline(context, t, style, width) {
    const p = poseAt(t).position;
    context.strokeStyle = style; context.lineWidth = width; context.lineCap = "round"; context.lineJoin = "round";
    context.beginPath();
    for (let k = 0; k < p.length; k += 3) { const [x, y] = toScreen(p[k], p[k + 1]); if (k) context.lineTo(x, y); else context.moveTo(x, y); }
    context.stroke();
  }

  function draw() {
    const [, width, height] = fitted(canvas);
    ratio = canvas.width / width;
    layer.width = canvas.width; layer.height = canvas.height;
    const context = layer.getContext("2d"), edge = 34;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    const [x0, x1, y0, y1] = bounds(), margin = 2 * shapes.radius;
    // A long thin path lies along the wider side of the card.
    const turned = (y1 - y0 > x1 - x0) === (width > height) && Math.abs((y1 - y0) - (x1 - x0)) > 0.1 * (x1 - x0 + y1 - y0);
    const wide = (turned ? y1 - y0 : x1 - x0) + 2 * margin, high = (turned ? x1 - x0 : y1 - y0) + 2 * margin;
    const scale = Math.min((width - 2 * edge) / wide, (height - 2 * edge) / high);
    pixels = scale;
    const cx = (x0 + x1) / 2, cy = (y0 + y1) / 2;
    toScreen = turned ? (x, y) => [width / 2 + scale * (y - cy), height / 2 + scale * (x - cx)] : (x, y) => [width / 2 + scale * (x - cx), height / 2 - scale * (y - cy)];
    drawGrid(context, width, height, turned, cx, cy, scale);
    stations().forEach(t => outline(context, t, faded(palette.grid, 0.2), 2 * shapes.radius * scale));
    const band = bandNamed("state");
    context.lineWidth = 3; context.lineCap = "round"; context.lineJoin = "round";
    for (const [start, end, name] of band ? band.spans : [[startS, endS, null]]) {
      context.strokeStyle = name ? stateColour(name) : palette.accent;
      context.beginPath();
      for (let i = before(times, start), last = before(times, end), pen = false; i <= last; i++) {
        if (!Number.isFinite(columns.x_cm[i] + columns.y_cm[i])) { pen = false; continue; }
        const [x, y] = toScreen(0.01 * columns.x_cm[i], 0.01 * columns.y_cm[i]);
        if (pen) context.lineTo(x, y); else context.moveTo(x, y);
        pen = true;
      }
      context.stroke();
    }
    for (const event of run.events) {
      if (event.type === "stall" || event.type === "recovery") continue;
      const [x, y] = toScreen(0.01 * valueAt("x_cm", event.t_s), 0.01 * valueAt("y_cm", event.t_s));
      drawMark(context, event.type, x, y - 9, 6);
    }
  }

  function drawGrid(context, width, height, turned, cx, cy, scale) {
    const shown = Math.max(width, height) / scale, [marks, digits] = ticks(0, 100 * shown, 10), step = 0.01 * (marks[1] - marks[0]);
    context.strokeStyle = palette.line; context.lineWidth = 1; context.fillStyle = palette.soft; context.font = "11px system-ui, sans-serif";
    context.textBaseline = "alphabetic";
    const [acrossMid, downMid] = turned ? [cy, cx] : [cx, cy], up = turned ? 1 : -1;
    context.beginPath();
    for (let k = Math.ceil((acrossMid - width / 2 / scale) / step); k * step < acrossMid + width / 2 / scale; k++) {
      const x = Math.round(width / 2 + scale * (k * step - acrossMid)) + 0.5;
      context.moveTo(x, 0); context.lineTo(x, height);
      context.textAlign = "center";
      if (x > 60 && x < width - 60) context.fillText(minus((100 * k * step).toFixed(digits)), x, height - 3);
    }
    for (let k = Math.ceil((downMid - height / 2 / scale) / step); k * step < downMid + height / 2 / scale; k++) {
      const y = Math.round(height / 2 + up * scale * (k * step - downMid)) + 0.5;
      context.moveTo(0, y); context.lineTo(width, y);
      context.textAlign = "left";
      if (y > 34 && y < height - 24) context.fillText(minus((100 * k * step).toFixed(digits)), 2, y - 3);
    }
    context.globalCompositeOperation = "destination-over"; context.stroke(); context.globalCompositeOperation = "source-over";
    context.textAlign = "right"; context.fillText(`${turned ? "y" : "x"} [cm]`, width - 4, height - 3);
    context.textAlign = "left"; context.fillText(`${turned ? "x" : "y"} [cm]`, 2, 12);
  }

  function mark(t) {
    if (!toScreen) return;
    const context = canvas.getContext("2d");
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, canvas.width, canvas.height);
    context.drawImage(layer, 0, 0);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    outline(context, t, faded(palette.ink, 0.32), 2 * shapes.radius * pixels);
    const [x, y] = toScreen(0.01 * valueAt("x_cm", t), 0.01 * valueAt("y_cm", t));
    context.fillStyle = palette.ink; context.strokeStyle = palette.card; context.lineWidth = 2;
    context.beginPath(); context.arc(x, y, 5.5, 0, 2 * Math.PI); context.fill(); context.stroke();
  }
  return { draw, mark };
})();
