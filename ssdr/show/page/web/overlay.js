// What is drawn over the picture: bones, names, the selected and the worst vertex.

// Colours of the style sheet, which change with the colour scheme.
const dark = matchMedia("(prefers-color-scheme: dark)");
const colorsFound = new Map();
dark.addEventListener("change", () => colorsFound.clear());
function css(name) {
  if (!colorsFound.has(name)) {
    colorsFound.set(name, getComputedStyle(document.documentElement).getPropertyValue(name).trim());
  }
  return colorsFound.get(name);
}
const rgb = ([r, g, b], alpha = 1) => `rgb(${r} ${g} ${b} / ${alpha})`;
// In linear RGB.
const linearColor = (hex) => [1, 3, 5].map((k) => (parseInt(hex.slice(k, k + 2), 16) / 255) ** 2.2);
const AXES = [[219, 69, 64], [77, 168, 79], [56, 115, 217]];
const RING = 38; // pixels, in which a drag turns the selected joint
const shortName = (b) => doc.rig.names[b].slice(0, 40);

// Place of a point on the screen: pixels within a port [x, y, width, height] from the upper left.
function projector(view, projection, [left, top, width, height]) {
  const m = product4(projection, view);
  return (p) => {
    const w = m[3] * p[0] + m[7] * p[1] + m[11] * p[2] + m[15];
    const x = (m[0] * p[0] + m[4] * p[1] + m[8] * p[2] + m[12]) / w;
    const y = (m[1] * p[0] + m[5] * p[1] + m[9] * p[2] + m[13]) / w;
    return [left + ((x + 1) / 2) * width, top + ((1 - y) / 2) * height, w];
  };
}

// Heads and tails of what is drawn for each bone, on the screen.
function limbs(matrices, project) {
  const { heads, ends, parents } = doc.rig;
  const places = heads.map((head, b) => project(moved(matrices, b, head)));
  if (!parents) return places.map((head, b) => ({ bone: b, head, tail: head }));
  const parts = [];
  const leaf = new Set(parents.keys());
  parents.forEach((a, b) => {
    if (a < 0) return;
    leaf.delete(a);
    parts.push({ bone: a, head: places[a], tail: places[b] });
  });
  for (const b of leaf) parts.push({ bone: b, head: places[b], tail: project(moved(matrices, b, ends[b])) });
  return parts;
}

function drawBone(pen, { bone, head, tail }, selected, thin) {
  const [dx, dy] = [tail[0] - head[0], tail[1] - head[1]];
  const length = Math.hypot(dx, dy) || 1;
  const wide = Math.min(thin ? 3 : 9, 0.1 * length) / length;
  const waist = [head[0] + 0.18 * dx, head[1] + 0.18 * dy];
  pen.beginPath();
  pen.moveTo(head[0], head[1]);
  pen.lineTo(waist[0] - wide * dy, waist[1] + wide * dx);
  pen.lineTo(tail[0], tail[1]);
  pen.lineTo(waist[0] + wide * dy, waist[1] - wide * dx);
  pen.closePath();
  pen.fillStyle = rgb(doc.rig.colors[bone], 0.85);
  pen.fill();
  pen.lineWidth = selected ? 2.5 : 1;
  pen.strokeStyle = selected ? css("--ink") : "rgb(20 24 32 / 0.7)";
  pen.stroke();
  dotAt(pen, head, selected ? 4.5 : 3, "#fff", "rgb(20 24 32 / 0.8)");
}

function drawAxes(pen, matrices, bone, head, project, selected) {
  const centre = moved(matrices, bone, doc.rig.heads[bone]);
  const size = 0.045 * Math.min(1, (20 / doc.bones) ** 0.33);
  pen.lineWidth = selected ? 3 : 1.8;
  AXES.forEach((color, axis) => {
    const way = unit([0, 4, 8].map((r) => matrices[12 * bone + r + axis]));
    const tip = project(plus(centre, way, size));
    pen.strokeStyle = rgb(color);
    pen.beginPath();
    pen.moveTo(head[0], head[1]);
    pen.lineTo(tip[0], tip[1]);
    pen.stroke();
  });
  dotAt(pen, head, selected ? 6 : 4, rgb(doc.rig.colors[bone]), css("--ink"));
}

function dotAt(pen, [x, y], radius, fill, stroke, width = 1) {
  pen.beginPath();
  pen.arc(x, y, radius, 0, 7);
  if (fill) {
    pen.fillStyle = fill;
    pen.fill();
  }
  pen.lineWidth = width;
  pen.strokeStyle = stroke;
  pen.stroke();
}

function label(pen, text, x, y, color = css("--ink")) {
  pen.lineWidth = 3;
  pen.strokeStyle = css("--paper");
  pen.strokeText(text, x, y);
  pen.fillStyle = color;
  pen.fillText(text, x, y);
}

// Names beside the heads where there is room: of the selected bone, of its neighbours, then of the nearest.
function drawNames(pen, heads, { bone, names }, taken, edge) {
  const parents = doc.rig.parents || [];
  const rank = (b) => (b === bone ? 0 : parents[b] === bone || parents[bone] === b ? 1 : 2);
  const bones = [...heads.keys()].filter((b) => names || b === bone);
  bones.sort((a, b) => rank(a) - rank(b) || heads.get(a)[2] - heads.get(b)[2]);
  for (const b of bones) {
    const [x, y] = heads.get(b);
    const wide = pen.measureText(shortName(b)).width;
    const places = [[x + 9, y + 4], [x - 9 - wide, y + 4], [x + 9, y - 9], [x - 9 - wide, y + 17]];
    const place = places.find(([u, v]) => u + wide < edge && taken.every(([s, t, w]) => u > s + w + 4 || s > u + wide + 4 || Math.abs(v - t) > 13));
    if (!place) continue;
    taken.push([...place, wide]);
    label(pen, shortName(b), ...place);
  }
}

// Everything over one port that shows the model.
function drawOver(pen, project, port, clip, { matrices, state, vertexAt, worst }) {
  pen.font = "12px system-ui, sans-serif";
  pen.lineJoin = "round";
  let spot, hidden, text, wide, at;
  if (worst) {
    spot = project(vertexAt(worst.vertex));
    hidden = worst.hidden(worst.vertex, project);
    text = `worst${hidden ? ", hidden" : ""}: ${withShare(worst.error)}${port[2] > 600 ? `, vertex ${worst.vertex}` : ""}`;
    wide = pen.measureText(text).width;
    const right = spot[0] + wide + 13 < port[0] + port[2];
    at = [right ? spot[0] + 13 : Math.max(port[0], spot[0] - wide - 13), spot[1] + 4];
  }
  pen.save();
  pen.beginPath();
  pen.rect(...clip);
  pen.clip();
  const { rig } = doc;
  if (rig && (state.joints || state.names || state.bone >= 0)) {
    const parts = limbs(matrices, project).sort((a, b) => b.head[2] - a.head[2]);
    const thin = ["weight", "error", "normals"].includes(state.color); // what matters lies below
    for (const part of parts) {
      const selected = part.bone === state.bone;
      pen.globalAlpha = thin && !selected ? 0.5 : 1;
      if (state.joints || (selected && rig.parents)) {
        if (rig.parents) drawBone(pen, part, selected, thin);
        else drawAxes(pen, matrices, part.bone, part.head, project, selected);
      } else if (selected) dotAt(pen, part.head, 6, rgb(rig.colors[part.bone]), css("--ink"));
      if (selected && rig.rigid) dotAt(pen, part.head, RING, null, css("--accent"), 1.5);
    }
    pen.globalAlpha = 1;
    drawNames(pen, new Map(parts.map(({ bone, head }) => [bone, head])), state, worst ? [[...at, wide]] : [], clip[0] + clip[2]);
  }
  if (state.vertex >= 0) dotAt(pen, project(vertexAt(state.vertex)), 5, null, css("--ink"), 2);
  pen.restore();
  if (!worst) return;
  pen.setLineDash(hidden ? [4, 4] : []);
  dotAt(pen, spot, 9, null, css("--paper"), 4.5);
  dotAt(pen, spot, 9, null, css("--ink"), 2);
  pen.setLineDash([]);
  label(pen, text, ...at);
}

// The bone whose drawing is nearest to a place, within a few pixels; -1 if there is none.
function boneAt(parts, [x, y]) {
  let found = -1, best = 9;
  for (const { bone, head, tail } of parts) {
    const [dx, dy] = [tail[0] - head[0], tail[1] - head[1]];
    const along = Math.max(0, Math.min(1, ((x - head[0]) * dx + (y - head[1]) * dy) / (dx * dx + dy * dy || 1)));
    const off = Math.hypot(x - head[0] - along * dx, y - head[1] - along * dy);
    if (off < best) [found, best] = [bone, off];
  }
  return found;
}

// The vertex seen at a place: a corner of the nearest triangle there, or a point near it.
function vertexSeen(points, mesh, project, [x, y]) {
  const seen = new Float32Array(points.length);
  for (let v = 0; v < points.length; v += 3) seen.set(project(points.subarray(v, v + 3)), v);
  const { faces, map } = mesh;
  let found = -1, nearest = Infinity;
  for (let t = 0; t < faces.length; t += 3) {
    const corner = [0, 1, 2].map((c) => 3 * map[faces[t + c]]);
    const [a, b, c] = corner;
    const area = (p, q, u, v) => (seen[q] - seen[p]) * (v - seen[p + 1]) - (seen[q + 1] - seen[p + 1]) * (u - seen[p]);
    const s = area(b, c, x, y), r = area(c, a, x, y), q = area(a, b, x, y);
    if (!((s >= 0 && r >= 0 && q >= 0) || (s <= 0 && r <= 0 && q <= 0)) || s + r + q === 0) continue;
    const depth = (s * seen[a + 2] + r * seen[b + 2] + q * seen[c + 2]) / (s + r + q);
    if (depth < nearest && depth > 0) {
      nearest = depth;
      const most = Math.max(Math.abs(s), Math.abs(r), Math.abs(q));
      found = corner[[s, r, q].findIndex((v) => Math.abs(v) === most)] / 3;
    }
  }
  if (faces.length) return found;
  let best = 12;
  for (let v = 0; v < seen.length; v += 3) {
    const off = Math.hypot(seen[v] - x, seen[v + 1] - y);
    if (off < best && seen[v + 2] > 0) [best, found] = [off, v / 3];
  }
  return found;
}
