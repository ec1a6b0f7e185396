// A camera that turns about a target, and the gestures that move it.

const VIEW_ANGLE = (30 * Math.PI) / 180;

const FOOT = 36; // pixels below the mesh

class Camera {
  constructor() {
    this.azimuth = 0.44;
    this.elevation = 0.2;
    this.target = [0, 0, 0];
    this.distance = 2;
    this.fitted = true; // nobody has moved it since
  }

  // Right, up and back as seen on the screen, in the mesh's coordinate system.
  axes() {
    const { azimuth, elevation } = this;
    const back = [
      Math.sin(azimuth) * Math.cos(elevation), Math.sin(elevation), Math.cos(azimuth) * Math.cos(elevation),
    ];
    const right = [Math.cos(azimuth), 0, -Math.sin(azimuth)];
    const { basis } = doc;
    const turned = (v) => [0, 1, 2].map((c) => v[0] * basis[c] + v[1] * basis[3 + c] + v[2] * basis[6 + c]);
    return [right, cross(back, right), back].map(turned);
  }

  view(shift) {
    const target = plus(this.target, shift);
    const rows = this.axes();
    const out = new Float32Array(16);
    rows.forEach((row, r) => {
      for (let c = 0; c < 3; c++) out[4 * c + r] = row[c];
      out[12 + r] = -dot(row, target) - (r === 2 ? this.distance : 0);
    });
    out[15] = 1;
    return out;
  }

  projection(aspect) {
    const f = 1 / Math.tan(VIEW_ANGLE / 2);
    const near = Math.max(this.distance - 4, this.distance * 0.02), far = this.distance + 8;
    const out = new Float32Array(16);
    out[0] = f / aspect;
    out[5] = f;
    out[10] = (far + near) / (near - far);
    out[11] = -1;
    out[14] = (2 * far * near) / (near - far);
    return out;
  }

  // Brings points (3 V) into view, as large as they fit below a heading.
  fit(points, width, height, heading) {
    const rows = this.axes();
    const f = 1 / Math.tan(VIEW_ANGLE / 2);
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    const each = (visit) => {
      for (let v = 0; v < points.length; v += 3) {
        rows.forEach((r, c) => visit(r[0] * points[v] + r[1] * points[v + 1] + r[2] * points[v + 2], c));
      }
    };
    each((x, c) => {
      low[c] = Math.min(low[c], x);
      high[c] = Math.max(high[c], x);
    });
    const middle = low.map((v, c) => (v + high[c]) / 2);
    const room = Math.max(0.5, 1 - (heading + FOOT) / height);
    const scale = [(1.1 * f * height) / Math.max(1, width), f / room];
    this.distance = 1e-3;
    let needed = 0; // by the point's x and y, then by its depth
    each((x, c) => {
      const off = x - middle[c];
      needed = c === 2 ? needed + off : Math.max(c && needed, scale[c] * Math.abs(off));
      if (c === 2) this.distance = Math.max(this.distance, needed);
    });
    this.target = [0, 1, 2].map((c) => rows.reduce((sum, row, r) => sum + row[c] * middle[r], 0));
    this.move(0, (heading - FOOT) / 2, height);
    this.fitted = true;
  }

  // Turns to a point from outside, and near it.
  look(point, normal) {
    const [x, y, z] = [0, 3, 6].map((r) => dot(doc.basis.slice(r, r + 3), unit(normal)));
    if (x || z) this.azimuth = Math.atan2(x, z);
    this.elevation = Math.max(-1.2, Math.min(1.2, Math.asin(y)));
    Object.assign(this, { target: point, distance: 0.9, fitted: false });
  }

  turn(dx, dy) {
    this.fitted = false;
    this.azimuth -= 0.008 * dx;
    this.elevation = Math.max(-1.55, Math.min(1.55, this.elevation + 0.008 * dy));
  }

  move(dx, dy, height) {
    this.fitted = false;
    const scale = (2 * this.distance * Math.tan(VIEW_ANGLE / 2)) / height;
    const [right, up] = this.axes();
    this.target = plus(plus(this.target, right, -dx * scale), up, dy * scale);
  }

  zoom(factor) {
    this.fitted = false;
    this.distance = Math.max(0.01, Math.min(50, this.distance * factor));
  }
}

// Mouse, pen and fingers on the canvas.  `grab(point)` returns a function of a drag (dx, dy) where
// something else than the camera is moved there; `click(point)` is a press without a drag.
function gestures(canvas, camera, { grab, click, changed }) {
  const fingers = new Map();
  let drag = null, travelled = 0;
  const at = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, at(event));
    travelled = fingers.size > 1 ? Infinity : 0;
    drag = fingers.size === 1 && !event.shiftKey && event.button === 0 ? grab(at(event)) : null;
  });
  canvas.addEventListener("pointermove", (event) => {
    const was = fingers.get(event.pointerId), is = at(event);
    if (!was) {
      canvas.classList.toggle("turning", !!grab(is, true));
      return;
    }
    const [dx, dy] = [is[0] - was[0], is[1] - was[1]];
    travelled += Math.abs(dx) + Math.abs(dy);
    const height = canvas.clientHeight;
    if (fingers.size === 2) {
      const [other] = [...fingers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
      const apart = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]) || 1;
      camera.zoom(apart(was) / apart(is));
      camera.move(dx / 2, dy / 2, height);
    } else if (drag) drag(dx, dy);
    else if (event.shiftKey || event.buttons & 6) camera.move(dx, dy, height);
    else camera.turn(dx, dy);
    fingers.set(event.pointerId, is);
    changed();
  });
  const end = (event) => {
    if (!fingers.delete(event.pointerId)) return;
    if (event.type === "pointerup" && travelled < 5 && event.button === 0) click(at(event));
    drag = null;
  };
  canvas.addEventListener("pointerup", end);
  canvas.addEventListener("pointercancel", end);
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const lines = event.deltaMode === 1 ? 30 : 1;
    camera.zoom(Math.exp(Math.max(-200, Math.min(200, event.deltaY * lines)) * 0.0015));
    changed();
  }, { passive: false });
}
