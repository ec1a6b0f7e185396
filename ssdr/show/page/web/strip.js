// The error over time, which is also the handle of time.

class Strip {
  constructor(box, { seek, step }) {
    this.box = box;
    this.canvas = box.querySelector("canvas");
    this.hover = -1;
    if (!doc.error) box.classList.add("low");
    const frameAt = (event) => {
      const { left, width } = box.getBoundingClientRect();
      const [start, stop] = this.range;
      const at = (event.clientX - left - 6) / (width - 12);
      return Math.max(start, Math.min(stop - 1, start + Math.round(at * (stop - 1 - start))));
    };
    box.addEventListener("pointerdown", (event) => {
      box.setPointerCapture(event.pointerId);
      seek(frameAt(event));
    });
    box.addEventListener("pointermove", (event) => {
      this.hover = frameAt(event);
      if (box.hasPointerCapture(event.pointerId)) seek(this.hover);
      this.draw();
    });
    box.addEventListener("pointerleave", () => {
      this.hover = -1;
      this.draw();
    });
    box.addEventListener("keydown", (event) => {
      const by = { ArrowUp: 1, ArrowDown: -1, PageUp: 10, PageDown: -10 }[event.key];
      if (!by) return;
      event.preventDefault();
      step(by);
    });
    this.range = [0, doc.frames];
    this.frame = 0;
  }

  set(frame, range) {
    this.frame = frame;
    this.range = range;
    const [start, stop] = range;
    const text = `frame ${numberOf(frame)}${errorText(frame)}`;
    for (const [name, value] of [["min", numberOf(start)], ["max", numberOf(stop - 1)], ["now", numberOf(frame)], ["text", text]]) {
      this.box.setAttribute(`aria-value${name}`, value);
    }
    this.draw();
  }

  draw() {
    const { canvas } = this;
    const dense = Math.min(2, devicePixelRatio || 1);
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (canvas.width !== Math.round(width * dense)) canvas.width = Math.round(width * dense);
    if (canvas.height !== Math.round(height * dense)) canvas.height = Math.round(height * dense);
    const pen = canvas.getContext("2d");
    pen.setTransform(dense, 0, 0, dense, 0, 0);
    pen.clearRect(0, 0, width, height);
    const [start, stop] = this.range;
    const x = (t) => 6 + ((t - start) / Math.max(1, stop - 1 - start)) * (width - 12);
    const floor = height - 3;
    pen.fillStyle = css("--line");
    pen.fillRect(6, floor, width - 12, 1);
    pen.font = "11px system-ui, sans-serif";
    for (const clip of doc.clips.length > 1 ? doc.clips : []) {
      if (clip.start < start || clip.stop > stop) continue;
      pen.fillStyle = css("--line");
      if (clip.start > start) pen.fillRect(x(clip.start - 0.5), 0, 1, height);
      pen.fillStyle = css("--quiet");
      const room = ((clip.stop - clip.start) / (stop - start)) * width - 8;
      pen.fillText(clip.name.slice(0, Math.max(0, Math.floor(room / 6))), x(clip.start) + 4, 10);
    }
    if (doc.error) {
      const { mean, largest } = doc.error;
      let worst = start;
      for (let t = start; t < stop; t++) if (largest[t] > largest[worst]) worst = t;
      const y = (value) => floor - (value / (largest[worst] || 1)) * (floor - 8);
      const path = (values) => {
        pen.beginPath();
        for (let t = start; t < stop; t++) pen.lineTo(x(t), y(values[t]));
        if (stop - start === 1) pen.lineTo(width - 6, y(values[start]));
      };
      path(mean);
      pen.lineTo(stop - start === 1 ? width - 6 : x(stop - 1), floor);
      pen.lineTo(6, floor);
      pen.globalAlpha = 0.35;
      pen.fillStyle = css("--mean");
      pen.fill();
      pen.globalAlpha = 1;
      for (const [values, color] of [[mean, "--mean"], [largest, "--most"]]) {
        path(values);
        pen.strokeStyle = css(color);
        pen.lineWidth = 1.5;
        pen.stroke();
      }
      dotAt(pen, [x(worst), y(largest[worst])], 3.5, css("--most"), css("--paper"), 1.5);
      const most = `largest error ${withShare(largest[worst])}`;
      const wide = pen.measureText(most).width, right = x(worst) + 8 + wide < width - 6;
      label(pen, most, right ? x(worst) + 8 : Math.max(6, x(worst) - 8 - wide), 12, css("--most"));
      label(pen, "mean error", width - 66, floor - 6, css("--mean"));
    }
    pen.fillStyle = css("--ink");
    pen.fillRect(x(this.frame) - 1, 0, 2, height);
    if (this.hover >= start && this.hover < stop) {
      pen.globalAlpha = 0.35;
      pen.fillRect(x(this.hover) - 0.5, 0, 1, height);
      pen.globalAlpha = 1;
      const text = `${numberOf(this.hover)}${errorText(this.hover)}`;
      const wide = pen.measureText(text).width;
      label(pen, text, Math.max(6, Math.min(width - wide - 6, x(this.hover) + 6)), floor - 6);
    }
  }
}

// The errors of a frame in words; empty if the page has none.
function errorText(frame) {
  if (!doc.error) return "";
  return `: mean error ${brief(doc.error.mean[frame])}, largest ${withShare(doc.error.largest[frame])}`;
}
