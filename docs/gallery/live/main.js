// The state of the page, its clock, and the order of prediction and drawing.

const KEPT = 10; // of so many frames one state of the network is kept, to go back to
const SETTLES = 3; // seconds for which the garment goes on after a change by hand in a pause

const errors = doc.error;
const input = doc.input && new Input(doc.input);
const pushes = doc.pushed && new Input(doc.pushed);
const camera = new Camera();
const state = {
  frame: 0, playing: false, speed: 1, clip: 0, view: "result", color: "texture", bone: -1, vertex: -1,
  turns: new Map(), parameters: doc.garment.parameters.map((one) => one.value), joints: false, names: false, fixed: true,
};
const times = []; // of the last predictions, milliseconds
const past = new Map(); // states of earlier frames that nobody has changed
let mesh, renderer, strip, garment;
const REST = { frame: -1, state: null, clean: true };
let now = REST; // of the network; clean: nothing was changed by hand since rest
let shown = { frame: -1 }; // what the graphics card holds
let asked = false, last = 0, clock = 0, settling = 0, waiting = [];

const range = () => [doc.clips[state.clip].start, doc.clips[state.clip].stop];
const usual = () => doc.garment.parameters.every(({ value }, k) => value === state.parameters[k]);
// The truth is of the pose and the parameters that were simulated.
const comparable = () => doc.clips[state.clip].truth && !state.turns.size && usual();
const needsInput = () => comparable() && (state.view !== "result" || state.color === "error");
const headerHeight = () => $("stage").querySelector("header").offsetHeight + 14;
const CLAY = [...linearColor("#d6d1c9"), 1];

function set(changes) {
  const before = { ...state };
  Object.assign(state, changes, { vertex: -1 });
  if (state.bone >= doc.bones) state.bone = -1; // virtual bones are predicted
  if (state.clip !== before.clip) state.frame = range()[0];
  doc.error = doc.clips[state.clip].truth ? errors : null;
  if (changes.turns || changes.parameters) {
    garment.setParameters(state.parameters);
    past.clear();
    now = { ...now, clean: false };
    settling = SETTLES;
  }
  if (!comparable()) Object.assign(state, { view: "result", color: "texture" });
  if (state.frame !== before.frame || state.playing) settling = 0;
  if (state.frame !== before.frame && !now.clean) now = REST;
  if (state.playing !== before.playing) last = clock = 0;
  if (camera.fitted && state.clip !== before.clip) face();
  if (camera.fitted && (state.clip !== before.clip || state.view !== before.view)) fit();
  sync();
  ask();
}

function sync() {
  for (const radio of document.querySelectorAll("[type=radio]")) radio.checked = state[radio.name] === radio.value;
  for (const id of ["joints", "names"]) $(id).checked = state[id];
  for (const id of ["clip", "speed"]) $(id).value = state[id];
  for (const one of document.querySelectorAll("[data-truth]")) one.hidden = !doc.clips[state.clip].truth;
  for (const one of document.querySelectorAll("[data-truth] input")) one.disabled = !comparable();
  $("play").classList.toggle("playing", state.playing);
  $("play").setAttribute("aria-label", state.playing ? "Pause" : "Play");
  $("posed").hidden = !state.turns.size;
  $("view").setAttribute("aria-label", `${doc.title.slice(0, 100)}, ${doc.clips[state.clip].name.slice(0, 100)}`);
  $("joint").value = state.bone;
  $("turn-sliders").hidden = state.bone < 0;
  showTurn(state);
  document.querySelectorAll("#parameters label").forEach((row, k) => {
    row.querySelector("input").value = state.parameters[k];
    row.querySelector("output").textContent = state.parameters[k].toFixed(2);
  });
  showLegend(state, doc.error?.top);
  const [start, stop] = range();
  strip.box.classList.toggle("low", !doc.error);
  $("frame").max = stop - start - 1;
  $("of").textContent = `of ${stop - start - 1}`;
  showFrame();
}

function showFrame() {
  strip.set(state.frame, range());
  if (document.activeElement !== $("frame")) $("frame").value = numberOf(state.frame);
  $("now").textContent = errorText(state.frame).slice(2);
  $("now").classList.toggle("stale", !comparable());
}

const figure = () => pose(mesh, state.frame, state.turns);

function predict(before, joints) {
  const began = performance.now();
  const after = garment.advance(before, joints);
  if (times.push(performance.now() - began) > 300) times.shift();
  return after;
}

// The network's state of the frame: on from the shown one, from one that was kept, or from rest.
function stateOf(frame) {
  const [start] = range();
  let from = frame;
  while (from >= start && from !== now.frame && !past.has(from)) from--;
  const kept = from < start ? null : past.get(from);
  if (from !== now.frame || from < start) now = { frame: from, state: kept, clean: true };
  while (now.frame < frame) {
    const t = now.frame + 1;
    now = { ...now, frame: t, state: predict(now.state, pose(mesh, t, state.turns)) };
    if (now.clean && t % KEPT === 0) past.set(t, now.state);
  }
  return now.state;
}

// Skins the frame of the state.  While what belongs to it is being unpacked, what was shown stays.
function skin() {
  const off = needsInput() ? input.at(state.frame) : null;
  const pushing = pushes && !state.turns.size && usual() && now.clean;
  const moved = pushing ? pushes.at(state.frame) : null;
  if ((needsInput() && !off) || (pushing && !moved)) {
    Promise.all([off || !needsInput() || input.wait(state.frame), moved || !pushing || pushes.wait(state.frame)]).then(ask);
    return false;
  }
  const predicted = stateOf(state.frame), { turns } = state;
  if (shown.predicted === predicted && shown.turns === turns && shown.off === !!off && shown.moved === !!moved) return true;
  const joints = figure(), began = performance.now();
  const matrices = garment.shown(predicted, joints);
  if (shown.predicted !== predicted) times[times.length - 1] += performance.now() - began;
  renderer.setFrame(matrices, off, garment.detail, moved, doc.pushed?.step);
  shown = { frame: state.frame, matrices, predicted, turns, off: !!off, moved: !!moved };
  return true;
}

function ports() {
  const { clientWidth: w, clientHeight: h } = $("view");
  const both = state.view === "side" && comparable();
  if (!both) return [{ port: [0, 0, w, h], which: comparable() && state.view === "input" ? 1 : 0 }];
  return [{ port: [0, 0, w / 2, h], which: 1 }, { port: [w / 2, 0, w / 2, h], which: 0 }];
}

const shift = () => [...mesh.path.subarray(3 * state.frame, 3 * state.frame + 3)];
const projectorOf = (port) => projector(camera.view(shift()), camera.projection(port[2] / port[3]), port);
const points = () => skinned(mesh, shown.matrices);
const vertexAt = (v) => points().subarray(3 * v, 3 * v + 3);

function fit() {
  const [, , width, height] = ports()[0].port;
  camera.fit(doc.clips[state.clip].room.flat(), width, height, headerHeight() + 8);
  ask();
}

// The camera goes before the body.
function face() {
  const m = figure();
  camera.azimuth = Math.atan2(m[2], m[10]) + 0.44;
}

function ask() {
  if (!asked) requestAnimationFrame(tick);
  asked = true;
}

// Time passes while the motion plays, and for a moment after a pose or a parameter was changed.
function tick(time) {
  asked = false;
  const elapsed = last ? Math.min(0.1, (time - last) / 1000) : 0; // a tab in the background stands still
  last = time;
  const { fps } = doc.garment;
  clock += elapsed * fps * (state.playing ? state.speed : 1);
  const steps = Math.floor(clock);
  clock -= steps;
  if (state.playing && steps) {
    const [start, stop] = range();
    const next = start + ((state.frame - start + steps) % (stop - start));
    if (!needsInput() || input.at(next)) state.frame = next;
    showFrame();
  } else if (settling > 0) {
    for (let k = 0; k < steps; k++) now = { ...now, state: predict(now.state, figure()) };
    settling -= elapsed;
  }
  draw();
  if (state.playing || settling > 0) ask();
  else last = clock = 0;
}

function draw() {
  if (renderer.gl.isContextLost()) return;
  const ready = skin();
  const { clientWidth: width, clientHeight: height } = $("view");
  if (shown.frame < 0 || !width || !height) return;
  const dense = Math.min(2, devicePixelRatio || 1);
  const pixels = ([x, y, w, h]) => [x, height - y - h, w, h].map((v) => Math.round(v * dense));
  renderer.begin(Math.round(width * dense), Math.round(height * dense));
  const over = $("over");
  Object.assign(over, { width: Math.round(width * dense), height: Math.round(height * dense) });
  const pen = over.getContext("2d");
  pen.scale(dense, dense);
  const parts = ports(), tags = [$("tag-left"), $("tag-right")];
  parts.forEach(({ port, which }, k) => {
    renderer.show(which, {
      port: pixels(port), view: camera.view(shift()), projection: camera.projection(port[2] / port[3]),
      heat: heatColors().flat(), top: (errors?.top || 1) / 1000, color: CLAY,
      mode: state.color === "error" && !which ? 3 : 1,
    });
    if (!which) drawOver(pen, projectorOf(port), port, port, { matrices: shown.matrices, state, vertexAt });
    tags[k].textContent = which ? "Simulation" : "Prediction";
    tags[k].style.left = `${port[0] + port[2] / 2}px`;
    tags[k].style.top = `${headerHeight()}px`;
  });
  tags.forEach((tag) => (tag.hidden = parts.length < 2));
  const sum = times.slice(-30);
  if (sum.length) $("ms").textContent = `prediction ${(sum.reduce((a, b) => a + b) / sum.length).toFixed(1)} ms a frame`;
  if (!ready) return;
  const done = waiting;
  waiting = [];
  done.forEach((resolve) => resolve());
}

// Frames are counted over all motions.
function seek(frame) {
  const [start, stop] = range();
  set({ playing: false, frame: Math.max(start, Math.min(stop - 1, Math.round(frame))) });
  return new Promise((resolve) => {
    waiting.push(resolve);
    ask();
  });
}

function slider(label, low, high, changed) {
  const row = element("label", label);
  const one = element("input", "", { type: "range", min: low, max: high, step: "any" });
  one.addEventListener("input", () => changed(Number(one.value)));
  row.append(one, element("output"));
  return row;
}

function bind() {
  $("summary").textContent = doc.summary;
  $("summary").after(element("p", "", { id: "ms" }));
  $("clip-row").firstChild.textContent = "Motion ";
  $("chip").remove();
  for (const note of doc.notes) $("notes").append(element("p", note));
  doc.clips.forEach((clip, k) => $("clip").append(new Option(clip.name.slice(0, 200), k)));
  $("joint").append(new Option("none", -1), ...doc.rig.names.map((name, k) => new Option(name.slice(0, 200), k)));
  $("parameters").hidden = !doc.garment.parameters.length;
  doc.garment.parameters.forEach(({ name, low, high }, k) => {
    const changed = (value) => set({ parameters: state.parameters.with(k, value) });
    $("parameters").append(slider(name.replace("_", " "), low, high, changed));
  });
  const angles = () => [...document.querySelectorAll("#turn-sliders input")].map((one) => Number(one.value));
  for (const axis of "xyz") $("turn-sliders").append(slider(axis, -180, 180, () => turn(state.bone, turnOf(angles()))));
  for (const radio of document.querySelectorAll("[type=radio]")) {
    radio.addEventListener("change", () => set({ [radio.name]: radio.value }));
  }
  for (const id of ["joints", "names"]) $(id).addEventListener("change", () => set({ [id]: $(id).checked }));
  for (const id of ["clip", "speed"]) $(id).addEventListener("change", () => set({ [id]: Number($(id).value) }));
  $("joint").addEventListener("change", () => set({ bone: Number($("joint").value) }));
  strip = new Strip($("strip"), { seek, step });
  gestures($("view"), camera, { grab, click, changed: ask });
  addEventListener("keydown", keys);
  $("play").addEventListener("click", () => set({ playing: !state.playing }));
  $("back").addEventListener("click", () => step(-1));
  $("forth").addEventListener("click", () => step(1));
  $("fit").addEventListener("click", fit);
  $("unpose").addEventListener("click", () => set({ turns: new Map() }));
  $("frame").addEventListener("change", () => seek(range()[0] + (Number($("frame").value) || 0)));
  foldPanel();
  const resized = () => {
    strip.draw();
    if (camera.fitted) fit();
    ask();
  };
  new ResizeObserver(resized).observe($("view"));
  dark.addEventListener("change", () => {
    sync();
    ask();
  });
}

async function start() {
  if (!globalThis.DecompressionStream || ![].with) throw new Error("old");
  [mesh, garment] = await Promise.all([loaded(), Garment.load(doc.garment)]);
  mesh.bones = doc.bones + doc.virtual;
  garment.setParameters(state.parameters);
  beginAndAgain($("view"), () => {
    renderer = new Dress($("view"), mesh);
    shown = { frame: -1 };
  });
  bind();
  face();
  fit();
  $("message").textContent = "";
  await seek(0);
  set({ playing: !matchMedia("(prefers-reduced-motion: reduce)").matches });
}

const ready = start().catch(failed);

// For tests and the curious.
window.garmentnet = {
  ready, state, set, seek, camera, times, read: (which) => renderer.read(which), settled: () => settling <= 0,
  place: (bone) => projectorOf(ports().at(-1).port)(moved(shown.matrices, bone, doc.rig.heads[bone])),
};
