// The document, and the arrays that its entries name.

const $ = (id) => document.getElementById(id);
const doc = JSON.parse($("document").textContent);

function blockBytes(number) {
  const text = $(`block${number}`).textContent;
  return Uint8Array.fromBase64
    ? Uint8Array.fromBase64(text)
    : Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
}

async function inflated(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// The inverse of `Blocks.array` in blocks.py; multiples of a step become Float32Array.
async function unpacked(entry) {
  const planes = await inflated(blockBytes(entry.block));
  const kind = globalThis[entry.type];
  const size = kind.BYTES_PER_ELEMENT;
  const count = planes.length / size;
  const bytes = new Uint8Array(planes.length);
  for (let plane = 0, from = 0; plane < size; plane++) {
    for (let at = plane; at < bytes.length; at += size) bytes[at] = planes[from++];
  }
  const values = new kind(bytes.buffer);
  if (entry.delta) {
    const row = count / (entry.shape[0] || 1);
    for (let k = row; k < count; k++) values[k] += values[k - row];
  }
  if (!entry.step) return values;
  const numbers = new Float32Array(count);
  for (let k = 0; k < count; k++) numbers[k] = values[k] * entry.step;
  return numbers;
}

// The mesh, the weights and the motion: all but the input, which comes in spans.
async function loaded() {
  const optional = (entry) => (entry ? unpacked(entry) : null);
  const entries = ["rest", "indices", "weights", "transforms", "path", "faces", "copies", "uv", "groups", "normals", "shapeVertices", "shapeMoves", "amounts"];
  const arrays = await Promise.all(entries.map((name) => optional(doc[name])));
  const mesh = Object.fromEntries(entries.map((name, k) => [name, arrays[k]]));
  mesh.shade = await optional(doc.rig?.shade);
  mesh.plain = mesh.rest; // without shapes
  mesh.bones = doc.bones;
  mesh.influences = doc.indices.shape[1];
  const { vertices } = doc;
  mesh.map = new Uint32Array(vertices + mesh.copies.length);
  for (let v = 0; v < vertices; v++) mesh.map[v] = v;
  mesh.map.set(mesh.copies, vertices);
  return mesh;
}

// The input's differences from the model.  A few spans of frames are held, the next is fetched ahead.
class Input {
  constructor(entry) {
    this.entry = entry;
    this.spans = new Map();
  }

  span(number) {
    const { spans } = this.entry;
    if (!this.spans.has(number) && number < spans.length) {
      const span = { data: null };
      span.promise = unpacked(spans[number]).then((data) => (span.data = data));
      this.spans.set(number, span);
      if (this.spans.size > 4) this.spans.delete(this.spans.keys().next().value);
    }
    return this.spans.get(number);
  }

  // Differences of a frame, or null while they are being decoded.
  at(frame, ahead = true) {
    const number = Math.floor(frame / this.entry.length);
    const { data } = this.span(number);
    if (ahead && data) this.span(number + 1);
    const size = 3 * doc.vertices;
    const start = (frame - number * this.entry.length) * size;
    return data && data.subarray(start, start + size);
  }

  async wait(frame) {
    await this.span(Math.floor(frame / this.entry.length)).promise;
    return this.at(frame, false);
  }
}

// The number of a frame in the animation, and the clip that it belongs to.
const clipOf = (frame) => doc.clips.find((clip) => frame < clip.stop) || doc.clips.at(-1);
const numberOf = (frame) => clipOf(frame).first + (frame - clipOf(frame).start) * doc.step;
function frameOf(number) {
  const clip = doc.clips.findLast((one) => one.first <= number) || doc.clips[0];
  return Math.min(clip.start + Math.round((number - clip.first) / doc.step), clip.stop - 1);
}

const digits = (value, count) => (value >= 10 ** count ? value.toFixed(0) : value.toPrecision(count));
const brief = (value) => digits(value, 3) + (doc.unit || "");
const share = (value) => (value / (doc.error.diagonal || 1)) * 100;
const withShare = (value) => `${brief(value)} (${digits(share(value), 2)} %)`;
