// WebGL2: skins the vertices of a frame once, and draws them as often as views need them.

class Renderer {
  get skinVertex() { return SKIN_VERTEX; }

  constructor(canvas, mesh) {
    const gl = canvas.getContext("webgl2", { antialias: true, alpha: true, premultipliedAlpha: true });
    if (!gl) throw new Error("no WebGL2");
    this.gl = gl;
    this.mesh = mesh;
    this.skin = this.program(this.skinVertex, SKIN_FRAGMENT, ["model", "truth", "turned"]);
    this.draw = this.program(DRAW_VERTEX, DRAW_FRAGMENT);
    this.rows = Math.ceil(mesh.map.length / WIDE);
    this.prepareSkin();
    this.prepareDraw();
    this.images = [];
  }

  program(vertex, fragment, outputs) {
    const { gl } = this;
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    if (outputs) gl.transformFeedbackVaryings(program, outputs, gl.SEPARATE_ATTRIBS);
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      const shaders = gl.getAttachedShaders(program).map((s) => gl.getShaderInfoLog(s));
      throw new Error([gl.getProgramInfoLog(program), ...shaders].join("\n"));
    }
    const places = {};
    for (let k = 0; k < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); k++) {
      const name = gl.getActiveUniform(program, k).name.replace("[0]", "");
      places[name] = gl.getUniformLocation(program, name);
    }
    return { program, at: places };
  }

  buffer(data, usage = this.gl.STATIC_DRAW, target = this.gl.ARRAY_BUFFER) {
    const buffer = this.gl.createBuffer();
    this.gl.bindBuffer(target, buffer);
    this.gl.bufferData(target, data, usage);
    return buffer;
  }

  attribute(place, size, type, stride = 0, offset = 0) {
    const { gl } = this;
    gl.enableVertexAttribArray(place);
    const whole = type === gl.UNSIGNED_INT;
    if (whole) gl.vertexAttribIPointer(place, size, type, stride, offset);
    else gl.vertexAttribPointer(place, size, type, type === gl.UNSIGNED_BYTE, stride, offset);
  }

  // A texture without filtering, from which shaders read numbers.
  table(format, width, height) {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, Math.max(height, 1));
    for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) {
      gl.texParameteri(gl.TEXTURE_2D, side, gl.NEAREST);
    }
    return texture;
  }

  // What the skinning needs for each vertex and copy; copies have normals of their own.
  prepareSkin() {
    const { gl, mesh } = this;
    const { influences, map } = mesh;
    this.skinArrays = gl.createVertexArray();
    gl.bindVertexArray(this.skinArrays);
    const copied = (values, size, wide) => {
      const out = new values.constructor(wide * map.length);
      map.forEach((v, n) => out.set(values.subarray(v * size, (v + 1) * size), wide * n));
      return out;
    };
    this.restOf = (rest) => copied(rest, 3, 3);
    this.rest = this.buffer(this.restOf(mesh.rest), doc.shapes ? gl.DYNAMIC_DRAW : gl.STATIC_DRAW);
    this.attribute(0, 3, gl.FLOAT);
    this.buffer(copied(mesh.indices, influences, 8));
    this.attribute(1, 4, gl.UNSIGNED_INT, 32, 0);
    this.attribute(2, 4, gl.UNSIGNED_INT, 32, 16);
    this.buffer(copied(mesh.weights, influences, 8));
    this.attribute(3, 4, gl.FLOAT, 32, 0);
    this.attribute(4, 4, gl.FLOAT, 32, 16);
    this.off = doc.input && this.buffer(6 * map.length, gl.DYNAMIC_DRAW); // copies have their vertex's
    if (this.off) this.attribute(5, 3, gl.SHORT, 6);
    if (mesh.normals) {
      this.buffer(mesh.normals);
      this.attribute(6, 3, gl.FLOAT);
    }
    gl.bindVertexArray(null);
    const boneRows = Math.ceil(mesh.bones / BONES_WIDE);
    this.boneData = new Float32Array(12 * BONES_WIDE * boneRows);
    this.transforms = this.table(gl.RGBA32F, 3 * BONES_WIDE, boneRows);
    this.feedback = gl.createTransformFeedback();
    const bytes = 16 * WIDE * this.rows;
    const target = gl.TRANSFORM_FEEDBACK_BUFFER;
    this.outputs = [0, 1, 2].map(() => this.buffer(bytes, gl.DYNAMIC_COPY, target));
    gl.bindBuffer(target, null);
    gl.bindTransformFeedback(gl.TRANSFORM_FEEDBACK, this.feedback);
    this.outputs.forEach((buffer, k) => gl.bindBufferBase(target, k, buffer));
    gl.bindTransformFeedback(gl.TRANSFORM_FEEDBACK, null);
    this.points = this.outputs.map(() => this.table(gl.RGBA32F, WIDE, this.rows));
  }

  // What the drawing needs: for each vertex and copy the other corners of its triangles, in a table.
  prepareDraw() {
    const { gl, mesh } = this;
    const { faces, map } = mesh;
    const group = mesh.groups || map;
    const size = group.reduce((most, g) => Math.max(most, g), 0) + 2;
    const start = new Uint32Array(size);
    for (const corner of faces) start[group[corner] + 1]++;
    for (let g = 1; g < size; g++) start[g] += start[g - 1];
    const fan = new Uint32Array(2 * map.length);
    for (let n = 0; n < map.length; n++) {
      fan[2 * n] = start[group[n]];
      fan[2 * n + 1] = start[group[n] + 1] - start[group[n]];
    }
    const ringRows = Math.max(1, Math.ceil(faces.length / WIDE));
    const ring = new Uint32Array(2 * WIDE * ringRows);
    for (let t = 0; t < faces.length; t += 3) {
      for (let c = 0; c < 3; c++) {
        const slot = 2 * start[group[faces[t + c]]]++;
        ring[slot] = map[faces[t + ((c + 1) % 3)]];
        ring[slot + 1] = map[faces[t + ((c + 2) % 3)]];
      }
    }
    this.ring = this.table(gl.RG32UI, WIDE, ringRows);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, WIDE, ringRows, gl.RG_INTEGER, gl.UNSIGNED_INT, ring);
    this.drawArrays = gl.createVertexArray();
    gl.bindVertexArray(this.drawArrays);
    this.buffer(map);
    this.attribute(0, 1, gl.UNSIGNED_INT);
    this.buffer(fan);
    this.attribute(1, 2, gl.UNSIGNED_INT);
    if (mesh.uv) {
      this.buffer(mesh.uv);
      this.attribute(2, 2, gl.FLOAT);
    }
    this.shades = this.buffer(4 * map.length, gl.DYNAMIC_DRAW);
    this.attribute(3, 4, gl.UNSIGNED_BYTE);
    this.buffer(faces, gl.STATIC_DRAW, gl.ELEMENT_ARRAY_BUFFER);
    gl.bindVertexArray(null);
  }

  // Textures of the materials; each part is drawn in its plain colour until its picture is there.
  async loadImages(changed) {
    const { gl } = this;
    for (const [k, { texture }] of doc.parts.entries()) {
      if (!texture) continue;
      try {
        const picture = await createImageBitmap(new Blob([blockBytes(texture.block)], { type: texture.type }));
        const image = gl.createTexture();
        gl.bindTexture(gl.TEXTURE_2D, image);
        gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, picture);
        gl.generateMipmap(gl.TEXTURE_2D);
        gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
        this.images[k] = image;
        changed();
      } catch (error) {
        console.warn("a texture cannot be shown", error);
      }
    }
  }

  // Colours (V, 3) of the vertices, 0 to 255.
  setShades(colors) {
    const { map } = this.mesh;
    const out = new Uint8Array(4 * map.length);
    map.forEach((v, n) => out.set(colors.subarray(3 * v, 3 * v + 3), 4 * n));
    this.gl.bindBuffer(this.gl.ARRAY_BUFFER, this.shades);
    this.gl.bufferSubData(this.gl.ARRAY_BUFFER, 0, out);
  }

  // Skins the vertices of a rest pose; `off` are the input's differences, if it is to be seen.
  setFrame(matrices, off, rest) {
    const { gl } = this;
    if (doc.shapes) {
      gl.bindBuffer(gl.ARRAY_BUFFER, this.rest);
      gl.bufferSubData(gl.ARRAY_BUFFER, 0, this.restOf(rest));
      gl.bindBuffer(gl.ARRAY_BUFFER, null);
    }
    this.boneData.set(matrices);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.transforms);
    const wide = 3 * BONES_WIDE;
    gl.texSubImage2D(
      gl.TEXTURE_2D, 0, 0, 0, wide, this.boneData.length / 4 / wide, gl.RGBA, gl.FLOAT, this.boneData,
    );
    if (off) {
      gl.bindBuffer(gl.ARRAY_BUFFER, this.off);
      gl.bufferSubData(gl.ARRAY_BUFFER, 0, off);
      gl.bindBuffer(gl.ARRAY_BUFFER, null);
    }
    gl.useProgram(this.skin.program);
    gl.uniform1i(this.skin.at.transforms, 0);
    gl.uniform1f(this.skin.at.unitOff, off ? doc.input.step : 0);
    gl.bindVertexArray(this.skinArrays);
    gl.enable(gl.RASTERIZER_DISCARD);
    gl.bindTransformFeedback(gl.TRANSFORM_FEEDBACK, this.feedback);
    gl.beginTransformFeedback(gl.POINTS);
    gl.drawArrays(gl.POINTS, 0, this.mesh.map.length);
    gl.endTransformFeedback();
    gl.bindTransformFeedback(gl.TRANSFORM_FEEDBACK, null);
    gl.disable(gl.RASTERIZER_DISCARD);
    gl.bindVertexArray(null);
    // From the buffers into textures, on the graphics card.
    this.outputs.forEach((buffer, k) => {
      gl.bindBuffer(gl.PIXEL_UNPACK_BUFFER, buffer);
      gl.bindTexture(gl.TEXTURE_2D, this.points[k]);
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, WIDE, this.rows, gl.RGBA, gl.FLOAT, 0);
    });
    gl.bindBuffer(gl.PIXEL_UNPACK_BUFFER, null);
  }

  // Vertices as the shader left them, four numbers each: of the model (0), of the input (1), or the
  // model's normals, turned (2).
  read(which) {
    const { gl } = this;
    const out = new Float32Array(4 * doc.vertices);
    gl.bindBuffer(gl.COPY_READ_BUFFER, this.outputs[which]);
    gl.getBufferSubData(gl.COPY_READ_BUFFER, 0, out);
    gl.bindBuffer(gl.COPY_READ_BUFFER, null);
    return out;
  }

  begin(width, height) {
    const { gl } = this;
    if (gl.canvas.width !== width) gl.canvas.width = width;
    if (gl.canvas.height !== height) gl.canvas.height = height;
    gl.disable(gl.SCISSOR_TEST);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.SCISSOR_TEST);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
  }

  // Draws the model (0) or the input (1) into `port` within `clip`, both [x, y, width, height].
  // An `engine` lights by rest normals, where there are any.
  show(which, { port, clip = port, view, projection, mode, color, heat, top, ghost = false, engine = true }) {
    const { gl, draw, mesh } = this;
    gl.viewport(...port);
    gl.scissor(...clip);
    gl.useProgram(draw.program);
    const [points, others, turned] = [this.points[which], this.points[1 - which], this.points[2]];
    Object.entries({ points, others, turned, ring: this.ring, image: null }).forEach(([name, texture], unitNumber) => {
      gl.activeTexture(gl.TEXTURE0 + unitNumber); // that of the image stays active
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.uniform1i(draw.at[name], unitNumber);
    });
    gl.uniform1i(draw.at.engine, engine && which === 0 && !!mesh.normals);
    gl.uniformMatrix4fv(draw.at.view, false, view);
    gl.uniformMatrix4fv(draw.at.projection, false, projection);
    gl.uniform3fv(draw.at.heat, heat);
    gl.uniform1f(draw.at.top, top);
    const cloud = !mesh.faces.length;
    gl.uniform1i(draw.at.cloud, cloud);
    gl.uniform1i(draw.at.outline, ghost);
    gl.uniform1f(draw.at.pointSize, (1.1 * port[3] * projection[5]) / Math.sqrt(doc.vertices) / 4);
    if (ghost) {
      gl.enable(gl.BLEND);
      gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
      gl.clear(gl.DEPTH_BUFFER_BIT); // before the other surface
    } else gl.disable(gl.BLEND);
    gl.bindVertexArray(this.drawArrays);
    // An outline's depth comes first: only the surface in front is seen through.
    for (const seen of ghost ? [false, true] : [true]) {
      gl.colorMask(seen, seen, seen, seen);
      for (const [k, part] of doc.parts.entries()) {
        const textured = mode === 1 && this.images[k];
        const own = mode === 1 && part.color ? [...part.color, 1] : color;
        gl.bindTexture(gl.TEXTURE_2D, this.images[k] || null);
        gl.uniform1i(draw.at.mode, mode === 1 && !textured ? 0 : mode);
        gl.uniform4fv(draw.at.color, own);
        gl.uniform1f(draw.at.behind, part.behind || 0);
        gl.drawElements(gl.TRIANGLES, part.count * 3, gl.UNSIGNED_INT, part.start * 12);
      }
    }
    if (cloud) {
      gl.uniform1i(draw.at.mode, mode === 1 ? 0 : mode);
      gl.uniform4fv(draw.at.color, color);
      gl.drawArrays(gl.POINTS, 0, doc.vertices);
    }
    gl.bindVertexArray(null);
  }
}

// Begins to draw, and again where the browser took the graphics card away and gave it back.
function beginAndAgain(canvas, begin) {
  begin();
  canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
  canvas.addEventListener("webglcontextrestored", () => {
    begin();
    ask();
  });
}
