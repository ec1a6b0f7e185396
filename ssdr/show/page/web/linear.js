// Small matrices.  Bones are 12 numbers, [R | T] by rows; cameras 16 by columns, as WebGL has them.

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const plus = (a, b, factor = 1) => [a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => plus([0, 0, 0], a, 1 / (Math.hypot(...a) || 1));

// The point `p` moved by bone `b` of `matrices`.
function moved(matrices, b, p) {
  const m = 12 * b;
  return [0, 4, 8].map(
    (r) => matrices[m + r] * p[0] + matrices[m + r + 1] * p[1] + matrices[m + r + 2] * p[2] + matrices[m + r + 3],
  );
}

// The product of two 3×4 matrices: first `b`, then `a`.
function after(a, b) {
  const out = new Array(12);
  for (let r = 0; r < 12; r += 4) {
    for (let c = 0; c < 4; c++) {
      out[r + c] = a[r] * b[c] + a[r + 1] * b[4 + c] + a[r + 2] * b[8 + c] + (c === 3 ? a[r + 3] : 0);
    }
  }
  return out;
}

// The rotation by `angle` about the axis through `point`, as 3×4 matrix (Rodrigues).
function rotation(axis, angle, point = [0, 0, 0]) {
  const [x, y, z] = unit(axis);
  const c = Math.cos(angle), s = Math.sin(angle), t = 1 - c;
  const r = [
    [t * x * x + c, t * x * y - s * z, t * x * z + s * y],
    [t * x * y + s * z, t * y * y + c, t * y * z - s * x],
    [t * x * z - s * y, t * y * z + s * x, t * z * z + c],
  ];
  return r.flatMap((row, k) => [...row, point[k] - dot(row, point)]);
}

function product4(a, b) {
  const out = new Float32Array(16);
  for (let c = 0; c < 16; c += 4) {
    for (let r = 0; r < 4; r++) {
      for (let k = 0; k < 4; k++) out[c + r] += a[4 * k + r] * b[c + k];
    }
  }
  return out;
}

// The inverse of a rigid [R | T].
function inverse(m) {
  const out = [m[0], m[4], m[8], 0, m[1], m[5], m[9], 0, m[2], m[6], m[10], 0];
  for (let r = 0; r < 12; r += 4) out[r + 3] = -(out[r] * m[3] + out[r + 1] * m[7] + out[r + 2] * m[11]);
  return out;
}
const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0];

// Parents before children.
const order = [];
if (doc.rig?.parents) {
  const depth = (b) => (doc.rig.parents[b] < 0 ? 0 : 1 + depth(doc.rig.parents[b]));
  doc.rig.depth = doc.rig.parents.map((_, b) => depth(b));
  order.push(...doc.rig.parents.keys());
  order.sort((a, b) => doc.rig.depth[a] - doc.rig.depth[b]);
}

// Transforms of the bones in a frame; `turns` maps bones to rotations about their joints by hand,
// in the joint's coordinate system.  What turns a bone moves all below it, too.
function pose(mesh, frame, turns) {
  const size = 12 * doc.bones;
  const matrices = mesh.transforms.subarray(frame * size, (frame + 1) * size);
  if (!turns.size) return matrices;
  const posed = Float32Array.from(matrices);
  const carried = [];
  for (const b of order) {
    const above = carried[doc.rig.parents[b]] || IDENTITY;
    let change = above;
    if (turns.has(b)) {
      const m = Array.from(matrices.subarray(12 * b, 12 * b + 12));
      const turn = turns.get(b), head = doc.rig.heads[b];
      const about = turn.map((v, k) => (k % 4 === 3 ? head[(k - 3) / 4] - dot(turn.slice(k - 3, k), head) : v));
      change = after(above, after(m, after(about, inverse(m))));
    }
    carried[b] = change;
    posed.set(after(change, matrices.subarray(12 * b, 12 * b + 12)), 12 * b);
  }
  return posed;
}

// Transforms of the bones for weights of the expressions, each a clip of two frames, the first at rest.
function driven(mesh, weights) {
  const size = 12 * doc.bones;
  const out = Float32Array.from(mesh.transforms.subarray(0, size));
  weights.forEach((weight, k) => {
    if (!weight) return;
    const from = 2 * k * size;
    for (let i = 0; i < size; i++) out[i] += weight * (mesh.transforms[from + size + i] - mesh.transforms[from + i]);
  });
  return out;
}

// The rest pose with the shapes of a frame, or those of the expressions that are weighted.
function shaped(mesh, frame, weights = null) {
  const { plain, shapeVertices, shapeMoves, amounts } = mesh;
  if (!doc.shapes) return plain;
  const out = Float32Array.from(plain);
  const count = doc.shapes.length - 1;
  for (let s = 0; s < count; s++) {
    const amount = weights
      ? weights.reduce((sum, weight, k) => sum + weight * amounts[(2 * k + 1) * count + s], 0)
      : amounts[frame * count + s];
    if (!amount) continue;
    for (let i = doc.shapes[s]; i < doc.shapes[s + 1]; i++) {
      const v = 3 * shapeVertices[i];
      for (let c = 0; c < 3; c++) out[v + c] += amount * shapeMoves[3 * i + c];
    }
  }
  return out;
}

// Linear blend skinning as the shader does it; differences of the input are added if there are any.
function skinned(mesh, matrices, off = null) {
  const { rest, indices, weights, influences } = mesh;
  const out = new Float32Array(rest.length);
  const step = off ? doc.input.step : 0;
  for (let v = 0, i = 0; v < out.length; v += 3) {
    const x = rest[v], y = rest[v + 1], z = rest[v + 2];
    let a = 0, b = 0, c = 0;
    for (let k = 0; k < influences; k++, i++) {
      const w = weights[i], m = 12 * indices[i];
      if (!w) continue;
      a += w * (matrices[m] * x + matrices[m + 1] * y + matrices[m + 2] * z + matrices[m + 3]);
      b += w * (matrices[m + 4] * x + matrices[m + 5] * y + matrices[m + 6] * z + matrices[m + 7]);
      c += w * (matrices[m + 8] * x + matrices[m + 9] * y + matrices[m + 10] * z + matrices[m + 11]);
    }
    out[v] = off ? a + step * off[v] : a;
    out[v + 1] = off ? b + step * off[v + 1] : b;
    out[v + 2] = off ? c + step * off[v + 2] : c;
  }
  return out;
}

// The sum of the normals of the triangles at a vertex, by their areas.
function normalAt({ faces, map }, points, vertex) {
  let sum = [0, 0, 0];
  for (let t = 0; t < faces.length; t += 3) {
    const corners = [0, 1, 2].map((c) => map[faces[t + c]]);
    if (!corners.includes(vertex)) continue;
    const [a, b, c] = corners.map((v) => points.slice(3 * v, 3 * v + 3));
    sum = plus(sum, cross(plus(b, a, -1), plus(c, a, -1)));
  }
  return sum;
}

// From the page's coordinates to those of the mesh.
const inUnits = (points, stride = 3) => {
  const out = new Float32Array((points.length / stride) * 3);
  for (let k = 0; k < out.length; k++) {
    out[k] = points[Math.floor(k / 3) * stride + (k % 3)] * doc.scale + doc.center[k % 3];
  }
  return out;
};
