// The panel beside the picture and the controls below it.

const element = (name, text = "", options = {}) => Object.assign(document.createElement(name), { textContent: text }, options);

function boneButton(bone, much, choose) {
  const button = element("button", "", { type: "button", title: doc.rig.names[bone].slice(0, 300) });
  const swatch = element("span", "", { className: "swatch" });
  swatch.style.background = rgb(doc.rig.colors[bone]);
  const name = element("span", doc.rig.names[bone].slice(0, 300), { className: "name" });
  button.append(swatch, name, element("span", much, { className: "much" }));
  button.dataset.bone = bone;
  button.addEventListener("click", () => choose(bone));
  return button;
}

const expressionRanges = () => [...$("expression-sliders").querySelectorAll("input")];

function expressionWeights() {
  return expressionRanges().map((range) => {
    range.nextSibling.textContent = range.value;
    return range.value / 100;
  });
}

function resetExpressions() {
  for (const range of expressionRanges()) range.value = 0;
  expressionWeights();
}

const percent = (part) => (part < 0.001 ? "< 0.1 %" : `${(100 * part).toFixed(1)} %`);

const CHECKS = ["joints", "names", "worst", "follow", "fixed", "surface"];

// Fills what does not change, and binds every control to `set`, which changes the state.
function buildPanel(set, choose, showWorst) {
  const { rig } = doc;
  $("summary").textContent = doc.summary;
  for (const [name, value, note] of doc.figures) {
    const remark = element("dd", note, { className: "note" });
    if (name === "Largest error" && doc.input) {
      const button = element("button", "Show it", { type: "button" });
      button.addEventListener("click", () => {
        if (narrow.matches) showPanel(false);
        showWorst();
      });
      remark.append(" ", button);
    }
    $("figures").append(element("dt", name), element("dd", value), remark);
  }
  for (const note of doc.notes) $("notes").append(element("p", note));
  for (const one of document.querySelectorAll("[data-needs]")) one.hidden = !one.dataset.needs.split(" ").every((name) => doc[name]);
  $("colors").hidden = !rig && !doc.looks;
  $("extras").hidden = !rig && !doc.follow;
  for (const radio of document.querySelectorAll("[type=radio]")) {
    radio.addEventListener("change", () => set({ [radio.name]: radio.value }));
  }
  for (const id of CHECKS) {
    $(id).addEventListener("change", () => set({ [id]: $(id).checked }));
  }
  for (const [k, name] of (doc.expressions || []).entries()) {
    const range = element("input", "", { type: "range", max: 100, value: 0 });
    range.setAttribute("aria-label", `Weight of ${name}`);
    range.addEventListener("input", () => set({ weights: expressionWeights() }));
    const label = element("label");
    label.append(element("span", name.slice(0, 300), { title: name.slice(0, 300) }), range, element("output", "0"));
    $("expression-sliders").append(label);
  }
  if (rig) {
    $("joints-word").textContent = rig.parents ? "Skeleton" : "Axes of bones";
    $("bones-title").firstChild.textContent = `${doc.bones} bones`;
    $("search").hidden = doc.bones < 12;
    const rows = (rig.parents ? treeOrder() : [...rig.names.keys()]).map((b) => {
      const button = boneButton(b, percent(rig.share[b]), (bone) => choose(bone, true));
      if (rig.parents) button.style.paddingLeft = `${6 + 8 * Math.min(rig.depth[b], 10)}px`;
      const row = element("li");
      row.append(button);
      return row;
    });
    $("bone-list").append(...rows);
    $("search").addEventListener("input", () => {
      const wanted = $("search").value.toLowerCase();
      for (const row of rows) row.hidden = !row.textContent.toLowerCase().includes(wanted);
    });
  }
  const several = doc.clips.length > 1;
  $("clip-row").hidden = !several;
  if (several) {
    $("clip").append(new Option("all clips", -1));
    doc.clips.forEach((clip, k) => $("clip").append(new Option(clip.name.slice(0, 200), k)));
  }
  $("clip").addEventListener("change", () => set({ clip: Number($("clip").value) }));
  $("speed").addEventListener("change", () => set({ speed: Number($("speed").value) }));
  foldPanel();
}

// The panel beside the picture, hidden at first where the screen is narrow.
const narrow = matchMedia("(max-width: 560px)");
function showPanel(shown) {
  document.body.classList.toggle("bare", !shown);
  $("panel-button").setAttribute("aria-expanded", shown);
  $("panel-button").textContent = shown ? "Hide panel" : "Show panel";
}
function foldPanel() {
  $("panel-button").addEventListener("click", () => showPanel(document.body.classList.contains("bare")));
  $("close").addEventListener("click", () => showPanel(false));
  narrow.addEventListener("change", () => showPanel(!narrow.matches));
  showPanel(!narrow.matches);
}

function treeOrder() {
  const { parents } = doc.rig;
  const below = (a) => [...parents.keys()].filter((b) => parents[b] === a).flatMap((b) => [b, ...below(b)]);
  return below(-1);
}

// Brings the controls to the state.
function showState(state, mesh, top) {
  for (const radio of document.querySelectorAll("[type=radio]")) radio.checked = state[radio.name] === radio.value;
  for (const id of CHECKS) $(id).checked = state[id];
  $("error-rows").hidden = state.color !== "error";
  $("clip").value = state.clip;
  $("speed").value = state.speed;
  $("play").classList.toggle("playing", state.playing);
  $("play").setAttribute("aria-label", state.playing ? "Pause" : "Play");
  $("posed").hidden = !state.turns.size;
  $("posed").firstChild.textContent = turned().size ? "Posed by hand " : "Pose kept for Result ";
  $("divider").hidden = state.view !== "slider";
  const ofInput = state.view === "input" || state.view === "overlay" ? `, ${state.view}` : "";
  $("view").setAttribute("aria-label", `${doc.title.slice(0, 100)}, ${doc.vertices} vertices${ofInput}`);
  showLegend(state, top);
  if (doc.rig) showSelected(state, mesh);
}

function showLegend(state, top) {
  const normals = state.color === "normals";
  const scaled = normals || state.color === "error" || (state.color === "weight" && state.bone >= 0);
  $("legend").hidden = !scaled;
  if (!scaled) return;
  const error = state.color === "error";
  $("legend-title").textContent =
    normals ? `Angle of normals to the input's${doc.rig ? (state.surface ? ", of the surface" : ", as engines draw them") : ""}`
    : error ? `Error, ${state.fixed ? "the same scale in every frame" : "its own scale in every frame"}`
    : `Weight of ${shortName(state.bone)}`;
  const colors = heatColors().map((color) => rgb(color.map((v) => Math.round(255 * v))));
  $("legend-bar").style.background = `linear-gradient(90deg, ${colors})`;
  const cut = error && state.fixed && doc.error.max > top;
  const inDegrees = (value) => `${digits(value, 2)}°`;
  const most = normals ? `Mean${state.surface ? " as engines draw them" : ""}: ${inDegrees(doc.angles.mean)}` : error && `Largest ${state.fixed ? "of all" : "in this frame"}: ${withShare(state.fixed ? doc.error.max : top)}`;
  $("legend-most").textContent = most || "";
  const words =
    normals ? ["0°", inDegrees(doc.angles.top / 2), `≥ ${inDegrees(doc.angles.top)}`]
    : error ? ["0", brief(top / 2), (cut ? "≥ " : "") + brief(top)]
    : ["0", "0.5", "1"];
  [...$("legend-ticks").children].forEach((tick, k) => (tick.textContent = words[k]));
}

// Pale to dark on a light ground, dark to pale on a dark one: much stands out.
const heatColors = () => doc.heat[dark.matches ? 1 : 0];

function showSelected(state, mesh) {
  const { vertex, bone } = state;
  $("vertex-text").classList.toggle("found", bone >= 0);
  $("vertex-text").textContent =
    vertex >= 0 ? `Vertex ${vertex}, circled, is moved by`
    : bone >= 0 ? `${shortName(bone)} carries ${percent(doc.rig.share[bone])} of the mesh`
    : "Click the mesh to see which bones move a vertex.";
  const found = [];
  for (let k = vertex * mesh.influences; vertex >= 0 && k < (vertex + 1) * mesh.influences; k++) {
    if (mesh.weights[k] > 0) found.push([mesh.indices[k], percent(mesh.weights[k])]);
  }
  const words = found.slice(0, 2).map(([b, much]) => `${shortName(b)} ${much}`).join(", ");
  $("chip").textContent = words || (bone >= 0 ? $("vertex-text").textContent : "Tap the mesh to see its bones");
  const choose = (b) => window.ssdr.set({ bone: b });
  $("influences").replaceChildren(...found.map(([b, much]) => boneButton(b, much, choose)));
  for (const button of document.querySelectorAll("[data-bone]")) {
    button.setAttribute("aria-pressed", Number(button.dataset.bone) === bone);
  }
  $("turn").hidden = bone < 0 || !doc.rig.parents;
  $("turn-sliders").hidden = !doc.rig.rigid;
  $("turn-text").textContent = doc.rig.rigid
    ? `Turn ${bone < 0 ? "" : shortName(bone)}: drag in its ring, whose rim is a dial, or`
    : "Its joints come apart, so they cannot be turned by hand.";
  showTurn(state);
}

function showTurn({ bone, turns }) {
  const angles = bone < 0 ? [0, 0, 0] : anglesOf(turns.get(bone) || IDENTITY);
  document.querySelectorAll("#turn-sliders label").forEach((row, k) => {
    row.querySelector("input").value = angles[k];
    row.querySelector("output").textContent = `${Math.round(angles[k])}°`;
  });
}

// A turn as degrees about x, then y, then z, and back.
const degrees = 180 / Math.PI;
const anglesOf = (m) =>
  [Math.atan2(m[9], m[10]), Math.asin(Math.max(-1, Math.min(1, -m[8]))), Math.atan2(m[4], m[0])].map((a) => a * degrees);
const turnOf = ([x, y, z]) =>
  after(rotation([0, 0, 1], z / degrees), after(rotation([0, 1, 0], y / degrees), rotation([1, 0, 0], x / degrees)));

// The page cannot be shown.
function failed(error) {
  const words = {
    old: "This browser is too old for the page: it needs one of 2023 or later.",
    "no WebGL2": "This page draws with WebGL 2, which this browser does not have or has switched off.",
  };
  $("message").textContent = words[error.message] || `The page cannot be shown: ${error.message}`;
  throw error;
}
