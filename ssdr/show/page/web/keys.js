// What keys, clicks and drags do.

// Letters and digits press the control that names them as its shortcut.
function keys(event) {
  const { key, target } = event;
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (target.matches("input:not([type=radio]):not([type=checkbox]), select, textarea")) return;
  if (key === " " && target.matches("button, summary, [type=checkbox], [type=radio]")) return;
  if (key.startsWith("Arrow") && target.matches("[type=radio]")) return;
  const [start, stop] = range();
  const turns = { a: [-15, 0], d: [15, 0], q: [0, 15], z: [0, -15] };
  const low = key.toLowerCase();
  const control = /^[a-z1-9]$/.test(low) && document.querySelector(`[aria-keyshortcuts="${low}"]`);
  if (control) { if (!control.closest("[hidden]")) control.click(); }
  else if (key === " ") set({ playing: !state.playing });
  else if (key === "ArrowLeft" || key === "ArrowRight") step((key === "ArrowLeft" ? -1 : 1) * (event.shiftKey ? 10 : 1));
  else if (key === "Home") set({ playing: false, frame: start });
  else if (key === "End") set({ playing: false, frame: stop - 1 });
  else if (key === "+" || key === "=" || key === "-") { camera.zoom(key === "-" ? 1.15 : 1 / 1.15); ask(); }
  else if (turns[low]) { camera.turn(...turns[low]); ask(); }
  else if (key === "Escape") rest();
  else return;
  event.preventDefault();
}

function step(by) {
  const [start, stop] = range();
  set({ playing: false, frame: start + ((state.frame - start + by + 10 * (stop - start)) % (stop - start)) });
}

// Back to the animation; what is selected is so no longer.
function rest() {
  if (state.turns.size) set({ turns: new Map() });
  else set({ bone: -1, vertex: -1, ...(state.color === "weight" ? { color: "bones" } : {}) });
}

const portAt = ([x, y]) =>
  ports().find(({ port, clip = port }) => x >= clip[0] && x < clip[0] + clip[2] && y >= clip[1] && y < clip[1] + clip[3]);

function divide(share) {
  $("divider").value = 1000 * share;
  set({ divider: Math.max(0, Math.min(1, share)) });
}

// What a drag moves there: the divider, or the selected joint of a rigid tree, in its ring.
function grab([x, y]) {
  const { clientWidth: width } = $("view");
  if (state.view === "slider" && Math.abs(x - width * state.divider) < 10) {
    return (dx) => divide(state.divider + dx / width);
  }
  const found = doc.rig?.rigid && state.bone >= 0 && shown.frame >= 0 && portAt([x, y]);
  if (!found || found.which) return null;
  const { bone } = state;
  const head = projectorOf(found.port)(moved(shown.matrices, bone, doc.rig.heads[bone]));
  const from = [x - head[0], y - head[1]];
  if (Math.hypot(...from) > RING + 4) return null;
  const onRim = Math.hypot(...from) > RING - 8;
  return (dx, dy) => {
    const [right, up, back] = camera.axes();
    let axis = plus(plus([0, 0, 0], up, dx), right, dy), angle = 0.012 * Math.hypot(dx, dy);
    if (onRim) {
      // as a dial: by the angle that the pointer goes round the joint
      const was = Math.atan2(from[1], from[0]);
      from[0] += dx;
      from[1] += dy;
      [axis, angle] = [back, was - Math.atan2(from[1], from[0])];
    }
    const m = shown.matrices.subarray(12 * bone, 12 * bone + 12);
    const own = [0, 1, 2].map((c) => m[c] * axis[0] + m[4 + c] * axis[1] + m[8 + c] * axis[2]);
    turn(bone, after(state.turns.get(bone) || IDENTITY, rotation(own, angle)));
    skin();
  };
}

function turn(bone, matrix) {
  set({ turns: new Map(state.turns).set(bone, matrix) });
}

function click(place) {
  const found = portAt(place);
  if (!found || !doc.rig || shown.frame < 0) return;
  const project = projectorOf(found.port);
  if (state.joints && !found.which) {
    const bone = boneAt(limbs(shown.matrices, project), place);
    if (bone >= 0) return choose(bone, false);
  }
  const vertex = vertexSeen(points(found.which), mesh, project, place);
  set({ vertex, bone: vertex < 0 ? -1 : mesh.indices[vertex * mesh.influences], ...(vertex < 0 && state.color === "weight" ? { color: "bones" } : {}) });
}

function choose(bone, listed) {
  set({ bone, vertex: -1, ...(listed && !state.turns.size ? { color: "weight" } : {}) });
}
