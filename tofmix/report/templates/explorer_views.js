// What the explorer shows: the image, the chosen pixel with its neighbours, and the section.

const rgb = (colour) => [1, 3, 5].map((k) => parseInt(colour.slice(k, k + 2), 16));

function swatches(list, entries) {
  list.replaceChildren(...entries.map(([background, text]) => {
    const swatch = filled("i", "");
    swatch.style.background = background;
    const item = filled("li", "");
    item.append(swatch, text);
    return item;
  }));
}

function keys(list, entries) {
  list.replaceChildren(...entries.map(([shape, text]) => {
    const picture = drawn("svg", { viewBox: "0 0 26 16", "aria-hidden": "true" });
    picture.append(shape);
    const item = filled("li", "");
    item.append(picture, text);
    return item;
  }));
}

const range0 = (layers) => layers.map(({ range }) => fixed(range, 0)).join(", ");
const counted = (n, word) => `${n} ${word}${n === 1 ? "" : "s"}`;

Object.assign(Explorer.prototype, {
  /** Value of a pixel in the chosen view; NaN where there is none. */
  valueOf(pixel) {
    const { arrays } = this.window;
    if (this.view === "averaged") return arrays.averaged[pixel];
    if (this.view === "surfaces") return arrays.status[pixel] === this.settings.tooFew ? NaN : arrays.n_modes[pixel];
    return this.window.rangeOf(pixel, Number(this.view.slice(6)));
  },

  drawImage() {
    const { rows, cols, shades, below, above, counts } = this.settings;
    const surfaces = this.view === "surfaces";
    const colours = (surfaces ? counts[this.dark.matches ? "dark" : "light"] : shades).map(rgb);
    const [under, over] = [rgb(below), rgb(above)];
    const image = new ImageData(cols, rows);
    const seen = { below: false, above: false, none: false, counts: new Set() };
    for (let p = 0; p < this.pixels; p++) {
      const value = this.valueOf(p);
      if (!Number.isFinite(value)) { seen.none = true; continue; }
      let colour;
      if (surfaces) {
        const n = Math.min(value, colours.length - 1);
        seen.counts.add(n);
        colour = colours[n];
      } else if (value < this.low) { seen.below = true; colour = under; }
      else if (value > this.high) { seen.above = true; colour = over; }
      else colour = colours[Math.min(colours.length - 1, Math.floor(((value - this.low) / (this.high - this.low)) * colours.length))];
      image.data.set(colour, 4 * p);
      image.data[4 * p + 3] = 255;
    }
    byId("x-canvas").getContext("2d").putImageData(image, 0, 0);
    this.nameImage(seen, surfaces);
    this.mark();
  },

  nameImage(seen, surfaces) {
    const { below, above, countLabels, counts } = this.settings;
    byId("x-image-title").textContent = byId("x-view").selectedOptions[0].textContent;
    byId("x-bar").hidden = surfaces;
    for (const id of ["x-low", "x-high", "x-reset"]) byId(id).disabled = surfaces;
    const labels = [0, 1, 2, 3, 4].map((k) => filled("span", fixed(this.low + ((this.high - this.low) * k) / 4, 0) + (k === 4 ? " mm" : "")));
    byId("x-bar").lastElementChild.replaceChildren(...labels);
    const shown = [...seen.counts].sort((a, b) => a - b).map((n) => [n ? counts.light[n] : "var(--no-surface)", countLabels[n]]);
    if (seen.below) shown.push([below, `below ${fixed(this.low, 0)} mm`]);
    if (seen.above) shown.push([above, `above ${fixed(this.high, 0)} mm`]);
    if (seen.none) shown.push(["var(--hatching)", "no data"]);
    swatches(byId("x-legend"), shown);
  },

  mark() {
    const { rows, cols } = this.settings;
    const box = { x: this.col, y: this.row, width: 1, height: 1 };
    const line = this.along === "row"
      ? { x1: 0, x2: cols, y1: this.row + 0.5, y2: this.row + 0.5 } : { x1: this.col + 0.5, x2: this.col + 0.5, y1: 0, y2: rows };
    byId("x-marker").replaceChildren(drawn("line", { class: "line", ...line }), drawn("rect", { class: "halo", ...box }), drawn("rect", { class: "frame", ...box }));
  },

  showPixel() {
    const pixel = this.row * this.settings.cols + this.col;
    const { arrays } = this.window;
    const [layers, samples] = [this.window.layers(pixel), this.window.samples(pixel)];
    const [status, meaning] = this.settings.statuses[arrays.status[pixel]] || [`status ${arrays.status[pixel]}`, "not known to this page"];
    const title = `Row ${this.row}, column ${this.col}`;
    const found = layers.length ? `${counted(layers.length, "layer")} at ${range0(layers)} mm` : "no layer";
    byId("x-pixel-title").textContent = title;
    byId("x-said").textContent = `${title}: ${found}; ${status}. Averaged ${fixed(arrays.averaged[pixel], 0)} mm.`;
    const noReturn = arrays.weight_no_return[pixel];
    drawPixel(byId("x-mixture"), { layers, samples, step: samples ? this.window.packedSamples.step : 1, noReturn, settings: this.settings });
    byId("x-mixture-alt").textContent = `${samples ? counted(samples.length, "sample") + ", their density and" : "No samples in this page;"} ${counted(layers.length, "fitted component")}. The numbers are in the table below.`;
    this.showKeys(layers, samples, noReturn);
    byId("x-layers").tBodies[0].replaceChildren(...layers.map((layer, k) => {
      const row = filled("tr", "");
      const cells = [`${fixed(layer.range, 2)} ± ${fixed(layer.range_stderr, 2)}`, `${fixed(layer.weight, 4)} ± ${fixed(layer.weight_stderr, 4)}`, fixed(layer.sigma, 2), fixed(layer.probability, 6)];
      row.append(filled("th", String(k + 1), { scope: "row" }), ...cells.map((text) => filled("td", text)));
      return row;
    }));
    const outlier = arrays.weight_outlier[pixel];
    const facts = [
      ["Status", `${status}: ${meaning}`],
      ["Share without a return", fixed(noReturn, 4)],
      ["Share of outliers", Number.isFinite(outlier) ? String(Number(outlier.toPrecision(2))) : "–"],
      ["Averaged range", `${fixed(arrays.averaged[pixel], 1)} mm`],
      ["Valid samples; peaks of the density", `${arrays.n_samples[pixel]}; ${arrays.n_peaks[pixel]}`],
    ];
    byId("x-facts").replaceChildren(...facts.flatMap(([name, value]) => [filled("dt", name), filled("dd", value)]));
    this.showNeighbours();
  },

  showKeys(layers, samples, noReturn) {
    const entries = layers.map((_, k) => [drawn("rect", { y: 2, width: 26, height: 12, fill: layerColour(k), "fill-opacity": 0.5 }), `layer ${k + 1}`]);
    if (noReturn > 0 && this.settings.rangeMax) entries.push([drawn("rect", { y: 2, width: 26, height: 12, class: "samples" }), "no return (dashed)"]);
    if (samples) entries.push([drawn("rect", { y: 2, width: 26, height: 12, class: "samples" }), "samples"]);
    if (samples && this.settings.noise) entries.push([drawn("path", { d: "M0 8H26", class: "density" }), "density"]);
    keys(byId("x-keys"), entries);
  },

  showNeighbours() {
    const { rows, cols } = this.settings;
    const body = byId("x-neighbours").tBodies[0];
    body.replaceChildren();
    for (let row = this.row - 1; row <= this.row + 1; row++) {
      if (row < 0 || row >= rows) continue;
      const line = body.insertRow();
      for (let col = this.col - 1; col <= this.col + 1; col++) {
        if (col < 0 || col >= cols) continue;
        const layers = this.window.layers(row * cols + col);
        const text = layers.map(({ range, weight }) => `${fixed(range, 0)} (${fixed(weight, 2)})`).join("\n") || "none";
        const button = filled("button", text, { type: "button", "aria-label": `Row ${row}, column ${col}: ${text.replaceAll("\n", ", ")}` });
        if (row === this.row && col === this.col) button.setAttribute("aria-current", "true");
        button.addEventListener("click", () => { this.goTo([row, col]); this.show(); byId("x-neighbours").querySelector("[aria-current]").focus(); });
        line.insertCell().append(button);
      }
    }
  },

  /** Where the pixels of the section look, radians from the axis; null where that is not known. */
  angles() {
    const { angles } = this.settings;
    return angles && angles[this.along === "row" ? 0 : 1];
  },

  showSection() {
    const { cols, rows } = this.settings;
    const byRow = this.along === "row";
    const points = Array.from({ length: byRow ? cols : rows }, (_, k) => {
      const pixel = byRow ? this.row * cols + k : k * cols + this.col;
      return { averaged: this.window.arrays.averaged[pixel], layers: this.window.layers(pixel) };
    });
    const all = this.angles();
    byId("x-shape").disabled = all === null;
    const angles = this.shape === "space" ? all : null;
    const inSpace = byRow ? "x, to the right (mm)" : "y, down (mm)";
    const labels = angles ? [inSpace, "z, away from the sensor (mm)"] : [byRow ? "column" : "row", "range (mm)"];
    const { plot, outside } = drawSection(byId("x-section"), { points, at: byRow ? this.col : this.row, angles, labels });
    this.sectionPlot = plot;
    byId("x-section-title").textContent = `Section through ${byRow ? `row ${this.row}` : `column ${this.col}`}`;
    const several = points.filter(({ layers }) => layers.length > 1).length;
    byId("x-section-alt").textContent = `${several} of ${points.length} pixels see more than one surface.${outside ? ` ${counted(outside, "averaged point")} outside this view.` : ""}`;
    const most = Math.min(3, Math.max(1, ...points.map(({ layers }) => layers.length)));
    const entries = Array.from({ length: most }, (_, n) => [drawn("path", { d: MARKS[n](13, 8, 5), fill: layerColour(n) }), `${ORDINALS[n].toLowerCase()} layer`]);
    keys(byId("x-section-keys"), [[drawn("path", { d: cross(13, 8), class: "averaged" }), "averaged"], ...entries]);
  },
});

async function startExplorer() {
  if (typeof DecompressionStream === "undefined") return; // the page says what it needs
  await new Explorer(JSON.parse(byId("explorer-data").textContent)).start();
}

startExplorer();
