// Values along one row or column: the estimate with its error band, the truth, and below them the error.

const profile = {axis: "row", at: Math.floor((data.height - 1) / 2), group: null};
let profileDrawn = 0;

function setAxis(axis) {
  profile.axis = axis;
  profile.at = axis === "row" ? cursor.y : cursor.x;
  for (const one of document.querySelectorAll("input[name=profile-axis]")) one.checked = one.value === axis;
  refresh();
}

function profileHere() {
  profile.at = profile.axis === "row" ? cursor.y : cursor.x;
  refresh();
}

function along(one, at) {
  const count = profile.axis === "row" ? data.width : data.height, found = [];
  // For subsampled maps, only the existing pixels.
  for (let n = 0; n < count; n += one.step) found.push([n, profile.axis === "row" ? valueAt(one, n, at) : valueAt(one, at, n)]);
  return found;
}

function ticks(low, high, most) {
  const rough = (high - low) / most, power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((one) => one * power >= rough), found = [];
  for (let n = Math.ceil(low / step - 1e-9); n * step <= high + 1e-9 * step; n++) found.push(n * step);
  return {found, decimals: Math.max(0, -Math.floor(Math.log10(step) + 1e-9))};
}

function tickText(value, decimals) {
  if (decimals > 5 || Math.abs(value) >= 1e6) return value === 0 ? "0" : value.toExponential(1).replaceAll("-", "−");
  return value.toFixed(decimals).replace("-", "−").replace(/^−(0(\.0+)?)$/, "$1");
}

// Names and units may contain any text.
const harmless = (text) => text.replace(/[&<>"']/g, (one) => "&#" + one.charCodeAt(0) + ";");

function chart(said, width, height, range, lines, bands, level) {
  const title = harmless(said), left = 64, right = 10, top = 24, bottom = 34, inner = width - left - right, tall = height - top - bottom;
  const seen = [...lines.map((one) => one.points), ...bands.flatMap((one) => [one.low, one.high])].flat()
    .filter(([n, value]) => Number.isFinite(value) && n >= range[0] && n <= range[1]).map(([, value]) => value).sort((a, b) => a - b);
  let low = seen.length ? seen[Math.floor(0.005 * (seen.length - 1))] : 0, high = seen.length ? seen[Math.ceil(0.995 * (seen.length - 1))] : 1;
  // Single peaks, as at discontinuities, are shown in full, unless the other values would form a flat line.
  if (seen.length && seen[seen.length - 1] - seen[0] <= 6 * (high - low)) { low = seen[0]; high = seen[seen.length - 1]; }
  if (level !== null) { low = Math.min(low, level); high = Math.max(high, level); }
  const pad = 0.08 * (high - low) || 0.05 * Math.abs(high) || 1;
  low -= pad;
  high += pad;
  const places = profile.axis === "row" ? data.x : data.y;
  const x = (n) => left + inner * (n - range[0]) / Math.max(range[1] - range[0], 1e-9);
  const y = (value) => top + tall * (1 - (Math.max(low - 9 * (high - low), Math.min(high + 9 * (high - low), value)) - low) / (high - low));
  const step = places.length > 1 ? (places[places.length - 1] - places[0]) / (places.length - 1) : 1;
  const across = ticks(places[0] + range[0] * step, places[0] + range[1] * step, Math.max(3, inner / 90));
  const up = ticks(low, high, Math.max(3, tall / 40));
  let text = `<svg viewBox="0 0 ${width} ${height}" width="${width}" height="${height}" role="img" aria-label="${title}">`;
  text += `<clipPath id="clip-${level === null ? "a" : "b"}"><rect x="${left}" y="${top}" width="${inner}" height="${tall}"/></clipPath>`;
  for (const value of up.found) text += `<line class="grid" x1="${left}" x2="${width - right}" y1="${y(value)}" y2="${y(value)}"/><text x="${left - 6}" y="${y(value) + 4}" text-anchor="end">${tickText(value, up.decimals)}</text>`;
  for (const value of across.found) {
    const at = x((value - places[0]) / step);
    text += `<line class="grid" x1="${at}" x2="${at}" y1="${top}" y2="${top + tall}"/><text x="${at}" y="${top + tall + 16}" text-anchor="middle">${tickText(value, across.decimals)}</text>`;
  }
  text += `<text x="${left}" y="14" class="title">${title}</text><text x="${width - right}" y="${height - 4}" text-anchor="end">${profile.axis === "row" ? "x" : "y"} [px]</text>`;
  text += `<g clip-path="url&#40;#clip-${level === null ? "a" : "b"})">`;
  for (const band of bands) {
    for (const run of runs(band.low.map(([n, value], at) => [n, value, band.high[at][1]]))) {
      text += `<path class="band" d="M${run.map(([n, , upper]) => x(n).toFixed(1) + " " + y(upper).toFixed(1)).join("L")}L${run.reverse().map(([n, lower]) => x(n).toFixed(1) + " " + y(lower).toFixed(1)).join("L")}Z"/>`;
    }
  }
  if (level !== null) text += `<line class="level" x1="${left}" x2="${width - right}" y1="${y(level)}" y2="${y(level)}"/>`;
  for (const line of lines) {
    for (const run of runs(line.points)) {
      const [n, value] = run[0];
      text += run.length > 1 ? `<path class="${line.name}" d="M${run.map(([m, one]) => x(m).toFixed(1) + " " + y(one).toFixed(1)).join("L")}"/>` : `<circle class="${line.name}" cx="${x(n)}" cy="${y(value)}" r="1"/>`;
    }
  }
  const here = x(profile.axis === "row" ? cursor.x : cursor.y);
  text += `<line class="here" x1="${here}" x2="${here}" y1="${top}" y2="${top + tall}"/></g><rect class="frame" x="${left}" y="${top}" width="${inner}" height="${tall}"/></svg>`;
  return text;
}

// Contiguous segments without gaps.
function runs(points) {
  const found = [];
  let run = [];
  for (const point of points) {
    if (point.slice(1).every(Number.isFinite)) run.push(point);
    else if (run.length) { found.push(run); run = []; }
  }
  if (run.length) found.push(run);
  return found;
}

async function drawProfile() {
  const group = groups.get(profile.group), host = byId("profile-charts");
  if (!group || !host) return;
  const kinds = kindsOf(group), asked = ++profileDrawn, places = profile.axis === "row" ? data.y : data.x;
  profile.at = Math.min(profile.at, places.length - 1);
  const input = byId("profile-at");
  if (document.activeElement !== input) input.value = places[profile.at];
  byId("profile-at-label").textContent = profile.axis === "row" ? "y [px]" : "x [px]";
  const found = {};
  for (const what of kinds) found[what] = await field(group.name + ":" + what);
  if (asked !== profileDrawn) return;
  const width = Math.max(280, host.clientWidth), narrow = width < 600;
  const start = profile.axis === "row" ? view.x : view.y, size = (profile.axis === "row" ? data.width : data.height) / view.scale;
  const range = [start, start + size - 1], at = profile.at;
  const get = (what) => (found[what] ? along(found[what], at) : null);
  const [estimate, truth, error, std, value] = ["estimate", "truth", "error", "std", "value"].map(get);
  const lines = [], bands = [], units = group.units === "1" ? "" : " [" + group.units + "]";
  const spread = (points, center) => {
    const bars = new Map(std || []);
    return {low: points.map(([n, one]) => [n, center(one) - 2 * bars.get(n)]), high: points.map(([n, one]) => [n, center(one) + 2 * bars.get(n)])};
  };
  if (estimate && std) bands.push(spread(estimate, (one) => one));
  if (truth) lines.push({name: "truth", points: truth});
  if (estimate) lines.push({name: "estimate", points: estimate});
  if (value) lines.push({name: "estimate", points: value});
  const line = (profile.axis === "row" ? "row y = " : "column x = ") + places[at] + ", t = " + state.frame;
  let text = lines.length ? chart(group.title + units + ", " + line, width, narrow ? 220 : 260, range, lines, bands, null) : "";
  if (error) {
    const around = std && !group.length_of ? [spread(error, () => 0)] : [];
    text += chart((group.length_of ? "Length of the error" : "Error, estimate − truth") + units, width, narrow ? 180 : 200, range, [{name: "error", points: error}], around, 0);
  }
  profileLines = Object.entries({estimate, truth, error, "standard deviation": std, value}).filter(([, points]) => points);
  host.innerHTML = text;
  byId("profile-key").hidden = false;
  for (const [name, there] of [["estimate", estimate || value], ["truth", truth], ["error", error], ["band", std]]) byId("key-" + name).hidden = !there;
}
