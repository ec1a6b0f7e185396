// Two programs: `SKIN` writes the vertices of model and input into buffers, `DRAW` draws either.
// A model with rest normals is lit as engines light it: by these, turned with the blended matrices.

const WIDE = 1024; // texels in a row of a texture of points
const BONES_WIDE = 256; // bones in a row, three texels each

const SKIN_HEAD = `#version 300 es
precision highp float;
precision highp sampler2D;
layout(location = 0) in vec3 rest;
layout(location = 1) in uvec4 bonesA;
layout(location = 2) in uvec4 bonesB;
layout(location = 3) in vec4 weightsA;
layout(location = 4) in vec4 weightsB;
layout(location = 5) in vec3 off;
layout(location = 6) in vec3 restNormal; // zero where there is none
uniform sampler2D transforms;
uniform float unitOff;
out vec4 model;
out vec4 truth;
out vec4 turned;

mat3x4 rows = mat3x4(0);

void add(uint bone, float weight) {
  if (weight == 0.0) return;
  ivec2 at = ivec2(3u * (bone % ${BONES_WIDE}u), bone / ${BONES_WIDE}u);
  for (int a = 0; a < 3; a++) rows[a] += weight * texelFetch(transforms, at + ivec2(a, 0), 0);
}

mat4x3 blended() {
  for (int k = 0; k < 4; k++) add(bonesA[k], weightsA[k]);
  for (int k = 0; k < 4; k++) add(bonesB[k], weightsB[k]);
  return transpose(rows);
}

void put(vec3 p, mat4x3 blend) {
  vec3 difference = unitOff * off;
  model = vec4(p, length(difference));
  truth = vec4(p + difference, length(difference));
  turned = vec4(mat3(blend) * restNormal, 0);
  gl_Position = vec4(0);
}
`;

const SKIN_VERTEX = `${SKIN_HEAD}
void main() {
  mat4x3 blend = blended();
  put(blend * vec4(rest, 1), blend);
}`;

const SKIN_FRAGMENT = `#version 300 es
void main() {}`;

const DRAW_VERTEX = `#version 300 es
precision highp float;
precision highp sampler2D;
precision highp usampler2D;
layout(location = 0) in uint vertex;
layout(location = 1) in uvec2 fan;
layout(location = 2) in vec2 uv;
layout(location = 3) in vec4 shade;
uniform sampler2D points;
uniform sampler2D others; // what they are compared with
uniform sampler2D turned;
uniform usampler2D ring;
uniform highp int mode;
uniform bool engine; // lit by the normals that were turned, not by those of the surface
uniform mat4 view;
uniform mat4 projection;
uniform float pointSize;
uniform float behind; // as if it were so much farther, where other surfaces are near
out vec3 normal;
out vec3 place;
out vec2 texel;
out vec3 paint;
out float error;

vec4 texel4(sampler2D of, uint i) {
  return texelFetch(of, ivec2(i % ${WIDE}u, i / ${WIDE}u), 0);
}

vec3 over(vec3 v) {
  float size = length(v);
  return size > 0.0 ? v / size : vec3(0);
}

float angle(vec3 a, vec3 b) { return atan(length(cross(a, b)), dot(a, b)); }

// The mean of the normals of the triangles around, by their angles (Thürmer and Wüthrich 1998).
vec3 surface(sampler2D of) {
  vec3 p = texel4(of, vertex).xyz, sum = vec3(0);
  for (uint k = fan.x; k < fan.x + fan.y; k++) {
    uvec2 pair = texelFetch(ring, ivec2(k % ${WIDE}u, k / ${WIDE}u), 0).xy;
    vec3 a = texel4(of, pair.x).xyz - p, b = texel4(of, pair.y).xyz - p;
    vec3 face = over(cross(a, b));
    if (face != vec3(0)) sum += angle(a, b) * face;
  }
  return over(sum);
}

void main() {
  vec4 p = texel4(points, vertex);
  vec3 own = engine ? over(texel4(turned, uint(gl_VertexID)).xyz) : surface(points);
  normal = mat3(view) * own;
  vec4 seen = view * vec4(p.xyz, 1);
  place = seen.xyz;
  texel = vec2(uv.x, 1.0 - uv.y);
  paint = shade.rgb;
  error = p.w;
  if (mode == 4) {
    vec3 other = surface(others);
    error = own == vec3(0) || other == vec3(0) ? 0.0 : degrees(angle(own, other));
  }
  gl_Position = projection * seen;
  if (behind > 0.0) {
    vec4 far = projection * vec4(place + behind * normalize(place), 1);
    gl_Position.z = far.z / far.w * gl_Position.w;
  }
  gl_PointSize = clamp(pointSize / gl_Position.w, 2.0, 40.0);
}`;

const DRAW_FRAGMENT = `#version 300 es
precision highp float;
in vec3 normal;
in vec3 place;
in vec2 texel;
in vec3 paint;
in float error;
uniform highp int mode; // 0 colour alone, 1 texture, 2 colour of the vertex, 3 error, 4 error of normals
uniform bool engine;
uniform vec4 color;
uniform sampler2D image;
uniform vec3 heat[16];
uniform float top;
uniform bool cloud;
uniform bool outline;
out vec4 pixel;

vec3 linear(vec3 c) { return pow(c, vec3(2.2)); }

void main() {
  vec3 albedo = color.rgb;
  float even = 0.0;
  if (mode == 1) albedo *= linear(texture(image, texel).rgb);
  if (mode == 2) { albedo = linear(paint); even = 0.35; }
  if (mode >= 3) {
    float at = clamp(error / top, 0.0, 1.0) * 15.0;
    int low = min(int(at), 14);
    albedo = linear(mix(heat[low], heat[low + 1], at - float(low)));
    even = 0.45;
  }
  vec3 n = normal;
  if (cloud) {
    vec2 at = 2.0 * gl_PointCoord - 1.0;
    if (dot(at, at) > 1.0) discard;
    n = vec3(at.x, -at.y, sqrt(1.0 - dot(at, at)));
  } else if (dot(n, n) == 0.0) {
    n = cross(dFdx(place), dFdy(place));
  }
  n = normalize(n);
  // Both sides of a surface are lit; a normal of an engine that points inwards stays so.
  if (engine && !cloud ? !gl_FrontFacing : dot(n, place) > 0.0) n = -n;
  float key = max(0.0, dot(n, normalize(vec3(-0.45, 0.6, 0.75))));
  float fill = max(0.0, dot(n, normalize(vec3(0.8, 0.1, 0.5))));
  float light = 0.26 + 0.10 * n.y + 0.66 * key + 0.20 * fill;
  light = mix(light, 0.92, even);
  float shine = 0.05 * pow(max(0.0, dot(reflect(normalize(place), n), normalize(vec3(-0.45, 0.6, 0.75)))), 24.0);
  pixel = vec4(pow(albedo * light + shine * (1.0 - even), vec3(1.0 / 2.2)), 1.0) * color.a;
  // where a surface turns away, all else is clear
  if (outline) pixel *= pow(1.0 - abs(dot(n, normalize(place))), 2.5);
}`;
