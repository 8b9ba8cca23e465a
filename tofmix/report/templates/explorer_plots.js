// Plots in SVG: axes with round ticks, one pixel's mixture, and a section through the image.

const SVG = "http://www.w3.org/2000/svg";

function drawn(name, attributes, text) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

/** Round numbers within limits; of an axis of pixels whole ones. */
function roundTicks(low, high, most, ofPixels = false) {
  const rough = (high - low) / most;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 2.5, 5, 10].map((factor) => factor * power).find((round) => round >= rough && (!ofPixels || Number.isInteger(round)));
  const ticks = [];
  for (let k = Math.ceil(low / step); k * step <= high + 1e-9 * step; k++) ticks.push(k * step);
  return ticks;
}

/** A plot of width x height with axes; x and y map values to places, `add` draws. */
class Plot {
  constructor(svg, { width, height, x, y, xLabel, yLabel }) {
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    svg.replaceChildren();
    this.svg = svg;
    this.left = 56;
    this.right = width - 10;
    this.top = 10;
    this.bottom = height - 40;
    this.limits = { x, y };
    this.x = (v) => this.left + ((v - x[0]) / (x[1] - x[0])) * (this.right - this.left);
    this.y = (v) => this.bottom - ((v - y[0]) / (y[1] - y[0])) * (this.bottom - this.top);
    const clip = drawn("clipPath", { id: `${svg.id}-clip` });
    clip.append(drawn("rect", { x: this.left, y: this.top, width: this.right - this.left, height: this.bottom - this.top }));
    svg.append(clip);
    this.axes(xLabel, yLabel);
    this.inside = drawn("g", { "clip-path": `url(#${svg.id}-clip)` });
    svg.append(this.inside);
  }

  axes(xLabel, yLabel) {
    const { left, right, top, bottom, svg } = this;
    for (const tick of roundTicks(...this.limits.x, 7, ["row", "column"].includes(xLabel))) {
      svg.append(drawn("line", { class: "grid", x1: this.x(tick), x2: this.x(tick), y1: top, y2: bottom }));
      svg.append(drawn("text", { x: this.x(tick), y: bottom + 16, "text-anchor": "middle" }, told(tick)));
    }
    for (const tick of roundTicks(...this.limits.y, 5)) {
      svg.append(drawn("line", { class: "grid", x1: left, x2: right, y1: this.y(tick), y2: this.y(tick) }));
      svg.append(drawn("text", { x: left - 6, y: this.y(tick) + 4, "text-anchor": "end" }, told(tick)));
    }
    svg.append(drawn("path", { class: "axis", d: `M${left} ${top}V${bottom}H${right}` }));
    svg.append(drawn("text", { x: (left + right) / 2, y: bottom + 34, "text-anchor": "middle" }, xLabel));
    const middle = (top + bottom) / 2;
    svg.append(drawn("text", { x: 12, y: middle, transform: `rotate(-90 12 ${middle})`, "text-anchor": "middle" }, yLabel));
  }

  add(name, attributes) {
    this.inside.append(drawn(name, attributes));
  }

  line(xs, ys, attributes, closed = false) {
    const points = xs.map((x, k) => `${this.x(x).toFixed(1)} ${this.y(ys[k]).toFixed(1)}`).join("L");
    const base = this.y(this.limits.y[0]);
    const d = closed ? `M${this.x(xs[0])} ${base}L${points}L${this.x(xs[xs.length - 1])} ${base}Z` : `M${points}`;
    this.add("path", { d, ...attributes });
  }
}

/** Width of a plot as it stands in the page, so that its text is neither large nor small. */
const shownWidth = (svg, least) => Math.max(least, Math.round(svg.getBoundingClientRect().width));

const told = (value) => String(Number(value.toPrecision(6)));
const layerColour = (k) => `var(--layer-${(k % 3) + 1})`;
const LINES = ["", "6 3", "2 3"]; // with the colours, so that none is needed to tell layers apart

/** Samples without those that are background, 12 sigma or more from every layer: these do not stretch the view. */
function nearLayers(layers, samples) {
  return layers.length ? samples.filter((r) => layers.some(({ range, sigma }) => Math.abs(r - range) < 12 * sigma)) : samples;
}

/** Limits in mm that hold every component and most samples. */
function pixelLimits(layers, samples) {
  const ends = layers.flatMap(({ range, sigma }) => (Number.isFinite(sigma) ? [range - 5 * sigma, range + 5 * sigma] : [range]));
  if (samples && samples.length) {
    const last = samples.length - 1;
    const [low, high] = layers.length ? [0.05, 0.95] : [0, 1];
    ends.push(samples[Math.round(low * last)], samples[Math.round(high * last)]);
  }
  if (!ends.length) return [0, 1000];
  const low = Math.min(...ends);
  const high = Math.max(...ends);
  const margin = Math.max(1, 0.04 * (high - low));
  return [low - margin, high + margin];
}

/** Heights in 1/m of the bars of a histogram over the limits, by Freedman and Diaconis' width within bounds. */
function histogram(samples, [low, high], step) {
  const last = samples.length - 1;
  const spread = samples[Math.round(0.75 * last)] - samples[Math.round(0.25 * last)];
  const wanted = (high - low) / ((2 * spread) / Math.cbrt(samples.length));
  const bounded = Math.min(80, Math.max(40, Number.isFinite(wanted) ? wanted : 80));
  const count = Math.max(1, Math.min(Math.round(bounded), Math.floor((high - low) / step))); // no bin between two steps
  const width = (high - low) / count;
  const bars = new Array(count).fill(0);
  for (const sample of samples) {
    const k = Math.floor((sample - low) / width);
    if (k >= 0 && k < count) bars[k] += 1000 / (samples.length * width);
  }
  return { bars, width };
}

/** Histogram, density and fitted components of one pixel. */
function drawPixel(svg, { step, noReturn, settings, ...seen }) {
  const cut = settings.circle ? cutBetween(seen.layers, settings.circle) : 0;
  const { layers, samples } = settings.circle ? openedAt(cut, settings.circle, seen.layers, seen.samples) : seen;
  const limits = pixelLimits(layers, settings.background && samples ? nearLayers(layers, samples) : samples);
  const places = Array.from({ length: 401 }, (_, k) => limits[0] + ((limits[1] - limits[0]) * k) / 400);
  const component = ({ range, sigma, weight }, form) => places.map((r) => (1000 * weight * form((r - range) / sigma)) / sigma);
  const learnt = errorDensity(settings.shape);
  const fitted = layers.map((layer) => component(layer, learnt));
  const end = settings.rangeMax < cut ? settings.rangeMax + settings.circle : settings.rangeMax;
  const open = settings.rangeMax && settings.noise && noReturn > 0
    ? component({ range: end, sigma: sigmaAt(settings.noise, settings.rangeMax), weight: noReturn }, bell) : [];
  const bins = samples && samples.length ? histogram(samples, limits, step) : null;
  const density = bins && settings.noise ? densityAt(samples, places, settings.noise).map((p) => 1000 * p) : [];
  const tops = [...fitted.flat(), ...open, ...(bins ? bins.bars : []), ...density].filter(Number.isFinite);
  const top = 1.08 * (Math.max(0, ...tops) || 1);
  const plot = new Plot(svg, { width: shownWidth(svg, 320), height: 280, x: limits, y: [0, top], xLabel: cut ? `range (mm); 0 again at ${settings.circle.toFixed(0)}` : "range (mm)", yLabel: "p(r)  (1/m)" });
  if (bins) bins.bars.forEach((bar, k) => {
    const x = plot.x(limits[0] + k * bins.width);
    const width = plot.x(limits[0] + (k + 1) * bins.width) - x;
    if (bar) plot.add("rect", { class: "samples", x, y: plot.y(bar), width, height: plot.bottom - plot.y(bar) });
  });
  if (open.length) plot.line(places, open, { class: "open" }, true);
  fitted.forEach((part, k) => {
    if (!part.every(Number.isFinite)) return;
    plot.line(places, part, { fill: layerColour(k), "fill-opacity": 0.35, stroke: layerColour(k), "stroke-width": 1.5 }, true);
  });
  if (density.length) plot.line(places, density, { class: "density" });
  layers.forEach(({ range, range_stderr }, k) => {
    if (range_stderr > 0) {
      const x = plot.x(range - range_stderr);
      plot.add("rect", { x, y: plot.top, width: plot.x(range + range_stderr) - x, height: plot.bottom - plot.top, fill: layerColour(k), "fill-opacity": 0.25 });
    }
    plot.add("line", { x1: plot.x(range), x2: plot.x(range), y1: plot.top, y2: plot.bottom, stroke: layerColour(k), "stroke-width": 1.5, "stroke-dasharray": LINES[k % 3] });
  });
}

const cross = (x, y) => `M${x - 3} ${y - 3}l6 6m0 -6l-6 6`;
const MARKS = [
  (x, y, r) => `M${x - r} ${y}a${r} ${r} 0 1 0 ${2 * r} 0a${r} ${r} 0 1 0 ${-2 * r} 0Z`,
  (x, y, r) => `M${x - r} ${y - r}h${2 * r}v${2 * r}h${-2 * r}Z`,
  (x, y, r) => `M${x} ${y - 1.2 * r}l${1.1 * r} ${2 * r}h${-2.2 * r}Z`,
];

/** Limits in x and y around some places; as large as the plot's area allows at one scale for both. */
function equalLimits(places, width, height) {
  const [xs, ys] = [0, 1].map((axis) => places.map((place) => place[axis]));
  const middle = [xs, ys].map((values) => (Math.min(...values) + Math.max(...values)) / 2);
  const extent = [xs, ys].map((values) => Math.max(...values) - Math.min(...values));
  const scale = 1.08 * Math.max(extent[0] / width, extent[1] / height, 1 / width);
  return [width, height].map((length, axis) => [middle[axis] - (scale * length) / 2, middle[axis] + (scale * length) / 2]);
}

/**
 * Averaged points against layers along a row or column; points are {averaged, layers}. With `angles` in radians
 * the points stand in space, across and away from the sensor; without, ranges stand over pixels.
 */
function drawSection(svg, { points, at, angles, labels }) {
  const place = (k, range) => (angles ? [range * Math.sin(angles[k]), range * Math.cos(angles[k])] : [k, range]);
  const ofLayers = points.flatMap(({ layers }, k) => layers.map(({ range }) => place(k, range)));
  const ofAveraged = points.map(({ averaged }, k) => place(k, averaged)).filter(([, y]) => Number.isFinite(y));
  const held = ofLayers.length ? ofLayers : ofAveraged.length ? ofAveraged : [[0, 0], [0, 1000]];
  const [width, height] = [shownWidth(svg, 640), angles ? 520 : 380];
  const ys = held.map((point) => point[1]);
  const margin = Math.max(1, 0.06 * (Math.max(...ys) - Math.min(...ys)));
  const [x, y] = angles ? equalLimits(held, width - 66, height - 50)
    : [[-0.5, points.length - 0.5], [Math.min(...ys) - margin, Math.max(...ys) + margin]];
  const plot = new Plot(svg, { width, height, x, y, xLabel: labels[0], yLabel: labels[1] });
  const shown = ([across, away]) => [Number(plot.x(across).toFixed(1)), Number(plot.y(away).toFixed(1))];
  const [from, to] = (angles ? [0, 2 * Math.abs(y[1])] : y).map((range) => shown(place(at, range)));
  plot.add("line", { class: "chosen", x1: from[0], x2: to[0], y1: from[1], y2: to[1] });
  const marks = ["", "", ""];
  let beams = "";
  points.forEach(({ layers }, k) => {
    layers.forEach(({ range, weight }, n) => {
      marks[n % 3] += MARKS[n % 3](...shown(place(k, range)), Number((2 + 3 * Math.sqrt(weight || 0)).toFixed(1)));
    });
    if (layers.length > 1) beams += `M${shown(place(k, layers[0].range))}L${shown(place(k, layers[layers.length - 1].range))}`;
  });
  plot.add("path", { class: "beam", d: beams });
  marks.forEach((d, n) => plot.add("path", { d, fill: layerColour(n), "fill-opacity": 0.6 }));
  // Last: a cross that lies on a layer's mark shows.
  plot.add("path", { class: "averaged", d: ofAveraged.map((point) => cross(...shown(point))).join("") });
  const inside = (value, [low, high]) => value >= low && value <= high;
  return { plot, outside: ofAveraged.filter((point) => !inside(point[0], x) || !inside(point[1], y)).length };
}
