// The estimated surface in 3D, drawn by plotly once it comes into view.

const MOST_VERTICES = 24000, MOST_ARROWS = 220, STEEPEST = Math.tan(80 * Math.PI / 180);
let plotly = null, surfaceDrawn = 0, surfaceWanted = false;

function loadPlotly() {
  if (window.Plotly) return Promise.resolve();
  if (plotly === null) {
    plotly = inflate(byId("plotly-data").textContent).then((bytes) => {
      const script = document.createElement("script");
      script.textContent = new TextDecoder().decode(bytes);
      document.head.append(script);
    });
  }
  return plotly;
}

function hasWebGl() {
  try {
    return Boolean(document.createElement("canvas").getContext("webgl"));
  } catch {
    return false;
  }
}

// Points and triangles of a depth map, open at depth discontinuities.
function mesh(depth, colour) {
  const f = data.focal_length_px, [cx, cy] = data.principal_point_px;
  const thin = Math.max(1, Math.ceil(Math.sqrt(depth.width * depth.height / MOST_VERTICES)));
  const every = thin * depth.step, [low, high] = firstLimits.get("depth:value"), pad = 0.25 * (high - low);
  const width = Math.ceil(depth.width / thin), height = Math.ceil(depth.height / thin);
  const found = {x: [], y: [], z: [], i: [], j: [], k: [], intensity: [], place: []}, number = new Int32Array(width * height).fill(-1);
  for (let row = 0; row < height; row++) for (let column = 0; column < width; column++) {
    const px = column * every, py = row * every, z = valueAt(depth, px, py), value = colour ? valueAt(colour, px, py) : 0;
    if (!Number.isFinite(z) || z < low - pad || z > high + pad || !Number.isFinite(value) || px >= data.width || py >= data.height) continue;
    number[row * width + column] = found.x.length;
    found.x.push((data.x[px] - cx) * z / f);
    found.y.push(z);
    found.z.push((data.y[py] - cy) * z / f);
    found.intensity.push(value);
    found.place.push([px, py]);
  }
  const step = every * (data.width > 1 ? Math.abs(data.x[data.width - 1] - data.x[0]) / (data.width - 1) : 1);
  const triangle = (a, b, c) => {
    if (a < 0 || b < 0 || c < 0) return;
    const depths = [found.y[a], found.y[b], found.y[c]], jump = Math.max(...depths) - Math.min(...depths);
    if (jump > STEEPEST * step * depths[0] / f) return;
    found.i.push(a);
    found.j.push(b);
    found.k.push(c);
  };
  for (let row = 0; row + 1 < height; row++) for (let column = 0; column + 1 < width; column++) {
    const at = row * width + column;
    triangle(number[at], number[at + 1], number[at + width]);
    triangle(number[at + 1], number[at + width + 1], number[at + width]);
  }
  return found;
}

function colourScale(name) {
  const table = tables[name], stops = [];
  for (let n = 0; n <= 32; n++) {
    const at = 3 * Math.min(255, Math.round(n * 255 / 32));
    stops.push([n / 32, "rgb(" + table.slice(at, at + 3).join(",") + ")"]);
  }
  return stops;
}

async function arrows(points) {
  const parts = await Promise.all(["velocity_x", "velocity_y", "velocity_z"].map((name) => (layers.has(name + ":estimate") ? field(name + ":estimate") : null)));
  if (parts.some((part) => part === null)) return null;
  const some = [], every = Math.max(1, Math.ceil(points.x.length / (8 * MOST_ARROWS)));
  const side = Math.max(1, Math.round(Math.sqrt(data.width * data.height / MOST_ARROWS)));
  const taken = new Set();
  points.place.forEach(([px, py], n) => {
    // One arrow per square of the image.
    const square = Math.floor(px / side) + " " + Math.floor(py / side);
    if (taken.has(square) || (every > 1 && n % 2)) return;
    const velocity = parts.map((part) => valueAt(part, px, py));
    if (!velocity.every(Number.isFinite)) return;
    taken.add(square);
    some.push([n, velocity]);
  });
  const lengths = some.map(([, velocity]) => Math.hypot(...velocity)).sort((a, b) => a - b);
  const typical = lengths.length ? lengths[Math.floor(0.9 * (lengths.length - 1))] : 0;
  if (!(typical > 0)) return null;
  const span = (values) => Math.max(...values) - Math.min(...values);
  const size = Math.max(span(points.x), span(points.z)) || 1;
  // A round factor.
  const rough = 0.12 * size / typical, power = 10 ** Math.floor(Math.log10(rough)), factor = power * [5, 2, 1].find((one) => one * power <= rough);
  const line = {x: [], y: [], z: []}, tip = {x: [], y: [], z: [], u: [], v: [], w: []};
  for (const [n, [ux, uy, uz]] of some) {
    const from = [points.x[n], points.y[n], points.z[n]], to = [from[0] + factor * ux, from[1] + factor * uz, from[2] + factor * uy];
    ["x", "y", "z"].forEach((axis, at) => line[axis].push(from[at], to[at], null));
    const length = Math.hypot(ux, uy, uz) || 1;
    ["x", "y", "z"].forEach((axis, at) => tip[axis].push(to[at]));
    tip.u.push(ux / length);
    tip.v.push(uz / length);
    tip.w.push(uy / length);
  }
  return {factor, line, tip, size};
}

async function drawSurface() {
  const host = byId("surface-plot");
  if (!host || !surfaceWanted) return;
  const asked = ++surfaceDrawn, status = byId("surface-status");
  if (!hasWebGl()) {
    host.hidden = true;
    status.textContent = "This browser does not support 3D (it has no WebGL); the figure “surface” below shows the same data.";
    return;
  }
  const layer = layers.get(byId("surface-colour").value);
  const [depth, colour] = await Promise.all([field("depth:estimate"), field(layer.id), loadPlotly()]);
  const truth = byId("surface-truth") && byId("surface-truth").checked ? await field("depth:truth") : null;
  if (asked !== surfaceDrawn) return;
  if (depth === null || colour === null) {
    status.textContent = "Depth or the selected colour is not available at t = " + state.frame + ".";
    host.hidden = true;
    return;
  }
  host.hidden = false;
  const points = mesh(depth, colour), [cmin, cmax] = limits.get(layer.scale), style = getComputedStyle(document.body);
  const ink = style.getPropertyValue("--ink").trim(), line = style.getPropertyValue("--line").trim();
  const labels = points.place.map(([px, py], n) => "x = " + data.x[px] + ", y = " + data.y[py] + " px<br>" + harmless(layer.title + ": " + spellValue(layer, colour, points.intensity[n])));
  const traces = [{type: "mesh3d", x: points.x, y: points.y, z: points.z, i: points.i, j: points.j, k: points.k, intensity: points.intensity,
    colorscale: colourScale(colours.get(layer.scale)), cmin, cmax, flatshading: false, text: labels, hovertemplate: "%{text}<extra></extra>",
    lighting: {ambient: 0.75, diffuse: 0.4, specular: 0.05, roughness: 0.9}, lightposition: {x: -1000, y: -4000, z: -3000},
    colorbar: {title: {text: harmless(layer.title).replace(", ", ",<br>") + (layer.units === "1" ? "" : "<br>[" + harmless(layer.units) + "]"), side: "top"}, thickness: 14, len: 0.8}}];
  let words = points.x.length + " points without smoothing.";
  if (truth) {
    const exact = mesh(truth, null);
    traces.push({type: "mesh3d", x: exact.x, y: exact.y, z: exact.z, i: exact.i, j: exact.j, k: exact.k, color: "#e69f00", opacity: 0.45, hoverinfo: "skip"});
    words += " The truth is orange.";
  }
  if (byId("surface-arrows") && byId("surface-arrows").checked) {
    const found = await arrows(points);
    if (asked !== surfaceDrawn) return;
    if (found) {
      traces.push({type: "scatter3d", mode: "lines", x: found.line.x, y: found.line.y, z: found.line.z, line: {color: ink, width: 3}, hoverinfo: "skip", showlegend: false});
      traces.push(Object.assign({type: "cone", anchor: "tip", sizemode: "absolute", sizeref: 0.025 * found.size, showscale: false, colorscale: [[0, ink], [1, ink]], hoverinfo: "skip"}, found.tip));
      words += " Arrows: the velocity in mm/frame, enlarged " + found.factor + " times.";
    }
  }
  const axis = (title, more = {}) => Object.assign({title: {text: title}, color: ink, nticks: host.clientWidth < 600 ? 4 : 6, gridcolor: line, zerolinecolor: line, showbackground: false}, more);
  const layout = {margin: {l: 0, r: 0, t: 0, b: 0}, paper_bgcolor: "rgba(0,0,0,0)", font: {family: style.fontFamily, size: 12, color: ink}, uirevision: "kept",
    scene: {uirevision: "kept", aspectmode: "data", xaxis: axis("X [mm]"), yaxis: axis("Z [mm]"), zaxis: axis("Y [mm]", {autorange: "reversed"}),
      camera: {eye: {x: -0.6, y: -1.28, z: 0.6}, projection: {type: "orthographic"}}}};
  if (host.clientWidth < 600) Object.assign(traces[0].colorbar, {orientation: "h", y: -0.02, yanchor: "top", len: 1, thickness: 10});
  await Plotly.react(host, traces, layout, {scrollZoom: false});
  status.textContent = words;
}

function prepareSurface() {
  const select = byId("surface-colour");
  if (!select) return;
  if (!layers.has("depth:estimate")) {
    byId("surface").hidden = true;
    return;
  }
  layerChoices(select);
  const first = ["depth:error", "velocity_z:estimate", "depth:estimate"].find((id) => layers.has(id));
  select.value = layers.has("growth_rate:estimate") ? "growth_rate:estimate" : layers.has("growth_rate_windowed:estimate") ? "growth_rate_windowed:estimate" : first;
  const moves = layers.has("velocity_z:estimate");
  byId("surface-arrows").closest("label").hidden = !moves;
  byId("surface-arrows").checked = moves;
  byId("surface-truth").closest("label").hidden = !layers.has("depth:truth");
  for (const id of ["surface-colour", "surface-arrows", "surface-truth"]) byId(id).addEventListener("change", drawSurface);
  const observer = new IntersectionObserver((entries) => {
    if (!entries.some((entry) => entry.isIntersecting)) return;
    observer.disconnect();
    surfaceWanted = true;
    drawSurface();
  }, {rootMargin: "150px"});
  observer.observe(byId("surface"));
}
