// Tools of all pages: definitions under the pointer, tables that scroll, and copies of figures (SVG, PNG) and data (CSV).

window.scenetruthPage = (() => {
  "use strict";

  function make(tag, attributes = {}, ...children) {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    made.append(...children);
    return made;
  }

  const svgNames = (() => {
    const within = document.createElement("div");
    within.innerHTML = "<svg></svg>";
    return within.firstChild.namespaceURI;
  })();

  // Definitions: shown at the pointer and at the keyboard's place, until Escape or until it moves away.

  function listenToTerms() {
    const shown = make("div", {id: "definition", role: "tooltip"});
    shown.hidden = true;
    document.body.append(shown);
    let hiding = 0;
    const hide = () => { shown.hidden = true; };
    const show = (term) => {
      const text = document.getElementById("term-" + term.dataset.term);
      if (!text) return;
      clearTimeout(hiding);
      shown.replaceChildren(...text.cloneNode(true).childNodes);
      shown.hidden = false;
      const place = term.getClientRects()[0] || term.getBoundingClientRect(), box = shown.getBoundingClientRect();
      const width = document.documentElement.clientWidth;
      shown.style.left = Math.max(8, Math.min(place.left, width - box.width - 8)) + "px";
      const above = place.top - box.height - 6;
      shown.style.top = (place.bottom + 6 + box.height > window.innerHeight && above > 0 ? above : place.bottom + 6) + "px";
    };
    const termOf = (event) => (event.target.closest ? event.target.closest("[data-term]") : null);
    for (const name of ["pointerover", "focusin", "click"]) {
      document.addEventListener(name, (event) => { const term = termOf(event); if (term) show(term); });
    }
    document.addEventListener("pointerout", (event) => { if (termOf(event)) hiding = setTimeout(hide, 200); });
    shown.addEventListener("pointerenter", () => clearTimeout(hiding));
    shown.addEventListener("pointerleave", hide);
    document.addEventListener("focusout", hide);
    document.addEventListener("keydown", (event) => { if (event.key === "Escape") hide(); });
    window.addEventListener("scroll", hide, {passive: true, capture: true});
  }

  // CSV: commas, quotes where needed, a full stop as decimal sign.

  function csv(rows) {
    const spelled = (value) => {
      const text = value === null || value === undefined || Number.isNaN(value) ? "" : String(value);
      return /[",\n]/.test(text) ? '"' + text.replaceAll('"', '""') + '"' : text;
    };
    return rows.map((row) => row.map(spelled).join(",")).join("\r\n") + "\r\n";
  }

  const plain = (text) => String(text === undefined || text === null ? "" : text).replace(/<br\s*\/?>/g, " ").replace(/<[^>]*>/g, "").replace(/\s+/g, " ").trim();

  // A cell's number in full where the cell holds only a number, else its text.
  function cellValue(cell) {
    const text = cell.textContent.trim(), key = cell.dataset.key;
    if (text === "–") return "";
    if (key !== undefined && key !== "" && /^[-−+]?[\d.\u202f\s]+(× 10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?$/.test(text)) return Number(key);
    return plain(cell.innerHTML.replaceAll("&nbsp;", " ")).replaceAll("&lt;", "<").replaceAll("&gt;", ">").replaceAll("&amp;", "&");
  }

  function tableRows(table) {
    const grid = [];
    [...(table.tHead ? table.tHead.rows : [])].forEach((row, y) => {
      let x = 0;
      for (const cell of row.cells) {
        while (grid[y] && grid[y][x] !== undefined) x++;
        for (let dy = 0; dy < cell.rowSpan; dy++) for (let dx = 0; dx < cell.colSpan; dx++) {
          (grid[y + dy] = grid[y + dy] || [])[x + dx] = cell.textContent.trim();
        }
        x += cell.colSpan;
      }
    });
    const width = grid.length ? grid[0].length : 0;
    const head = Array.from({length: width}, (_, x) => [...new Set(grid.map((row) => row[x]))].filter(Boolean).join(": "));
    const lines = [...table.tBodies, ...(table.tFoot ? [table.tFoot] : [])].flatMap((part) => [...part.rows]);
    return [...(width ? [head] : []), ...lines.map((row) => [...row.cells].map(cellValue))];
  }

  // The traces of a chart: one row per point, with the ends of its error bars.
  function chartRows(data, layout) {
    const title = (axis, other) => plain(layout[axis] && layout[axis].title && layout[axis].title.text) || other;
    const x = title("xaxis", "x"), y = title("yaxis", plain(layout.title && layout.title.text) || "y");
    const ends = (bars, value, n) => {
      if (!bars || bars.visible === false || !bars.array) return ["", ""];
      const up = bars.array[n], down = bars.symmetric === false || bars.arrayminus ? (bars.arrayminus || bars.array)[n] : up;
      return up === null || up === undefined || value === null ? ["", ""] : [value - down, value + up];
    };
    const grids = data.filter((trace) => trace.z && Array.isArray(trace.z[0]));
    if (grids.length) {
      const rows = [["series", x, y, "value"]];
      for (const trace of grids) trace.z.forEach((line, j) => line.forEach((value, i) => {
        rows.push([plain(trace.name), trace.x ? trace.x[i] : i, trace.y ? trace.y[j] : j, value]);
      }));
      return rows;
    }
    const barred = ["error_x", "error_y"].filter((name) => data.some((trace) => trace[name] && trace[name].array));
    const based = data.some((trace) => trace.base);
    const rows = [["series", x, y, ...barred.flatMap((name) => (name === "error_x" ? [x + ", lower", x + ", upper"] : [y + ", lower", y + ", upper"])), ...(based ? ["from"] : [])]];
    for (const trace of data) {
      const size = Math.max((trace.x || []).length, (trace.y || []).length);
      for (let n = 0; n < size; n++) {
        const at = trace.x ? trace.x[n] : n, value = trace.y ? trace.y[n] : n;
        const bars = barred.flatMap((name) => ends(trace[name], name === "error_x" ? at : value, n));
        rows.push([plain(trace.name), at, value, ...bars, ...(based ? [trace.base ? trace.base[n] : ""] : [])]);
      }
    }
    return rows;
  }

  // Copies and files. A figure is an SVG text, or a canvas for PNG.

  function fileName(title) {
    return plain(title).replace(/[^\p{L}\p{N}.]+/gu, "_").replace(/^_+|_+$/g, "").slice(0, 60) || "figure";
  }

  function save(blob, name) {
    const link = make("a", {href: URL.createObjectURL(blob), download: name});
    document.body.append(link);
    link.click();
    link.remove();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  }

  async function copyText(text) {
    try {
      await navigator.clipboard.writeText(text);
    } catch {
      // Pages opened as files have no clipboard in all browsers.
      const area = make("textarea", {"aria-hidden": "true"});
      area.value = text;
      document.body.append(area);
      area.select();
      const done = document.execCommand("copy");
      area.remove();
      if (!done) throw new Error("no clipboard");
    }
  }

  const blobOf = (canvas) => new Promise((done) => canvas.toBlob(done, "image/png"));

  // An SVG element of the page as a text of its own, with the styles that the page gives it.
  function svgText(svg) {
    const copy = svg.cloneNode(true), box = svg.getBoundingClientRect();
    const names = ["fill", "fill-opacity", "stroke", "stroke-width", "stroke-dasharray", "stroke-linecap", "stroke-linejoin", "opacity", "font-family", "font-size", "font-weight", "text-anchor"];
    const originals = [svg, ...svg.querySelectorAll("*")], copies = [copy, ...copy.querySelectorAll("*")];
    originals.forEach((one, n) => {
      const style = getComputedStyle(one);
      for (const name of names) copies[n].style.setProperty(name, style.getPropertyValue(name));
    });
    if (!copy.getAttribute("width") || copy.getAttribute("width").endsWith("%")) copy.setAttribute("width", box.width);
    if (!copy.getAttribute("height")) copy.setAttribute("height", box.height);
    copy.style.background = getComputedStyle(document.body).backgroundColor;
    return new XMLSerializer().serializeToString(copy);
  }

  function loadPicture(address) {
    return new Promise((done, failed) => {
      const picture = new Image();
      picture.onload = () => done(picture);
      picture.onerror = () => failed(new Error("no picture"));
      picture.src = address;
    });
  }

  async function canvasOf(picture, scale = 1) {
    const canvas = make("canvas", {width: Math.round(picture.naturalWidth * scale), height: Math.round(picture.naturalHeight * scale)});
    canvas.getContext("2d").drawImage(picture, 0, 0, canvas.width, canvas.height);
    return canvas;
  }

  async function svgCanvas(text) {
    return canvasOf(await loadPicture("data:image/svg+xml;charset=utf-8," + encodeURIComponent(text)), 2);
  }

  // A small group of buttons: of: {svg: () => text, png: () => canvas, csv: () => rows}, each of them optional.
  function addTools(place, title, of) {
    const status = make("span", {role: "status"});
    const kinds = ["png", "svg", "csv"].filter((kind) => of[kind]);
    const said = (text) => { status.textContent = text; setTimeout(() => { status.textContent = ""; }, 4000); };
    const content = async (kind) => {
      const found = await of[kind]();
      if (kind === "png") return await blobOf(found);
      return kind === "csv" ? csv(found) : found;
    };
    const types = {png: "image/png", svg: "image/svg+xml", csv: "text/csv"};
    const button = (verb, kind, act) => {
      const one = make("button", {type: "button", "data-tool": verb + "-" + kind, "aria-label": verb + " " + kind.toUpperCase()}, kind.toUpperCase());
      one.addEventListener("click", async () => {
        try {
          await act(await content(kind), kind);
          said(verb === "Copy" ? "Copied." : "Saved.");
        } catch {
          said(verb === "Copy" ? "This browser does not allow copies here; save the file." : "Not available.");
        }
      });
      return one;
    };
    const copy = (found, kind) => (kind === "png" ? navigator.clipboard.write([new ClipboardItem({"image/png": found})]) : copyText(found));
    const keep = (found, kind) => save(found instanceof Blob ? found : new Blob([found], {type: types[kind] + ";charset=utf-8"}), fileName(typeof title === "function" ? title() : title) + "." + kind);
    const name = plain(typeof title === "function" ? title() : title);
    const group = make("div", {role: "group", "aria-label": "Copy or save: " + name}, make("span", {}, "Copy"), ...kinds.map((kind) => button("Copy", kind, copy)),
      make("span", {}, "Save"), ...kinds.map((kind) => button("Save", kind, keep)), status);
    const tools = make("details", {class: "tools"}, make("summary", {"aria-label": "Copy or save: " + name}, "Copy or save"), group);
    place.append(tools);
    return tools;
  }

  function addTableTools(table) {
    const around = table.closest(".wide, .scroll") || table, caption = table.caption || around.previousElementSibling;
    const title = around.getAttribute("aria-label") || (caption ? caption.textContent : "Table");
    const tools = addTools(document.createDocumentFragment(), title, {csv: () => tableRows(table)});
    around.after(tools);
  }

  // Charts of plotly: title above in the page, title within in copies.
  function chartTitle(layout) {
    const [title, below] = String((layout.title && layout.title.text) || "").split("<br><sub>");
    return [plain(title.replaceAll("<br>", ", ")), plain(below || "")];
  }

  // Ticks of a logarithmic axis at the values of the data, as many as fit.
  function ticksAt(data, width) {
    const places = [...new Set(data.flatMap((trace) => trace.x || []))].filter((one) => typeof one === "number" && one > 0).sort((a, b) => a - b);
    if (places.length < 2 || places.length > 24) return null;
    const step = Math.log(places[places.length - 1] / places[0]) * 44 / Math.max(width - 90, 120), found = [];
    for (const one of places.toReversed()) if (!found.length || Math.log(found[0] / one) >= step) found.unshift(one);
    return found;
  }

  // A title of an axis in lines of at most so many letters.
  function inLines(text, most) {
    const lines = [];
    for (const word of text.split(" ")) {
      if (lines.length && (lines[lines.length - 1] + " " + word).length <= most) lines[lines.length - 1] += " " + word;
      else lines.push(word);
    }
    return lines.join("<br>");
  }

  // What depends on the width: titles of axes in lines, and ticks of logarithmic axes.
  function axesFor(place, data, layout, names) {
    const found = {};
    for (const name of names) {
      const axis = layout[name], along = name.startsWith("x") ? place.clientWidth - 80 : (layout.height || place.clientHeight) - 150;
      const text = axis.title && axis.title.text;
      if (text && !text.includes("<br>")) found[name + ".title.text"] = inLines(text, Math.max(18, along / 7.5));
      const places = name.startsWith("x") && axis.type === "log" && !axis.dtick && !axis.tickvals ? ticksAt(data, place.clientWidth) : null;
      if (places) Object.assign(found, {[name + ".tickvals"]: places, [name + ".ticktext"]: places.map((one) => String(Number(one.toPrecision(3)))), [name + ".tickangle"]: 0});
    }
    return found;
  }

  function drawChart(place, data, layout, more = {}) {
    const style = getComputedStyle(document.body), shown = structuredClone(layout);
    const margin = Object.assign({l: 60, r: 15, t: 12, b: 40}, layout.margin, {t: Math.min(12 + (layout.annotations ? 18 : 0), 40)});
    Object.assign(shown, {margin, font: {family: style.fontFamily, size: 13}, hovermode: "closest", modebar: {orientation: "v"}});
    shown.legend = Object.assign({orientation: "h", yref: "container", y: 0, yanchor: "bottom"}, layout.legend);
    delete shown.title;
    for (const name of Object.keys(shown).filter((one) => /^[xy]axis\d*$/.test(one))) {
      shown[name] = Object.assign({automargin: true}, shown[name]);
      if (shown[name].title) shown[name].title = Object.assign({standoff: 6, font: {size: 13}}, shown[name].title);
    }
    const fitted = () => axesFor(place, data, layout, Object.keys(shown).filter((one) => /^[xy]axis\d*$/.test(one)));
    for (const [path, value] of Object.entries(fitted())) {
      const [name, ...rest] = path.split(".");
      if (rest.length === 2) shown[name].title.text = value;
      else shown[name][rest[0]] = value;
    }
    // Numbers next to bars need more of a narrow chart.
    const bars = data.some((trace) => trace.type === "bar" && trace.orientation === "h" && trace.text);
    const [low, high] = (shown.xaxis && shown.xaxis.range) || [0, 0];
    if (bars && low < 0 && place.clientWidth < 520) shown.xaxis.range = [low - 0.4 * (high - low), high];
    if (shown.height && layout.title) shown.height -= Math.max(0, ((layout.margin || {}).t || 60) - margin.t);
    Plotly.newPlot(place, structuredClone(data), shown, Object.assign({displayModeBar: "hover"}, more));
    let width = place.clientWidth;
    new ResizeObserver(() => {
      if (!place.isConnected || Math.abs(place.clientWidth - width) < 20 || !place.clientWidth) return;
      width = place.clientWidth;
      Plotly.relayout(place, fitted());
    }).observe(place);
    const [title, below] = chartTitle(layout);
    const whole = () => {
      const text = title + (below ? "<br><sub>" + below + "</sub>" : "");
      const copy = Object.assign({}, structuredClone(place.layout), {title: {text, x: 0.01, xanchor: "left", font: {size: 16}}, paper_bgcolor: "#ffffff", plot_bgcolor: "#ffffff"});
      copy.margin = Object.assign({}, copy.margin, {t: 60});
      delete copy.width;
      return [{data: place.data, layout: copy}, {width: Math.max(place.clientWidth, 560), height: place.clientHeight + 48}];
    };
    const svg = async () => {
      const [figure, size] = whole(), address = await Plotly.toImage(figure, Object.assign({format: "svg"}, size));
      return decodeURIComponent(address.slice(address.indexOf(",") + 1));
    };
    addTools(place.closest("figure") || place.parentElement, title, {
      png: async () => canvasOf(await loadPicture(await Plotly.toImage(whole()[0], Object.assign({format: "png", scale: 2}, whole()[1])))),
      svg,
      csv: () => chartRows(place.data, Object.assign({}, place.layout, {title: {text: title}})),
    });
  }

  // Tables that are wider than the window say so, and show on which side there is more.
  function watchWidth(around) {
    const look = () => {
      const rest = around.scrollWidth - around.clientWidth, left = around.scrollLeft > 2, right = around.scrollLeft < rest - 2;
      around.dataset.more = rest > 2 ? (left && right ? "both" : left ? "left" : "right") : "no";
    };
    around.addEventListener("scroll", look, {passive: true});
    new ResizeObserver(look).observe(around);
    for (const table of around.querySelectorAll("table")) new ResizeObserver(look).observe(table);
    around.before(make("p", {class: "more", "aria-hidden": "true"}, "Scroll sideways for further columns →"));
    look();
  }

  // Numbers stay on one line with their units, and names with their values.
  function bindUnits() {
    const within = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT, (node) => (node.parentElement.closest("script, style, pre, code, select, textarea, svg, .chart") ? NodeFilter.FILTER_REJECT : NodeFilter.FILTER_ACCEPT));
    const nodes = [];
    while (within.nextNode()) nodes.push(within.currentNode);
    for (const node of nodes) {
      const text = node.data
        .replace(/([\d⁰¹²³⁴⁵⁶⁷⁸⁹)]) (?=(?:%|°|mm|µm|nm|m|px|s|ms|min|h|Hz|DN|rad|lux|MB|GB|electrons|times)(?![\p{L}\d]))/gu, "$1\u00a0")
        .replace(/ ([×±]) (?=\d)/g, "\u00a0$1\u00a0")
        .replace(/(?<![\p{L}\d])([a-zA-Z]) = (?=[−-]?\d)/gu, "$1\u00a0=\u00a0");
      if (text !== node.data) node.data = text;
    }
  }

  // Figures that are much smaller than drawn, as on narrow screens, can be enlarged; they then scroll sideways.
  function watchPicture(picture) {
    const figure = picture.closest("figure"), button = make("button", {type: "button", class: "enlarge"}, "Enlarge the figure");
    const look = () => {
      const enlarged = figure.classList.contains("enlarged");
      button.hidden = !enlarged && picture.clientWidth > 0.75 * Number(picture.getAttribute("width") || 0);
    };
    button.addEventListener("click", () => {
      button.textContent = figure.classList.toggle("enlarged") ? "Fit the figure to the screen" : "Enlarge the figure";
    });
    picture.after(button);
    new ResizeObserver(look).observe(picture);
    look();
  }

  function start() {
    bindUnits();
    listenToTerms();
    for (const picture of document.querySelectorAll("main figure > img[width]")) watchPicture(picture);
    for (const around of document.querySelectorAll(".wide, .scroll")) watchWidth(around);
    for (const table of document.querySelectorAll("main table")) addTableTools(table);
    for (const picture of document.querySelectorAll("main figure > img")) {
      // Pictures in files of their own cannot be read from a page that is a file: their SVG and data are in the page.
      const copy = picture.parentElement.querySelector("template.copy"), rows = picture.parentElement.querySelector("script.rows");
      const svg = copy && (() => new XMLSerializer().serializeToString(copy.content.querySelector("svg")));
      const whole = {svg, png: async () => svgCanvas(svg()), csv: rows && (() => JSON.parse(rows.textContent))};
      addTools(picture.parentElement, picture.alt, copy ? whole : {png: () => canvasOf(picture)});
    }
    for (const svg of document.querySelectorAll("main figure > svg")) {
      const heading = svg.parentElement.querySelector("h3");
      addTools(svg.parentElement, (heading || svg).textContent, {png: () => svgCanvas(svgText(svg)), svg: () => svgText(svg)});
    }
  }

  document.addEventListener("DOMContentLoaded", start);
  return {addTools, chartRows, chartTitle, csv, drawChart, svgCanvas, svgNames, svgText, tableRows};
})();
