// The state of the page, its clock, and the order of drawing.

const state = {
  frame: 0, playing: false, speed: 1, clip: doc.clips.length > 1 ? -1 : 0,
  view: doc.rig ? "result" : "input", color: "plain", bone: -1, vertex: -1, turns: new Map(), weights: null,
  joints: false, names: false, worst: true, fixed: true, surface: false, follow: doc.follow, divider: 0.5,
};
const camera = new Camera();
const input = doc.input && new Input(doc.input);
let mesh, renderer, strip;
let shown = { frame: -1, matrices: null }; // what the graphics card holds
let resting = true; // nothing has moved yet
let asked = false, stale = true, last = 0, clock = 0, waiting = [];

const range = () => (state.clip < 0 ? [0, doc.frames] : [doc.clips[state.clip].start, doc.clips[state.clip].stop]);
const compared = () => state.color === "error" || state.color === "normals";
const needsInput = () => input && (state.view !== "result" || compared());
// The turns that are drawn: a pose by hand has no input to be compared with, and waits for Result.
const turned = () => (state.view === "result" && !compared() ? state.turns : NO_TURNS);
// Weights of expressions that are set by hand, where they are drawn; the next frame takes them back.
const weighted = () => (state.view === "result" && !compared() ? state.weights : null);
const heading = () => $("stage").querySelector("header").offsetHeight + 14;
const errorTop = () => (state.fixed ? doc.error.top : doc.error.largest[state.frame] || doc.error.top);
const NO_TURNS = new Map();
const CLAY = [...linearColor("#d6d1c9"), 1];
const GHOST = [...linearColor("#1c5fd0"), 1];

function set(changes) {
  const before = { ...state };
  Object.assign(state, changes);
  if ("clip" in changes && changes.clip !== before.clip) state.frame = range()[0];
  if (changes.turns?.size) Object.assign(state, { view: "result", color: compared() ? "bones" : state.color });
  if (changes.weights) Object.assign(state, { view: "result", color: compared() ? "bones" : state.color, playing: false });
  else if (state.weights && (state.playing || state.frame !== before.frame)) {
    state.weights = null;
    resetExpressions();
  }
  if (state.color === "weight" && state.bone < 0) state.bone = doc.rig.share.indexOf(Math.max(...doc.rig.share));
  if (state.color !== before.color || state.bone !== before.bone) paint();
  const moves = resting && (state.playing || state.frame !== before.frame);
  resting &&= !moves;
  if (state.follow !== before.follow || ((moves || state.view !== before.view) && camera.fitted)) fit();
  if (state.playing !== before.playing) last = 0;
  if (!state.playing && ("frame" in changes || before.playing)) say();
  sync();
  ask();
}

function sync() {
  showState(state, mesh, doc.error && errorTop());
  const [start, stop] = range();
  strip.set(state.frame, [start, stop]);
  showFrame();
  Object.assign($("frame"), { min: numberOf(start), max: numberOf(stop - 1), step: doc.step });
  $("of").textContent = `of ${numberOf(start)} to ${numberOf(stop - 1)}`;
}

function showFrame() {
  if (document.activeElement !== $("frame")) $("frame").value = numberOf(state.frame);
  $("now").textContent = errorText(state.frame).slice(2);
  $("now").classList.toggle("stale", turned().size > 0 || !!weighted());
  if (!state.fixed) showLegend(state, doc.error && errorTop());
}

let saying = 0;
function say() {
  clearTimeout(saying);
  saying = setTimeout(() => ($("said").textContent = `Frame ${numberOf(state.frame)}${errorText(state.frame)}`), 400);
}

// Colours of the vertices by bone or by the weight of one bone.
function paint() {
  if (state.color === "bones") renderer.setShades(mesh.shade);
  if (state.color !== "weight") return;
  const colors = new Uint8Array(3 * doc.vertices);
  const heat = heatColors();
  const { influences, indices, weights } = mesh;
  for (let v = 0; v < doc.vertices; v++) {
    let weight = 0;
    for (let k = v * influences; k < (v + 1) * influences; k++) if (indices[k] === state.bone) weight += weights[k];
    const at = Math.min(weight, 1) * (heat.length - 1), low = Math.min(Math.floor(at), heat.length - 2);
    for (let c = 0; c < 3; c++) colors[3 * v + c] = 255 * (heat[low][c] + (at - low) * (heat[low + 1][c] - heat[low][c]));
  }
  renderer.setShades(colors);
}

// Parts of the canvas, in its CSS pixels from the upper left, and what each shows: 0 model, 1 input.
function ports() {
  const { clientWidth: w, clientHeight: h } = $("view");
  const whole = [0, 0, w, h];
  if (state.view === "side") {
    const { tall } = state;
    const second = tall ? [0, h / 2, w, h / 2] : [w / 2, 0, w / 2, h];
    return [{ port: tall ? [0, 0, w, h / 2] : [0, 0, w / 2, h], which: 1 }, { port: second, which: 0 }];
  }
  if (state.view === "slider") {
    const x = Math.round(w * state.divider);
    return [
      { port: whole, clip: [0, 0, x, h], which: 1 },
      { port: whole, clip: [x, 0, w - x, h], which: 0 },
    ];
  }
  if (state.view === "overlay") return [{ port: whole, which: 0 }, { port: whole, which: 1, ghost: true }];
  return [{ port: whole, which: state.view === "input" ? 1 : 0 }];
}

const shift = () => (state.follow ? [...mesh.path.subarray(3 * shown.frame, 3 * shown.frame + 3)] : [0, 0, 0]);
const projectorOf = (port) => projector(camera.view(shift()), camera.projection(port[2] / port[3]), port);

// Brings into view the frame, as the page opens and when it is asked for, or else all frames.
function fit(one = resting) {
  skin();
  const [from, places] = one ? [shift(), points(doc.rig ? 0 : 1)] : [[0, 0, 0], (state.follow ? doc.body : doc.whole).flat()];
  const size = (tall) => {
    state.tall = tall;
    const [, , width, height] = ports()[0].port;
    camera.fit(places, width, height, heading() + (ports().length > 1 ? 36 : 8));
    camera.target = plus(camera.target, from, -1);
    return height / camera.distance;
  };
  size(size(true) > size(false)); // inputs beside or above results: where the mesh is larger
  ask();
}

function ask() {
  stale = true;
  if (!asked) requestAnimationFrame(tick);
  asked = true;
}

function tick(now) {
  asked = false;
  if (state.playing && advance(now)) stale = true;
  if (stale) {
    stale = false;
    draw();
  }
  if (state.playing && !asked) asked = !!requestAnimationFrame(tick);
}

// Goes to the next frame, if it is time for it and the input is decoded; says whether it did.
function advance(now) {
  const elapsed = last ? Math.min(0.1, (now - last) / 1000) : 0; // a tab in the background stands still
  last = now;
  clock += elapsed * state.speed * clipOf(state.frame).fps;
  const steps = Math.floor(clock);
  if (!steps) return false;
  clock -= steps;
  const [start, stop] = range();
  const next = start + ((state.frame - start + steps) % (stop - start));
  if (needsInput() && !input.at(next)) return false;
  state.frame = next;
  strip.set(next, [start, stop]);
  showFrame();
  return true;
}

// Skins the frame of the state.  While the input's differences are being decoded, what was shown stays.
function skin() {
  const off = needsInput() ? input.at(state.frame) : null;
  if (needsInput() && !off) {
    input.wait(state.frame).then(ask);
    return false;
  }
  const turns = turned();
  const weights = weighted();
  if (shown.frame !== state.frame || shown.turns !== turns || shown.weights !== weights || shown.off !== !!off) {
    const matrices = weights ? driven(mesh, weights) : pose(mesh, state.frame, turns);
    mesh.rest = shaped(mesh, state.frame, weights);
    renderer.setFrame(matrices, off, mesh.rest);
    shown = { frame: state.frame, turns, weights, off: !!off, matrices, points: null };
  }
  return true;
}

// The vertices on the screen, on the processor: for clicks and marks alone.
function points(which) {
  shown.points ||= [];
  const off = which ? input.at(shown.frame, false) : null;
  shown.points[which] ||= skinned(mesh, shown.matrices, off);
  return shown.points[which];
}
function vertexAt(v) {
  const sum = [0, 0, 0];
  for (let k = v * mesh.influences; k < (v + 1) * mesh.influences; k++) {
    const p = moved(shown.matrices, mesh.indices[k], mesh.rest.subarray(3 * v, 3 * v + 3));
    for (let c = 0; c < 3; c++) sum[c] += mesh.weights[k] * p[c];
  }
  return sum;
}

// Whether something lies before a vertex of the model; not looked for while the mesh moves.
function isHidden(v, project) {
  const [x, y, depth] = project(vertexAt(v));
  const front = state.playing ? -1 : vertexSeen(points(0), mesh, project, [x, y]);
  return front >= 0 && project(vertexAt(front))[2] < depth - 0.01;
}

function draw() {
  if (renderer.gl.isContextLost()) return;
  const ready = skin();
  if (shown.frame < 0) return;
  const { clientWidth: width, clientHeight: height } = $("view");
  if (!width || !height) return;
  const dense = Math.min(2, devicePixelRatio || 1);
  const pixels = ([x, y, w, h]) => [x, height - y - h, w, h].map((v) => Math.round(v * dense));
  renderer.begin(Math.round(width * dense), Math.round(height * dense));
  const view = camera.view(shift());
  const heat = heatColors().flat();
  const top = state.color === "normals" ? doc.angles.top : doc.error ? errorTop() / doc.scale : 1;
  const mode = { plain: 0, texture: 1, bones: 2, weight: 2, error: 3, normals: 4 }[state.color];
  for (const { port, clip = port, which, ghost } of ports()) {
    const projection = camera.projection(port[2] / port[3]);
    const input1 = which === 1 && state.color !== "texture" && doc.rig;
    renderer.show(which, {
      port: pixels(port), clip: pixels(clip), view, projection, heat, top, ghost, engine: !state.surface,
      mode: ghost || input1 ? 0 : mode, color: ghost ? GHOST : CLAY,
    });
  }
  drawMarks(width, height, dense);
  if (!ready) return;
  const done = waiting;
  waiting = [];
  done.forEach((resolve) => resolve());
}

function drawMarks(width, height, dense) {
  const over = $("over");
  // A new size empties the canvas; after clearRect alone some browsers go on showing the last picture.
  Object.assign(over, { width: Math.round(width * dense), height: Math.round(height * dense) });
  const pen = over.getContext("2d");
  pen.scale(dense, dense);
  const { error } = doc;
  const marked = state.worst && state.color === "error";
  const worst = marked && { vertex: error.worst[shown.frame], error: error.largest[shown.frame], hidden: isHidden };
  const parts = ports();
  for (const { port, clip = port, which } of parts) {
    if (which === 0) drawOver(pen, projectorOf(port), port, clip, { matrices: shown.matrices, state, vertexAt, worst });
  }
  const [left, right] = [$("tag-left"), $("tag-right")];
  left.hidden = right.hidden = parts.length < 2;
  if (parts.length < 2) return;
  const over2 = state.view === "overlay";
  [left, right].forEach((tag, k) => {
    const [x, y, w] = parts[k].clip || parts[k].port;
    tag.textContent = over2 ? ["Result", "Input: blue outline"][k] : ["Input", "Result"][k];
    tag.style.left = `${over2 ? width / 2 + (k ? 58 : -42) : x + w / 2}px`;
    tag.style.top = `${y || heading()}px`;
  });
  if (state.view === "slider") {
    pen.fillStyle = css("--ink");
    pen.fillRect(width * state.divider - 1, 0, 2, height);
  }
}

function seek(frame) {
  const [start, stop] = range();
  const inside = frame >= start && frame < stop;
  set({ playing: false, ...(inside ? {} : { clip: -1 }) });
  set({ frame: Math.max(0, Math.min(doc.frames - 1, Math.round(frame))) });
  return new Promise((resolve) => {
    waiting.push(resolve);
    ask();
  });
}

function bind() {
  buildPanel(set, choose, async () => {
    set({ color: "error", worst: true });
    await seek(frameOf(doc.error.frame));
    const vertex = doc.error.worst[shown.frame];
    camera.look(plus(vertexAt(vertex), shift(), -1), normalAt(mesh, points(0), vertex));
    ask();
  });
  strip = new Strip($("strip"), { seek, step });
  gestures($("view"), camera, { grab, click, changed: ask });
  addEventListener("keydown", keys);
  $("play").addEventListener("click", () => set({ playing: !state.playing }));
  $("back").addEventListener("click", () => step(-1));
  $("forth").addEventListener("click", () => step(1));
  $("fit").addEventListener("click", () => {
    fit(true);
    camera.fitted = false;
  });
  $("unpose").addEventListener("click", () => set({ turns: new Map() }));
  $("frame").addEventListener("change", () => seek(frameOf(Number($("frame").value) || 0)));
  $("divider").addEventListener("input", () => divide($("divider").value / 1000));
  document.querySelectorAll("#turn-sliders input").forEach((slider) => {
    slider.addEventListener("input", () => {
      const angles = [...document.querySelectorAll("#turn-sliders input")].map((one) => Number(one.value));
      turn(state.bone, turnOf(angles));
    });
  });
  const resized = () => {
    strip.draw();
    if (camera.fitted && shown.frame >= 0) fit();
    ask();
  };
  new ResizeObserver(resized).observe($("view"));
  dark.addEventListener("change", () => {
    paint();
    sync();
    resized();
  });
}

function startRenderer() {
  renderer = new Renderer($("view"), mesh);
  shown = { frame: -1 };
  paint();
  renderer.loadImages(ask);
}

async function start() {
  if (!globalThis.DecompressionStream) throw new Error("old");
  mesh = await loaded();
  beginAndAgain($("view"), startRenderer);
  bind();
  if (input) await input.wait(0);
  state.color = doc.looks ? "texture" : doc.rig ? "bones" : "plain";
  if (input && doc.rig) state.view = "side";
  paint();
  sync();
  fit();
  $("message").textContent = "";
  await seek(0);
  if (doc.frames > 1 && !matchMedia("(prefers-reduced-motion: reduce)").matches) set({ playing: true });
}

const ready = start().catch(failed);

const inFrame = (frame) => ({ ...mesh, rest: shaped(mesh, frame) });

// For tests and the curious.  Frames are counted from 0 in the page; vertices are in the mesh's units.
window.ssdr = {
  ready, state, set, seek, camera,
  vertices: (frame) => inUnits(skinned(inFrame(frame), pose(mesh, frame, new Map()))),
  input: async (frame) => inUnits(skinned(inFrame(frame), pose(mesh, frame, new Map()), await input.wait(frame))),
  read: (which) => inUnits(renderer.read(which), 4),
  normals: () => renderer.read(2),
  place: (bone) => projectorOf(ports().at(-1).port)(moved(shown.matrices, bone, doc.rig.heads[bone])),
};
