// Skins with detail: v = Σ w_i M_i p + T d, T the blended rotation made orthonormal.

const DRESS_VERTEX = `${SKIN_HEAD}
layout(location = 7) in vec3 detail;
layout(location = 8) in vec3 pushed;

vec3 over(vec3 v) { return v / max(length(v), 1e-8); }

void main() {
  mat4x3 blend = blended();
  vec3 x = over(blend[0]);
  vec3 y = over(blend[1] - dot(x, blend[1]) * x);
  put(blend * vec4(rest, 1) + mat3(x, y, cross(x, y)) * detail + pushed, blend);
}`;

class Dress extends Renderer {
  get skinVertex() { return DRESS_VERTEX; }

  prepareSkin() {
    super.prepareSkin();
    const { gl, mesh } = this;
    gl.bindVertexArray(this.skinArrays);
    this.detail = this.buffer(12 * mesh.map.length, gl.DYNAMIC_DRAW); // zeros: the body has none
    this.attribute(7, 3, gl.FLOAT);
    this.pushed = this.buffer(12 * mesh.map.length, gl.DYNAMIC_DRAW);
    this.attribute(8, 3, gl.FLOAT);
    gl.bindVertexArray(null);
  }

  // `moved`: how far the cloth is pushed out of the body, in steps of so many metres; null: not.
  setFrame(matrices, off, detail, moved, step) {
    const { gl } = this;
    const pushed = new Float32Array(detail.length);
    if (moved) for (let k = 0; k < pushed.length; k++) pushed[k] = step * moved[k];
    gl.bindBuffer(gl.ARRAY_BUFFER, this.pushed);
    gl.bufferSubData(gl.ARRAY_BUFFER, 0, pushed);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.detail);
    gl.bufferSubData(gl.ARRAY_BUFFER, 0, detail);
    gl.bindBuffer(gl.ARRAY_BUFFER, null);
    super.setFrame(matrices, off);
  }
}
