// Skins with detail: v = Σ w_i M_i p + T d, T the blended rotation made orthonormal.

const DRESS_VERTEX = `${SKIN_HEAD}
layout(location = 6) in vec3 detail;

mat3x4 rows = mat3x4(0);

void add(uint bone, float weight) {
  if (weight == 0.0) return;
  ivec2 at = ivec2(3u * (bone % ${BONES_WIDE}u), bone / ${BONES_WIDE}u);
  for (int a = 0; a < 3; a++) rows[a] += weight * texelFetch(transforms, at + ivec2(a, 0), 0);
}

vec3 over(vec3 v) { return v / max(length(v), 1e-8); }

void main() {
  for (int k = 0; k < 4; k++) add(bonesA[k], weightsA[k]);
  for (int k = 0; k < 4; k++) add(bonesB[k], weightsB[k]);
  mat4x3 blend = transpose(rows);
  vec3 x = over(blend[0]);
  vec3 y = over(blend[1] - dot(x, blend[1]) * x);
  put(blend * vec4(rest, 1) + mat3(x, y, cross(x, y)) * detail);
}`;

class Dress extends Renderer {
  get skinVertex() { return DRESS_VERTEX; }

  prepareSkin() {
    super.prepareSkin();
    const { gl } = this;
    gl.bindVertexArray(this.skinArrays);
    this.detail = this.buffer(12 * doc.vertices, gl.DYNAMIC_DRAW); // zeros: the body has none
    this.attribute(6, 3, gl.FLOAT);
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
