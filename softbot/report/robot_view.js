// The robot in three dimensions: a tube of shaded quads with four chamber stripes, sorted from far to near.
const robotView = (() => {
  const canvas = document.getElementById("robot");
  const AROUND = 32, CAP = [0.92, 0.7, 0.36, 0.01], R = shapes.radius, N = shapes.nodes;
  const rings = N + 2 * CAP.length;
  const screen = new Float64Array(3 * rings * AROUND), world = new Float64Array(3 * rings * AROUND);
  const normal = new Float64Array(3 * rings * AROUND);
  const cosines = Array.from({ length: AROUND }, (_, j) => Math.cos(2 * Math.PI * j / AROUND));
  const sines = Array.from({ length: AROUND }, (_, j) => Math.sin(2 * Math.PI * j / AROUND));
  // A stripe covers the four quads about its chamber's direction; the four between two stripes are bare wall.
  const stripe = Array.from({ length: AROUND }, (_, j) => (j + 2) % 8 < 4 ? Math.floor(((j + 2) % AROUND) / 8) : -1);
  const order = new Uint16Array((rings - 1) * AROUND), depth = new Float32Array((rings - 1) * AROUND);
  const spacing = tubeLength() / (N - 1);

  function tubeLength() {
    const p = poseAt(startS).position;
    let sum = 0;
    for (let k = 3; k < p.length; k += 3) sum += Math.hypot(p[k] - p[k - 3], p[k + 1] - p[k - 2], p[k + 2] - p[k - 1]);
    return sum;
  }

  // Where the camera looks: the centre of mass over ±0.8 s, so that reversals do not shake the picture.
  const follow = smoothed(0.8);
  function smoothed(halfS) {
    const axes = ["x_cm", "y_cm", "z_cm"].map(name => {
      const values = columns[name], sums = new Float64Array(values.length + 1), counts = new Float64Array(values.length + 1);
      for (let i = 0; i < values.length; i++) {
        const good = Number.isFinite(values[i]);
        sums[i + 1] = sums[i] + (good ? values[i] : 0); counts[i + 1] = counts[i] + (good ? 1 : 0);
      }
      return t => {
        const a = before(times, t - halfS), b = before(times, t + halfS) + 1;
        return 0.01 * (sums[b] - sums[a]) / Math.max(1, counts[b] - counts[a]);
      };
    });
    // Three averages side by side weigh the middle most and make the motion smooth.
    return t => axes.map(at => (at(t - 0.4) + at(t) + at(t + 0.4)) / 3);
  }

  // The way it goes over the whole run, so that the camera stands across it.
  const first = follow(startS), last = follow(endS);
  const went = Math.hypot(last[0] - first[0], last[1] - first[1]);
  const heading = went > 0.5 * R ? Math.atan2(last[1] - first[1], last[0] - first[0]) : acrossTube();
  function acrossTube() {
    const p = poseAt(startS).position, n = p.length - 3;
    return Math.atan2(p[n + 1] - p[1], p[n] - p[0]) + Math.PI / 2;
  }
  const home = {
    follow: { azimuth: heading - 0.92, elevation: 0.52, distance: 1.85 * tubeLength() },
    side: { azimuth: heading - 1.5, elevation: 0.2, distance: 1.75 * tubeLength() },
    top: { azimuth: heading - Math.PI / 2, elevation: 1.45, distance: 2.1 * tubeLength() },
  };
  const camera = { ...home.follow };
  let wanted = { ...home.follow };

  let eye, right, up, ahead, focus, midX, midY;
  function aim(target, width, height) {
    const { azimuth, elevation, distance } = camera, c = Math.cos(elevation), s = Math.sin(elevation);
    const away = [c * Math.cos(azimuth), c * Math.sin(azimuth), s];
    eye = [0, 1, 2].map(i => target[i] + distance * away[i]);
    ahead = away.map(v => -v);
    right = [-Math.sin(azimuth), Math.cos(azimuth), 0];
    up = [-s * Math.cos(azimuth), -s * Math.sin(azimuth), c];
    focus = 1.25 * Math.min(height * 1.15, width * 0.72); midX = width / 2; midY = height * 0.53;
  }
  function project(x, y, z) {
    const a = x - eye[0], b = y - eye[1], c = z - eye[2];
    const far = a * ahead[0] + b * ahead[1] + c * ahead[2];
    if (far < 0.2 * R) return null;
    return [midX + focus * (a * right[0] + b * right[1] + c * right[2]) / far, midY - focus * (a * up[0] + b * up[1] + c * up[2]) / far, far];
  }

  function gridStep() {
    const wantedStep = 0.35 * tubeLength(), power = 10 ** Math.floor(Math.log10(wantedStep));
    return [1, 2, 5, 10].map(k => k * power).reverse().find(s => s <= wantedStep) || power;
  }
  const GRID = gridStep();
  document.getElementById("scale").textContent = run.ground ? `floor grid ${+(100 * GRID).toPrecision(3)} cm` : "floating, no floor";

  function drawFloor(context, target) {
    const reach = 13, cells = 26, lines = Array.from({ length: 6 }, () => []);
    const ox = Math.round(target[0] / GRID), oy = Math.round(target[1] / GRID);
    const add = (x0, y0, x1, y1) => {
      const d = Math.hypot((x0 + x1) / 2 - target[0] / GRID, (y0 + y1) / 2 - target[1] / GRID) / reach;
      const bucket = Math.floor(6 * (1 - d * d));
      if (bucket > 0) lines[Math.min(bucket, 5)].push(x0, y0, x1, y1);
    };
    for (let i = -reach; i <= reach; i++)
      for (let j = 0; j < cells; j++) {
        add(ox + i, oy + j - reach, ox + i, oy + j + 1 - reach);
        add(ox + j - reach, oy + i, ox + j + 1 - reach, oy + i);
      }
    context.lineWidth = 1;
    lines.forEach((list, bucket) => {
      context.strokeStyle = faded(palette.grid, 0.09 * bucket);
      context.beginPath();
      for (let k = 0; k < list.length; k += 4) {
        const a = project(list[k] * GRID, list[k + 1] * GRID, 0), b = project(list[k + 2] * GRID, list[k + 3] * GRID, 0);
        if (a && b) { context.moveTo(a[0], a[1]); context.lineTo(b[0], b[1]); }
      }
      context.stroke();
    });
  }

  function drawTrail(context, t) {
    const step = Math.max(1, Math.floor(times.length / 700)), now = before(times, t);
    const height = run.ground ? () => 0 : i => 0.01 * columns.z_cm[i];
    const line = (from, to, style, width) => {
      context.strokeStyle = style; context.lineWidth = width; context.lineJoin = "round"; context.lineCap = "round";
      context.beginPath();
      let pen = false;
      const point = i => {
        const p = project(0.01 * columns.x_cm[i], 0.01 * columns.y_cm[i], height(i));
        if (!p || !Number.isFinite(p[0])) { pen = false; return; }
        if (pen) context.lineTo(p[0], p[1]); else context.moveTo(p[0], p[1]);
        pen = true;
      };
      for (let i = from; i < to; i += step) point(i);
      point(to);
      context.stroke();
    };
    line(now, times.length - 1, faded(palette.accent, 0.2), 2);
    line(0, now, faded(palette.accent, 0.9), 3);
    for (const event of run.events) {
      if (event.type === "stall" || event.t_s > t) continue;
      const i = before(times, event.t_s), p = project(0.01 * columns.x_cm[i], 0.01 * columns.y_cm[i], height(i));
      if (p) drawMark(context, event.type, p[0], p[1], clamp(0.35 * R * focus / p[2], 3, 7));
    }
  }

  function drawShadow(context) {
    const points = [];
    for (let m = 0; m < N; m++) {
      const p = project(pose.position[3 * m], pose.position[3 * m + 1], 0);
      if (p) points.push(p);
    }
    if (points.length < 2) return;
    const thick = 2 * R * focus / points[points.length >> 1][2];
    context.lineCap = "round"; context.lineJoin = "round";
    for (let layer = 0; layer < 12; layer++) {
      context.strokeStyle = faded(palette.shadow, 0.016 + 0.0042 * layer);
      context.lineWidth = (1.6 - 0.1 * layer) * thick;
      context.beginPath();
      points.forEach((p, i) => i ? context.lineTo(p[0], p[1]) : context.moveTo(p[0], p[1]));
      context.stroke();
    }
  }

  function buildRings() {
    let ring = 0;
    const put = (m, radius, along) => {
      const k = 3 * m, { position, tangent, e1, e2 } = pose;
      const lean = radius < 1 ? Math.sqrt(1 - radius * radius) * Math.sign(along) : 0;
      for (let j = 0; j < AROUND; j++) {
        const q = 3 * (ring * AROUND + j), c = cosines[j], s = sines[j];
        for (let i = 0; i < 3; i++) {
          const out = c * e1[k + i] + s * e2[k + i];
          normal[q + i] = radius * out + lean * tangent[k + i];
          world[q + i] = position[k + i] + R * (radius * out + along * tangent[k + i]);
        }
        const p = project(world[q], world[q + 1], world[q + 2]);
        screen[q] = p ? p[0] : NaN; screen[q + 1] = p ? p[1] : NaN; screen[q + 2] = p ? p[2] : NaN;
      }
      ring++;
    };
    // Rounded ends, drawn within half a radius so that they add little to the length.
    const bulge = radius => 0.5 * Math.sqrt(1 - radius * radius);
    for (let i = CAP.length - 1; i >= 0; i--) put(0, CAP[i], -bulge(CAP[i]));
    for (let m = 0; m < N; m++) put(m, 1, 0);
    for (let i = 0; i < CAP.length; i++) put(N - 1, CAP[i], bulge(CAP[i]));
  }

  function stripeColours(t) {
    const body = rgb(palette.body), dead = rgb(palette.dead);
    return [0, 1, 2, 3].map(i => {
      if (run.dead_from_s[i] !== null && t >= run.dead_from_s[i]) return { colour: dead, glow: 0 };
      const full = rgb(palette[`chamber-${i}`]);
      if (!run.highest_kPa) return { colour: full, glow: 0 };
      const level = clamp(valueAt(`pressure_${i}_kPa`, t) / run.highest_kPa, 0, 1) || 0;
      return { colour: mixed(mixed(body, full, 0.5).map(v => 0.72 * v), full, Math.sqrt(level)), glow: 0.4 * level };
    });
  }

  function drawTube(context, t) {
    buildRings();
    const stripes = stripeColours(t), bare = rgb(palette.body), ends = rgb(palette.soft).map(v => 0.75 * v);
    const lamp = [0, 1, 2].map(i => 0.35 * right[i] - 0.28 * ahead[i]); lamp[2] += 0.85;
    const size = Math.hypot(...lamp); lamp.forEach((v, i) => { lamp[i] = v / size; });
    const half = lamp.map((v, i) => v - ahead[i]), halfSize = Math.hypot(...half);
    let count = 0;
    for (let g = 0; g < rings - 1; g++)
      for (let j = 0; j < AROUND; j++) {
        const a = 3 * (g * AROUND + j), b = 3 * (g * AROUND + (j + 1) % AROUND), c = a + 3 * AROUND, d = b + 3 * AROUND;
        const area = (screen[d] - screen[a]) * (screen[c + 1] - screen[b + 1]) - (screen[c] - screen[b]) * (screen[d + 1] - screen[a + 1]);
        if (!(area < 0)) continue;
        const id = g * AROUND + j;
        depth[id] = screen[a + 2] + screen[b + 2] + screen[c + 2] + screen[d + 2];
        order[count++] = id;
      }
    const seen = order.subarray(0, count).sort((p, q) => depth[q] - depth[p]);
    context.lineWidth = 0.8; context.lineJoin = "round";
    for (const id of seen) {
      const g = Math.floor(id / AROUND), j = id % AROUND;
      const a = 3 * id, b = 3 * (g * AROUND + (j + 1) % AROUND), c = a + 3 * AROUND, d = b + 3 * AROUND;
      const x = normal[a] + normal[d], y = normal[a + 1] + normal[d + 1], z = normal[a + 2] + normal[d + 2], n = Math.hypot(x, y, z) || 1;
      const light = Math.max(0, (x * lamp[0] + y * lamp[1] + z * lamp[2]) / n);
      const shine = Math.max(0, (x * half[0] + y * half[1] + z * half[2]) / (n * halfSize)) ** 26;
      const end = g < CAP.length || g >= rings - 1 - CAP.length;
      const which = end ? null : stripes[stripe[j]] || null;
      const base = end ? ends : which ? which.colour : bare;
      // Every other ring a little darker: the hoop fibres.
      const hoop = end || g % 2 ? 1 : 0.955, glow = which ? which.glow : 0;
      const bright = hoop * (glow + (1 - glow) * (0.42 + 0.66 * light)), white = 70 * shine;
      const style = `rgb(${base[0] * bright + white | 0},${base[1] * bright + white | 0},${base[2] * bright + white | 0})`;
      context.fillStyle = style; context.strokeStyle = style;
      context.beginPath();
      context.moveTo(screen[a], screen[a + 1]); context.lineTo(screen[b], screen[b + 1]);
      context.lineTo(screen[d], screen[d + 1]); context.lineTo(screen[c], screen[c + 1]);
      context.closePath(); context.fill(); context.stroke();
    }
  }

  // The middle cross-section, looked at from the camera's side: which chamber is where, how full, and where the C opens.
  function drawSection(context, t, width) {
    const m = N >> 1, k = 3 * m, size = clamp(0.055 * width, 34, 58), cx = width - 1.8 * size - 14, cy = size + 34;
    const along = pose.tangent.subarray(k, k + 3);
    const sense = along[0] * ahead[0] + along[1] * ahead[1] + along[2] * ahead[2] < 0 ? -1 : 1, T = [...along].map(v => sense * v), flat = Math.hypot(T[0], T[1]) || 1;
    const across = [T[1] / flat, -T[0] / flat, 0];           // view × up
    const over = [across[1] * T[2], -across[0] * T[2], across[0] * T[1] - across[1] * T[0]]; // across × view
    const flatten = v => [v[0] * across[0] + v[1] * across[1] + v[2] * across[2], v[0] * over[0] + v[1] * over[1] + v[2] * over[2]];
    const [x1, y1] = flatten(pose.e1.subarray(k, k + 3)), [x2, y2] = flatten(pose.e2.subarray(k, k + 3));
    const stripes = stripeColours(t);
    if (run.ground) {
      context.strokeStyle = faded(palette.grid, 0.8); context.lineWidth = 2;
      context.beginPath(); context.moveTo(cx - 1.5 * size, cy + size + 2); context.lineTo(cx + 1.5 * size, cy + size + 2); context.stroke();
    }
    context.fillStyle = palette.body;
    context.beginPath(); context.arc(cx, cy, size, 0, 2 * Math.PI); context.fill();
    context.font = `600 ${Math.round(0.26 * size)}px system-ui, sans-serif`; context.textAlign = "center"; context.textBaseline = "middle";
    for (let i = 0; i < 4; i++) {
      const c = [1, 0, -1, 0][i], s = [0, 1, 0, -1][i], x = c * x1 + s * x2, y = c * y1 + s * y2;
      const angle = Math.atan2(-y, x), wide = 0.62, ring = [0.36 * size, 0.9 * size];
      context.fillStyle = `rgb(${stripes[i].colour.map(v => Math.round(v)).join(",")})`;
      context.beginPath(); context.arc(cx, cy, ring[1], angle - wide, angle + wide); context.arc(cx, cy, ring[0], angle + wide, angle - wide, true); context.closePath(); context.fill();
      context.fillStyle = "#fff";
      context.fillText(String(i), cx + 0.64 * size * x, cy - 0.64 * size * y);
    }
    const s = m > 2 ? 3 : 1, p = pose.position;
    const bend = [0, 1, 2].map(i => (p[3 * (m + s) + i] - 2 * p[k + i] + p[3 * (m - s) + i]) / (s * spacing) ** 2);
    const [bx, by] = flatten(bend), curvature = Math.hypot(bx, by);
    if (curvature * tubeLengthNow > 0.12) {
      const long = size * clamp(0.32 + 0.28 * curvature * tubeLengthNow / 2, 0.3, 0.75), ux = bx / curvature, uy = -by / curvature;
      const from = size + 5, tip = from + long;
      context.strokeStyle = context.fillStyle = palette.ink; context.lineWidth = 2.5; context.lineCap = "round";
      context.beginPath(); context.moveTo(cx + ux * from, cy + uy * from); context.lineTo(cx + ux * (tip - 5), cy + uy * (tip - 5)); context.stroke();
      context.beginPath(); context.moveTo(cx + ux * tip, cy + uy * tip);
      context.lineTo(cx + ux * (tip - 9) - uy * 5, cy + uy * (tip - 9) + ux * 5); context.lineTo(cx + ux * (tip - 9) + uy * 5, cy + uy * (tip - 9) - ux * 5); context.fill();
    }
    context.fillStyle = palette.soft; context.font = "12px system-ui, sans-serif";
    context.fillText("mid section,", cx, cy + size + 17);
    context.fillText("arrow: inside of the C", cx, cy + size + 32);
  }
  const tubeLengthNow = tubeLength();

  function draw(t) {
    const [context, width, height] = fitted(canvas);
    for (const key of ["azimuth", "elevation", "distance"]) camera[key] += 0.22 * (wanted[key] - camera[key]);
    const target = follow(t);
    if (run.ground) target[2] = R;
    aim(target, width, height);
    const back = context.createLinearGradient(0, 0, 0, height);
    back.addColorStop(0, palette.sky); back.addColorStop(1, run.ground ? palette.floor : palette.sky);
    context.fillStyle = back; context.fillRect(0, 0, width, height);
    poseAt(t);
    if (run.ground) { drawFloor(context, target); drawTrail(context, t); drawShadow(context); } else drawTrail(context, t);
    drawTube(context, t);
    drawSection(context, t, width);
  }
  const settled = () => ["azimuth", "elevation", "distance"].every(key => Math.abs(wanted[key] - camera[key]) < 1e-3 * (1 + Math.abs(wanted[key])));

  const pointers = new Map();
  let gap = 0;
  canvas.addEventListener("pointerdown", event => { pointers.set(event.pointerId, [event.clientX, event.clientY]); canvas.setPointerCapture(event.pointerId); gap = 0; });
  canvas.addEventListener("pointermove", event => {
    const old = pointers.get(event.pointerId);
    if (!old) return;
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (pointers.size === 2) {
      const [p, q] = [...pointers.values()], apart = Math.hypot(p[0] - q[0], p[1] - q[1]);
      if (gap) zoom(gap / apart);
      gap = apart;
      return;
    }
    wanted.azimuth -= 0.008 * (event.clientX - old[0]);
    wanted.elevation = clamp(wanted.elevation + 0.006 * (event.clientY - old[1]), run.ground ? 0.05 : -1.5, 1.5);
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, event => { pointers.delete(event.pointerId); gap = 0; });
  // The wheel belongs to the page until the picture has been touched.
  canvas.addEventListener("wheel", event => { if (document.activeElement !== canvas && !event.ctrlKey) return; event.preventDefault(); zoom(Math.exp(0.0012 * event.deltaY)); }, { passive: false });
  function zoom(factor) { wanted.distance = clamp(wanted.distance * factor, 0.5 * tubeLengthNow, 12 * tubeLengthNow); }

  function look(name, atOnce = false) {
    const turn = 2 * Math.PI * Math.round((camera.azimuth - home[name].azimuth) / (2 * Math.PI));
    wanted = { ...home[name], azimuth: home[name].azimuth + turn };
    if (atOnce) Object.assign(camera, wanted);
  }
  return { draw, look, settled };
})();
