// The available layers, and their values at the selected frame and camera.

const data = JSON.parse(document.getElementById("viewer-data").textContent);
const groups = new Map(data.groups.map((group) => [group.name, group]));
const state = {frame: data.frame, fallback: false, camera: data.images.cameras.findIndex(([row, column]) => row === 0 && column === 0)};
const WHAT = {estimate: "estimate", truth: "truth", error: "error", std: "standard deviation", value: ""};

function kindsOf(group) {
  const found = [], maps = Object.values(group.maps);
  if (group.length_of) return ["error"];
  if (maps.some((one) => "estimate" in one || "rest" in one || ("error" in one && "truth" in one))) found.push("estimate");
  for (const what of ["truth", "error", "std", "value"]) if (maps.some((one) => what in one)) found.push(what);
  return found;
}

const layers = new Map([["image", {id: "image", group: null, what: "image", title: "Image", units: data.images.units, scale: "image"}]]);
for (const group of data.groups) {
  for (const what of kindsOf(group)) {
    const scale = what === "error" || what === "std" ? what : "value";
    const title = WHAT[what] ? group.title + ", " + (group.length_of ? "length of the error" : WHAT[what]) : group.title;
    layers.set(group.name + ":" + what, {id: group.name + ":" + what, group, what, title, units: group.units, scale: group.name + ":" + scale});
  }
}

const limits = new Map([["image", [...data.images.limits]]]);
for (const group of data.groups) for (const [scale, pair] of Object.entries(group.limits)) limits.set(group.name + ":" + scale, [...pair]);
const firstLimits = new Map([...limits].map(([name, pair]) => [name, [...pair]]));

function firstColours(layer) {
  if (layer.what === "image") return "grey";
  if (layer.what === "error") return limits.get(layer.scale)[0] < 0 ? "blue-white-red" : "magma";
  return layer.what === "std" ? "cividis" : "viridis";
}
const colours = new Map([...layers.values()].map((layer) => [layer.scale, firstColours(layer)]));

const unpacked = new Map(), fields = new Map();

function mapOf(number) {
  if (!unpacked.has(number)) unpacked.set(number, unpack(data.maps[number]));
  return unpacked.get(number);
}

// The image of the selected camera and frame, if the page has it.
function chosenImage() {
  const [row, camera] = data.images.cameras[state.camera];
  return data.images.shown.find((one) => one.row === row && one.camera === camera && one.frame === state.frame);
}

// A field: width, height, values, quantum (the step to which they are rounded), step (pixels of the widest map between them).
function field(id, frame = state.frame) {
  const layer = layers.get(id), name = id === "image" ? "image " + state.camera + " " + frame : id + " " + frame + (state.fallback ? " with fallback" : "");
  if (!fields.has(name)) {
    // A few large maps would fill the memory of a phone.
    if (fields.size > 48) fields.delete(fields.keys().next().value);
    fields.set(name, layer.what === "image" ? imageField(frame) : layer.group.length_of ? lengthField(layer, frame) : shownField(layer, frame));
  }
  return fields.get(name);
}

async function imageField(frame) {
  const [row, camera] = data.images.cameras[state.camera];
  const one = data.images.shown.find((each) => each.row === row && each.camera === camera && each.frame === frame);
  return one === undefined ? null : Object.assign({step: one.step}, await mapOf(one.map));
}

// Whether a quantity has fallback values in any frame.
const hasFallback = data.groups.some((group) => Object.values(group.maps).some((one) => "fallback_estimate" in one));

// The valid values, and fallback values on request.
async function shownField(layer, frame) {
  const valid = await mapField(layer, frame), maps = layer.group.maps[String(frame)];
  if (!state.fallback || maps === undefined || !("fallback_" + layer.what in maps)) return valid;
  const rest = await mapOf(maps["fallback_" + layer.what]);
  if (valid === null) return Object.assign({step: maps.step}, rest);
  const values = valid.values.map((value, n) => (Number.isNaN(value) ? rest.values[n] : value));
  return Object.assign({}, valid, {values, quantum: Math.max(valid.quantum, rest.quantum)});
}

async function mapField(layer, frame) {
  const maps = layer.group.maps[String(frame)];
  if (maps === undefined) return null;
  const {step} = maps;
  if (layer.what in maps) return Object.assign({step}, await mapOf(maps[layer.what]));
  if (layer.what !== "estimate" || !("truth" in maps && "error" in maps)) return null;
  const [truth, error] = await Promise.all([mapOf(maps.truth), mapOf(maps.error)]);
  const rest = "rest" in maps ? await mapOf(maps.rest) : null;
  const values = truth.values.map((value, n) => value + error.values[n]);
  if (rest) rest.values.forEach((value, n) => { if (Number.isNaN(values[n])) values[n] = value; });
  return {width: truth.width, height: truth.height, values, quantum: Math.max(truth.quantum, error.quantum), step};
}

async function lengthField(layer, frame) {
  const parts = await Promise.all(layer.group.length_of.map((name) => field(name + ":error", frame)));
  if (parts.some((part) => part === null)) return null;
  const values = parts[0].values.map((_, n) => Math.hypot(...parts.map((part) => part.values[n])));
  return {width: parts[0].width, height: parts[0].height, values, quantum: Math.max(...parts.map((part) => part.quantum)), step: parts[0].step};
}

// The value at a pixel of the widest map.
function valueAt(one, x, y) {
  const column = Math.min(one.width - 1, Math.round(x / one.step)), row = Math.min(one.height - 1, Math.round(y / one.step));
  return one.values[row * one.width + column];
}

function spellDigits(value, digits) {
  const text = value.toPrecision(Math.max(1, Math.min(digits, 12)));
  const [mantissa, exponent] = text.split("e");
  return (exponent ? mantissa + " × 10^" + Number(exponent) : mantissa).replaceAll("-", "−");
}

// A number with the digits that are significant after rounding.
function spell(value, quantum) {
  if (Number.isNaN(value)) return "no value";
  if (!Number.isFinite(value)) return value > 0 ? "∞" : "−∞";
  if (value === 0) return "0";
  if (Number.isInteger(value) && Math.abs(value) < 1e9 && (quantum === 1 || quantum === 0)) return String(value).replace("-", "−");
  const least = quantum > 0 ? Math.floor(Math.log10(quantum)) : -Infinity;
  const digits = Math.floor(Math.log10(Math.abs(value))) - least + 1;
  if (digits < 1) return "0";
  return spellDigits(value, Math.min(digits, 7));
}

function spellValue(layer, one, value) {
  if (one === null) return layer.what === "image" ? "no image of this camera at this frame" : "no estimate at this frame";
  const word = layer.group && layer.group.codes[String(value)];
  if (word) return word;
  const units = layer.units === "1" || Number.isNaN(value) ? "" : " " + layer.units;
  return spell(value, one.quantum) + units;
}
