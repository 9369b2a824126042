// Copies of maps and profiles: pictures with title and colour scale, and their values as CSV.

const escaped = (text) => harmless(String(text));

// The shown section of a map with its title, axes in px and colour scale, as SVG.
function panelSvg(panel) {
  const {layer, field: one, picture} = panel, [low, high] = limits.get(layer.scale);
  const wide = 480, tall = wide * data.height / data.width, left = 56, top = 34, bottom = 84, k = wide * view.scale / data.width;
  const first = 0.5 - one.step / 2, units = layer.units === "1" ? "" : " [" + layer.units + "]";
  const image = (address, x, y, width, height) => '<image x="' + x + '" y="' + y + '" width="' + width + '" height="' + height + '" preserveAspectRatio="none" style="image-rendering:pixelated" href="' + address + '"/>';
  const text = (x, y, said, anchor = "middle", weight = "normal") => '<text x="' + x + '" y="' + y + '" text-anchor="' + anchor + '" font-weight="' + weight + '">' + escaped(said) + "</text>";
  const width = left + wide + 20, height = top + tall + bottom;
  let found = '<svg xmlns="' + scenetruthPage.svgNames + '" width="' + width + '" height="' + height + '" font-family="sans-serif" font-size="12"><rect width="100%" height="100%" fill="#ffffff"/>';
  found += text(left, 20, layer.title + units + ", t = " + state.frame, "start", "bold") + '<svg x="' + left + '" y="' + top + '" width="' + wide + '" height="' + tall + '"><rect width="100%" height="100%" fill="#a9b0b8"/>';
  found += image(picture.toDataURL("image/png"), (first - view.x) * k, (first - view.y) * k, one.width * one.step * k, one.height * one.step * k) + "</svg>";
  found += '<rect x="' + left + '" y="' + top + '" width="' + wide + '" height="' + tall + '" fill="none" stroke="#444444"/>';
  const pitch = (places) => (places.length > 1 ? (places[places.length - 1] - places[0]) / (places.length - 1) : 1);
  for (const [places, start, extent, along] of [[data.x, view.x, data.width, true], [data.y, view.y, data.height, false]]) {
    const begin = places[0] + start * pitch(places), end = begin + (extent / view.scale - 1) * pitch(places), marks = ticks(begin, Math.max(end, begin + 1e-9), along ? 6 : 4);
    for (const value of marks.found) {
      const at = ((value - places[0]) / pitch(places) + 0.5 - start) * k;
      found += along ? text(left + at, top + tall + 15, tickText(value, marks.decimals)) : text(left - 6, top + at + 4, tickText(value, marks.decimals), "end");
    }
  }
  found += text(left + wide / 2, top + tall + 31, "x [px]") + text(4, top - 6, "y [px]", "start");
  if (panel.codes.hidden) {
    found += image(panel.ramp.toDataURL("image/png"), left, top + tall + 42, wide, 12) + text(left, top + tall + 70, spellDigits(low, 4), "start") + text(left + wide, top + tall + 70, spellDigits(high, 4), "end");
  } else {
    found += text(left, top + tall + 56, [...panel.codes.children].map((item) => item.textContent).join(", "), "start");
  }
  return found + "</svg>";
}

function panelRows(panel) {
  const {layer, field: one} = panel, rows = [["x [px]", "y [px]", layer.title + (layer.units === "1" ? "" : " [" + layer.units + "]")]];
  for (let y = 0, n = 0; y < one.height; y++) for (let x = 0; x < one.width; x++, n++) {
    rows.push([data.x[Math.min(x * one.step, data.width - 1)], data.y[Math.min(y * one.step, data.height - 1)], Number.isNaN(one.values[n]) ? "" : Number(one.values[n].toPrecision(7))]);
  }
  return rows;
}

function addPanelTools(panel) {
  const svg = () => panelSvg(panel);
  scenetruthPage.addTools(panel.root, () => (panel.layer ? panel.layer.title : "Panel " + panel.number), {svg, png: () => scenetruthPage.svgCanvas(svg()), csv: () => panelRows(panel)});
}

let profileLines = [];

function profileRows() {
  const places = profile.axis === "row" ? data.x : data.y, group = groups.get(profile.group), units = group.units === "1" ? "" : " [" + group.units + "]";
  const count = places.length, columns = profileLines.map(([, points]) => new Map(points));
  const rows = [[(profile.axis === "row" ? "x" : "y") + " [px]", ...profileLines.map(([name]) => name + units)]];
  for (let n = 0; n < count; n++) {
    if (!columns.some((points) => points.has(n))) continue;
    rows.push([places[n], ...columns.map((points) => (points.has(n) && !Number.isNaN(points.get(n)) ? Number(points.get(n).toPrecision(7)) : ""))]);
  }
  return rows;
}

// The charts of a profile, one below the other.
function profileSvg() {
  const charts = [...byId("profile-charts").querySelectorAll("svg")];
  let height = 0, width = 0, text = "";
  for (const one of charts) {
    const box = one.getBoundingClientRect();
    text += scenetruthPage.svgText(one).replace("<svg ", '<svg y="' + height + '" ');
    height += box.height;
    width = Math.max(width, box.width);
  }
  return '<svg xmlns="' + scenetruthPage.svgNames + '" width="' + width + '" height="' + height + '">' + text + "</svg>";
}

function addProfileTools() {
  const place = element("div");
  byId("profile-key").after(place);
  scenetruthPage.addTools(place, "Profile", {svg: profileSvg, png: () => scenetruthPage.svgCanvas(profileSvg()), csv: profileRows});
}

function addSurfaceTools() {
  const host = byId("surface-plot");
  const picture = (format) => Plotly.toImage(host, {format, width: host.clientWidth, height: host.clientHeight, scale: format === "png" ? 2 : 1});
  const png = async () => {
    const shown = new Image();
    shown.src = await picture("png");
    await shown.decode();
    const canvas = element("canvas", {width: shown.naturalWidth, height: shown.naturalHeight});
    canvas.getContext("2d").drawImage(shown, 0, 0);
    return canvas;
  };
  const csv = () => {
    const points = host.data[0], label = layers.get(byId("surface-colour").value), units = label.units === "1" ? "" : " [" + label.units + "]";
    // The axes of the plot are X, Z and Y.
    return [["X [mm]", "Y [mm]", "Z [mm]", label.title + units], ...Array.from(points.x, (x, n) => [x, points.z[n], points.y[n], points.intensity[n]])];
  };
  scenetruthPage.addTools(byId("surface"), "Surface in 3D", {png, csv});
}
