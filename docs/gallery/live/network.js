// Products of matrices and vectors in WebAssembly, and a GRU with the linear layer behind it.

let memory, multiply, numbers; // numbers: all of the memory
let used = 0;

// Of a number of rows or columns: the kernel of affine.wat takes four at a time.
const padded = (count) => Math.max(4, (count + 3) & ~3);

async function startProducts() {
  const bytes = Uint8Array.from(atob(doc.garment.product), (c) => c.charCodeAt(0));
  ({ memory, affine: multiply } = (await WebAssembly.instantiate(bytes)).instance.exports);
}

// Where `count` more numbers lie, zeros.
function reserve(count) {
  const at = used;
  used += count;
  const missing = 4 * used - memory.buffer.byteLength;
  if (missing > 0) memory.grow(Math.ceil(missing / 65536));
  numbers = new Float32Array(memory.buffer);
  return at;
}

// w x + b, w by rows.
class Affine {
  constructor(w, b) {
    this.rows = b.length;
    const columns = w.length / this.rows, wide = padded(columns), high = padded(this.rows);
    [this.w, this.b, this.x, this.out] = [high * wide, high, wide, high].map(reserve);
    numbers.set(b, this.b);
    for (let r = 0; r < this.rows; r++) {
      numbers.set(w.subarray(r * columns, (r + 1) * columns), this.w + r * wide);
    }
    this.call = [...[this.w, this.b, this.x, this.out].map((at) => 4 * at), wide, high];
  }

  // Good until the next call.
  of(x) {
    numbers.set(x, this.x);
    multiply(...this.call);
    return numbers.subarray(this.out, this.out + this.rows);
  }
}

class Recurrent {
  constructor({ w_in, b_in, w_state, b_state, w_out, b_out }) {
    this.size = b_state.length / 3;
    this.input = new Affine(w_in, b_in);
    this.state = new Affine(w_state, b_state);
    this.output = new Affine(w_out, b_out);
  }

  // Output and new state; gates in torch's order r, z, n.
  run(x, h) {
    const { size } = this, gates = this.input.of(x), own = this.state.of(h);
    const next = new Float32Array(size);
    for (let k = 0; k < size; k++) {
      // σ(x) = (1 + tanh(x / 2)) / 2 does not overflow
      const r = 0.5 + 0.5 * Math.tanh(0.5 * (gates[k] + own[k]));
      const z = 0.5 + 0.5 * Math.tanh(0.5 * (gates[size + k] + own[size + k]));
      const n = Math.tanh(gates[2 * size + k] + r * own[2 * size + k]);
      next[k] = n + z * (h[k] - n);
    }
    return [this.output.of(next).slice(), next];
  }
}
