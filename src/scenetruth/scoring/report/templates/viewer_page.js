// The page itself: sorting of tables, light and dark colours, printing, and the start of the viewer.

function keyOf(cell) {
  const key = cell.dataset.key;
  if (key !== undefined) return key === "" ? null : parseFloat(key);
  return cell.textContent.trim();
}

for (const table of document.querySelectorAll("table.sortable")) {
  for (const button of table.querySelectorAll("th button")) {
    button.addEventListener("click", () => {
      const head = button.closest("th"), column = Number(head.dataset.column), up = head.getAttribute("aria-sort") !== "ascending";
      table.querySelectorAll("th").forEach((one) => one.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
      const body = table.tBodies[0], lines = Array.from(body.rows);
      lines.sort((one, other) => {
        const a = keyOf(one.cells[column]), b = keyOf(other.cells[column]);
        // Undefined values stay at the end in both directions.
        if (a === null || b === null) return (a === null) - (b === null);
        const order = a < b ? -1 : a > b ? 1 : 0;
        return up ? order : -order;
      });
      body.append(...lines);
    });
  }
}

const appearance = byId("appearance");
appearance.addEventListener("change", () => {
  if (appearance.value === "auto") delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = appearance.value;
  try { localStorage.setItem("scenetruth-appearance", appearance.value); } catch { /* Files may not be allowed to keep anything. */ }
  refresh();
  drawSurface();
});
try {
  const kept = localStorage.getItem("scenetruth-appearance");
  if (kept === "light" || kept === "dark") {
    appearance.value = kept;
    document.documentElement.dataset.theme = kept;
  }
} catch { /* As above. */ }
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { refresh(); drawSurface(); });

const opened = [];
window.addEventListener("beforeprint", () => {
  for (const one of document.querySelectorAll("details:not([open])")) { one.open = true; opened.push(one); }
});
window.addEventListener("afterprint", () => { for (const one of opened.splice(0)) one.open = false; });

function slider(input, output, places, spelled, changed) {
  input.max = places.length - 1;
  input.closest(".slider").hidden = places.length < 2;
  const tell = () => {
    output.textContent = spelled(places[Number(input.value)]);
    input.setAttribute("aria-valuetext", output.textContent);
  };
  input.addEventListener("input", () => { tell(); changed(Number(input.value)); });
  return (n) => { input.value = n; tell(); };
}

function start() {
  const {cameras, frames} = data.images, rows = new Set(cameras.map(([row]) => row)).size > 1;
  const spellCamera = ([row, column]) => (rows ? "s_y = " + row + ", s = " : "s = ") + column;
  const reference = state.camera;
  const changed = () => { showAll(); drawSurface(); };
  const setCamera = slider(byId("camera"), byId("camera-value"), cameras, spellCamera, (n) => {
    state.camera = n;
    // Images of other cameras exist at one frame only.
    if (n !== reference && !chosenImage()) { state.frame = data.frame; setFrame(frames.indexOf(state.frame)); }
    changed();
  });
  const setFrame = slider(byId("frame"), byId("frame-value"), frames, (t) => "t = " + t, (n) => {
    state.frame = frames[n];
    if (state.camera !== reference && !chosenImage()) { state.camera = reference; setCamera(reference); }
    changed();
  });
  setCamera(state.camera);
  setFrame(frames.indexOf(state.frame));
  const missing = cameras.length > 1 && frames.length > 1 && data.images.shown.length < cameras.length * frames.length;
  byId("images-note").hidden = !missing;
  byId("images-note").textContent = "Images of cameras other than " + spellCamera(cameras[reference]) + " are available at t = " + data.frame + " only.";

  const quantity = byId("quantity"), along = byId("profile-quantity"), count = byId("panel-count");
  for (const group of data.groups) {
    if (kindsOf(group)[0] !== "value") quantity.append(new Option(group.title, group.name));
    along.append(new Option(group.title, group.name));
  }
  const first = ["depth", "velocity_z", "disparity", "flow_x", "growth_rate"].find((name) => groups.has(name) && kindsOf(groups.get(name)).includes("estimate"));
  quantity.value = first || (data.groups[0] || {name: ""}).name;
  profile.group = quantity.value;
  along.value = profile.group;
  count.value = window.innerWidth < 700 ? "2" : "3";
  const again = () => { profile.group = quantity.value; along.value = profile.group; return arrange(Number(count.value), quantity.value); };
  quantity.addEventListener("change", again);
  count.addEventListener("change", again);
  along.addEventListener("change", () => { profile.group = along.value; refresh(); });
  for (const one of document.querySelectorAll("input[name=profile-axis]")) one.addEventListener("change", () => setAxis(one.value));
  byId("profile-at").addEventListener("input", (event) => {
    const places = profile.axis === "row" ? data.y : data.x, wanted = Number(event.target.value);
    if (event.target.value === "" || Number.isNaN(wanted)) return;
    let best = 0;
    places.forEach((place, n) => { if (Math.abs(place - wanted) < Math.abs(places[best] - wanted)) best = n; });
    profile.at = best;
    cursor[profile.axis === "row" ? "y" : "x"] = best;
    refresh();
  });
  byId("profile-charts").addEventListener("pointermove", (event) => {
    const svg = event.target.closest("svg");
    if (!svg) return;
    const box = svg.getBoundingClientRect(), horizontal = profile.axis === "row", size = horizontal ? data.width : data.height;
    const n = (horizontal ? view.x : view.y) + (event.clientX - box.left - 64) / (box.width - 74) * (size / view.scale - 1);
    moveCursor(horizontal ? n + 0.5 : profile.at, horizontal ? profile.at : n + 0.5);
  });
  const centre = () => [view.x + data.width / view.scale / 2, view.y + data.height / view.scale / 2];
  byId("zoom-in").addEventListener("click", () => zoom(1.5, ...centre()));
  byId("zoom-out").addEventListener("click", () => zoom(1 / 1.5, ...centre()));
  byId("zoom-all").addEventListener("click", zoomOut);
  const fallback = byId("fallback");
  byId("fallback-label").hidden = !hasFallback;
  fallback.checked = false;
  fallback.addEventListener("change", () => { state.fallback = fallback.checked; changed(); });
  const regions = byId("regions");
  regions.hidden = data.regions.length === 0;
  for (const region of data.regions) {
    const box = element("input", {type: "checkbox", value: region.name});
    box.addEventListener("change", () => { if (box.checked) shownRegions.add(region.name); else shownRegions.delete(region.name); refresh(); });
    const swatch = element("i");
    swatch.style.background = REGION_COLOURS[region.name] || "#e69f00";
    regions.append(element("label", {}, box, swatch, region.title));
  }
  for (const button of document.querySelectorAll("button.go")) {
    const id = button.dataset.layer;
    button.hidden = !layers.has(id);
    button.addEventListener("click", async () => {
      const nearest = (places, wanted) => places.reduce((best, place, n) => (Math.abs(place - wanted) < Math.abs(places[best] - wanted) ? n : best), 0);
      state.frame = data.frame;
      setFrame(frames.indexOf(state.frame));
      quantity.value = layers.get(id).group.name;
      await arrange(Number(count.value), quantity.value);
      if (!panels.some((panel) => panel.layer.id === id)) await show(panels[panels.length - 1], id);
      moveCursor(nearest(data.x, Number(button.dataset.x)), nearest(data.y, Number(button.dataset.y)));
      Object.assign(view, {scale: 1, x: 0, y: 0});
      zoom(4, cursor.x, cursor.y);
      Object.assign(view, {x: cursor.x - data.width / 8, y: cursor.y - data.height / 8});
      keepInside();
      panels.forEach(stretch);
      profile.group = layers.get(id).group.name;
      along.value = profile.group;
      profileHere();
      byId("maps").scrollIntoView({block: "start"});
      panels[0].canvas.focus({preventScroll: true});
    });
  }
  window.addEventListener("scroll", () => { lastScroll = performance.now(); }, {passive: true});
  new ResizeObserver(refresh).observe(byId("panels"));
  prepareSurface();
  addProfileTools();
  addSurfaceTools();
  return again();
}

// For the tests: the content of the viewer.
window.scenetruthReport = {data, state, view, cursor, profile, panels, layers, field, valueAt, ready: null};
if (typeof DecompressionStream === "undefined") {
  byId("viewer").hidden = true;
  byId("surface").hidden = true;
  byId("too-old").hidden = false;
} else {
  window.scenetruthReport.ready = start().then(() => { document.documentElement.dataset.ready = "yes"; });
}
