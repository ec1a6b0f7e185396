// Skins with detail: v = Σ w_i M_i p + T d, T the blended rotation made orthonormal.

const DRESS_VERTEX = `${SKIN_HEAD}
layout(location = 7) in vec3 detail;

vec3 over(vec3 v) { return v / max(length(v), 1e-8); }

void main() {
  mat4x3 blend = blended();
  vec3 x = over(blend[0]);
  vec3 y = over(blend[1] - dot(x, blend[1]) * x);
  put(blend * vec4(rest, 1) + mat3(x, y, cross(x, y)) * detail, blend);
}`;

class Dress extends Renderer {
  get skinVertex() { return DRESS_VERTEX; }

  prepareSkin() {
    super.prepareSkin();
    const { gl, mesh } = this;
    gl.bindVertexArray(this.skinArrays);
    this.detail = this.buffer(12 * mesh.map.length, gl.DYNAMIC_DRAW); // zeros: the body has none
    this.attribute(7, 3, gl.FLOAT);
    gl.bindVertexArray(null);
  }

  setFrame(matrices, off, detail) {
    const { gl } = this;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.detail);
    gl.bufferSubData(gl.ARRAY_BUFFER, 0, detail);
    gl.bindBuffer(gl.ARRAY_BUFFER, null);
    super.setFrame(matrices, off);
  }
}
