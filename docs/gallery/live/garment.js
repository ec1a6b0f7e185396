// The garment frame by frame, as garmentnet/networks does it (network.py, features.py).  Joints and bones are 12 numbers each.

const TELEPORT = 15, SPIN = 40; // m/s and rad/s of the root beyond which the garment starts anew

class Garment {
  constructor(about, { basis, still, ...arrays }) {
    Object.assign(this, about, arrays);
    this.low = new Recurrent(arrays.low);
    this.high = arrays.high && new Recurrent(arrays.high);
    this.detail = new Float32Array(3 * doc.cloth);
    this.spread = basis && new Affine(basis, still);
    this.theta = new Float32Array(this.parameters.length);
    this.input = new Float32Array(this.mean.length + this.theta.length);
  }

  static async load(about) {
    await startProducts();
    const parts = async (entry) => {
      const names = Object.keys(entry);
      const arrays = await Promise.all(names.map((name) => unpacked(entry[name])));
      return Object.fromEntries(names.map((name, k) => [name, arrays[k]]));
    };
    const { low, high, scale, shift, centres, basis, still } = about;
    const arrays = await parts({ scale, shift, centres, ...(basis && { basis, still }) });
    return new Garment(about, { ...arrays, low: await parts(low), high: high && (await parts(high)) });
  }

  // Logarithms, [-1, 1] over their ranges.
  setParameters(values) {
    this.parameters.forEach(({ low, high }, k) => {
      this.theta[k] = (2 * Math.log(values[k] / low)) / Math.log(high / low) - 1;
    });
  }

  // The state after the next pose; of no state: the motion starts here, from rest.
  advance(state, m) {
    if (state && this.jumped(state.pose, m)) state = null;
    const { input, mean, deviation, clamp, theta } = this;
    const [pose, features] = this.features(state?.pose, m);
    const most = clamp > 0 ? clamp : Infinity;
    for (let k = 0; k < mean.length; k++) {
      input[k] = Math.max(-most, Math.min(most, (features[k] - mean[k]) / deviation[k]));
    }
    input.set(theta, mean.length);
    const [motion, low] = this.low.run(input, state?.low || new Float32Array(this.low.size));
    let numbers = null, high = null;
    if (this.high) {
      const read = this.readsBody ? input : Float32Array.of(...motion, ...theta);
      [numbers, high] = this.high.run(read, state?.high || new Float32Array(this.high.size));
    }
    return { pose, low, high, numbers, bones: this.bones(motion) };
  }

  jumped({ place, rotation }, m) {
    const dt = 1 / this.fps;
    const way = Math.hypot(...plus(moved(m, 0, doc.rig.heads[0]), place, -1));
    let trace = 0;
    for (let k = 0; k < 9; k++) trace += rotation[k] * m[Math.floor(k / 3) * 4 + (k % 3)];
    return way > TELEPORT * dt || Math.acos(Math.max(-1, Math.min(1, (trace - 1) / 2))) > SPIN * dt;
  }

  features(before, m) {
    const { fps } = this;
    const head = heading(m), turn = [0, 1, 2, 4, 5, 6, 8, 9, 10].map((k) => m[k]);
    const places = this.tracked.map((j) => moved(m, j, doc.rig.heads[j])), place = places[0];
    const code = this.read.flatMap((j) => {
      const p = doc.rig.parents[j], own = rotationOf(m, j);
      const r = p >= 0 ? across(rotationOf(m, p), own) : this.headingFree ? across(head, own) : own;
      return this.sixd ? [0, 1].flatMap((c) => [r[c], r[3 + c], r[6 + c]]) : rotationVector(r);
    });
    const zero = [0, 0, 0];
    const rates = (now, then) => now.map((p, k) => (before ? plus(p, then[k], -1).map((v) => v * fps) : zero));
    const velocities = rates(places, before?.places), changes = rates(velocities, before?.velocities);
    const pose = { first: before?.first || place, place, places, velocities, rotation: turn, code };
    const out = this.translation ? plus(place, pose.first, -1) : [];
    out.push(...code);
    if (this.velocities) out.push(...code.map((v, k) => (before ? (v - before.code[k]) * fps : 0)));
    if (this.rootMotion) {
      const transposed = (r) => [r[0], r[3], r[6], r[1], r[4], r[7], r[2], r[5], r[8]];
      const since = before ? rotationVector(across(transposed(turn), transposed(before.rotation))) : zero;
      const [v, c, w] = [velocities[0], changes[0], since.map((x) => x * fps)].map((x) => turnedBack(head, x));
      out.push(...v, ...c, ...w, ...w.map((x) => x * x));
    }
    const seen = [places.map((p) => plus(p, place, -1)), velocities, changes];
    for (const every of seen) out.push(...every.slice(1).flatMap((v) => turnedBack(head, v)));
    for (const j of this.tracked.slice(1)) {
      const r = across(head, rotationOf(m, j));
      out.push(r[0], r[3], r[6], r[1], r[4], r[7]);
    }
    return [pose, out];
  }

  // Transforms of 6D rotations and moved centres, in the moving frame or that of the joint followed.
  bones(motion) {
    const { scale, shift, centres } = this;
    const out = new Float32Array(12 * doc.virtual);
    for (let b = 0; b < doc.virtual; b++) {
      const n = (k) => motion[9 * b + k] * scale[9 * b + k] + shift[9 * b + k];
      const x = over([n(0), n(1), n(2)]);
      const second = [n(3), n(4), n(5)];
      const y = over(plus(second, x, -dot(x, second)));
      const z = cross(x, y);
      for (let a = 0; a < 3; a++) {
        const row = [x[a], y[a], z[a]];
        out.set(row, 12 * b + 4 * a);
        out[12 * b + 4 * a + 3] = n(6 + a) - dot(row, centres.subarray(3 * b, 3 * b + 3));
      }
    }
    return out;
  }

  // Transforms of joints and bones from the rest pose to the world, and the detail in the rest pose.
  shown({ bones, numbers }, m) {
    const place = this.frame === "world" ? [0, 0, 0] : moved(m, 0, doc.rig.heads[0]);
    const turn = { world: [1, 0, 0, 0, 1, 0, 0, 0, 1], root: rotationOf(m, 0), heading: heading(m) }[this.frame];
    const frame = place.flatMap((v, a) => [...turn.slice(3 * a, 3 * a + 3), v]);
    const out = new Float32Array(m.length + bones.length);
    out.set(m);
    this.followed.forEach((j, k) => {
      const base = j < 0 ? frame : m.subarray(12 * j, 12 * j + 12);
      out.set(after(base, bones.subarray(12 * k, 12 * k + 12)), m.length + 12 * k);
    });
    if (numbers) this.detail = this.spread.of(numbers);
    return out;
  }
}

const over = (v) => plus([0, 0, 0], v, 1 / Math.max(Math.hypot(...v), 1e-8));
const rotationOf = (m, j) => [0, 1, 2, 4, 5, 6, 8, 9, 10].map((k) => m[12 * j + k]);
// Aᵀ b and Aᵀ B of rotations by rows.
const turnedBack = (a, b) => [0, 1, 2].map((r) => a[r] * b[0] + a[3 + r] * b[1] + a[6 + r] * b[2]);
const across = (a, b) =>
  [0, 1, 2].flatMap((r) => [0, 1, 2].map((c) => a[r] * b[c] + a[3 + r] * b[3 + c] + a[6 + r] * b[6 + c]));

// The root's turn about the vertical: the twist of swing and twist.
function heading(m) {
  const s = m[2] - m[8], c = m[0] + m[10], size = Math.hypot(s, c);
  const [x, y] = size > 1e-12 ? [s / size, c / size] : [0, 1];
  return [y, 0, x, 0, 1, 0, -x, 0, y];
}

// Axis times angle, 0 to π, by way of the quaternion's largest part.
function rotationVector(r) {
  const trace = r[0] + r[4] + r[8];
  const off = [r[7] - r[5], r[2] - r[6], r[3] - r[1]];
  const largest = [r[0], r[4], r[8]].indexOf(Math.max(r[0], r[4], r[8]));
  let w = 1 + trace, v = off;
  if (trace < r[4 * largest]) {
    w = off[largest];
    v = [0, 1, 2].map((k) => (k === largest ? 1 + 2 * r[4 * k] - trace : r[3 * k + largest] + r[3 * largest + k]));
  }
  const sine = Math.hypot(...v);
  return v.map((x) => (sine > 0 ? (2 * Math.atan2(sine, Math.abs(w)) * (w >= 0 ? 1 : -1) * x) / sine : 0));
}
