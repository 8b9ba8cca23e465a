// The numbers of the page: unpacks what tofmix.report.explorer wrote.

const NOT_KNOWN = -(2 ** 31);
const PER_LAYER = ["range", "range_stderr", "weight", "weight_stderr", "sigma", "probability"];
const BANDWIDTH = 0.5; // h(r) in units of sigma(r), as in tofmix.estimation.peaks.modes
const REACH = 5;

async function inflated(text) {
  const packed = atob(text);
  const bytes = new Uint8Array(packed.length);
  for (let k = 0; k < packed.length; k++) bytes[k] = packed.charCodeAt(k);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Arrays by name, float64, NaN where not known; their byte planes follow one another. */
function unpacked(specs, bytes) {
  const arrays = {};
  let at = 0;
  for (const { name, length, unit } of specs) {
    const values = new Float64Array(length);
    const inverse = Math.round(1 / unit);
    for (let k = 0; k < length; k++) {
      const whole = bytes[at + k] | (bytes[at + length + k] << 8) | (bytes[at + 2 * length + k] << 16) | (bytes[at + 3 * length + k] << 24);
      values[k] = whole === NOT_KNOWN ? NaN : whole / inverse;
    }
    arrays[name] = values;
    at += 4 * length;
  }
  return arrays;
}

/** One window: layers of every pixel, averaged ranges, and samples if the page has them. */
class WindowData {
  constructor(packed, arrays, gaps, counts, pixels) {
    this.number = packed.window;
    this.frames = packed.frames;
    this.arrays = arrays;
    this.pixels = pixels;
    this.packedSamples = packed.samples;
    this.gaps = gaps;
    this.counts = counts; // valid samples of each pixel
    this.first = new Uint32Array(pixels + 1); // of each pixel's layers
    for (let p = 0; p < pixels; p++) this.first[p + 1] = this.first[p] + arrays.n_modes[p];
  }

  static async read(packed, pixels) {
    const arrays = unpacked(packed.arrays, await inflated(packed.data));
    if (!packed.samples) return new WindowData(packed, arrays, null, null, pixels);
    const { counts, data } = packed.samples;
    const read = unpacked(counts.arrays, await inflated(counts.data));
    return new WindowData(packed, arrays, await inflated(data), read.counts, pixels);
  }

  layers(pixel) {
    const found = [];
    for (let k = this.first[pixel]; k < this.first[pixel + 1]; k++)
      found.push(Object.fromEntries(PER_LAYER.map((name) => [name, this.arrays[name][k]])));
    return found;
  }

  rangeOf(pixel, layer) {
    const k = this.first[pixel] + layer;
    return k < this.first[pixel + 1] ? this.arrays.range[k] : NaN;
  }

  /** Samples of a pixel, mm, ascending; null without a recording. */
  samples(pixel) {
    if (!this.gaps) return null;
    const { ranks, step, offset } = this.packedSamples;
    const high = ranks * this.pixels;
    const values = new Float64Array(this.counts[pixel]);
    let steps = 0;
    for (let k = 0; k < values.length; k++) {
      const at = k * this.pixels + pixel;
      steps += this.gaps[at] | (this.gaps[high + at] << 8);
      values[k] = offset + step * steps;
    }
    return values;
  }
}

/** sigma(r) in mm: linear between the curve's points, constant past its ends. */
function sigmaAt(noise, range) {
  const [ranges, sigmas] = noise;
  const last = ranges.length - 1;
  if (range <= ranges[0]) return sigmas[0];
  if (range >= ranges[last]) return sigmas[last];
  let k = 0;
  while (ranges[k + 1] <= range) k++;
  return sigmas[k] + ((range - ranges[k]) / (ranges[k + 1] - ranges[k])) * (sigmas[k + 1] - sigmas[k]);
}

/**
 * Where to cut the circle of ranges open, as tofmix.circle.cut_between: at the fold, unless layers lie across it;
 * then in the middle of the gap that follows the last of them.
 */
function cutBetween(layers, circle) {
  const known = layers.filter(({ range, sigma }) => Number.isFinite(range) && Number.isFinite(sigma));
  if (!known.some(({ range, sigma }) => range < 4 * sigma || range > circle - 4 * sigma)) return 0;
  const past = known.filter(({ range, sigma }) => range < 4 * sigma);
  const last = Math.max(...(past.length ? past : known).map(({ range }) => range));
  const ahead = known.map(({ range }) => (range - last + circle) % circle).filter((gap) => gap > 0);
  return (last + Math.min(circle, ...ahead) / 2) % circle;
}

/** Layers and ascending samples on a line that begins at the cut: what is before it is a turn on. */
function openedAt(cut, circle, layers, samples) {
  const opened = (range) => (range < cut ? range + circle : range);
  return {
    layers: layers.map((layer) => ({ ...layer, range: opened(layer.range) })),
    samples: samples && samples.map((range) => opened(((range % circle) + circle) % circle)).sort(),
  };
}

const bell = (z) => Math.exp(-0.5 * z * z) / Math.sqrt(2 * Math.PI);

/** Density of the standardised error: the Gaussian's, or a learnt shape's, [first z, step, densities]; 0 past its ends. */
function errorDensity(shape) {
  if (!shape) return bell;
  const [first, step, densities] = shape;
  return (z) => {
    const at = (z - first) / step;
    if (!(at >= 0 && at < densities.length - 1)) return 0;
    const k = Math.floor(at);
    return densities[k] + (at - k) * (densities[k + 1] - densities[k]);
  };
}

/** Equation (4): the kernel density of ascending samples at ascending places, 1/mm. */
function densityAt(samples, places, noise) {
  let first = 0;
  return places.map((place) => {
    const h = BANDWIDTH * sigmaAt(noise, place);
    while (first > 0 && samples[first - 1] >= place - REACH * h) first--;
    while (first < samples.length && samples[first] < place - REACH * h) first++;
    let sum = 0;
    for (let k = first; k < samples.length && samples[k] <= place + REACH * h; k++) sum += bell((place - samples[k]) / h);
    return sum / (samples.length * h);
  });
}
