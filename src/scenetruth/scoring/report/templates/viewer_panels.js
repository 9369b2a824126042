// Linked panels: view, cursor, colours, outlines of regions.

const tables = Object.fromEntries(Object.entries(data.colours).map(([name, text]) => [name, Uint8Array.from(atob(text), (one) => one.charCodeAt(0))]));
const view = {scale: 1, x: 0, y: 0};
const cursor = {x: Math.floor((data.width - 1) / 2), y: Math.floor((data.height - 1) / 2)};
const panels = [];
const outlines = new Map(), shownRegions = new Set();
const REGION_COLOURS = {interior: "#e69f00", edges: "#ff3b30", hidden: "#cc79a7"};
const dark = () => getComputedStyle(document.documentElement).colorScheme === "dark";
const byId = (name) => document.getElementById(name);
const MOST_ZOOM = 64;
let lastScroll = -1e9, drawing = false;

function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === true) made.setAttribute(name, "");
    else if (value !== false && value !== null) made.setAttribute(name, value);
  }
  made.append(...children);
  return made;
}

function layerChoices(select) {
  const own = element("optgroup", {label: "Images"}, new Option("Image", "image"));
  select.append(own);
  const about = element("optgroup", {label: "Further"});
  for (const group of data.groups) {
    const kinds = kindsOf(group);
    const place = kinds[0] === "value" ? about : element("optgroup", {label: group.title});
    for (const what of kinds) place.append(new Option(layers.get(group.name + ":" + what).title, group.name + ":" + what));
    if (place !== about) select.append(place);
  }
  if (about.children.length) select.append(about);
}

function makePanel(number) {
  const select = element("select", {id: "panel-" + number});
  layerChoices(select);
  const canvas = element("canvas", {tabindex: 0, role: "application", "aria-describedby": "viewer-keys"});
  const output = element("output", {class: "value", id: "value-" + number, for: "panel-" + number});
  const low = element("input", {type: "number", step: "any", "aria-label": "Lower limit of panel " + number});
  const high = element("input", {type: "number", step: "any", "aria-label": "Upper limit of panel " + number});
  const ramp = element("canvas", {class: "ramp", width: 256, height: 1, "aria-hidden": "true"});
  const again = element("button", {type: "button", "aria-label": "Reset the limits of panel " + number}, "Auto");
  const table = element("select", {"aria-label": "Colour map of panel " + number});
  for (const name of Object.keys(tables)) table.append(new Option(name, name));
  const scale = element("div", {class: "scale"}, low, ramp, high, again);
  const codes = element("ul", {class: "codes", hidden: true});
  const root = element("div", {class: "panel", role: "group", "aria-label": "Panel " + number},
    element("div", {class: "panel-head"}, element("label", {for: "panel-" + number}, "Panel " + number), select),
    element("div", {class: "screen"}, canvas), element("p", {class: "readout"}, output, table), scale, codes);
  const panel = {number, root, select, canvas, output, low, high, ramp, again, table, scale, codes, layer: null, field: null, picture: null, painted: ""};
  canvas.style.aspectRatio = data.width + " / " + data.height;
  select.addEventListener("change", () => show(panel, select.value));
  const limit = () => {
    const pair = [Number(low.value), Number(high.value)];
    if (low.value !== "" && high.value !== "" && pair[0] < pair[1]) limits.set(panel.layer.scale, pair);
    refresh();
  };
  low.addEventListener("change", limit);
  high.addEventListener("change", limit);
  again.addEventListener("click", () => { limits.set(panel.layer.scale, [...firstLimits.get(panel.layer.scale)]); refresh(); });
  table.addEventListener("change", () => { colours.set(panel.layer.scale, table.value); refresh(); });
  listen(panel);
  addPanelTools(panel);
  return panel;
}

async function show(panel, id) {
  panel.layer = layers.get(id);
  panel.select.value = id;
  panel.canvas.setAttribute("aria-label", panel.layer.title + ". Arrow keys move the cursor.");
  const asked = panel.layer;
  const found = await field(id);
  // Another layer may have been selected in the meantime.
  if (panel.layer !== asked) return;
  panel.field = found;
  panel.painted = "";
  refresh();
}

function showAll() {
  return Promise.all(panels.map((panel) => show(panel, panel.layer.id)));
}

function paint(panel) {
  const {field: one, layer} = panel, [low, high] = limits.get(layer.scale), name = colours.get(layer.scale);
  const key = [layer.id, state.frame, state.camera, low, high, name].join(" ");
  if (one === null || panel.painted === key) return;
  panel.painted = key;
  const table = tables[name], picture = panel.picture || document.createElement("canvas");
  picture.width = one.width;
  picture.height = one.height;
  const context = picture.getContext("2d"), image = context.createImageData(one.width, one.height), bytes = image.data;
  const factor = 255.999 / (high - low);
  for (let n = 0, at = 0; n < one.values.length; n++, at += 4) {
    const value = one.values[n];
    if (Number.isNaN(value)) continue;
    const colour = 3 * Math.max(0, Math.min(255, Math.floor((value - low) * factor)));
    bytes[at] = table[colour];
    bytes[at + 1] = table[colour + 1];
    bytes[at + 2] = table[colour + 2];
    bytes[at + 3] = 255;
  }
  context.putImageData(image, 0, 0);
  panel.picture = picture;
}

function paintRamp(panel) {
  const {layer} = panel, table = tables[colours.get(layer.scale)], [low, high] = limits.get(layer.scale);
  const context = panel.ramp.getContext("2d"), image = context.createImageData(256, 1);
  for (let n = 0; n < 256; n++) image.data.set([table[3 * n], table[3 * n + 1], table[3 * n + 2], 255], 4 * n);
  context.putImageData(image, 0, 0);
  const named = layer.group ? Object.entries(layer.group.codes) : [];
  panel.scale.hidden = panel.table.hidden = named.length > 0;
  panel.codes.hidden = named.length === 0;
  if (named.length) {
    panel.codes.replaceChildren(...named.map(([code, word]) => {
      const at = 3 * Math.max(0, Math.min(255, Math.floor((Number(code) - low) / (high - low) * 255.999)));
      const swatch = element("i");
      swatch.style.background = "rgb(" + table.slice(at, at + 3).join(",") + ")";
      return element("li", {}, swatch, word);
    }));
  }
  for (const [input, value] of [[panel.low, low], [panel.high, high]]) {
    if (document.activeElement !== input) input.value = Number(value.toPrecision(4));
  }
  panel.table.value = colours.get(layer.scale);
}

// Limits of images, estimates and truths of the values that are in view: differences there become visible.
function stretch(panel) {
  const {layer, field: one} = panel;
  if (one === null || !["image", "estimate", "truth"].includes(layer.what)) return;
  const seen = [];
  for (let y = Math.ceil(view.y / one.step); y < one.height && y * one.step < view.y + data.height / view.scale; y++) {
    for (let x = Math.ceil(view.x / one.step); x < one.width && x * one.step < view.x + data.width / view.scale; x++) {
      const value = one.values[y * one.width + x];
      if (Number.isFinite(value)) seen.push(value);
    }
  }
  seen.sort((a, b) => a - b);
  const low = seen[Math.floor(0.02 * (seen.length - 1))], high = seen[Math.ceil(0.98 * (seen.length - 1))];
  if (low < high) limits.set(layer.scale, [low, high]);
}

function outlineOf(region) {
  const number = region.maps[String(state.frame)];
  if (number === undefined) return null;
  if (!outlines.has(number)) {
    outlines.set(number, null);
    mapOf(number).then((one) => {
      const path = new Path2D(), {width, height, values} = one;
      const inside = (x, y) => x >= 0 && y >= 0 && x < width && y < height && values[y * width + x] > 0;
      for (let y = 0; y <= height; y++) for (let x = 0, from = -1; x <= width; x++) {
        const edge = x < width && inside(x, y) !== inside(x, y - 1);
        if (edge && from < 0) from = x;
        if (!edge && from >= 0) { path.moveTo(from, y); path.lineTo(x, y); from = -1; }
      }
      for (let x = 0; x <= width; x++) for (let y = 0, from = -1; y <= height; y++) {
        const edge = y < height && inside(x, y) !== inside(x - 1, y);
        if (edge && from < 0) from = y;
        if (!edge && from >= 0) { path.moveTo(x, from); path.lineTo(x, y); from = -1; }
      }
      outlines.set(number, path);
      refresh();
    });
  }
  return outlines.get(number);
}

function pixelsPer(panel) {
  return panel.canvas.clientWidth * view.scale / data.width;
}

function draw(panel) {
  const {canvas} = panel, ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  if (!width || !panel.layer) return;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d"), k = pixelsPer(panel);
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  if (panel.field !== null) {
    paint(panel);
    const {step} = panel.field, first = 0.5 - step / 2;
    context.imageSmoothingEnabled = k * step * ratio < 1;
    context.drawImage(panel.picture, (first - view.x) * k, (first - view.y) * k, panel.field.width * step * k, panel.field.height * step * k);
  }
  for (const region of data.regions) {
    const path = shownRegions.has(region.name) ? outlineOf(region) : null;
    if (!path) continue;
    context.setTransform(ratio * k, 0, 0, ratio * k, -view.x * k * ratio, -view.y * k * ratio);
    context.lineWidth = 1.5 / k;
    context.strokeStyle = REGION_COLOURS[region.name] || "#e69f00";
    context.stroke(path);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
  }
  const x = (cursor.x + 0.5 - view.x) * k, y = (cursor.y + 0.5 - view.y) * k;
  const line = (points, colour, thick, dashes = []) => {
    context.beginPath();
    context.setLineDash(dashes);
    points.forEach(([a, b], n) => (n % 2 ? context.lineTo(a, b) : context.moveTo(a, b)));
    context.lineWidth = thick;
    context.strokeStyle = colour;
    context.stroke();
    context.setLineDash([]);
  };
  const along = profile.axis === "row" ? (profile.at + 0.5 - view.y) * k : (profile.at + 0.5 - view.x) * k;
  const path = profile.axis === "row" ? [[0, along], [width, along]] : [[along, 0], [along, height]];
  line(path, "#000000", 2);
  line(path, "#ffd23f", 2, [6, 4]);
  const gap = Math.max(4, k / 2 + 2);
  const cross = [[0, y], [x - gap, y], [x + gap, y], [width, y], [x, 0], [x, y - gap], [x, y + gap], [x, height]];
  line(cross, "rgba(0,0,0,.55)", 2);
  line(cross, "#ffffff", 0.9);
}

function readout(panel) {
  if (!panel.layer) return;
  const value = panel.field === null ? NaN : valueAt(panel.field, cursor.x, cursor.y);
  panel.output.textContent = spellValue(panel.layer, panel.field, value);
  panel.output.dataset.number = String(value);
}

// At most once per displayed frame of the screen.
function refresh() {
  if (drawing) return;
  drawing = true;
  requestAnimationFrame(() => {
    drawing = false;
    for (const panel of panels) {
      if (!panel.layer) continue;
      draw(panel);
      paintRamp(panel);
      readout(panel);
    }
    byId("place").textContent = "x = " + spell(data.x[cursor.x], 0) + " px, y = " + spell(data.y[cursor.y], 0) + " px";
    byId("zoom").textContent = view.scale.toFixed(view.scale < 10 ? 1 : 0).replace(/\.0$/, "") + " ×";
    const touch = view.scale > 1 ? "none" : "pan-y";
    for (const panel of panels) panel.canvas.style.touchAction = touch;
    drawProfile();
  });
}

function keepInside() {
  view.scale = Math.max(1, Math.min(MOST_ZOOM, view.scale));
  view.x = Math.max(0, Math.min(data.width - data.width / view.scale, view.x));
  view.y = Math.max(0, Math.min(data.height - data.height / view.scale, view.y));
}

// Zooms about a fixed point of the map.
function zoom(factor, x, y) {
  const before = view.scale;
  view.scale = Math.max(1, Math.min(MOST_ZOOM, before * factor));
  view.x = x - (x - view.x) * before / view.scale;
  view.y = y - (y - view.y) * before / view.scale;
  keepInside();
  refresh();
}

function moveCursor(x, y) {
  cursor.x = Math.max(0, Math.min(data.width - 1, Math.floor(x)));
  cursor.y = Math.max(0, Math.min(data.height - 1, Math.floor(y)));
  refresh();
}

function reveal() {
  const width = data.width / view.scale, height = data.height / view.scale;
  if (cursor.x < view.x || cursor.x >= view.x + width) view.x = cursor.x - width / 2;
  if (cursor.y < view.y || cursor.y >= view.y + height) view.y = cursor.y - height / 2;
  keepInside();
}

function listen(panel) {
  const {canvas} = panel, pointers = new Map();
  let moved = 0, apart = 0, middle = [0, 0];
  const place = (event) => {
    const box = canvas.getBoundingClientRect(), k = pixelsPer(panel);
    return [(event.clientX - box.left) / k + view.x, (event.clientY - box.top) / k + view.y];
  };
  // The distance of two fingers, and their midpoint.
  const spread = () => {
    if (pointers.size !== 2) return 0;
    const [a, b] = [...pointers.values()];
    middle = [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];
    return Math.hypot(a[0] - b[0], a[1] - b[1]);
  };
  canvas.addEventListener("pointerdown", (event) => {
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    canvas.setPointerCapture(event.pointerId);
    if (pointers.size === 1) moved = 0;
    apart = spread();
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (before === undefined) {
      moveCursor(...place(event));
      return;
    }
    const k = pixelsPer(panel), now = [event.clientX, event.clientY];
    pointers.set(event.pointerId, now);
    moved += Math.hypot(now[0] - before[0], now[1] - before[1]);
    if (pointers.size === 1 && moved > 4) {
      view.x -= (now[0] - before[0]) / k;
      view.y -= (now[1] - before[1]) / k;
      keepInside();
      refresh();
    } else if (pointers.size === 2) {
      const from = middle, before = apart;
      apart = spread();
      view.x -= (middle[0] - from[0]) / k;
      view.y -= (middle[1] - from[1]) / k;
      keepInside();
      if (before > 0 && apart > 0) zoom(apart / before, ...place({clientX: middle[0], clientY: middle[1]}));
    }
  });
  const end = (event, clicked) => {
    const single = pointers.size === 1;
    pointers.delete(event.pointerId);
    apart = spread();
    if (clicked && single && moved <= 4) {
      moveCursor(...place(event));
      profileHere();
    }
  };
  canvas.addEventListener("pointerup", (event) => end(event, true));
  canvas.addEventListener("pointercancel", (event) => end(event, false));
  canvas.addEventListener("wheel", (event) => {
    const factor = Math.exp(-0.0015 * event.deltaY * (event.deltaMode === 1 ? 16 : 1));
    // Ongoing scrolling continues over the maps, and zooming out at full view scrolls the page.
    if (performance.now() - lastScroll < 250 || (view.scale <= 1 && factor < 1)) return;
    event.preventDefault();
    zoom(factor, ...place(event));
  }, {passive: false});
  canvas.addEventListener("dblclick", (event) => { event.preventDefault(); zoom(2, ...place(event)); });
  canvas.addEventListener("keydown", (event) => {
    const far = event.shiftKey ? 10 : 1;
    const steps = {ArrowLeft: [-far, 0], ArrowRight: [far, 0], ArrowUp: [0, -far], ArrowDown: [0, far]}[event.key];
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    if (steps) { moveCursor(cursor.x + steps[0], cursor.y + steps[1]); reveal(); tell(); }
    else if (event.key === "+" || event.key === "=") zoom(1.5, cursor.x + 0.5, cursor.y + 0.5);
    else if (event.key === "-") zoom(1 / 1.5, cursor.x + 0.5, cursor.y + 0.5);
    else if (event.key === "0" || event.key === "Home") zoomOut();
    else if (event.key === "Enter" || event.key === " ") profileHere();
    else if (event.key === "r" || event.key === "c") { setAxis(event.key === "r" ? "row" : "column"); profileHere(); }
    else return;
    event.preventDefault();
  });
}

// Announces the values at the cursor to screen readers once the keys rest.
let telling = 0;
function tell() {
  clearTimeout(telling);
  telling = setTimeout(() => {
    byId("announcement").textContent = byId("place").textContent + ": " + panels.map((panel) => panel.layer.title + " " + panel.output.textContent).join("; ");
  }, 400);
}

function zoomOut() {
  Object.assign(view, {scale: 1, x: 0, y: 0});
  refresh();
}

// The layers of the panels for a quantity, the most informative first.
function arrangement(name, count) {
  const group = groups.get(name), kinds = group ? kindsOf(group) : [], ids = (...some) => some.filter((what) => kinds.includes(what)).map((what) => name + ":" + what);
  const all = count > 2 ? ["image", ...ids("value", "estimate", "error", "truth", "std")] : [...ids("value", "estimate", "error", "truth", "std"), "image"];
  if (count > 3) all.splice(0, all.length, "image", ...ids("value", "estimate", "truth", "error", "std"));
  // For quantities with few layers: the components of an endpoint error, or the depth.
  const more = group && group.length_of ? group.length_of.map((part) => part + ":error").reverse() : [];
  more.push("depth:estimate", "depth:error");
  all.push(...more.filter((id) => layers.has(id) && !all.includes(id)));
  return all.slice(0, count);
}

function arrange(wanted, name) {
  const shown = arrangement(name, wanted), count = shown.length;
  while (panels.length < count) {
    const panel = makePanel(panels.length + 1);
    panels.push(panel);
    byId("panels").append(panel.root);
  }
  while (panels.length > count) panels.pop().root.remove();
  byId("panels").dataset.count = count;
  return Promise.all(shown.map((id, n) => show(panels[n], id)));
}
