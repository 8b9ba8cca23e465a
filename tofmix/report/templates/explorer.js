// The explorer of the page: an image in which a pixel is chosen, and what is known of that pixel.

const byId = (id) => document.getElementById(id);
const fixed = (value, digits) => (Number.isFinite(value) ? value.toFixed(digits) : "–");
const ORDINALS = ["First", "Second", "Third", "Fourth", "Fifth", "Sixth"];

function filled(name, text, attributes = {}) {
  const element = document.createElement(name);
  element.textContent = text;
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  return element;
}

const nearest = (values, wanted) =>
  values.reduce((best, value, k) => (Math.abs(value - wanted) < Math.abs(values[best] - wanted) ? k : best), 0);

class Explorer {
  constructor(settings) {
    this.settings = settings;
    this.pixels = settings.rows * settings.cols;
    this.read = new Map(); // windows that were unpacked
    this.dark = matchMedia("(prefers-color-scheme: dark)");
    [this.low, this.high] = settings.scale;
    this.view = "layer-0";
    this.along = "row";
    this.shape = "plain";
  }

  async start() {
    await this.openWindow(this.settings.shown);
    this.row = this.col = 0;
    this.goTo(this.worthSeeing());
    this.fillControls();
    const linked = await this.followLink();
    this.listen();
    byId("needs-script").hidden = true;
    byId("explorer").hidden = false;
    this.show();
    if (linked) byId("explorer-title").scrollIntoView();
    document.documentElement.dataset.explorer = "ready";
  }

  async openWindow(number) {
    const packed = this.settings.windows.find(({ window }) => window === number);
    if (!packed) return false;
    if (!this.read.has(number)) this.read.set(number, await WindowData.read(packed, this.pixels));
    this.window = this.read.get(number);
    return true;
  }

  /** The pixel nearest the middle that has most layers. */
  worthSeeing() {
    const { rows, cols } = this.settings;
    const counts = this.window.arrays.n_modes;
    const off = (p) => Math.abs(Math.floor(p / cols) - (rows - 1) / 2) + Math.abs((p % cols) - (cols - 1) / 2);
    let best = Math.floor(rows / 2) * cols + Math.floor(cols / 2);
    for (let p = 0; p < this.pixels; p++)
      if (counts[p] > counts[best] || (counts[p] === counts[best] && off(p) < off(best))) best = p;
    return [Math.floor(best / cols), best % cols];
  }

  goTo([row, col]) {
    const { rows, cols } = this.settings;
    this.row = Math.min(rows - 1, Math.max(0, row));
    this.col = Math.min(cols - 1, Math.max(0, col));
  }

  /** Follow #pixel=72,92&window=0&image=layer-1&section=column&drawn=space. */
  async followLink() {
    const link = new URLSearchParams(location.hash.slice(1));
    const place = (link.get("pixel") || "").split(",").map(Number);
    if (place.length === 2 && place.every(Number.isInteger)) this.goTo(place);
    if (link.has("window")) await this.openWindow(Number(link.get("window")));
    const view = link.get("image");
    if ([...byId("x-view").options].some(({ value }) => value === view)) this.view = view;
    if (link.has("drawn")) this.shape = link.get("drawn") === "space" ? "space" : "plain";
    if (link.get("section")) this.along = link.get("section") === "column" ? "column" : "row";
    return link.has("pixel");
  }

  fillControls() {
    const most = Math.max(1, ...this.settings.windows.map(({ most_layers: n }) => n));
    const views = [["averaged", "Averaged"]];
    for (let k = 0; k < most; k++) views.push([`layer-${k}`, `${ORDINALS[k] || k + 1} layer`]);
    views.push(["surfaces", "Number of surfaces"]);
    byId("x-view").replaceChildren(...views.map(([value, text]) => filled("option", text, { value })));
    const windows = this.settings.windows.map(({ window, frames }) =>
      filled("option", `${window} (frames ${frames[0]} to ${frames[1] - 1})`, { value: window }));
    byId("x-window").replaceChildren(...windows);
    byId("x-window-label").hidden = windows.length < 2;
    this.showScale();
  }

  showScale() {
    byId("x-low").value = this.low;
    byId("x-high").value = this.high;
  }

  listen() {
    const choose = (place) => { this.goTo(place); this.show(); };
    const plane = byId("x-plane");
    plane.addEventListener("click", (event) => choose(this.placeOf(event)));
    plane.addEventListener("keydown", (event) => {
      const place = this.afterKey(event);
      if (!place) return;
      event.preventDefault();
      choose(place);
    });
    byId("x-row").addEventListener("change", (event) => choose([Math.round(event.target.valueAsNumber) || 0, this.col]));
    byId("x-col").addEventListener("change", (event) => choose([this.row, Math.round(event.target.valueAsNumber) || 0]));
    byId("x-view").addEventListener("change", (event) => { this.view = event.target.value; this.show(); });
    byId("x-along").addEventListener("change", (event) => { this.along = event.target.value; this.show(); });
    byId("x-shape").addEventListener("change", (event) => { this.shape = event.target.value; this.show(); });
    byId("x-window").addEventListener("change", async (event) => { await this.openWindow(Number(event.target.value)); this.show(); });
    const scale = () => {
      const [low, high] = [byId("x-low").valueAsNumber, byId("x-high").valueAsNumber];
      if (low < high) [this.low, this.high] = [low, high];
      this.showScale();
      this.drawImage();
    };
    byId("x-low").addEventListener("change", scale);
    byId("x-high").addEventListener("change", scale);
    byId("x-reset").addEventListener("click", () => { [this.low, this.high] = this.settings.scale; this.showScale(); this.drawImage(); });
    byId("x-section").addEventListener("click", (event) => choose(this.placeInSection(event)));
    addEventListener("hashchange", async () => { await this.followLink(); this.show(); });
    addEventListener("resize", () => { this.showPixel(); this.showSection(); });
    this.dark.addEventListener("change", () => this.drawImage());
  }

  placeOf(event) {
    const box = byId("x-plane").getBoundingClientRect();
    const { rows, cols } = this.settings;
    return [Math.floor(((event.clientY - box.top) / box.height) * rows), Math.floor(((event.clientX - box.left) / box.width) * cols)];
  }

  placeInSection(event) {
    const svg = byId("x-section");
    const { x, y } = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    const { left, right, top, bottom, limits } = this.sectionPlot;
    const across = limits.x[0] + ((x - left) / (right - left)) * (limits.x[1] - limits.x[0]);
    const away = limits.y[1] - ((y - top) / (bottom - top)) * (limits.y[1] - limits.y[0]);
    const angles = this.shape === "space" ? this.angles() : null;
    const at = angles ? nearest(angles, Math.atan2(across, away)) : Math.round(across);
    return this.along === "row" ? [this.row, at] : [at, this.col];
  }

  afterKey(event) {
    if (event.altKey || event.ctrlKey || event.metaKey) return null;
    const far = event.shiftKey ? 10 : 1;
    const { row, col } = this;
    return {
      ArrowUp: [row - far, col], ArrowDown: [row + far, col], ArrowLeft: [row, col - far], ArrowRight: [row, col + far],
      Home: [row, 0], End: [row, this.settings.cols - 1],
    }[event.key];
  }

  show() {
    byId("x-row").value = this.row;
    byId("x-col").value = this.col;
    byId("x-view").value = this.view;
    byId("x-window").value = this.window.number;
    byId("x-along").value = this.along;
    byId("x-shape").value = this.shape;
    this.drawImage();
    this.showPixel();
    this.showSection();
    try {
      const link = `#pixel=${this.row},${this.col}&window=${this.window.number}&image=${this.view}&section=${this.along}&drawn=${this.shape}`;
      history.replaceState(null, "", link);
    } catch { /* a page inside another may not name itself */ }
  }
}
